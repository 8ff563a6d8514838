#include "app/document/data_tree.h"

#include <fmt/format.h>

#include <cstring>
#include <functional>
#include <istream>
#include <nlohmann/json.hpp>
#include <numeric>
#include <ostream>
#include <stdexcept>
#include <type_traits>

#include "app/document/valid_text.h"

namespace abcal {
namespace {

using Json = nlohmann::json;

// Each kind of content is the member of this name; a group has none.
constexpr const char* kText = "text";
constexpr const char* kReal = "real";
constexpr const char* kWhole = "whole";

template <class Number>
Json array_json(const DataNode::Array<Number>& array, const char* kind) {
  std::vector<std::uint8_t> bytes(array.values.size() * sizeof(Number));
  if (!bytes.empty()) std::memcpy(bytes.data(), array.values.data(), bytes.size());
  return {{"shape", array.shape}, {kind, Json::binary(std::move(bytes))}};
}

template <class Number>
DataNode::Array<Number> array_from(const Json& json, const char* kind) {
  DataNode::Array<Number> array{json.at("shape").get<std::vector<std::size_t>>(), {}};
  const Json::binary_t& bytes = json.at(kind).get_binary();
  const std::size_t size =
      std::accumulate(array.shape.begin(), array.shape.end(), sizeof(Number), std::multiplies<>());
  if (bytes.size() != size)
    throw std::runtime_error(fmt::format("{}: an array of {} bytes; required by its shape: {}",
                                         json.at("path").get<std::string>(), bytes.size(), size));
  array.values.resize(size / sizeof(Number));
  if (size > 0) std::memcpy(array.values.data(), bytes.data(), size);
  return array;
}

Json content_json(const DataNode& node) {
  if (const auto* text = std::get_if<std::string>(&node.content)) return {{kText, valid_text(*text)}};
  if (const auto* real = std::get_if<DataNode::Array<double>>(&node.content)) return array_json(*real, kReal);
  if (const auto* whole = std::get_if<DataNode::Array<std::int64_t>>(&node.content))
    return array_json(*whole, kWhole);
  return Json::object();
}

Json attribute_json(const DataNode::Attribute& attribute) {
  if (const auto* number = std::get_if<std::int64_t>(&attribute)) return *number;
  if (const auto* text = std::get_if<std::string>(&attribute)) return valid_text(*text);
  Json texts = Json::array();
  for (const std::string& text : std::get<std::vector<std::string>>(attribute))
    texts.push_back(valid_text(text));
  return texts;
}

DataNode::Attribute attribute_from(const Json& json) {
  if (json.is_array()) return json.get<std::vector<std::string>>();
  if (json.is_string()) return json.get<std::string>();
  return json.get<std::int64_t>();
}

DataNode node_from(const Json& json) {
  DataNode node{json.at("path").get<std::string>(), DataNode::Group{}, json.value("grows", false), {}};
  if (json.contains(kText)) node.content = json.at(kText).get<std::string>();
  if (json.contains(kReal)) node.content = array_from<double>(json, kReal);
  if (json.contains(kWhole)) node.content = array_from<std::int64_t>(json, kWhole);
  if (json.contains("attributes"))
    for (const auto& [name, attribute] : json.at("attributes").items())
      node.attributes[name] = attribute_from(attribute);
  return node;
}

}  // namespace

void write_node(const DataNode& node, std::ostream& stream) {
  Json json = content_json(node);
  json["path"] = node.path;
  if (node.grows) json["grows"] = true;
  for (const auto& [name, attribute] : node.attributes) json["attributes"][name] = attribute_json(attribute);
  Json::to_cbor(json, stream);
}

std::optional<DataNode> read_node(std::istream& stream) {
  constexpr const char* kUnreadable = "the groups and datasets cannot be read to their end";
  if (stream.peek() == std::istream::traits_type::eof()) {
    if (stream.bad()) throw std::runtime_error(kUnreadable);
    return std::nullopt;
  }
  try {
    return node_from(Json::from_cbor(stream, /*strict=*/false));  // Other nodes follow.
  } catch (const Json::exception& error) {
    throw std::runtime_error(fmt::format("{}: {}", kUnreadable, error.what()));
  }
}

}  // namespace abcal
