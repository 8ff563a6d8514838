#include "app/results/logs/log_table.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <sstream>
#include <stdexcept>

#include "app/results/analysis/other_file.h"
#include "app/results/logs/table_mapping.h"
#include "app/system/helper_program.h"
#include "app/system/read_file.h"
#include "app/system/temporary_folder.h"
#include "protocol/record/run_schema.h"

namespace abcal {
namespace {

/// A log is read into memory, and its rows become text there.
constexpr std::size_t kLargestLog = std::size_t{2} << 30;

/// Logs that are known and not read, with what makes them readable.
struct Refused {
  std::string_view begins, what, remedy;
};
constexpr std::array kRefused{
    Refused{"\x89MCAP", "an MCAP file", "`ros2 bag convert` into sqlite3, or `mcap convert`"},
    Refused{"\x28\xb5\x2f\xfd", "a file compressed by zstd", "`zstd -d`, then the bag"},
    Refused{"PK\x03\x04", "a ZIP archive, such as .npz or a spreadsheet",
            "numpy.save(), or the sheet saved as CSV"},
    Refused{"\x1f\x8b", "a file compressed by gzip", "`gunzip`"},
    Refused{"\xa3\x95\x80", "a DataFlash log of ArduPilot", "`mavlogdump.py --types IMU --format csv`"},
};

const Refused* refused(std::string_view start) {
  const auto found =
      std::ranges::find_if(kRefused, [&](const Refused& each) { return start.starts_with(each.begins); });
  return found == kRefused.end() ? nullptr : &*found;
}

LogTable matlab_table(const std::filesystem::path& path) {
  const TemporaryFolder folder;
  const std::filesystem::path output = folder / "readings.csv";
  run_helper("abcal-mat", "MATLAB files are read by", {"read", "--", path.string(), output.string()});
  return {"MATLAB file", read_file(output)};
}

LogTable read_log(LogFormat format, const std::filesystem::path& path, const TableOptions& options) {
  const std::string source = path.string();
  switch (format) {
    case LogFormat::kNumpy:
      return numpy_table(read_file(path, kLargestLog), source);
    case LogFormat::kUlog:
      return ulog_table(read_file(path, kLargestLog), source, options.topic);
    case LogFormat::kRosBag:
      return ros_bag_table(read_file(path, kLargestLog), source, options.topic);
    case LogFormat::kRos2Bag:
      return ros2_bag_table(path, options.topic);
    case LogFormat::kMatlab:
      return matlab_table(path);
    default: {
      const Refused& known = *refused(beginning_of_file(path));
      throw std::runtime_error(
          fmt::format("{}: is {}; required: a table of readings, or a log that is not packed ({})", source,
                      known.what, known.remedy));
    }
  }
}

/// Without a mapping that is kept.
ImportedTable import_stated(const std::filesystem::path& path, const TableOptions& options) {
  const LogFormat format = log_format(path);
  if (format == LogFormat::kNone) return import_table(path, options);
  LogTable log = read_log(format, path, options);
  std::istringstream text(std::move(log.text));
  ImportedTable table = import_table(text, path.string(), options);
  std::string& first = table.record.read_as.front();
  first = log.words + ": " + first;
  return table;
}

}  // namespace

LogFormat log_format(const std::filesystem::path& path) {
  const std::string start = beginning_of_file(path);
  if (start.starts_with("\x93NUMPY")) return LogFormat::kNumpy;
  if (start.starts_with("ULog\x01\x12\x35")) return LogFormat::kUlog;
  if (start.starts_with("#ROSBAG V")) return LogFormat::kRosBag;
  if (start.starts_with("MATLAB 5.0 MAT-file") || start.starts_with("MATLAB 7.3 MAT-file"))
    return LogFormat::kMatlab;
  if (refused(start) != nullptr) return LogFormat::kRefused;
  return begins_as_sqlite(path) && is_ros2_bag(path) ? LogFormat::kRos2Bag : LogFormat::kNone;
}

ImportedTable import_readings(const std::filesystem::path& path, const TableOptions& options) {
  std::string from_mapping;
  const TableOptions stated = with_mapping(path, options, from_mapping);
  ImportedTable table = import_stated(path, stated);
  if (options.keep) {
    keep_mapping(path, stated);
    from_mapping = "kept in " + mapping_path(path).filename().string();
  }
  if (!from_mapping.empty()) table.record.read_as.front() += "; " + from_mapping;
  return table;
}

}  // namespace abcal
