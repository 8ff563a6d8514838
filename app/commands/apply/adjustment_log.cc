#include "app/commands/apply/adjustment_log.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <utility>

#include "app/document/json_text.h"
#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "drivers/text/names.h"

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kSchema = "abcal.adjustments/1";

constexpr auto kStates = names<AdjustmentState>({{AdjustmentState::kBegun, "begun"},
                                                 {AdjustmentState::kDeclined, "declined"},
                                                 {AdjustmentState::kWritten, "written"},
                                                 {AdjustmentState::kVerified, "verified"},
                                                 {AdjustmentState::kSaving, "saving"},
                                                 {AdjustmentState::kSaved, "saved"},
                                                 {AdjustmentState::kUndone, "undone"},
                                                 {AdjustmentState::kUndoFailed, "undo failed"}});

AdjustmentState state_from(const std::string& word) {
  if (const auto state = kStates.value(word)) return *state;
  throw std::runtime_error(fmt::format("\"{}\" is no state", word));
}

Json to_json(const Adjustment& a) {
  return {{"utc", a.utc},     {"driver", a.driver},   {"model", a.model}, {"serial_number", a.serial_number},
          {"label", a.label}, {"before", a.before},   {"after", a.after}, {"state", to_string(a.state)},
          {"saved", a.saved}, {"as_left", a.as_left}, {"why", a.why},     {"item", a.item}};
}

Adjustment from_json(const Json& json) {
  Adjustment a;
  a.item = json.value("item", 1);  // Files of version 1.0 have none, and one item.
  json.at("utc").get_to(a.utc);
  json.at("driver").get_to(a.driver);
  json.at("model").get_to(a.model);
  json.at("serial_number").get_to(a.serial_number);
  json.at("label").get_to(a.label);
  json.at("before").get_to(a.before);
  json.at("after").get_to(a.after);
  a.state = state_from(json.at("state").get<std::string>());
  json.at("saved").get_to(a.saved);
  json.at("as_left").get_to(a.as_left);
  json.at("why").get_to(a.why);
  return a;
}

}  // namespace

std::string_view to_string(AdjustmentState state) {
  return kStates.of(state);
}

bool Adjustment::can_be_undone() const {
  return state != AdjustmentState::kDeclined && state != AdjustmentState::kUndone;
}

bool Adjustment::is_unfinished() const {
  return state == AdjustmentState::kBegun || state == AdjustmentState::kWritten ||
         state == AdjustmentState::kSaving || state == AdjustmentState::kUndoFailed;
}

std::filesystem::path AdjustmentLog::path_beside(const std::filesystem::path& run) {
  return run.string() + ".adjustments.json";
}

AdjustmentLog::AdjustmentLog(const std::filesystem::path& run) : path_(path_beside(run)) {
  if (!std::filesystem::exists(path_)) return;
  try {
    const Json json = Json::parse(read_file(path_));
    if (json.at("schema") != kSchema)
      throw std::runtime_error(
          fmt::format("its schema is {}; required: {}", json.at("schema").dump(), kSchema));
    for (const Json& each : json.at("adjustments")) all_.push_back(from_json(each));
  } catch (const std::exception& error) {
    throw std::runtime_error(fmt::format("{}: {}", path_.string(), error.what()));
  }
}

const Adjustment* AdjustmentLog::last_to_undo(int item) const {
  const auto found = std::find_if(all_.rbegin(), all_.rend(), [item](const Adjustment& each) {
    return each.item == item && each.can_be_undone();
  });
  return found == all_.rend() ? nullptr : &*found;
}

void AdjustmentLog::begin(Adjustment adjustment) {
  all_.push_back(std::move(adjustment));
  store();
}

void AdjustmentLog::update(const Adjustment& adjustment) {
  const auto found = std::find_if(all_.rbegin(), all_.rend(), [&](const Adjustment& each) {
    return each.utc == adjustment.utc && each.item == adjustment.item;
  });
  if (found == all_.rend()) throw std::logic_error("AdjustmentLog::update: no such adjustment");
  *found = adjustment;
  store();
}

void AdjustmentLog::store() const {
  Json json{{"schema", kSchema}, {"adjustments", Json::array()}};
  for (const Adjustment& each : all_) json["adjustments"].push_back(to_json(each));
  OutputFile(path_).write(json_text(json, 2) + "\n");
  const std::filesystem::path folder = path_.has_parent_path() ? path_.parent_path() : ".";
  flush_to_disk(folder, folder);
}

}  // namespace abcal
