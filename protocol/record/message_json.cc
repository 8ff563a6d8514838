#include "protocol/record/message_json.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <variant>

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

struct ValueJson {
  Json operator()(const Stated& value) const { return value.text; }
  Json operator()(const Number& value) const { return {{"number", value.digits}}; }
  Json operator()(const Message& value) const { return message_json(value); }
  Json operator()(const Joined& value) const {
    Json list = Json::array();
    for (const Message& message : value.messages) list.push_back(message_json(message));
    return {{"messages", std::move(list)}, {"separator", value.separator}};
  }
};

/// Values of a file are nested no deeper than this; beyond it they are left out, and make another text.
constexpr int kDeepest = 16;

Message message_of_json(const Json& json, int depth);

NamedValue value_of_json(const std::string& name, const Json& json, int depth) {
  if (json.is_string()) return {name, Stated{json.get<std::string>()}};
  if (json.contains("number")) return {name, Number{json.at("number").get<std::string>()}};
  if (!json.contains("messages")) return {name, message_of_json(json, depth)};
  Joined joined{{}, json.at("separator").get<std::string>()};
  for (const Json& each : json.at("messages")) joined.messages.push_back(message_of_json(each, depth));
  return {name, std::move(joined)};
}

Message message_of_json(const Json& json, int depth) {
  std::vector<NamedValue> values;
  if (json.contains("values") && depth < kDeepest)
    for (const auto& [name, value] : json.at("values").items())
      values.push_back(value_of_json(name, value, depth + 1));
  return Message::stored(json.value("id", ""), std::move(values), json.at("text").get<std::string>());
}

}  // namespace

Message message_from_json(const Json& json) {
  return message_of_json(json, 0);
}

Json message_json(const Message& message) {
  Json json = {{"text", message.english()}};
  if (message.id().empty()) return json;
  json["id"] = message.id();
  json["values"] = Json::object();
  for (const NamedValue& named : message.values())
    json["values"][named.name] = std::visit(ValueJson(), named.value);
  return json;
}

Json messages_json(const std::vector<Message>& messages) {
  Json list = Json::array();
  for (const Message& message : messages) {
    if (message.id().empty()) continue;
    Json json = message_json(message);
    if (std::find(list.begin(), list.end(), json) == list.end()) list.push_back(std::move(json));
  }
  return list;
}

}  // namespace abcal
