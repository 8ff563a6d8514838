#include "app/formats/toml_writer.h"

#include <fmt/format.h>

#include <toml++/toml.h>
#include <sstream>

namespace abcal {
namespace {

/// With a point, so that TOML sees no integer.
std::string real(double value) {
  std::string digits = fmt::format("{}", value);
  if (digits.find_first_of(".en") == std::string::npos) digits += ".0";
  return digits;
}

std::string triple(const Eigen::Vector3d& v) {
  return fmt::format("[{}, {}, {}]", real(v[0]), real(v[1]), real(v[2]));
}

std::string toml_text(const std::string& value) {
  std::ostringstream text;
  text << toml::toml_formatter(toml::value<std::string>(value));
  return text.str();
}

}  // namespace

void TomlWriter::section(const std::string& path) {
  if (!path.empty()) text_ += "\n[" + path + "]\n";
  path_ = path;
}

void TomlWriter::text(const std::string& key, std::string& value, const std::vector<std::string>&) {
  line(key, toml_text(value));
}

void TomlWriter::uncertainty(const std::string& key, StatedUncertainty& stated, double, const std::string&) {
  const std::string source = stated.source.empty() ? std::string(kDefaultSource) : stated.source;
  const std::string distribution =
      stated.distribution.empty() ? "" : fmt::format(", distribution = {}", toml_text(stated.distribution));
  line(key,
       fmt::format("{{ value = {}{}, source = {} }}", real(stated.value), distribution, toml_text(source)));
}

void TomlWriter::required_text(const std::string& key, std::string& value,
                               const std::vector<std::string>& choices) {
  text(key, value, choices);
}

void TomlWriter::number(const std::string& key, double& value, Range) {
  line(key, real(value));
}

void TomlWriter::number(const std::string& key, std::optional<double>& value, Range) {
  if (value) line(key, real(*value));
}

void TomlWriter::number_or_auto(const std::string& key, double& value, bool& automatic, Range) {
  line(key, automatic ? toml_text(std::string(kAuto)) : real(value));
}

void TomlWriter::integer(const std::string& key, int& value, int, int) {
  line(key, std::to_string(value));
}

void TomlWriter::integer(const std::string& key, std::optional<int>& value, int, int) {
  if (value) line(key, std::to_string(*value));
}

void TomlWriter::seed(const std::string& key, std::uint64_t& value) {
  line(key, std::to_string(value));
}

void TomlWriter::boolean(const std::string& key, bool& value) {
  line(key, value ? "true" : "false");
}

void TomlWriter::vector(const std::string& key, Eigen::Vector3d& value, Range) {
  line(key, triple(value));
}

void TomlWriter::matrix(const std::string& key, Eigen::Matrix3d& value, Range) {
  line(key, fmt::format("[{}, {}, {}]", triple(value.row(0)), triple(value.row(1)), triple(value.row(2))));
}

void TomlWriter::numbers(const std::string& key, std::vector<double>& value, Range) {
  line(key, fmt::format("[{}]", fmt::join(value, ", ")));
}

void TomlWriter::integers(const std::string& key, std::array<int, 3>& value, int, int) {
  line(key, fmt::format("[{}, {}, {}]", value[0], value[1], value[2]));
}

void TomlWriter::tables(const std::string& key, std::size_t size,
                        const std::function<void(std::size_t)>& visit_entry) {
  const std::string outer = path_;
  for (std::size_t i = 0; i < size; ++i) {
    path_ = outer.empty() ? key : outer + "." + key;
    text_ += "\n[[" + path_ + "]]\n";
    visit_entry(i);
  }
  path_ = outer;
}

void TomlWriter::table(const std::string& key, const std::function<void()>& visit_keys) {
  const std::string outer = path_;
  path_ = outer.empty() ? key : outer + "." + key;
  text_ += "\n[" + path_ + "]\n";
  visit_keys();
  path_ = outer;
}

}  // namespace abcal
