#include "app/certificate/words.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "app/certificate/language_files.h"

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

std::size_t placeholders(std::string_view sentence) {
  std::size_t count = 0;
  for (std::size_t at = 0; (at = sentence.find('{', at)) != std::string_view::npos; ++at) ++count;
  return count;
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

std::string Words::known(std::string_view english) const {
  if (table_ == nullptr) return std::string(english);
  const auto found = table_->find(std::string(english));
  return found == table_->end() ? std::string(english) : found->second;
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
    if (found == table.end() || placeholders(found->second) != placeholders(sentence))
      missing.push_back(sentence);
  }
  return missing;
}

}  // namespace abcal
