#include "app/laboratory/certificate/words.h"

#include <fmt/ranges.h>

#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>

#include "app/laboratory/certificate/language_files.h"

namespace abcal {
namespace {

using Table = std::unordered_map<std::string, std::string>;

/// The tables of all languages, by their codes; read once.
const std::map<std::string, Table>& tables() {
  static const std::map<std::string, Table> kTables = [] {
    std::map<std::string, Table> all;
    for (const LanguageFile& file : language_files()) {
      const auto json = nlohmann::json::parse(file.body);
      Table table;
      for (const auto& [english, translated] : json.items()) table.emplace(english, translated);
      all.emplace(std::string(file.path), std::move(table));
    }
    return all;
  }();
  return kTables;
}

}  // namespace

Words::Words(std::string_view language) : language_(language) {
  if (language == "en") return;
  const auto found = tables().find(language_);
  if (found == tables().end())
    throw std::invalid_argument(
        fmt::format("language \"{}\"; required: {}", language, fmt::join(languages(), ", ")));
  table_ = &found->second;
}

Wording Words::operator()(const Message& message) const {
  if (table_ == nullptr) return {message.english(), language_};
  Rendered made = message.rendered([this](std::string_view english) -> std::optional<std::string_view> {
    const auto found = table_->find(std::string(english));
    return found == table_->end() ? std::nullopt : std::optional<std::string_view>(found->second);
  });
  return {std::move(made.text), made.complete ? language_ : std::string()};
}

std::vector<std::string> Words::languages() {
  std::vector<std::string> codes{"en"};
  for (const LanguageFile& file : language_files()) codes.emplace_back(file.path);
  return codes;
}

std::vector<std::string> missing_in_language(const std::string& language,
                                             const std::vector<std::string>& sentences) {
  std::vector<std::string> missing;
  const Table& table = tables().at(language);
  for (const std::string& sentence : sentences) {
    const auto found = table.find(sentence);
    if (found == table.end()) missing.push_back(sentence);
  }
  return missing;
}

}  // namespace abcal
