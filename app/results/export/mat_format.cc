#include "app/results/export/mat_format.h"

#include <fstream>

#include "app/system/helper_program.h"
#include "app/system/read_file.h"
#include "app/system/temporary_folder.h"

namespace abcal {

std::string as_mat(const std::string& constants_json) {
  const TemporaryFolder folder;
  const std::filesystem::path constants = folder / "constants.json", output = folder / "constants.mat";
  std::ofstream(constants, std::ios::binary) << constants_json;
  run_helper("abcal-mat", "MATLAB files are written by",
             {"write", "--", constants.string(), output.string()});
  return read_file(output);
}

}  // namespace abcal
