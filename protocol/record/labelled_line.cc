#include "protocol/record/labelled_line.h"

#include <algorithm>
#include <charconv>

#include "drivers/text/text.h"

namespace abcal {
namespace {

bool is_letter(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}

/// The last word before a colon, without quotes and brackets: the label of the number behind it.
std::string label_before(std::string_view text) {
  const auto belongs = [](char c) { return is_letter(c) || pieces::is_digit(c) || c == '_'; };
  while (!text.empty() && !belongs(text.back())) text.remove_suffix(1);
  std::size_t begin = text.size();
  while (begin > 0 && belongs(text[begin - 1])) --begin;
  const std::string_view label = text.substr(begin);
  return std::ranges::any_of(label, is_letter) ? std::string(label) : std::string();
}

/// Characters of the number at the beginning of a text.
std::size_t length_of_number(std::string_view text) {
  double ignored = 0.0;
  const std::size_t sign = text.starts_with('+') ? 1 : 0;
  const auto [end, error] = std::from_chars(text.data() + sign, text.data() + text.size(), ignored);
  return error == std::errc() ? static_cast<std::size_t>(end - text.data()) : 0;
}

}  // namespace

std::optional<std::vector<std::pair<std::string, std::string>>> labelled_numbers(std::string_view line) {
  std::vector<std::pair<std::string, std::string>> pairs;
  if (const std::size_t arrow = line.find("->"); arrow != std::string_view::npos) {
    pairs.emplace_back("time", pieces::trimmed(line.substr(0, arrow)));
    line.remove_prefix(arrow + 2);
  }
  std::size_t numbers = 0;
  for (std::size_t at = 0; (at = line.find_first_of("=:")) != std::string_view::npos;) {
    std::string label = label_before(line.substr(0, at));
    line = pieces::trimmed(line.substr(at + 1));
    const std::size_t length = length_of_number(line);
    if (label.empty() || length == 0) continue;
    pairs.emplace_back(std::move(label), std::string(line.substr(0, length)));
    line.remove_prefix(length);
    ++numbers;
  }
  constexpr std::size_t kLeast = 3;
  return numbers >= kLeast ? std::optional(std::move(pairs)) : std::nullopt;
}

}  // namespace abcal
