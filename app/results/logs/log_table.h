#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/record/import_table.h"

namespace abcal {

/// Binary files of readings that other programs write.
enum class LogFormat {
  kNone,     ///< Another file, such as a table.
  kNumpy,    ///< .npy: an array.
  kUlog,     ///< ULog of PX4.
  kRosBag,   ///< Bag of ROS 1, version 2.0.
  kRos2Bag,  ///< Bag of ROS 2 in SQLite.
  kMatlab,   ///< .mat, read by the program abcal-mat.
  kRefused,  ///< Known, but not read: refuse_log() gives the reason and the conversion.
};
/// Told by the first bytes of a file, or the tables of an SQLite file.
/// @throws DiskError
LogFormat log_format(const std::filesystem::path& path);

/// The readings of a log as the text of a table, with the names of its columns, and what it is.
struct LogTable {
  std::string words;  ///< "ROS bag, topic /imu/data"
  std::string text;   ///< docs/your_file.md
};

// Each reads the bytes of a file of its format. `source` names it in errors.
// @throws std::runtime_error  with what was found and what is required

/// An array of three or four columns (or rows), or with names of columns.
LogTable numpy_table(std::string_view bytes, const std::string& source);
/// @param topic  "sensor_accel", "sensor_accel.1" (its second instance), "sensor_combined"; empty: the first
/// of these
LogTable ulog_table(std::string_view bytes, const std::string& source, const std::string& topic);
/// @param topic  of messages sensor_msgs/Imu; empty: the only one
LogTable ros_bag_table(std::string_view bytes, const std::string& source, const std::string& topic);
/// As ros_bag_table(). @throws also RunFileError
LogTable ros2_bag_table(const std::filesystem::path& path, const std::string& topic);

/// The one of `found` that was asked for, or the only one.
/// @param what  "topic of sensor_msgs/Imu"
/// @throws std::runtime_error  that lists what the log has
std::string chosen_topic(const std::vector<std::string>& found, const std::string& asked,
                         const std::string& source, const std::string& what);

/// Reads any file of readings: a table, as import_table(), or a log. What `options` do not state, its mapping
/// does (table_mapping.h).
/// @throws as import_table(), with_mapping(), keep_mapping(); std::runtime_error
ImportedTable import_readings(const std::filesystem::path& path, const TableOptions& options = {});

}  // namespace abcal
