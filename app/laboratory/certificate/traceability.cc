#include "app/laboratory/certificate/traceability.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "app/bench_file/not_real.h"
#include "app/laboratory/certificate/certified_record.h"
#include "app/results/analysis/effect_words.h"
#include "protocol/record/run_label.h"
#include "protocol/record/run_operator.h"

namespace abcal {
namespace {

Message words_for(const Equipment& equipment) {
  return {"\"{name}\", certificate \"{certificate}\", performed {performed}, due {due}",
          equipment.name + " " + equipment.serial_number, equipment.certificate,
          date_words(equipment.performed), date_words(equipment.due)};
}

Message roles(const std::vector<std::string>& instruments) {
  std::vector<Message> all;
  for (const std::string& one : instruments) all.push_back(word_of(kRoles, one));
  return in_sequence(all, ", ");
}

/// A quantity that needs a calibration that holds on the day of the run.
struct Chain {
  Term quantity;
  /// Serial numbers of the instruments that must be calibrated; empty: any equipment will do.
  std::string serial_numbers = {};
};

void look_for(const Chain& chain, const LaboratoryFile& laboratory, Date day, const Message& which,
              std::vector<Reason>& problems) {
  std::vector<Equipment> calibrated;
  std::vector<Message> found;
  for (const Equipment& one : laboratory.equipment) {
    if (one.quantity != chain.quantity) continue;
    if (holds_on(one, day)) calibrated.push_back(one);
    found.push_back(words_for(one));
  }
  const std::string missing =
      serial_number_without_equipment(calibrated, std::string(chain.quantity), chain.serial_numbers);
  if (!calibrated.empty() && missing.empty()) return;
  const std::string date = format_date(day);
  problems.push_back(
      {which, chain.quantity, found.empty() ? Message("no calibrated equipment") : in_sequence(found),
       missing.empty()
           ? Message(
                 "equipment for {quantity} with a calibration that was performed before and holds on {day}",
                 chain.quantity, date)
           : Message("equipment for {quantity} with serial number {serial_number} and a calibration that was "
                     "performed before and holds on {day}",
                     chain.quantity, quoted(missing), date)});
}

/// Serial numbers that the instrument of a role reported; empty if it reported none.
std::string reported_serial_numbers(const StoredRun& run, const std::string& role) {
  for (const InstrumentIdentity& instrument : run.header.instruments)
    if (instrument.role == role && is_serial_number_reported(instrument.serial_number))
      return instrument.serial_number;
  return {};
}

/// Serial number from the bench file, for an instrument that reports none.
std::string stated_serial_number(const StoredRun& run, const std::string& role) {
  // With several items, the header of the whole run contains the number of each.
  return label_of(run.header.labels,
                  stated_serial_number_label(role == "accelerometer" && run.items.size() > 1
                                                 ? fmt::format("item-{}", run.item)
                                                 : role));
}

/// Requires the serial number of an instrument whose calibration is part of the traceability.
/// @param section  section of the bench file in which the serial number can be stated
void require_serial_number(const ReportData& data, const std::string& role, const std::string& section,
                           const Message& which, Term part, std::vector<Reason>& problems) {
  if (!serial_numbers_of(data, role).empty()) return;
  problems.push_back({which, part, Message("no serial number, neither reported by the instrument nor stated"),
                      Message("[{role}] serial_number in the bench file before the run", section)});
}

/// The quantities that need a calibration. Stage and voltmeter must have serial numbers.
std::vector<Chain> chains_of(const ReportData& data, const Message& which, std::vector<Reason>& problems) {
  std::vector<Chain> chains{{"angle", serial_numbers_of(data, "stage")}, {"gravity"}, {"temperature"}};
  require_serial_number(data, "stage", "stage", which, "stage", problems);
  if (!measured_by_voltmeter(data)) return chains;
  chains.push_back({"voltage", serial_numbers_of(data, "accelerometer")});
  require_serial_number(data, "accelerometer",
                        data.is_one_of_several() ? "item.accelerometer" : "accelerometer", which, "voltmeter",
                        problems);
  return chains;
}

/// A value that a calibration of the register states, U = k u.
struct CalibrationValue {
  std::string unit;
  double value = 0.0, expanded_uncertainty = 0.0, coverage_factor = 2.0;
};

/// A calibration that a run stored from the register when it began.
struct StoredCalibration {
  Equipment equipment;
  std::vector<CalibrationValue> values;
};

/// @throws std::runtime_error if the stored text cannot be read
std::vector<StoredCalibration> stored_calibrations(const StoredRun& run) {
  std::vector<StoredCalibration> calibrations;
  const std::string stored = label_of(run.header.labels, kCalibrationsLabel);
  if (stored.empty()) return calibrations;
  try {
    for (const auto& json : nlohmann::json::parse(stored)) {
      StoredCalibration calibration;
      Equipment& one = calibration.equipment;
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
      for (const auto& value : json.value("values", nlohmann::json::array()))
        calibration.values.push_back({value.at("unit"), value.at("value"), value.at("expanded_uncertainty"),
                                      value.at("coverage_factor")});
      calibrations.push_back(std::move(calibration));
    }
  } catch (const nlohmann::json::exception& error) {
    throw std::runtime_error(
        fmt::format("what the run keeps of the register cannot be read: {}", error.what()));
  }
  return calibrations;
}

/// Whether g_loc of a run is a value of a calibration, with an uncertainty that is not smaller.
bool agrees(const LocalGravity& g_loc, const CalibrationValue& value) {
  constexpr double kRounding = 1e-9;  // Both numbers went through decimal text.
  const double u = g_loc.expanded_uncertainty_mps2 / g_loc.coverage_factor;
  const double u_of_value = value.expanded_uncertainty / value.coverage_factor;
  return std::abs(g_loc.value_mps2 - value.value) <= kRounding * value.value &&
         u >= u_of_value * (1.0 - kRounding);
}

/// Values stated by the calibration of a piece of equipment, as the run stored them; a laboratory file states
/// no values.
std::vector<CalibrationValue> values_of(const ReportData& data, const Equipment& equipment) {
  if (!data.run) return {};
  for (StoredCalibration& stored : stored_calibrations(*data.run))
    if (stored.equipment.certificate == equipment.certificate &&
        stored.equipment.serial_number == equipment.serial_number)
      return std::move(stored.values);
  return {};
}

/// Requires that local gravity is that of the equipment for gravity: its source names this equipment, and its
/// value is that of the calibration.
void check_gravity(const LaboratoryFile& laboratory, const ReportData& data, Date day, const Message& which,
                   std::vector<Reason>& problems) {
  const Message part("local gravity");
  const LocalGravity& g_loc = data.record.g_loc;
  if (g_loc.source.starts_with("formula")) {
    problems.push_back({which, part, Message("by {source}", quoted(g_loc.source)),
                        Message("a survey: a formula has no calibration")});
    return;
  }
  const auto holds = [&](const Equipment& one) { return one.quantity == "gravity" && holds_on(one, day); };
  // If none holds, which is reported already, g_loc is compared with all of them.
  const bool one_holds = std::any_of(laboratory.equipment.begin(), laboratory.equipment.end(), holds);
  std::vector<std::string> known;
  std::vector<Message> stated;
  for (const Equipment& one : laboratory.equipment) {
    if (one.quantity != "gravity" || (one_holds && !holds(one))) continue;
    known.push_back(one.certificate);
    if (!names_number(g_loc.source, one.certificate) && !names_number(g_loc.source, one.serial_number))
      continue;
    const std::size_t before = stated.size();
    for (const CalibrationValue& value : values_of(data, one)) {
      if (value.unit != "m/s2") continue;
      if (agrees(g_loc, value)) return;
      stated.push_back(Message("g_loc = {value} m/s2, U = {expanded:g} m/s2, k = {factor:g}", value.value,
                               value.expanded_uncertainty, value.coverage_factor));
    }
    if (stated.size() == before) return;  // It states no value: the source names it.
  }
  if (known.empty()) return;  // The missing calibration has been reported already.
  if (!stated.empty()) {
    problems.push_back({which, part,
                        Message("g_loc = {value} m/s2, U = {expanded:g} m/s2, k = {factor:g}",
                                g_loc.value_mps2, g_loc.expanded_uncertainty_mps2, g_loc.coverage_factor),
                        Message("as its source states it: {values}", in_sequence(stated, " / "))});
    return;
  }
  problems.push_back(
      {which, part,
       g_loc.source.empty() ? Message("no source") : Message("source \"{source}\"", g_loc.source),
       Message("[bench] g_loc_mps2 from a record of the register, or a g_loc_source that names the "
               "certificate of the equipment for gravity: {certificates}",
               fmt::format("\"{}\"", fmt::join(known, "\" / \"")))});
}

}  // namespace

bool holds_on(const Equipment& equipment, Date day) {
  return equipment.performed && *equipment.performed <= day && equipment.due && day <= *equipment.due;
}

Message date_words(const std::optional<Date>& date) {
  return date ? Message("{date}", format_date(*date)) : Message("not stated");
}

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

std::vector<Reason> against_traceability(const LaboratoryFile& laboratory, const ReportData& data,
                                         const Message& which) {
  std::vector<Reason> problems;
  if (!data.run) return problems;
  if (!data.simulated.empty())
    problems.push_back({which, Message("instruments"),
                        Message("simulated: {instruments}", roles(data.simulated)),
                        Message("real ones, no [simulation] in the bench file, no serial number of the "
                                "emulator: nothing was calibrated")});
  if (!data.label("replay.of").empty())
    problems.push_back({which,
                        {},
                        Message("repeated from the recording of {source}", quoted(data.label("replay.of"))),
                        Message("a measured run")});
  if (const auto day = parse_date(data.ended_utc())) {
    for (const Chain& chain : chains_of(data, which, problems))
      look_for(chain, laboratory, *day, which, problems);
    check_gravity(laboratory, data, *day, which, problems);
  } else {
    problems.push_back({which, {}, Message("no date"), Message("a run that says when it was made")});
  }
  const EffectSizes sizes = sizes_behind(data);
  if (const Message words = default_effects_words(sizes, Advice::kNone); !words.empty())
    problems.push_back({which, Message("effects"), words, Message("a source for each")});
  if (const std::vector<Message> bare = effects_without_source(sizes); !bare.empty())
    problems.push_back({which, Message("effects"), Message("stated without a source: {effects}", bare),
                        Message("a source for each: a table with value and source in place of the number")});
  if (const std::vector<Term> unstated = unstated_voltmeter(data); !unstated.empty())
    problems.push_back({which, Message("voltmeter"),
                        Message("not stated: {effects}", Joined{{unstated.begin(), unstated.end()}, ", "}),
                        Message("[item_uncertainty] voltmeter_gain and voltmeter_offset, each with its "
                                "source (0 where the other covers it)")});
  return problems;
}

bool names_number(std::string_view text, std::string_view number) {
  if (number.find_first_not_of(' ') == std::string_view::npos) return false;
  constexpr std::string_view kJoins = "-/._";
  const auto is_word = [&](std::size_t at) {
    return at < text.size() && (std::isalnum(static_cast<unsigned char>(text[at])) != 0);
  };
  const auto goes_on = [&](std::size_t at, std::size_t next) {
    return is_word(at) ||
           (at < text.size() && kJoins.find(text[at]) != std::string_view::npos && is_word(next));
  };
  for (std::size_t at = text.find(number); at != std::string_view::npos; at = text.find(number, at + 1)) {
    // At the beginning, at - 1 wraps around to a position beyond the end, which has no character.
    if (!goes_on(at - 1, at - 2) && !goes_on(at + number.size(), at + number.size() + 1)) return true;
  }
  return false;
}

std::string serial_numbers_of(const StoredRun& run, const std::string& role) {
  const std::string reported = reported_serial_numbers(run, role);
  return reported.empty() ? stated_serial_number(run, role) : reported;
}

std::string serial_numbers_of(const ReportData& data, const std::string& role) {
  return data.run ? serial_numbers_of(*data.run, role) : std::string();
}

bool is_serial_number_stated(const ReportData& data, const std::string& role) {
  return data.run && reported_serial_numbers(*data.run, role).empty() &&
         !stated_serial_number(*data.run, role).empty();
}

std::vector<Equipment> equipment_of_run(const StoredRun& run) {
  std::vector<Equipment> equipment;
  for (StoredCalibration& stored : stored_calibrations(run)) equipment.push_back(std::move(stored.equipment));
  return equipment;
}

std::vector<Equipment> equipment_of_run(const ReportData& data) {
  if (!data.run) return {};
  try {
    return equipment_of_run(*data.run);
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(fmt::format("{}: {}", data.path.string(), error.what()));
  }
}

bool is_environment_stated(const ReportData& data) {
  return !data.bench || data.bench->environment.driver.empty();
}

}  // namespace abcal
