#include "app/document/number_text.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdlib>

#include "drivers/text/text.h"

namespace abcal {
namespace {

using pieces::is_digit;

/// Whether a character belongs to a word, so that no number begins or ends next to it. Bytes of other than
/// ASCII letters ("°", "µ") do not.
bool is_of_word(char c) {
  return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_';
}

std::size_t end_of_digits(std::string_view text, std::size_t at) {
  while (at < text.size() && is_digit(text[at])) ++at;
  return at;
}

/// A decimal number at the beginning of a text.
struct Number {
  std::size_t mantissa = 0;  ///< Bytes of digits and point; 0: there is no number.
  std::size_t all = 0;       ///< With the exponent.
  int exponent = 0;
};

Number number_at(std::string_view text) {
  Number number;
  number.mantissa = end_of_digits(text, 0);
  if (number.mantissa == 0) return number;
  if (number.mantissa + 1 < text.size() && (text[number.mantissa] == '.' || text[number.mantissa] == ',') &&
      is_digit(text[number.mantissa + 1]))
    number.mantissa = end_of_digits(text, number.mantissa + 1);
  number.all = number.mantissa;
  if (number.all + 2 >= text.size() || text[number.all] != 'e') return number;
  const char sign = text[number.all + 1];
  const std::size_t first = number.all + 2, end = end_of_digits(text, first);
  if ((sign != '-' && sign != '+') || end == first || (end < text.size() && is_of_word(text[end])))
    return number;
  std::from_chars(text.data() + first, text.data() + end, number.exponent);
  if (sign == '-') number.exponent = -number.exponent;
  number.all = end;
  return number;
}

}  // namespace

std::string power_of_ten(int exponent) {
  if (exponent == 0) return "1";
  static const std::array<std::string_view, 10> kDigits{"⁰", "¹", "²", "³", "⁴", "⁵", "⁶", "⁷", "⁸", "⁹"};
  std::string text = exponent < 0 ? "10⁻" : "10";
  for (const char digit : std::to_string(std::abs(exponent)))
    text += kDigits[static_cast<std::size_t>(digit - '0')];
  return text;
}

std::string typeset_numbers(std::string_view text) {
  std::string out;
  bool in_word = false;  // The character before belongs to a word or to the number before.
  for (std::size_t at = 0; at < text.size();) {
    const bool negative = text[at] == '-';
    const Number number = in_word ? Number{} : number_at(text.substr(at + (negative ? 1 : 0)));
    if (number.mantissa == 0) {
      in_word = is_of_word(text[at]) || (text[at] == '.' && in_word);
      out += text[at++];
      continue;
    }
    if (negative) {
      out += "−";
      ++at;
    }
    out += text.substr(at, number.mantissa);
    if (number.exponent != 0) out += " × " + power_of_ten(number.exponent);
    at += number.all;
    in_word = true;
  }
  return out;
}

int place_of_second_digit(double number) {
  constexpr double kRoundedUp = 0.995;  // 9.95 and more are 10 in two digits
  return static_cast<int>(std::floor(std::log10(number / kRoundedUp))) - 1;
}

std::string without_negative_zero(std::string number) {
  if (!number.starts_with('-')) return number;
  const std::string_view mantissa = std::string_view(number).substr(1, number.find('e') - 1);
  const bool is_zero = !mantissa.empty() && mantissa.find_first_not_of("0.") == std::string_view::npos;
  return is_zero ? number.substr(1) : number;
}

}  // namespace abcal
