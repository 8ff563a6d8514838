#include "app/results/report/hdf5_export.h"

#include <string>
#include <vector>

#include "app/ground/system/helper_program.h"

namespace abcal {

void export_hdf5(std::span<const ReportData> items, const std::filesystem::path& path,
                 const std::string& file_name) {
  std::vector<std::string> arguments{"export", "--file-name", file_name, "--created-utc",
                                     items.front().created_utc};
  for (const ReportData& data : items) {
    arguments.emplace_back("--item");
    arguments.push_back(std::to_string(data.item));
  }
  for (const std::string& last : {std::string("--"), items.front().path.string(), path.string()})
    arguments.push_back(last);
  run_helper("abcal-hdf5", "HDF5 is written by", arguments);
}

}  // namespace abcal
