#include "app/laboratory/register/register_lookup.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <vector>

#include "app/laboratory/register/login.h"
#include "app/system/real_clock.h"
#include "protocol/record/run_file.h"

namespace abcal {
namespace {

/// The register's equipment and calibrations, read once.
struct Records {
  std::string today;
  std::vector<lab::Equipment> equipment;
  std::vector<lab::Calibration> calibrations;
  std::vector<lab::Withdrawal> withdrawals;
};

Records read_records() {
  const std::string location = lab::register_location({});
  if (location.empty())
    throw RecordProblem("a record, but no register is configured",
                        "a register that has it: ABCAL_REGISTER=FILE or postgresql://...");
  const Clock::UtcTime now = RealClock().utc_now();
  try {
    lab::Register opened = lab::Register::open(location, now);
    return {format_utc(now).substr(0, 10), opened.equipment(), opened.calibrations(), opened.withdrawals()};
  } catch (const lab::RegisterError& error) {
    throw RecordProblem(fmt::format("a record that cannot be read: {}", error.what()), "the register");
  }
}

RecordedValue find_value(const Records& records, const std::string& record, const std::string& name) {
  const auto calibration =
      std::find_if(records.calibrations.begin(), records.calibrations.end(),
                   [&](const lab::Calibration& one) { return one.certificate == record; });
  if (calibration == records.calibrations.end()) {
    std::vector<std::string> known;
    for (const lab::Calibration& one : records.calibrations) known.push_back(one.certificate);
    throw RecordProblem(fmt::format("record \"{}\", which the register does not have", record),
                        known.empty() ? "a calibration of the register, which has none"
                                      : fmt::format("one of {}", fmt::join(known, ", ")));
  }
  const std::string words =
      fmt::format("calibration {} of {} by {}, performed {}, due {}", record, calibration->equipment,
                  calibration->issuer, calibration->performed, calibration->due);
  if (!calibration->holds_on(records.today))
    throw RecordProblem(words, fmt::format("a calibration that holds today, {}", records.today));
  for (const lab::Withdrawal& one : records.withdrawals)
    if (one.kind == lab::kCalibrationKind && one.name == record)
      throw RecordProblem(
          fmt::format("{}, which was withdrawn on {} because {}", words, one.date(), one.reason),
          "a calibration that was not withdrawn");
  for (const lab::Equipment& one : records.equipment)
    if (one.identity == calibration->equipment && !one.retired.empty())
      throw RecordProblem(fmt::format("{}, which is retired since {}", words, one.retired),
                          "a calibration of equipment in use");
  std::vector<std::string> names;
  for (const lab::CalibratedValue& value : calibration->values) {
    names.push_back(value.name);
    if (value.name != name) continue;
    return {
        value.value, value.expanded_uncertainty, value.coverage_factor, value.unit,
        fmt::format("{}, valid on {}: {} = {} {}, U = {:g} {}, k = {:g}", words, records.today, name,
                    value.value, value.unit, value.expanded_uncertainty, value.unit, value.coverage_factor)};
  }
  throw RecordProblem(
      fmt::format("{}, which has no value \"{}\"", words, name),
      names.empty() ? "a calibration with values" : fmt::format("name = one of {}", fmt::join(names, ", ")));
}

}  // namespace

RecordLookup register_records() {
  auto records = std::make_shared<std::optional<Records>>();
  return [records](const std::string& record, const std::string& name) {
    if (!*records) *records = read_records();
    return find_value(**records, record, name);
  };
}

}  // namespace abcal
