#include "protocol/record/limits_entries.h"

#include <fmt/format.h>

namespace abcal {
namespace {

std::string in_full(double value) {
  return fmt::format("{}", value);
}

}  // namespace

std::map<std::string, std::string> limits_entries(const LimitsConfig& limits, const ExpectedItem& expected) {
  std::map<std::string, std::string> entries{
      {"limits.temperature_min_degc", in_full(limits.temperature_min_degc)},
      {"limits.temperature_max_degc", in_full(limits.temperature_max_degc)},
      {"limits.mounting_deg", in_full(limits.mounting.deg())},
      {"expected.sensitivity_tolerance", in_full(expected.sensitivity_tolerance)},
      {"expected.mounting", expected.mounting},
  };
  const auto optional = [&](const char* name, const std::optional<double>& value) {
    if (value) entries[name] = in_full(*value);
  };
  optional("limits.temperature_change_degc", limits.temperature_change_degc);
  optional("limits.drift", limits.drift);
  if (limits.slip) entries["limits.slip_deg"] = in_full(limits.slip->deg());
  if (limits.angle) entries["limits.angle_deg"] = in_full(limits.angle->deg());
  optional("expected.nominal_sensitivity", expected.nominal_sensitivity);
  return entries;
}

void read_limits_entries(const std::function<std::optional<double>(const std::string&)>& number,
                         const std::function<std::optional<std::string>(const std::string&)>& text,
                         LimitsConfig& limits, ExpectedItem& expected) {
  const auto set = [&](const char* name, auto& value) {
    if (const auto found = number(name)) value = *found;
  };
  const auto set_angle = [&](const char* name, auto& angle) {
    if (const auto found = number(name)) angle = Angle::degrees(*found);
  };
  set("limits.temperature_min_degc", limits.temperature_min_degc);
  set("limits.temperature_max_degc", limits.temperature_max_degc);
  set("limits.temperature_change_degc", limits.temperature_change_degc);
  set("limits.drift", limits.drift);
  set_angle("limits.mounting_deg", limits.mounting);
  set_angle("limits.slip_deg", limits.slip);
  set_angle("limits.angle_deg", limits.angle);
  set("expected.nominal_sensitivity", expected.nominal_sensitivity);
  set("expected.sensitivity_tolerance", expected.sensitivity_tolerance);
  if (const auto mounting = text("expected.mounting")) expected.mounting = *mounting;
}

}  // namespace abcal
