#include "app/report/hdf5_export.h"

#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "app/system/child_process.h"
#include "app/system/helper_program.h"

namespace abcal {

void export_hdf5(const ReportData& data, const std::filesystem::path& path, const std::string& file_name) {
  const Tool helper = helper_program("abcal-hdf5", "HDF5 is written by");
  const ToolResult result =
      run_tool_for_words(helper, {"export", "--file-name", file_name, "--created-utc", data.created_utc, "--",
                                  data.path.string(), path.string()});
  if (result.exit_code == 0) return;
  constexpr std::string_view kPrefix = "abcal: ";  // Whoever shows this says it again.
  const bool has_prefix = result.words.starts_with(kPrefix);
  throw std::runtime_error(result.words.empty() ? "abcal-hdf5 failed"
                                                : result.words.substr(has_prefix ? kPrefix.size() : 0));
}

}  // namespace abcal
