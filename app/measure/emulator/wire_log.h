#pragma once

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

namespace abcal {

/// Bytes that went over a wire between a host program and an instrument.
struct LoggedBytes {
  enum class From { kHost, kInstrument };
  From from = From::kHost;
  double t_s = 0.0;  ///< Since the log began.
  std::string bytes;
};

/// Bytes that went over a wire, in the order of time.
struct WireLog {
  std::string port;  ///< Port of the instrument.
  std::string begun_utc;
  std::vector<LoggedBytes> rows;
};

/// Writes a log as it happens: a line of JSON each (docs/emulate.md, schema abcal.wire/1), on disk at once.
class WireLogWriter {
 public:
  /// @throws std::runtime_error if the file exists or cannot be written
  WireLogWriter(const std::filesystem::path& path, const std::string& port, const std::string& begun_utc);

  /// @throws std::runtime_error if it cannot be written
  void add(const LoggedBytes& bytes);
  std::size_t rows() const { return rows_; }

 private:
  void write(const std::string& line);

  std::filesystem::path path_;
  std::ofstream file_;
  std::size_t rows_ = 0;
};

/// @throws std::runtime_error naming the line of the file that is not understood. An incomplete last line, as
/// a killed program leaves it, is ignored.
WireLog read_wire_log(const std::filesystem::path& path);

}  // namespace abcal
