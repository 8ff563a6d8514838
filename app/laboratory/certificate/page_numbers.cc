#include "app/laboratory/certificate/page_numbers.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <map>
#include <string_view>

namespace abcal {
namespace {

constexpr std::string_view kMinus = "−";

std::string superscript(std::string_view digits) {
  static const std::array<std::string_view, 10> kDigits{"⁰", "¹", "²", "³", "⁴", "⁵", "⁶", "⁷", "⁸", "⁹"};
  std::string text;
  bool leading = true;
  for (const char c : digits) {
    if (c == '-') text += "⁻";
    if (c >= '1' && c <= '9') leading = false;
    if (c >= '0' && c <= '9' && !leading) text += kDigits[static_cast<std::size_t>(c - '0')];
  }
  return text;
}

void replace_all(std::string& text, std::string_view from, std::string_view to) {
  for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
    text.replace(at, from.size(), to);
}

/// Symbols of the words that units of the certificate have.
const std::map<std::string_view, std::string_view>& symbols() {
  static const std::map<std::string_view, std::string_view> kSymbols{
      {"one", ""},      {"volt", "V"},    {"ampere", "A"},  {"metre", "m"},    {"second", "s"},
      {"kelvin", "K"},  {"pascal", "Pa"}, {"degree", "°"},  {"radian", "rad"}, {"degreecelsius", "°C"},
      {"percent", "%"}, {"milli", "m"},   {"micro", "µ"},   {"nano", "n"},     {"kilo", "k"},
      {"hecto", "h"},   {"hertz", "Hz"},  {"coulomb", "C"}, {"pico", "p"}};
  return kSymbols;
}

bool is_prefix(std::string_view word) {
  return word == "milli" || word == "micro" || word == "nano" || word == "kilo" || word == "hecto" ||
         word == "pico";
}

}  // namespace

std::string typeset_number(std::string_view decimal, const Words& words) {
  const std::size_t e = std::min(decimal.find('e'), decimal.size());
  std::string text = words("{number}", Number{std::string(decimal.substr(0, e))}).text;
  replace_all(text, "-", kMinus);
  if (e == decimal.size()) return text;
  return text + " × 10" + superscript(decimal.substr(e + 1));
}

std::string typeset_unit(std::string_view d_si) {
  std::string text(d_si);
  if (text == "\\one") return "1";
  // Units per acceleration are written in their usual form.
  constexpr std::string_view kPerAcceleration = "\\second\\tothe{2}\\metre\\tothe{-1}";
  bool per_acceleration = false;
  if (const std::size_t at = text.find(kPerAcceleration); at != std::string::npos) {
    text.erase(at, kPerAcceleration.size());
    per_acceleration = true;
  }
  std::string shown;
  std::string_view rest = text;
  if (rest.starts_with('|')) {
    const std::size_t end = std::min(rest.find('\\'), rest.size());
    shown = rest.substr(1, end - 1);
    rest.remove_prefix(end);
  }
  bool joined = shown.empty();  // A prefix belongs to the unit behind it.
  while (rest.starts_with('\\')) {
    const std::size_t end = std::min(rest.find('\\', 1), rest.size());
    const std::string_view word = rest.substr(1, end - 1);
    rest.remove_prefix(end);
    if (word.starts_with("tothe{")) {
      shown += superscript(word.substr(6, word.size() - 7));
      continue;
    }
    const auto symbol = symbols().find(word);
    if (symbol == symbols().end()) return std::string(d_si);
    if (!shown.empty() && !joined) shown += " ";
    shown += symbol->second;
    joined = is_prefix(word);
  }
  if (shown == "m s⁻²") shown = "m/s²";
  if (shown == "° s⁻¹") shown = "°/s";
  replace_all(shown, "m/s2", "m/s²");
  if (!per_acceleration) return shown;
  return (shown.empty() ? "1" : shown) + "/(m/s²)";
}

double number_in_xml(std::string_view word) {
  double value = std::nan("");
  std::from_chars(word.data(), word.data() + word.size(), value);
  return value;
}

}  // namespace abcal
