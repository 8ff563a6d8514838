#include "app/laboratory/register/find_operator.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "app/laboratory/register/login.h"

namespace abcal {
namespace {

nlohmann::ordered_json to_json(const lab::Equipment& equipment, const lab::Calibration& calibration) {
  nlohmann::ordered_json values = nlohmann::ordered_json::array();
  for (const lab::CalibratedValue& value : calibration.values) {
    values.push_back({{"name", value.name},
                      {"unit", value.unit},
                      {"value", value.value},
                      {"expanded_uncertainty", value.expanded_uncertainty},
                      {"coverage_factor", value.coverage_factor}});
  }
  return {{"equipment", equipment.identity},
          {"name", equipment.name},
          {"maker", equipment.maker},
          {"model", equipment.model},
          {"serial_number", equipment.serial_number},
          {"quantity", equipment.quantity},
          {"certificate", calibration.certificate},
          {"issuer", calibration.issuer},
          {"performed", calibration.performed},
          {"due", calibration.due},
          {"sha256", calibration.sha256},
          {"values", values}};
}

std::string calibrations_of(lab::Register& opened, const std::string& today) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  std::vector<lab::Calibration> calibrations = opened.calibrations();
  for (const lab::Withdrawal& withdrawn : opened.withdrawals())
    std::erase_if(calibrations, [&](const lab::Calibration& one) {
      return withdrawn.kind == lab::kCalibrationKind && withdrawn.name == one.certificate;
    });
  for (const lab::Equipment& equipment : opened.equipment()) {
    if (!equipment.retired.empty()) continue;
    for (const lab::Calibration& calibration : calibrations)
      if (calibration.equipment == equipment.identity && calibration.holds_on(today))
        list.push_back(to_json(equipment, calibration));
  }
  return list.dump();
}

}  // namespace

std::vector<std::string> unknown_calibrations(lab::Register& opened, const std::string& calibrations_json) {
  nlohmann::json known = nlohmann::json::array();
  const std::vector<lab::Calibration> calibrations = opened.calibrations();
  for (const lab::Equipment& equipment : opened.equipment())
    for (const lab::Calibration& calibration : calibrations)
      if (calibration.equipment == equipment.identity)
        known.push_back(nlohmann::json(to_json(equipment, calibration)));
  // Earlier versions stated fewer members.
  const auto is_stated_by = [](const nlohmann::json& stated, const nlohmann::json& one) {
    return std::ranges::all_of(stated.items(), [&](const auto& member) {
      const auto found = one.find(member.key());
      return found != one.end() && *found == member.value();
    });
  };
  std::vector<std::string> unknown;
  const nlohmann::json all = nlohmann::json::parse(calibrations_json, nullptr, false);
  if (!all.is_array()) return {"of no certificate"};
  for (const nlohmann::json& stated : all)
    if (std::ranges::none_of(known, [&](const nlohmann::json& one) { return is_stated_by(stated, one); }))
      unknown.push_back(stated.is_object() ? stated.value("certificate", "of no certificate")
                                           : "of no certificate");
  return unknown;
}

RegisteredStart find_operator(const std::string& stated, Clock::UtcTime now, const std::string& login) {
  const std::string location = lab::register_location({});
  if (location.empty()) {
    if (login.empty()) return {{stated, {}}, {}};
    throw std::invalid_argument(
        "the console has a register, but the process that holds the bench has none; required: the same "
        "ABCAL_REGISTER for both");
  }
  lab::Register opened = lab::Register::open(location, now);
  const lab::LoggedIn person = login.empty() ? lab::require_login(opened, now) : opened.who(login, now);
  if (!person.person().may(lab::Right::kMeasure))
    throw std::invalid_argument(fmt::format(
        "{} is logged in but may not measure; required: a person with the right to measure", person.name()));
  if (!stated.empty() && stated != person.name())
    throw std::invalid_argument(fmt::format(
        "[operator] name is \"{}\", but {} is logged in; required: the person who is logged in, or no name",
        stated, person.name()));
  return {{person.name(), opened.facts().identity}, calibrations_of(opened, format_utc(now).substr(0, 10))};
}

}  // namespace abcal
