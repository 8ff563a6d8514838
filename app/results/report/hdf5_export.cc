#include "app/results/report/hdf5_export.h"

#include <fmt/format.h>

#include <fstream>
#include <stdexcept>

#include "app/results/report/record_hdf5.h"
#include "app/system/helper_program.h"
#include "app/system/output_file.h"

namespace abcal {

void export_hdf5(std::span<const ReportData> items, const std::filesystem::path& path,
                 const std::string& file_name) {
  // In the same folder, where there is room for all readings; the folder for temporary files may be in
  // memory.
  const OutputFile tree(std::filesystem::path(path).replace_extension(".tree"));
  std::ofstream stream(tree.temporary(), std::ios::binary);
  write_hdf5_tree(items, file_name, stream);
  stream.close();
  if (!stream)
    throw std::runtime_error(fmt::format("{}: cannot be written (is the disk full?)", path.string()));
  run_helper("abcal-hdf5", "HDF5 is written by", {"write", "--", tree.temporary().string(), path.string()});
}

}  // namespace abcal
