#include "app/console/run_choice.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <set>

#include "app/console/request.h"
#include "app/console/visible_text.h"
#include "drivers/text/number.h"
#include "protocol/plan/run_config.h"

namespace abcal::console {
namespace {

using Json = nlohmann::json;

// Within the ranges of these keys of the bench file, so that choices need no other check.
constexpr int kLeastSteps = 4, kMostSteps = 720;
constexpr int kLeastReadings = 4, kMostReadings = 1'000'000;
constexpr std::size_t kLongestForm = 100;

std::string text_of(const Json& object, const char* key, std::size_t most) {
  const auto found = object.find(key);
  if (found == object.end()) return {};
  if (!found->is_string()) throw RequestError(fmt::format("\"{}\" is no text", key));
  const auto text = found->get<std::string>();
  require_plain_text(key, text, most);
  return text;
}

std::optional<int> number_of(const Json& object, const char* key, int least, int most) {
  const auto found = object.find(key);
  if (found == object.end()) return std::nullopt;
  const bool fits =
      found->is_number_integer() && found->get<double>() >= least && found->get<double>() <= most;
  if (!fits) throw RequestError(fmt::format("\"{}\" is no whole number from {} to {}", key, least, most));
  return found->get<int>();
}

ItemChoice item_of(const Json& object) {
  static const std::set<std::string> kKeys{"maker", "model", "serial_number", "customer_number"};
  if (!object.is_object()) throw RequestError("\"item\" is no JSON object");
  for (const auto& member : object.items())
    if (!kKeys.contains(member.key()))
      throw RequestError(fmt::format("\"{}\" does not belong to \"item\"", member.key()));
  const auto text = [&](const char* key) { return text_of(object, key, kLongestItemText); };
  ItemChoice item{text("maker"), text("model"), text("serial_number"), text("customer_number")};
  if (item.serial_number.empty()) throw RequestError("the item has no serial number; required: one");
  return item;
}

}  // namespace

void require_plain_text(const char* name, const std::string& text, std::size_t most) {
  if (text.size() > most)
    throw RequestError(fmt::format("\"{}\" has {} bytes; required: at most {}", name, text.size(), most));
  const bool unprintable = std::any_of(text.begin(), text.end(), [](char c) {
    return static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) == 0x7F;
  });
  if (unprintable)
    throw RequestError(fmt::format("\"{}\" has control characters; required: one line of text", name));
  if (has_direction_controls(text))
    throw RequestError(
        fmt::format("\"{}\" has characters that turn the direction of writing (Unicode Bidi_Control)", name));
}

RunChoice parse_run_choice(const Json& object) {
  RunChoice choice;
  if (object.contains("item")) choice.item = item_of(object.at("item"));
  choice.steps = number_of(object, "steps", kLeastSteps, kMostSteps);
  choice.dwell_readings = number_of(object, "dwell_readings", kLeastReadings, kMostReadings);
  choice.estimator = text_of(object, "estimator", kLongestForm);
  if (!choice.estimator.empty() &&
      std::ranges::find(kEstimatorNames, choice.estimator) == kEstimatorNames.end())
    throw RequestError(fmt::format("\"estimator\" is \"{}\"; required: one of {}", choice.estimator,
                                   fmt::join(kEstimatorNames, ", ")));
  if (const auto found = object.find("without_missing_items"); found != object.end()) {
    if (!found->is_boolean()) throw RequestError("\"without_missing_items\" is neither true nor false");
    choice.without_missing_items = found->get<bool>();
  }
  choice.bench_sha256 = text_of(object, "bench_sha256", kLongestForm);
  choice.form = text_of(object, "form", kLongestForm);
  return choice;
}

RunChoice parse_run_choice(const std::map<std::string, std::string>& fields) {
  Json object = Json::object();
  for (const auto& [key, text] : fields) {
    if (text.empty()) continue;
    if (key == "steps" || key == "dwell_readings") {
      const auto number = pieces::number<int>(text);
      object[key] = number ? Json(*number) : Json(text);
    } else if (key == "estimator" || key == "bench_sha256" || key == "form") {
      object[key] = text;
    } else {
      object["item"][key] = text;
    }
  }
  try {
    (void)object.dump();
  } catch (const Json::exception&) {
    throw RequestError("a field is no UTF-8");
  }
  return parse_run_choice(object);
}

nlohmann::ordered_json to_json(const RunChoice& choice) {
  nlohmann::ordered_json json = nlohmann::ordered_json::object();
  if (choice.item)
    json["item"] = {{"maker", choice.item->maker},
                    {"model", choice.item->model},
                    {"serial_number", choice.item->serial_number},
                    {"customer_number", choice.item->customer_number}};
  if (choice.steps) json["steps"] = *choice.steps;
  if (choice.dwell_readings) json["dwell_readings"] = *choice.dwell_readings;
  if (!choice.estimator.empty()) json["estimator"] = choice.estimator;
  if (choice.without_missing_items) json["without_missing_items"] = true;
  return json;
}

}  // namespace abcal::console
