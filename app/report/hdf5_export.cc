#include "app/report/hdf5_export.h"

#include <string>

#include "app/system/helper_program.h"

namespace abcal {

void export_hdf5(const ReportData& data, const std::filesystem::path& path, const std::string& file_name,
                 bool all_items) {
  run_helper("abcal-hdf5", "HDF5 is written by",
             {"export", "--file-name", file_name, "--created-utc", data.created_utc, "--item",
              std::to_string(all_items ? 0 : data.item), "--", data.path.string(), path.string()});
}

}  // namespace abcal
