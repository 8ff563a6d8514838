#include "app/certificate/traceability.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "app/results/effect_words.h"
#include "protocol/record/run_operator.h"

namespace abcal {
namespace {

/// The parts of "123/456".
std::vector<std::string> parts_of(const std::string& serial_numbers) {
  std::vector<std::string> parts;
  std::size_t at = 0;
  while (at <= serial_numbers.size()) {
    const std::size_t end = std::min(serial_numbers.find('/', at), serial_numbers.size());
    parts.push_back(serial_numbers.substr(at, end - at));
    at = end + 1;
  }
  return parts;
}

/// Whether a calibration of equipment holds on a day.
bool holds_on(const Equipment& equipment, Date day) {
  return equipment.performed && *equipment.performed <= day && equipment.due && day <= *equipment.due;
}

std::string words_for(const Equipment& equipment) {
  return fmt::format("{} {}, certificate {}, performed {}, due {}", equipment.name, equipment.serial_number,
                     equipment.certificate,
                     equipment.performed ? format_date(*equipment.performed) : "not stated",
                     equipment.due ? format_date(*equipment.due) : "not stated");
}

/// A quantity that needs a calibration that holds on the day of the run.
void look_for(const std::string& quantity, const LaboratoryFile& laboratory, Date day,
              const std::string& which, std::vector<Problem>& problems) {
  std::string found;
  for (const Equipment& one : laboratory.equipment) {
    if (one.quantity != quantity) continue;
    if (holds_on(one, day)) return;
    found += (found.empty() ? "" : "; ") + words_for(one);
  }
  problems.push_back(
      {which + ", " + quantity, found.empty() ? "no calibrated equipment" : found,
       fmt::format("equipment for {} with a calibration that was performed before and holds on {}", quantity,
                   format_date(day))});
}

}  // namespace

bool has_serial_number(const Equipment& equipment, const std::string& instrument_serial_number) {
  if (equipment.serial_number == instrument_serial_number) return true;
  const std::vector<std::string> parts = parts_of(instrument_serial_number);
  return std::find(parts.begin(), parts.end(), equipment.serial_number) != parts.end();
}

std::vector<Problem> against_traceability(const LaboratoryFile& laboratory, const ReportData& data,
                                          const std::string& which) {
  std::vector<Problem> problems;
  if (!data.run) return problems;
  if (!data.simulated.empty())
    problems.push_back({which + ", instruments",
                        fmt::format("simulated: {}", fmt::join(data.simulated, ", ")),
                        "real ones: nothing was calibrated"});
  if (!data.label("replay.of").empty())
    problems.push_back(
        {which, "repeated from the recording of " + data.label("replay.of"), "a measured run"});
  if (const auto day = parse_date(data.ended_utc())) {
    for (const char* quantity : {"angle", "gravity", "temperature"})
      look_for(quantity, laboratory, *day, which, problems);
    if (data.record.response_unit.ends_with("V")) look_for("voltage", laboratory, *day, which, problems);
  } else {
    problems.push_back({which, "no date", "a run that says when it was made"});
  }
  if (data.record.g_loc.source.starts_with("formula"))
    problems.push_back({which + ", local gravity", "by " + data.record.g_loc.source,
                        "a survey: a formula has no calibration"});
  if (const std::string words = default_effects_words(data.record.tolerances); !words.empty())
    problems.push_back({which + ", effects", words, "a source for each"});
  return problems;
}

std::vector<Equipment> equipment_of_run(const ReportData& data) {
  std::vector<Equipment> equipment;
  const std::string stored = data.label(kCalibrationsLabel);
  if (stored.empty()) return equipment;
  try {
    for (const auto& json : nlohmann::json::parse(stored)) {
      Equipment one;
      one.name = json.at("name");
      one.maker = json.at("maker");
      one.model = json.at("model");
      one.serial_number = json.at("serial_number");
      one.quantity = json.at("quantity");
      one.certificate = json.at("certificate");
      one.certificate_issuer = json.at("issuer");
      one.certificate_sha256 = json.at("sha256");
      one.performed = parse_date(json.at("performed").get<std::string>());
      one.due = parse_date(json.at("due").get<std::string>());
      equipment.push_back(std::move(one));
    }
  } catch (const nlohmann::json::exception& error) {
    throw std::runtime_error(fmt::format("{}: what it keeps of the register cannot be read: {}",
                                         data.path.string(), error.what()));
  }
  return equipment;
}

bool is_environment_stated(const ReportData& data) {
  return !data.bench || data.bench->environment.driver.empty();
}

}  // namespace abcal
