#include "app/formats/toml_mistake.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <optional>
#include <utility>

#include "drivers/text/text.h"

namespace abcal {
namespace {

constexpr std::string_view kSpace = " \t\r";

std::string_view trimmed(std::string_view text) {
  return pieces::trimmed(text, kSpace);
}

bool is_word_character(char c) {
  return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_' || c == '-';
}

bool is_bare_key(std::string_view text) {
  return !text.empty() && std::ranges::all_of(text, [](char c) { return is_word_character(c) || c == '.'; });
}

bool are_digits(std::string_view text) {
  return !text.empty() &&
         std::ranges::all_of(text, [](char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; });
}

/// A line in its parts: "  key", " = ", "value", "  # comment".
struct Line {
  std::string_view key, value;
  std::string_view before_value, behind_value;  ///< All bytes around the value.
  char separator = 0;                           ///< '=' or ':'; 0: none.
};

/// Begin of a comment outside quotes, or the length of the line.
std::size_t end_of_content(std::string_view line) {
  char quote = 0;
  for (std::size_t i = 0; i < line.size(); ++i) {
    if (quote != 0 && line[i] == quote) {
      quote = 0;
    } else if (quote == 0 && (line[i] == '"' || line[i] == '\'')) {
      quote = line[i];
    } else if (quote == 0 && line[i] == '#') {
      return i;
    }
  }
  return line.size();
}

Line split(std::string_view line) {
  Line parts;
  const std::string_view content = line.substr(0, end_of_content(line));
  std::size_t at = content.find_first_of("=:");
  if (at == std::string_view::npos) {  // "key value"
    const std::size_t word = content.find_first_not_of(kSpace);
    at = word == std::string_view::npos ? content.size()
                                        : std::min(content.find_first_of(kSpace, word), content.size());
    parts.key = trimmed(content.substr(0, at));
  } else {
    parts.separator = content[at];
    parts.key = trimmed(content.substr(0, at));
    at = std::min(content.find_first_not_of("=:", at), content.size());
  }
  parts.value = trimmed(content.substr(at));
  const std::size_t begin =
      parts.value.empty() ? content.size() : static_cast<std::size_t>(parts.value.data() - line.data());
  parts.before_value = line.substr(0, begin);
  parts.behind_value = line.substr(begin + parts.value.size());
  return parts;
}

struct Numeral {
  std::string text;        ///< As TOML writes it.
  std::size_t length = 0;  ///< Bytes of the value that it takes.
  bool has_comma = false;
};

/// The number at the begin of a value, as people write it: "5,0", ".5", "5.", "007".
std::optional<Numeral> leading_number(std::string_view value) {
  Numeral number;
  std::size_t at = 0;
  if (!value.empty() && (value[0] == '+' || value[0] == '-')) number.text += value[at++];
  const auto digits_from = [&](std::size_t from) {
    return value.substr(from, std::min(value.find_first_not_of("0123456789", from), value.size()) - from);
  };
  std::string_view whole = digits_from(at);
  at += whole.size();
  while (whole.size() > 1 && whole.front() == '0') whole.remove_prefix(1);
  number.text += whole.empty() ? "0" : std::string(whole);
  bool has_fraction = false;
  if (at < value.size() && (value[at] == '.' || value[at] == ',')) {
    number.has_comma = value[at] == ',';
    const std::string_view fraction = digits_from(at + 1);
    if (whole.empty() && fraction.empty()) return std::nullopt;
    number.text += "." + (fraction.empty() ? std::string("0") : std::string(fraction));
    at += 1 + fraction.size();
    has_fraction = true;
  }
  if (whole.empty() && !has_fraction) return std::nullopt;
  if (at + 1 < value.size() && (value[at] == 'e' || value[at] == 'E')) {
    const std::size_t digits = at + (value[at + 1] == '-' || value[at + 1] == '+' ? 2 : 1);
    if (digits < value.size() && are_digits(value.substr(digits, 1))) {
      const std::string_view exponent = digits_from(digits);
      number.text += value.substr(at, digits + exponent.size() - at);
      at = digits + exponent.size();
    }
  }
  number.length = at;
  return number;
}

using Guess = std::optional<TomlMistake>;

Guess typographic_quotes(std::string_view line) {
  static constexpr std::array<std::string_view, 8> kDouble{"\u201c", "\u201d", "\u201e", "\u201f",
                                                           "\u00ab", "\u00bb", "\u2033", "\uff02"};
  static constexpr std::array<std::string_view, 4> kSingle{"\u2018", "\u2019", "\u201a", "\u2032"};
  std::string corrected(line);
  const auto replace = [&](std::string_view quote) {
    for (std::size_t at = 0; (at = corrected.find(quote, at)) != std::string::npos;)
      corrected.replace(at, quote.size(), "\"");
  };
  std::ranges::for_each(kDouble, replace);
  std::ranges::for_each(kSingle, replace);
  if (corrected == line) return std::nullopt;
  return TomlMistake{"typographic quotes", "straight quotes: \"text\"", corrected};
}

Guess open_section(std::string_view line) {
  const std::string_view content = trimmed(line.substr(0, end_of_content(line)));
  if (content.empty() || content.front() != '[') return std::nullopt;
  const std::size_t brackets = std::min({content.find_first_not_of('['), content.size(), std::size_t{2}});
  const std::string_view inner = content.substr(brackets);
  std::string_view name = trimmed(inner.substr(0, inner.find_first_of("])}")));
  if (!is_bare_key(name)) return std::nullopt;
  const std::string corrected = std::string(brackets, '[') + std::string(name) + std::string(brackets, ']');
  if (content == corrected) return std::nullopt;
  const std::string rest = std::string(line.substr(end_of_content(line)));
  return TomlMistake{fmt::format("\"{}\"", content), "a section, " + corrected + ", alone on its line",
                     corrected + (rest.empty() ? "" : " " + rest)};
}

Guess separator_of(const Line& line) {
  if (!is_bare_key(line.key) || line.value.empty()) return std::nullopt;
  const std::string_view written =
      trimmed(line.before_value.substr(line.before_value.find(line.key) + line.key.size()));
  if (written == "=") return std::nullopt;
  const std::string corrected = fmt::format("{} = {}{}", line.key, line.value, line.behind_value);
  return TomlMistake{
      written.empty() ? std::string("no equals sign between key and value") : fmt::format("\"{}\"", written),
      "key = value", corrected};
}

/// The line with another value.
std::string with_value(const Line& line, const std::string& value) {
  return std::string(line.before_value) + value + std::string(line.behind_value);
}

Guess no_value(const Line& line) {
  if (line.separator == 0 || !line.value.empty()) return std::nullopt;
  return TomlMistake{"no value",
                     fmt::format("a value for {}, or no such line (its default counts then)", line.key), ""};
}

Guess truth(const Line& line) {
  const std::string word = pieces::lower(line.value);
  const bool yes = word == "true" || word == "yes" || word == "on",
             no = word == "false" || word == "no" || word == "off";
  if (!yes && !no) return std::nullopt;
  return TomlMistake{fmt::format("\"{}\"", line.value), "true or false, in small letters",
                     with_value(line, yes ? "true" : "false")};
}

Guess comma_at_end(const Line& line) {
  if (line.value.size() < 2 || !line.value.ends_with(',')) return std::nullopt;
  const std::string_view value = trimmed(line.value.substr(0, line.value.size() - 1));
  return TomlMistake{"a comma at the end of the line", "no comma: each key has a line of its own",
                     with_value(line, std::string(value))};
}

Guess number(const Line& line) {
  const auto numeral = leading_number(line.value);
  if (!numeral) return std::nullopt;
  const std::string_view rest = trimmed(line.value.substr(numeral->length));
  // A date, a time, an address or a name that begins with digits is not a number with a unit.
  const bool is_unit = rest.empty() || rest.front() == '%' ||
                       static_cast<unsigned char>(rest.front()) >= 0x80 ||
                       (std::isalpha(static_cast<unsigned char>(rest.front())) != 0 &&
                        rest.find_first_of(".:@") == std::string_view::npos);
  if (!is_unit) return std::nullopt;
  if (!rest.empty())
    return TomlMistake{fmt::format("\"{}\" behind the number", rest),
                       "the number alone; the name of the key has its unit", with_value(line, numeral->text)};
  if (numeral->has_comma)
    return TomlMistake{"a decimal comma", "a decimal point", with_value(line, numeral->text)};
  return TomlMistake{fmt::format("\"{}\"", line.value), "a number as TOML writes it",
                     with_value(line, numeral->text)};
}

Guess text(const Line& line) {
  const std::string_view value = line.value;
  if (value.empty()) return std::nullopt;
  const char first = value.front();
  if (first == '"' && value.find('\\') != std::string_view::npos) {
    const std::string_view inner =
        value.substr(1, value.rfind('"') == 0 ? value.size() - 1 : value.rfind('"') - 1);
    if (inner.find('\'') != std::string_view::npos) return std::nullopt;
    return TomlMistake{"a backslash inside \"...\", where it begins a special character",
                       "single quotes around text with backslashes",
                       with_value(line, fmt::format("'{}'", inner))};
  }
  const bool has_quote = first == '"' || first == '\'';
  if (has_quote && value.find(first, 1) == std::string_view::npos) {
    std::string_view inner = value.substr(1);
    if (!inner.empty() && (inner.back() == '"' || inner.back() == '\'')) inner.remove_suffix(1);
    return TomlMistake{"text whose quote is not closed", "the same quote at both ends of the text",
                       with_value(line, fmt::format("\"{}\"", trimmed(inner)))};
  }
  const bool is_plain = std::ranges::none_of(value, [](char c) {
    return c == '"' || c == '\'' || c == '[' || c == ']' || c == '{' || c == '}' || c == '\\' || c == '=';
  });
  if (!is_plain) return std::nullopt;
  if (pieces::lower(value).starts_with("com") && are_digits(value.substr(3)))
    return TomlMistake{
        "text without quotes",
        "text in quotes; serial ports have names such as \"/dev/ttyUSB0\" here: `abcal instruments` "
        "lists them",
        ""};
  return TomlMistake{"text without quotes", "text in quotes", with_value(line, fmt::format("\"{}\"", value))};
}

}  // namespace

TomlMistake explain_toml_mistake(std::string_view line, std::size_t column, bool is_second) {
  const Line parts = split(line);
  if (is_second) {
    const bool is_section = parts.key.starts_with('[') || trimmed(line).starts_with('[');
    return {
        fmt::format("{} for the second time", parts.key.empty() || is_section ? trimmed(line) : parts.key),
        is_section ? "each section once: the keys of both under one of them"
                   : "each key once in its section: keep one of the two",
        is_section ? "" : " "};
  }
  if (Guess guess = typographic_quotes(line)) return *guess;
  if (Guess guess = open_section(line)) return *guess;
  if (Guess guess = no_value(parts)) return *guess;
  if (Guess guess = separator_of(parts)) return *guess;
  if (is_bare_key(parts.key)) {
    for (const auto& look : {comma_at_end, truth, number, text})
      if (Guess guess = look(parts)) return *guess;
  }
  const std::string_view rest = trimmed(line.substr(std::min(column, line.size())));
  return {rest.empty() ? std::string("the end of the line") : fmt::format("\"{}\"", rest),
          "key = value under a [section], with text in quotes", ""};
}

}  // namespace abcal
