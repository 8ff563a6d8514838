#include "app/measure/emulator/wire_log.h"

#include <fmt/format.h>

#include <boost/algorithm/hex.hpp>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>

#include "app/system/output.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kSchema = "abcal.wire/1";
constexpr const char* kHost = "host";
constexpr const char* kInstrument = "instrument";

/// @throws std::runtime_error  with the text; the library's own error has no words
std::string bytes_of(const std::string& hex) {
  try {
    return boost::algorithm::unhex(hex);
  } catch (const boost::algorithm::hex_decode_error&) {
    throw std::runtime_error(
        fmt::format("\"hex\" is \"{}\", which is not two hexadecimal digits for each byte",
                    shortened_text(printable_text(hex), 60)));
  }
}

LoggedBytes row_of(const Json& line) {
  LoggedBytes row;
  const auto from = line.at("from").get<std::string>();
  if (from != kHost && from != kInstrument) throw std::runtime_error("\"from\" is " + from);
  row.from = from == kHost ? LoggedBytes::From::kHost : LoggedBytes::From::kInstrument;
  row.t_s = line.at("t_s").get<double>();
  row.bytes = bytes_of(line.at("hex").get<std::string>());
  return row;
}

}  // namespace

WireLogWriter::WireLogWriter(const std::filesystem::path& path, const std::string& port,
                             const std::string& begun_utc)
    : path_(path) {
  if (std::filesystem::exists(path))
    throw std::runtime_error(path.string() + ": exists already; choose another name with -o");
  file_.open(path, std::ios::binary);
  write(Json{{"schema", kSchema}, {"port", port}, {"begun_utc", begun_utc}}.dump());
}

void WireLogWriter::add(const LoggedBytes& bytes) {
  write(Json{{"t_s", bytes.t_s},
             {"from", bytes.from == LoggedBytes::From::kHost ? kHost : kInstrument},
             {"hex", boost::algorithm::hex_lower(bytes.bytes)},
             {"text", wire::bytes_as_text(bytes.bytes)}}
            .dump(-1, ' ', true));
  ++rows_;
}

void WireLogWriter::write(const std::string& line) {
  file_ << line << '\n' << std::flush;
  if (!file_) throw std::runtime_error(path_.string() + ": cannot be written");
}

WireLog read_wire_log(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error(path.string() + ": cannot be read");
  WireLog log;
  std::string line;
  for (std::size_t number = 1; std::getline(file, line); ++number) {
    if (file.eof()) break;  // No line end: half a line.
    try {
      const Json json = Json::parse(line);
      if (number > 1) {
        log.rows.push_back(row_of(json));
      } else if (json.value("schema", "") == kSchema) {
        log.port = json.at("port").get<std::string>();
        log.begun_utc = json.at("begun_utc").get<std::string>();
      } else {
        throw std::runtime_error("not the beginning of a log");
      }
    } catch (const std::exception& error) {
      throw std::runtime_error(fmt::format("{}, line {}: {}; required: {}, made by `abcal record`",
                                           path.string(), number, error.what(), kSchema));
    }
  }
  if (log.begun_utc.empty())
    throw std::runtime_error(
        fmt::format("{}: empty; required: {}, made by `abcal record`", path.string(), kSchema));
  return log;
}

}  // namespace abcal
