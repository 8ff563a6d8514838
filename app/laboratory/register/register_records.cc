#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>

#include "app/laboratory/register/register.h"
#include "protocol/record/run_file.h"

namespace abcal::lab {
namespace {

constexpr std::array kQuantities{"angle",    "voltage",  "gravity", "temperature",
                                 "humidity", "pressure", "level",   kStageRecordQuantity,
                                 "other"};

bool is_date(const std::string& text) {
  if (text.size() != 10 || text[4] != '-' || text[7] != '-') return false;
  const auto number = [&](std::size_t from, std::size_t length) {
    int value = -1;
    const char* end = text.data() + from + length;
    return std::from_chars(text.data() + from, end, value).ptr == end ? value : -1;
  };
  const std::chrono::year_month_day date{std::chrono::year(number(0, 4)),
                                         std::chrono::month(static_cast<unsigned>(number(5, 2))),
                                         std::chrono::day(static_cast<unsigned>(number(8, 2)))};
  return date.ok();
}

nlohmann::ordered_json to_json(const std::vector<CalibratedValue>& values) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const CalibratedValue& value : values) {
    list.push_back({{"name", value.name},
                    {"unit", value.unit},
                    {"value", value.value},
                    {"expanded_uncertainty", value.expanded_uncertainty},
                    {"coverage_factor", value.coverage_factor}});
  }
  return list;
}

std::vector<CalibratedValue> values_of(const std::string& text) {
  std::vector<CalibratedValue> values;
  for (const auto& json : nlohmann::json::parse(text)) {
    values.push_back({json.at("name"), json.at("unit"), json.at("value"), json.at("expanded_uncertainty"),
                      json.at("coverage_factor")});
  }
  return values;
}

/// All problems of a calibration.
std::vector<std::string> problems_of(const Calibration& calibration, const std::string& today) {
  std::vector<std::string> problems;
  if (calibration.certificate.empty()) problems.emplace_back("the number of its certificate is not given");
  if (calibration.issuer.empty()) problems.emplace_back("its issuer is not given");
  for (const auto& [name, date] :
       {std::pair{"performed", calibration.performed}, std::pair{"due", calibration.due}}) {
    if (!is_date(date))
      problems.push_back(fmt::format("{}: \"{}\"; required: a date, 2026-03-01", name, date));
  }
  if (problems.empty() && calibration.performed > today)
    problems.push_back(
        fmt::format("performed on {}, which is after today, {}", calibration.performed, today));
  if (problems.empty() && calibration.due < calibration.performed)
    problems.push_back(
        fmt::format("due on {}, before it was performed, {}", calibration.due, calibration.performed));
  for (const CalibratedValue& value : calibration.values) {
    if (!std::isfinite(value.value) || !(value.expanded_uncertainty > 0.0) || !(value.coverage_factor >= 1.0))
      problems.push_back(fmt::format("{}: value {}, U {}, k {}; required: finite, U > 0, k >= 1", value.name,
                                     value.value, value.expanded_uncertainty, value.coverage_factor));
  }
  return problems;
}

}  // namespace

void Register::add_equipment(const LoggedIn& by, const Equipment& equipment, Clock::UtcTime now) {
  require(by, Right::kOperate);
  if (std::find(kQuantities.begin(), kQuantities.end(), equipment.quantity) == kQuantities.end())
    throw RegisterError(fmt::format("equipment {}: quantity \"{}\"; required: one of {}", equipment.identity,
                                    equipment.quantity, fmt::join(kQuantities, ", ")));
  if (equipment.serial_number.empty())
    throw RegisterError(fmt::format("equipment {}: no serial number is given", equipment.identity));
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_new("equipment", equipment.identity);
  change({by.name(), "equipment added", "equipment", equipment.identity, {}}, now, [&] {
    database_.insert("equipment", {{"identity", equipment.identity},
                                   {"name", equipment.name},
                                   {"maker", equipment.maker},
                                   {"model", equipment.model},
                                   {"serial_number", equipment.serial_number},
                                   {"quantity", equipment.quantity},
                                   {"retired", ""}});
  });
  transaction.commit();
}

void Register::retire_equipment(const LoggedIn& by, const std::string& identity, const std::string& reason,
                                Clock::UtcTime now) {
  require(by, Right::kOperate);
  if (reason.empty()) throw RegisterError("retiring " + identity + ": no reason is given");
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_known("equipment", identity);
  change({by.name(), "equipment retired", "equipment", identity, reason}, now, [&] {
    database_.execute("update equipment set retired = :utc where identity = :identity",
                      {{"utc", format_utc(now)}, {"identity", identity}});
  });
  transaction.commit();
}

bool Register::is_stage_record(const std::string& identity) {
  return !database_
              .query(1, "select identity from equipment where identity = :identity and quantity = :quantity",
                     {{"identity", identity}, {"quantity", kStageRecordQuantity}})
              .empty();
}

void Register::add_calibration(const LoggedIn& by, const Calibration& calibration, Clock::UtcTime now) {
  const bool is_record = is_stage_record(calibration.equipment);
  require(by, is_record ? Right::kApprove : Right::kOperate);
  std::vector<std::string> problems = problems_of(calibration, format_utc(now).substr(0, 10));
  if (is_record && calibration.sha256.empty())
    problems.emplace_back("the SHA-256 of the record, which `abcal stage show` prints, is not given");
  if (is_record && calibration.issuer != by.name())
    problems.push_back(
        fmt::format("its issuer is {}; required: who approves it, {}", calibration.issuer, by.name()));
  if (!problems.empty())
    throw RegisterError(fmt::format("calibration {} of {}: {}", calibration.certificate,
                                    calibration.equipment, fmt::join(problems, "; ")));
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_known("equipment", calibration.equipment);
  require_new("calibration", calibration.certificate);
  change({by.name(), "calibration added", "calibration", calibration.certificate, {}}, now, [&] {
    database_.insert("calibration", {{"certificate", calibration.certificate},
                                     {"equipment", calibration.equipment},
                                     {"issuer", calibration.issuer},
                                     {"performed", calibration.performed},
                                     {"due", calibration.due},
                                     {"sha256", calibration.sha256},
                                     {"values_json", to_json(calibration.values).dump()}});
  });
  transaction.commit();
}

void Register::add_item(const LoggedIn& by, const Item& item, Clock::UtcTime now) {
  require(by, Right::kMeasure);
  const std::string identity = item.identity.empty()
                                   ? fmt::format("{} {} {}", item.maker, item.model, item.serial_number)
                                   : item.identity;
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_new("item", identity);
  change({by.name(), "item added", "item", identity, {}}, now, [&] {
    database_.insert("item", {{"identity", identity},
                              {"maker", item.maker},
                              {"model", item.model},
                              {"serial_number", item.serial_number},
                              {"owner", item.owner},
                              {"retired", ""}});
  });
  transaction.commit();
}

void Register::add_key(const LoggedIn& by, const SigningKey& key, Clock::UtcTime now) {
  require(by, Right::kAdminister);
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_new("signing_key", key.fingerprint);
  change({by.name(), "key added", "signing_key", key.fingerprint, {}}, now, [&] {
    database_.insert("signing_key", {{"fingerprint", key.fingerprint},
                                     {"owner", key.owner},
                                     {"kind", key.kind},
                                     {"public_pem", key.public_pem},
                                     {"valid_from", format_utc(now)},
                                     {"valid_to", ""}});
  });
  transaction.commit();
}

void Register::retire_key(const LoggedIn& by, const std::string& fingerprint, const std::string& reason,
                          Clock::UtcTime now) {
  require(by, Right::kAdminister);
  if (reason.empty()) throw RegisterError("retiring key " + fingerprint + ": no reason is given");
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_known("signing_key", fingerprint);
  change({by.name(), "key retired", "signing_key", fingerprint, reason}, now, [&] {
    database_.execute("update signing_key set valid_to = :utc where fingerprint = :fingerprint",
                      {{"utc", format_utc(now)}, {"fingerprint", fingerprint}});
  });
  transaction.commit();
}

std::vector<Equipment> Register::equipment() {
  std::vector<Equipment> list;
  for (const auto& row : database_.query(7,
                                         "select identity, name, maker, model, serial_number, quantity, "
                                         "retired from equipment order by identity"))
    list.push_back({row[0], row[1], row[2], row[3], row[4], row[5], row[6]});
  return list;
}

std::vector<Calibration> Register::calibrations() {
  std::vector<Calibration> list;
  for (const auto& row : database_.query(7,
                                         "select certificate, equipment, issuer, performed, due, sha256, "
                                         "values_json from calibration order by equipment, performed"))
    list.push_back({row[0], row[1], row[2], row[3], row[4], row[5], values_of(row[6])});
  return list;
}

std::vector<Item> Register::items() {
  std::vector<Item> list;
  for (const auto& row : database_.query(
           6, "select identity, maker, model, serial_number, owner, retired from item order by identity"))
    list.push_back({row[0], row[1], row[2], row[3], row[4], row[5]});
  return list;
}

std::vector<SigningKey> Register::keys() {
  std::vector<SigningKey> list;
  for (const auto& row : database_.query(6,
                                         "select fingerprint, owner, kind, public_pem, valid_from, valid_to "
                                         "from signing_key order by owner"))
    list.push_back({row[0], row[1], row[2], row[3], row[4], row[5]});
  return list;
}

}  // namespace abcal::lab
