#include "app/certificate/traceability.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "app/results/effect_words.h"
#include "app/results/not_real.h"
#include "protocol/record/run_operator.h"

namespace abcal {
namespace {

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
struct Chain {
  std::string quantity;
  std::string serial_numbers;  ///< Of the instruments that must be calibrated; empty: any equipment will do.
};

void look_for(const Chain& chain, const LaboratoryFile& laboratory, Date day, const std::string& which,
              std::vector<Problem>& problems) {
  std::vector<Equipment> calibrated;
  std::string found;
  for (const Equipment& one : laboratory.equipment) {
    if (one.quantity != chain.quantity) continue;
    if (holds_on(one, day)) calibrated.push_back(one);
    found += (found.empty() ? "" : "; ") + words_for(one);
  }
  const std::string missing =
      serial_number_without_equipment(calibrated, chain.quantity, chain.serial_numbers);
  if (!calibrated.empty() && missing.empty()) return;
  const std::string date = format_date(day);
  problems.push_back(
      {which + ", " + chain.quantity, found.empty() ? "no calibrated equipment" : found,
       missing.empty()
           ? fmt::format("equipment for {} with a calibration that was performed before and holds on {}",
                         chain.quantity, date)
           : fmt::format("equipment for {} with serial number {} and a calibration that was performed before "
                         "and holds on {}",
                         chain.quantity, missing, date)});
}

/// Serial numbers of the instruments of a part of the bench, "123/456".
std::string serial_numbers_of(const StoredRun& run, std::string_view role) {
  std::string all;
  for (const InstrumentIdentity& instrument : run.header.instruments)
    if (instrument.role.starts_with(role) && !instrument.serial_number.empty())
      all += (all.empty() ? "" : "/") + instrument.serial_number;
  return all;
}

/// Angle and voltage were measured by instruments that say who they are.
std::vector<Chain> chains_of(const ReportData& data) {
  std::vector<Chain> chains{
      {"angle", serial_numbers_of(*data.run, "stage")}, {"gravity", {}}, {"temperature", {}}};
  const bool by_voltmeter = data.bench && data.bench->accelerometer.driver.starts_with("scpi_");
  if (measured_by_voltmeter(data))
    chains.push_back(
        {"voltage", by_voltmeter ? serial_numbers_of(*data.run, "accelerometer") : std::string()});
  return chains;
}

}  // namespace

std::string serial_number_without_equipment(const std::vector<Equipment>& equipment,
                                            const std::string& quantity, const std::string& serial_numbers) {
  const auto is_listed = [&](const std::string& serial_number) {
    return std::any_of(equipment.begin(), equipment.end(), [&](const Equipment& one) {
      return one.quantity == quantity && one.serial_number == serial_number;
    });
  };
  if (serial_numbers.empty() || is_listed(serial_numbers)) return {};
  for (const std::string& part : single_serial_numbers(serial_numbers))
    if (!is_listed(part)) return part;
  return {};
}

std::vector<Problem> against_traceability(const LaboratoryFile& laboratory, const ReportData& data,
                                          const std::string& which) {
  std::vector<Problem> problems;
  if (!data.run) return problems;
  if (!data.simulated.empty())
    problems.push_back({which + ", instruments",
                        fmt::format("simulated: {}", fmt::join(data.simulated, ", ")),
                        "real ones, no [simulation] in the bench file, no serial number of the emulator: "
                        "nothing was calibrated"});
  if (!data.label("replay.of").empty())
    problems.push_back(
        {which, "repeated from the recording of " + data.label("replay.of"), "a measured run"});
  if (const auto day = parse_date(data.ended_utc())) {
    for (const Chain& chain : chains_of(data)) look_for(chain, laboratory, *day, which, problems);
  } else {
    problems.push_back({which, "no date", "a run that says when it was made"});
  }
  if (data.record.g_loc.source.starts_with("formula"))
    problems.push_back({which + ", local gravity", "by " + data.record.g_loc.source,
                        "a survey: a formula has no calibration"});
  if (const std::string words = default_effects_words(data.record.tolerances); !words.empty())
    problems.push_back({which + ", effects", words, "a source for each"});
  if (const std::vector<std::string> unstated = unstated_voltmeter(data); !unstated.empty())
    problems.push_back(
        {which + ", voltmeter", fmt::format("not stated: {}", fmt::join(unstated, ", ")),
         "[item_uncertainty] voltmeter_gain and voltmeter_offset, each with its source (0 where "
         "the other covers it)"});
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
