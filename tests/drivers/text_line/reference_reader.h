#pragma once

#include <cstddef>
#include <cstdlib>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

/// Lines of numbers read the slow way, from a whole recording at once and without a line of the driver's
/// codec: lines by one pass over the bytes, numbers by the C library once they look like one.
namespace abcal::test::text_line_reference {

struct Format {
  std::vector<int> columns{1, 2, 3};
  char separator = ',';
  std::string comment = "#";
  std::size_t required_words = 0;  ///< 0: any.
};

struct Decoded {
  std::vector<std::vector<double>> lines;
  std::vector<std::size_t> words;  ///< Columns of each.
  std::size_t headers = 0;
  std::size_t bad_lines = 0;
  std::size_t skipped_bytes = 0;
};

/// Words, blanks around them removed.
inline std::vector<std::string> words_of(const std::string& line, char separator) {
  const auto blank = [](char c) { return c == ' ' || c == '\t'; };
  std::vector<std::string> words(1);
  std::size_t quotes = 0;
  for (const char c : line) {
    quotes += c == '"' ? 1 : 0;
    if (quotes % 2 == 0 && (separator == ' ' ? blank(c) : c == separator)) {
      words.emplace_back();
    } else {
      words.back() += c;
    }
  }
  std::vector<std::string> result;
  for (std::string word : words) {
    while (!word.empty() && blank(word.front())) word.erase(0, 1);
    while (!word.empty() && blank(word.back())) word.pop_back();
    if (separator != ' ' || !word.empty()) result.push_back(word);
  }
  return result;
}

/// [sign] (digits [. digits] | . digits) [e [sign] digits], or [sign] nan, nan(letters), inf, infinity in any
/// case.
inline bool is_number(std::string word) {
  for (char& c : word)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  std::size_t at = 0;
  const auto take = [&](std::string_view any_of) {
    std::size_t taken = 0;
    while (at < word.size() && any_of.find(word[at]) != std::string_view::npos) ++at, ++taken;
    return taken;
  };
  if (!word.empty() && (word[0] == '+' || word[0] == '-')) word.erase(0, 1);
  if (word == "nan" || word == "inf" || word == "infinity") return true;
  if (word.substr(0, 4) == "nan(") {
    at = 4;
    take("abcdefghijklmnopqrstuvwxyz0123456789_");
    return word.substr(at) == ")";
  }
  std::size_t digits = take("0123456789");
  if (at < word.size() && word[at] == '.') {
    ++at;
    digits += take("0123456789");
  }
  if (digits == 0) return false;
  if (at == word.size()) return true;
  if (word[at] != 'e') return false;
  ++at;
  if (at < word.size() && (word[at] == '+' || word[at] == '-')) ++at;
  return take("0123456789") > 0 && at == word.size();
}

inline std::optional<double> number_of(std::string word) {
  if (word.size() > 1 && word.front() == '"' && word.back() == '"') {
    word = word.substr(1, word.size() - 2);
    while (!word.empty() && (word.front() == ' ' || word.front() == '\t')) word.erase(0, 1);
    while (!word.empty() && (word.back() == ' ' || word.back() == '\t')) word.pop_back();
  }
  if (!is_number(word)) return std::nullopt;
  const double value = std::strtod(word.c_str(), nullptr);
  // Beyond a double: a number with a digit other than 0 that becomes infinite or zero.
  const bool has_digit =
      word.find_first_of("0123456789") != std::string::npos && word.find_first_of("nN") == std::string::npos;
  const bool not_zero =
      word.substr(0, word.find_first_of("eE")).find_first_of("123456789") != std::string::npos;
  if (has_digit && not_zero && (value == 0.0 || value - value != 0.0)) return std::nullopt;
  return value;
}

inline Decoded decode(std::string_view bytes, const Format& format) {
  Decoded decoded;
  std::size_t begin = 0;
  while (begin < bytes.size() && bytes[begin] != '\r' && bytes[begin] != '\n') ++begin;
  if (begin == bytes.size()) {
    decoded.skipped_bytes = bytes.size();
    return decoded;
  }
  decoded.skipped_bytes = ++begin;
  for (std::size_t end = begin; end <= bytes.size(); ++end) {
    const bool is_end = end < bytes.size() && (bytes[end] == '\r' || bytes[end] == '\n');
    if (!is_end && end < bytes.size()) continue;
    const std::string line(bytes.substr(begin, end - begin));
    begin = end + 1;
    const bool too_long = line.size() > 1024;
    if (!is_end && !too_long) break;
    std::string content = line;
    while (!content.empty() && (content.front() == ' ' || content.front() == '\t')) content.erase(0, 1);
    if (!too_long && content.find_first_not_of(" \t") == std::string::npos) continue;
    if (!too_long && !format.comment.empty() && content.substr(0, format.comment.size()) == format.comment)
      continue;
    std::vector<double> values;
    const auto words = too_long ? std::vector<std::string>() : words_of(line, format.separator);
    for (const int column : format.columns) {
      if (static_cast<std::size_t>(column) > words.size()) break;
      const auto value = number_of(words[static_cast<std::size_t>(column - 1)]);
      if (!value) break;
      values.push_back(*value);
    }
    const std::size_t size = line.size() + (is_end ? 1 : 0);
    if (values.size() == format.columns.size() &&
        (format.required_words == 0 || format.required_words == words.size())) {
      decoded.lines.push_back(values);
      decoded.words.push_back(words.size());
    } else if (decoded.lines.empty()) {
      ++decoded.headers;
      if (too_long) decoded.skipped_bytes += size;
    } else {
      ++decoded.bad_lines;
      decoded.skipped_bytes += size;
    }
  }
  return decoded;
}

}  // namespace abcal::test::text_line_reference
