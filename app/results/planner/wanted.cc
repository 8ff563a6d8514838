#include "app/results/planner/wanted.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <charconv>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "drivers/text/text.h"

namespace abcal {
namespace {

constexpr std::array<PlannedOutput, kPlannedOutputs> kAll{
    PlannedOutput::kSensitivity, PlannedOutput::kOffDiagonal, PlannedOutput::kOffset, PlannedOutput::kAngle};

/// Factor of a unit; absent: the output has no such unit.
std::optional<double> factor_of(PlannedOutput output, std::string_view unit) {
  if (output == PlannedOutput::kAngle) {
    if (unit == "deg" || unit == "degree") return 1.0;
    return std::nullopt;
  }
  if (unit.empty()) return 1.0;
  if (unit == "ppm") return 1e-6;
  if (unit == "g" && output == PlannedOutput::kOffset) return 1.0;
  return std::nullopt;
}

std::string_view units_of(PlannedOutput output) {
  switch (output) {
    case PlannedOutput::kAngle:
      return "deg";
    case PlannedOutput::kOffset:
      return "no unit, g or ppm";
    default:
      return "no unit or ppm (relative to the sensitivity)";
  }
}

/// One "phi=1e-3 deg".
/// @return a problem, or nothing
std::optional<std::string> read_one(std::string_view text, WantedValues& wanted) {
  const std::size_t sign = text.find('=');
  const std::string_view name = pieces::trimmed(text.substr(0, sign));
  std::optional<PlannedOutput> output;
  for (const PlannedOutput each : kAll) {
    if (name == symbol_of(each)) output = each;
  }
  if (!output || sign == std::string_view::npos)
    return fmt::format("\"{}\"; required: s=, off=, O= or phi= and a value", pieces::trimmed(text));
  const std::string_view rest = pieces::trimmed(text.substr(sign + 1));
  double value = 0.0;
  const auto [end, error] = std::from_chars(rest.data(), rest.data() + rest.size(), value);
  if (error != std::errc()) return fmt::format("{}: \"{}\" is not a number", name, rest);
  const std::string_view unit = pieces::trimmed(rest.substr(static_cast<std::size_t>(end - rest.data())));
  const auto factor = factor_of(*output, unit);
  if (!factor) return fmt::format("{}: unit \"{}\"; required: {}", name, unit, units_of(*output));
  if (!std::isfinite(value) || value <= 0.0)
    return fmt::format("{} is {}; required: a standard uncertainty above 0", name, rest);
  std::optional<double>& place = wanted[static_cast<std::size_t>(*output)];
  if (place) return fmt::format("{} is given twice", name);
  place = value * *factor;
  return std::nullopt;
}

}  // namespace

std::string_view symbol_of(PlannedOutput output) {
  constexpr std::array<std::string_view, kPlannedOutputs> kSymbols{"s", "off", "O", "phi"};
  return kSymbols[static_cast<std::size_t>(output)];
}

std::string_view unit_of(PlannedOutput output) {
  return output == PlannedOutput::kAngle ? "degree" : "";
}

WantedValues published_wanted() {
  return {1e-5, 2e-4, 5e-5, 5e-3};
}

WantedValues parse_wanted(std::string_view text) {
  WantedValues wanted;
  std::vector<std::string> problems;
  for (const std::string_view part : pieces::split(text, ',')) {
    if (auto problem = read_one(part, wanted)) problems.push_back(*std::move(problem));
  }
  if (!problems.empty()) throw std::invalid_argument(fmt::format("--reach: {}", fmt::join(problems, "; ")));
  return wanted;
}

}  // namespace abcal
