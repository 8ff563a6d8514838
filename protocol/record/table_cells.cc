#include "protocol/record/table_cells.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <utility>

namespace abcal {
namespace {

constexpr std::array<std::string_view, 3> kReadingCells{"r_u", "r_v", "r_w"};
constexpr std::array<std::string_view, 3> kUncertaintyCells{"u_u", "u_v", "u_w"};

}  // namespace

void TableCells::problem(std::string_view name, std::string found, std::string required) {
  problems_.add(fmt::format("line {}, {}", line(), name), std::move(found), std::move(required));
}

std::optional<double> TableCells::number(std::string_view name, const char* required) {
  const std::string& cell = text(name);
  const std::optional<double> value = table_.number(cell);
  if (value && std::isfinite(*value)) return value;
  problem(name, cell.empty() ? "nothing" : as_quoted(cell),
          value ? fmt::format("{} that is finite", required) : required);
  return std::nullopt;
}

std::optional<double> TableCells::optional_number(std::string_view name) {
  return has(name) ? number(name) : std::nullopt;
}

std::optional<std::int64_t> TableCells::whole_number(std::string_view name, double lowest, double highest,
                                                     const char* required) {
  const std::optional<double> value = number(name, required);
  if (!value) return std::nullopt;
  if (*value >= lowest && *value <= highest && *value == std::floor(*value))
    return static_cast<std::int64_t>(*value);
  problem(name, as_quoted(text(name)), required);
  return std::nullopt;
}

Eigen::Vector3d TableCells::readings() {
  Eigen::Vector3d out;
  for (std::size_t j = 0; j < 3; ++j)
    out(static_cast<Eigen::Index>(j)) =
        number(kReadingCells[j]).value_or(std::numeric_limits<double>::quiet_NaN());
  return out;
}

std::optional<Eigen::Vector3d> TableCells::uncertainties() {
  Eigen::Vector3d u = Eigen::Vector3d::Zero();
  int given = 0;
  for (std::size_t j = 0; j < 3; ++j) {
    const std::string_view name = kUncertaintyCells[j];
    if (!has(name)) continue;
    ++given;
    constexpr const char* kRule = "a standard uncertainty >= 0";
    const std::optional<double> value = number(name, kRule);
    if (value && *value < 0.0) problem(name, as_quoted(text(name)), kRule);
    u(static_cast<Eigen::Index>(j)) = value.value_or(0.0);
  }
  if (given == 3) return u;
  if (given > 0)
    problems_.add(fmt::format("line {}", line()), fmt::format("{} of u_u, u_v, u_w", given),
                  "all three or none");
  return std::nullopt;
}

}  // namespace abcal
