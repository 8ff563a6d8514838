#include "drivers/text_line/codec.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <stdexcept>
#include <utility>

#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal::text_line {
namespace {

constexpr std::string_view kBlanks = " \t";

std::string_view trimmed(std::string_view text) {
  return pieces::trimmed(text, kBlanks);
}

/// A character that a number may have.
bool is_of_a_number(char c) {
  return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
         std::string_view("+-.()_").find(c) != std::string_view::npos;
}

using pieces::is_digit;

bool all_digits(std::string_view word) {
  return !word.empty() && std::ranges::all_of(word, is_digit);
}

/// True for an even number of whole numbers of which every second one is all digits, and one has a leading
/// zero before other digits. No board prints a number such as "01", but it may follow a decimal comma.
bool looks_like_decimal_commas(const std::vector<std::string_view>& words) {
  constexpr std::size_t kAxes = 3;
  if (words.size() % 2 != 0 || words.size() < 2 * kAxes) return false;
  bool leading_zero = false;
  for (std::size_t n = 0; n < words.size(); n += 2) {
    std::string_view whole = words[n];
    if (whole.starts_with('-') || whole.starts_with('+')) whole.remove_prefix(1);
    const std::string_view part = words[n + 1];
    if (!all_digits(whole) || !all_digits(part)) return false;
    leading_zero = leading_zero || (part.size() > 1 && part.front() == '0');
  }
  return leading_zero;
}

bool is_of_a_name(char c) {
  return is_digit(c) || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
}

/// The number behind a name, up to the first character that cannot belong to it; absent if there is none.
std::optional<double> number_behind(std::string_view rest, const LineFormat& format) {
  if (rest.starts_with('"') || rest.starts_with('\'')) rest.remove_prefix(1);
  rest = trimmed(rest);
  if (!rest.starts_with(':') && !rest.starts_with('=')) return std::nullopt;
  rest = trimmed(rest.substr(1));
  if (rest.starts_with('"')) rest.remove_prefix(1);
  if (rest.starts_with('+')) rest.remove_prefix(1);
  std::string text(rest.substr(0, LineReader::kLongestLine));
  if (format.decimal_mark == ',') {
    // Points are not part of its numbers then, and only the first comma is.
    text.resize(std::min(text.find('.'), text.size()));
    const std::size_t comma = text.find(',');
    const bool is_mark = comma != std::string::npos && comma + 1 < text.size() && is_digit(text[comma + 1]);
    if (is_mark) text[comma] = '.';
  }
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{}) return std::nullopt;
  std::string_view behind = rest.substr(static_cast<std::size_t>(end - text.data()));
  if (!format.unit.empty() && behind.starts_with(format.unit)) behind.remove_prefix(format.unit.size());
  if (behind.empty()) return value;
  if (is_of_a_name(behind.front()) || behind.front() == '.') return std::nullopt;
  // "0,01": a decimal comma where a point is expected.
  const bool goes_on = behind.front() == ',' && behind.size() > 1 && is_digit(behind[1]);
  return goes_on ? std::nullopt : std::optional(value);
}

}  // namespace

NamedNumber named_number(std::string_view line, std::string_view name, const LineFormat& format) {
  NamedNumber number;
  for (std::size_t at = 0; (at = line.find(name, at)) != std::string_view::npos; at += name.size()) {
    if (at > 0 && is_of_a_name(line[at - 1])) continue;
    std::string_view rest = line.substr(at + name.size());
    if (!rest.empty() && is_of_a_name(rest.front())) continue;
    const std::size_t sign = rest.find_first_not_of("\"' \t");
    if (sign == std::string_view::npos || (rest[sign] != ':' && rest[sign] != '=')) continue;
    ++number.found;
    number.value = number_behind(rest, format);
  }
  return number;
}

std::optional<double> parse_number(std::string_view word) {
  return pieces::number<double>(pieces::without_plus(word));
}

void require_names(const LineFormat& format) {
  for (const std::string& name : format.names) {
    if (name.empty() || !std::ranges::all_of(name, is_of_a_name))
      throw std::invalid_argument(
          fmt::format("lines of text: name \"{}\"; required: letters, digits and _ only", name));
    if (std::ranges::count(format.names, name) > 1)
      throw std::invalid_argument(fmt::format("lines of text: name \"{}\" is given twice", name));
  }
  if (format.decimal_mark != '.' && format.decimal_mark != ',')
    throw std::invalid_argument(
        fmt::format("lines of text: decimal mark \"{}\"; required: . or ,", format.decimal_mark));
}

LineReader::LineReader(LineFormat format) : format_(std::move(format)), so_far_(format_.names.size()) {
  require_names(format_);
  if (format_.columns.empty()) throw std::invalid_argument("lines of text: no column is to be read");
  for (const int column : format_.columns) {
    if (column < 1)
      throw std::invalid_argument(fmt::format("lines of text: column {}; required: 1 or more", column));
    if (std::count(format_.columns.begin(), format_.columns.end(), column) > 1)
      throw std::invalid_argument(fmt::format("lines of text: column {} is given twice", column));
  }
  const std::string& separator = format_.separator;
  if (separator.size() != 1 || is_of_a_number(separator.front()) ||
      std::string_view("\r\n").find(separator) != std::string_view::npos) {
    throw std::invalid_argument(fmt::format(
        "lines of text: separator \"{}\"; required: one character that no number and no line end has",
        separator));
  }
}

void LineReader::feed(std::string_view bytes) {
  buffer_.erase(0, begin_);
  begin_ = 0;
  buffer_ += bytes;
}

std::optional<NumberLine> LineReader::next() {
  for (;;) {
    const std::size_t end = buffer_.find_first_of("\r\n", begin_);
    const std::size_t length = std::min(end, buffer_.size()) - begin_;
    if (!dropping_ && length > kLongestLine) {
      count_other_line(0);
      dropping_ = true;
    }
    const bool is_whole = end != std::string::npos;
    const std::size_t size = length + (is_whole ? 1 : 0);
    if (dropping_) {
      skipped_bytes_ += size;
      begin_ += size;
      dropping_ = !is_whole;
    }
    if (!is_whole) return std::nullopt;
    if (begin_ > end) continue;  // It was dropped.
    const std::string_view line = std::string_view(buffer_).substr(begin_, length);
    begin_ += size;
    if (auto numbers = decode(line)) return numbers;
  }
}

void LineReader::lose_track() {
  skipped_bytes_ += buffer_.size() - begin_;
  begin_ = buffer_.size();
  dropping_ = true;
  so_far_.assign(format_.names.size(), std::nullopt);
}

std::vector<std::string_view> LineReader::split(std::string_view line) const {
  const bool by_blanks = format_.separator == " ";
  std::vector<std::string_view> words;
  bool is_quoted = false;
  std::size_t begin = 0;
  const auto add = [&](std::size_t end) {
    const std::string_view word = trimmed(line.substr(begin, end - begin));
    if (!by_blanks || !word.empty()) words.push_back(word);
    begin = end + 1;
  };
  for (std::size_t at = 0; at < line.size(); ++at) {
    if (line[at] == '"') is_quoted = !is_quoted;
    const bool separates =
        by_blanks ? kBlanks.find(line[at]) != std::string_view::npos : line[at] == format_.separator.front();
    if (separates && !is_quoted) add(at);
  }
  add(line.size());
  return words;
}

std::optional<double> LineReader::number_in(std::string_view word) const {
  if (word.size() >= 2 && word.starts_with('"') && word.ends_with('"'))
    word = trimmed(word.substr(1, word.size() - 2));
  if (!format_.unit.empty() && word.ends_with(format_.unit))
    word = trimmed(word.substr(0, word.size() - format_.unit.size()));
  if (format_.decimal_mark == '.') return parse_number(word);
  if (word.find('.') != std::string_view::npos) return std::nullopt;
  std::string with_point(word);
  std::ranges::replace(with_point, ',', '.');
  return parse_number(with_point);
}

std::optional<NumberLine> LineReader::decode(std::string_view line) {
  const std::string_view text = trimmed(line);
  if (text.empty() || (!format_.comment.empty() && text.starts_with(format_.comment))) return std::nullopt;
  return format_.names.empty() ? decode_columns(line) : decode_names(line);
}

std::optional<NumberLine> LineReader::decode_columns(std::string_view line) {
  const std::vector<std::string_view> words = split(line);
  NumberLine numbers{.values = {}, .words = words.size(), .size = line.size() + 1};
  for (const int column : format_.columns) {
    const auto index = static_cast<std::size_t>(column - 1);
    const auto value = index < words.size() ? number_in(words[index]) : std::nullopt;
    if (!value) break;
    numbers.values.push_back(*value);
  }
  if (numbers.values.size() < format_.columns.size() ||
      (required_words_ && words.size() != *required_words_)) {
    count_other_line(line.size() + 1);
    return std::nullopt;
  }
  has_numbers_come_ = true;
  numbers.decimal_commas = format_.separator == "," && looks_like_decimal_commas(words);
  return numbers;
}

std::optional<NumberLine> LineReader::decode_names(std::string_view line) {
  std::size_t found = 0;
  bool is_bad = false;
  for (std::size_t i = 0; i < format_.names.size(); ++i) {
    const NamedNumber number = named_number(line, format_.names[i], format_);
    if (number.found == 0) continue;
    ++found;
    is_bad = is_bad || number.found > 1 || !number.value || so_far_[i].has_value();
    so_far_[i] = number.value;
  }
  const bool is_part = all_on_one_line_ && found < format_.names.size();
  if (found == 0 && !is_part) return std::nullopt;
  size_so_far_ += line.size() + 1;
  if (is_bad || is_part) {
    count_other_line(std::exchange(size_so_far_, 0));
    so_far_.assign(format_.names.size(), std::nullopt);
    return std::nullopt;
  }
  if (!std::ranges::all_of(so_far_, [](const auto& value) { return value.has_value(); })) return std::nullopt;
  all_on_one_line_ = all_on_one_line_ || found == format_.names.size();
  NumberLine numbers{.values = {}, .words = format_.names.size(), .size = std::exchange(size_so_far_, 0)};
  for (std::optional<double>& value : so_far_) numbers.values.push_back(*std::exchange(value, std::nullopt));
  has_numbers_come_ = true;
  return numbers;
}

/// Counts a line that has no numbers where they should be. `bytes`: those of its bytes that have not been
/// counted elsewhere.
void LineReader::count_other_line(std::size_t bytes) {
  if (!has_numbers_come_) {
    ++header_lines_;
    return;
  }
  ++bad_lines_;
  skipped_bytes_ += bytes;
}

}  // namespace abcal::text_line
