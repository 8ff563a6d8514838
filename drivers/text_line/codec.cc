#include "drivers/text_line/codec.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <stdexcept>
#include <utility>

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

bool all_digits(std::string_view word) {
  return !word.empty() && std::all_of(word.begin(), word.end(), [](char c) { return c >= '0' && c <= '9'; });
}

/// Whole numbers, every second of which are digits, one of them with a zero before others: "01" is no number
/// that a board prints, but what stands behind a decimal mark.
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

}  // namespace

std::optional<double> parse_number(std::string_view word) {
  if (word.starts_with('+')) {
    word.remove_prefix(1);
    if (word.starts_with('-')) return std::nullopt;
  }
  double value = 0.0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc{} || end != word.data() + word.size()) return std::nullopt;
  return value;
}

LineReader::LineReader(LineFormat format) : format_(std::move(format)) {
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
}

std::vector<std::string_view> LineReader::split(std::string_view line) const {
  std::vector<std::string_view> words;
  if (format_.separator == " ") {
    for (std::string_view rest = trimmed(line); !rest.empty();) {
      const std::size_t end = std::min(rest.find_first_of(kBlanks), rest.size());
      words.push_back(rest.substr(0, end));
      rest = trimmed(rest.substr(end));
    }
    return words;
  }
  for (;;) {
    const std::size_t end = line.find(format_.separator);
    words.push_back(trimmed(line.substr(0, end)));
    if (end == std::string_view::npos) return words;
    line.remove_prefix(end + 1);
  }
}

std::optional<NumberLine> LineReader::decode(std::string_view line) {
  const std::string_view text = trimmed(line);
  if (text.empty() || (!format_.comment.empty() && text.starts_with(format_.comment))) return std::nullopt;
  const std::vector<std::string_view> words = split(line);
  NumberLine numbers{.values = {}, .words = words.size(), .size = line.size() + 1};
  for (const int column : format_.columns) {
    const auto index = static_cast<std::size_t>(column - 1);
    const auto value = index < words.size() ? parse_number(words[index]) : std::nullopt;
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

/// A line that has no numbers where they should be. `bytes`: of it, that have not been counted elsewhere.
void LineReader::count_other_line(std::size_t bytes) {
  if (!has_numbers_come_) {
    ++header_lines_;
    return;
  }
  ++bad_lines_;
  skipped_bytes_ += bytes;
}

}  // namespace abcal::text_line
