#include "app/system/helper_program.h"

#include <utility>

namespace abcal {
namespace {

std::filesystem::path& helper_folder() {
  static std::filesystem::path folder = [] {
    std::error_code ignored;
    return std::filesystem::read_symlink("/proc/self/exe", ignored).parent_path();
  }();
  return folder;
}

}  // namespace

Tool helper_program(const std::string& name, const std::string& needed_by) {
  const std::filesystem::path beside = helper_folder() / name;
  const std::filesystem::path installed = helper_folder().parent_path() / "libexec/abcal" / name;
  std::error_code ignored;
  const std::filesystem::path& found = std::filesystem::exists(installed, ignored) ? installed : beside;
  return {found.string(), needed_by, "abcal"};
}

void set_helper_folder(std::filesystem::path folder) {
  helper_folder() = std::move(folder);
}

}  // namespace abcal
