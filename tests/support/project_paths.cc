#include "tests/support/project_paths.h"

namespace abcal::test {

std::filesystem::path source_folder() {
  return ABCAL_SOURCE_DIR;
}

std::string abcal_program() {
  return ABCAL_PROGRAM;
}

}  // namespace abcal::test
