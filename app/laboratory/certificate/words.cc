#include "app/laboratory/certificate/words.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
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

/// A sentence of a table with places for values, as the pieces between them.
struct Template {
  std::vector<std::string_view> names;
  std::vector<std::string_view> between;  ///< Their number is that of the values plus one.
  std::size_t letters = 0;
  std::string_view translation;
};

/// Whether a template recognises its own sentences without matching others that merely contain a short word
/// like "to".
bool is_telling(const Template& made) {
  constexpr std::size_t kFewestLetters = 10, kShortestEnd = 5;
  return made.between.size() > 1 && (made.letters >= kFewestLetters || !made.between.front().empty() ||
                                     made.between.back().size() >= kShortestEnd);
}

Template template_of(std::string_view english, std::string_view translation) {
  Template made;
  made.translation = translation;
  for (auto place = message_detail::next_place(english, 0); place.begin != std::string_view::npos;
       place = message_detail::next_place(english, 0)) {
    made.names.push_back(place.name);
    made.between.push_back(english.substr(0, place.begin));
    english.remove_prefix(place.end);
  }
  made.between.push_back(english);
  for (const std::string_view part : made.between)
    made.letters += static_cast<std::size_t>(
        std::count_if(part.begin(), part.end(), [](unsigned char c) { return std::isalpha(c) != 0; }));
  return made;
}

/// The templates of a table, those with most letters first.
std::vector<Template> make_templates(const Table& table) {
  std::vector<Template> all;
  for (const auto& [english, translation] : table) {
    Template made = template_of(english, translation);
    if (is_telling(made)) all.push_back(std::move(made));
  }
  std::sort(all.begin(), all.end(),
            [](const Template& a, const Template& b) { return a.letters > b.letters; });
  return all;
}

const std::vector<Template>& templates_of(const std::string& language) {
  static const std::map<std::string, std::vector<Template>> kAll = [] {
    std::map<std::string, std::vector<Template>> all;
    for (const auto& [code, table] : tables()) all.emplace(code, make_templates(table));
    return all;
  }();
  return kAll.at(language);
}

/// The values of a text made from a template; absent: it was not made from it.
std::optional<std::vector<std::string_view>> values_in(std::string_view text, const Template& made) {
  const std::string_view first = made.between.front(), last = made.between.back();
  if (text.size() < first.size() + last.size() || !text.starts_with(first) || !text.ends_with(last))
    return std::nullopt;
  text.remove_prefix(first.size());
  text.remove_suffix(last.size());
  std::vector<std::string_view> values;
  for (std::size_t i = 1; i + 1 < made.between.size(); ++i) {
    const std::size_t at = text.find(made.between[i]);
    if (at == std::string_view::npos) return std::nullopt;
    values.push_back(text.substr(0, at));
    text.remove_prefix(at + made.between[i].size());
  }
  values.push_back(text);
  return values;
}

/// Whether a text has no word to translate: a number, a symbol, a unit, a quoted name, a key of a file.
bool is_wordless(std::string_view text) {
  constexpr std::size_t kLongestSymbol = 3;
  if (text.starts_with('[') || (text.starts_with('"') && text.ends_with('"'))) return true;
  std::size_t letters = 0;
  for (const char c : text) {
    letters = std::isalpha(static_cast<unsigned char>(c)) != 0 ? letters + 1 : 0;
    if (letters > kLongestSymbol) return false;
  }
  return true;
}

std::string with_decimal_mark(std::string_view text, const std::string& mark) {
  const auto is_digit = [&](std::size_t at) {
    return at < text.size() && std::isdigit(static_cast<unsigned char>(text[at])) != 0;
  };
  std::string marked;
  for (std::size_t at = 0; at < text.size(); ++at) {
    const bool is_point = text[at] == '.' && at > 0 && is_digit(at - 1) && is_digit(at + 1);
    marked += is_point ? mark : std::string(1, text[at]);
  }
  return marked;
}

/// Whether a value extends over the end of a sentence. A list, which a template has between ": " and "; ",
/// may do so, but not over the end of a sentence of the same template.
bool holds_sentences(const std::vector<std::string_view>& values, const Template& made) {
  constexpr std::size_t kTelling = 10;
  const std::string_view end = made.between.back();
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (values[i].find("; ") != std::string_view::npos && !made.between[i + 1].starts_with(';')) return true;
    if (end.size() >= kTelling && values[i].find(end) != std::string_view::npos) return true;
  }
  return false;
}

/// A text whose quotations are taken out, each replaced by a mark without letters: a person wrote them, so no
/// part of them is translated.
struct Quotations {
  std::string text;
  std::vector<std::string> taken;

  static std::string mark(std::size_t k) { return fmt::format("\x1f{}\x1f", k); }

  explicit Quotations(std::string_view from) {
    while (true) {
      const std::size_t begin = from.find('"');
      const std::size_t end = begin == std::string_view::npos ? begin : from.find('"', begin + 1);
      if (end == std::string_view::npos) break;
      text += fmt::format("{}\"{}\"", from.substr(0, begin), mark(taken.size()));
      taken.emplace_back(from.substr(begin + 1, end - begin - 1));
      from.remove_prefix(end + 1);
    }
    text += from;
  }

  std::string put_back(std::string into) const {
    for (std::size_t k = 0; k < taken.size(); ++k)
      if (const auto at = into.find(mark(k)); at != std::string::npos)
        into.replace(at, mark(k).size(), taken[k]);
    return into;
  }
};

struct Translated {
  std::string text;
  bool is_complete = false;  ///< Every part was found.
};

/// Finds the sentences of a table in composed texts.
struct Translator {
  const Table& table;
  const std::vector<Template>& templates;
  std::string decimal_mark;
  const Quotations& quotations;  ///< Those of the whole text.

  /// One sentence of the table with its values, or a text that needs no translation; absent: neither.
  std::optional<std::string> sentence(std::string_view english) const {
    if (const auto found = table.find(std::string(english)); found != table.end()) return found->second;
    // A sentence of the table may have a quotation of its own.
    if (english.find('"') != std::string_view::npos)
      if (const auto found = table.find(quotations.put_back(std::string(english))); found != table.end())
        return found->second;
    for (const Template& made : templates) {
      const auto values = values_in(english, made);
      if (!values || holds_sentences(*values, made)) continue;
      // Values are names and numbers, or sentences in their turn.
      std::vector<NamedValue> named;
      for (std::size_t i = 0; i < values->size(); ++i)
        named.push_back({std::string(made.names[i]), Stated{text((*values)[i]).text}});
      return Message::stored(std::string(made.translation), std::move(named), {}).english();
    }
    if (!is_wordless(english)) return std::nullopt;
    return with_decimal_mark(english, decimal_mark);
  }

  /// Sentences one after the other.
  Translated text(std::string_view english) const {
    if (const auto found = sentence(english)) return {*found, true};
    for (const std::string_view separator : {"; ", ": ", ", "}) {
      const std::size_t first = english.find(separator);
      if (first == std::string_view::npos) continue;
      // A sentence may have the separator within it.
      for (std::size_t at = first; at != std::string_view::npos; at = english.find(separator, at + 1)) {
        const auto head = sentence(english.substr(0, at));
        if (!head) continue;
        const Translated rest = text(english.substr(at + separator.size()));
        return {fmt::format("{}{}{}", *head, separator, rest.text), rest.is_complete};
      }
      const Translated head = text(english.substr(0, first)),
                       rest = text(english.substr(first + separator.size()));
      return {fmt::format("{}{}{}", head.text, separator, rest.text), head.is_complete && rest.is_complete};
    }
    return {std::string(english), false};
  }
};

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

Wording Words::operator()(const Message& message) const {
  if (table_ == nullptr) return {message.english(), language_};
  Rendered made = message.rendered([this](std::string_view english) -> std::optional<std::string_view> {
    const auto found = table_->find(std::string(english));
    return found == table_->end() ? std::nullopt : std::optional<std::string_view>(found->second);
  });
  return {std::move(made.text), made.complete ? language_ : std::string()};
}

Wording Words::composed(std::string_view english) const {
  if (table_ == nullptr) return {std::string(english), language_};
  Translation made = translated(english);
  return {std::move(made.text), made.is_complete ? language_ : std::string()};
}

Words::Translation Words::translated(std::string_view english) const {
  const Quotations quotations(english);
  const Translated made =
      Translator{*table_, templates_of(language_), known("."), quotations}.text(quotations.text);
  return {quotations.put_back(made.text), made.is_complete};
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
