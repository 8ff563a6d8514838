#include "protocol/record/table_cells.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <utility>

#include "drivers/instrument/angle.h"

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

std::optional<Eigen::Vector3d> TableCells::up() {
  Eigen::Vector3d up;
  if (columns_.has("up_x")) {
    const auto x = number("up_x"), y = number("up_y"), z = number("up_z");
    if (!x || !y || !z) return std::nullopt;
    up << *x, *y, *z;
    constexpr double kRoundOff = 1e-14;  // Directions that this program wrote stay as they are.
    const double length = up.norm();
    if (std::abs(length - 1.0) < kRoundOff) return up;
    if (length > 0.0 && std::isfinite(length)) return up / length;
    problem("up_x", "a direction of no length", "up_x, up_y, up_z of any length above 0");
  } else if (columns_.has("pose_roll_deg")) {
    const auto roll = number("pose_roll_deg", "an angle in degrees"),
               pitch = number("pose_pitch_deg", "an angle in degrees");
    if (!roll || !pitch) return std::nullopt;
    const SinCos r = sincos(Angle::degrees(*roll)), p = sincos(Angle::degrees(*pitch));
    return Eigen::Vector3d(-p.sin, r.sin * p.cos, r.cos * p.cos);
  } else if (columns_.has("pose_qw")) {
    constexpr double kFarFromUnit = 0.01;
    const auto w = number("pose_qw"), x = number("pose_qx"), y = number("pose_qy"), z = number("pose_qz");
    if (!w || !x || !y || !z) return std::nullopt;
    const double length2 = *w * *w + *x * *x + *y * *y + *z * *z;
    up << *x * *z - *w * *y, *y * *z + *w * *x, 0.5 * (*w * *w - *x * *x - *y * *y + *z * *z);
    if (std::abs(std::sqrt(length2) - 1.0) < kFarFromUnit) return 2.0 / length2 * up;
    problem("pose_qw", fmt::format("a quaternion of the length {:.3g}", std::sqrt(length2)), "the length 1");
  }
  return std::nullopt;
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
