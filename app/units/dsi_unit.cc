#include "app/units/dsi_unit.h"

#include <fmt/format.h>

#include <algorithm>
#include <map>

#include "app/certificate/derived.h"
#include "app/xml/xml_tree.h"

namespace abcal {
namespace {

DsiUnit acceleration() {
  return DsiUnit("\\metre") * DsiUnit("\\second").to_the(-2);
}

/// Per m/s2, in the order of the examples of the PTB.
DsiUnit per_acceleration() {
  return DsiUnit("\\second").to_the(2) * DsiUnit("\\metre").to_the(-1);
}

/// Units that D-SI has a name for.
const std::map<std::string, DsiUnit>& known_units() {
  static const std::map<std::string, DsiUnit> kUnits{
      {"V", DsiUnit("\\volt")},
      {"mV", DsiUnit("\\milli\\volt")},
      {"uV", DsiUnit("\\micro\\volt")},
      {"\u00b5V", DsiUnit("\\micro\\volt")},
      {"\u03bcV", DsiUnit("\\micro\\volt")},
      {"V/V", DsiUnit()},
      {"mV/V", DsiUnit("\\milli\\volt") * DsiUnit("\\volt").to_the(-1)},
      {"A", DsiUnit("\\ampere")},
      {"mA", DsiUnit("\\milli\\ampere")},
      {"m/s2", acceleration()},
      {"m/s^2", acceleration()},
      {"m/s\u00b2", acceleration()},
      {"1", DsiUnit()},
      {"degree", DsiUnit("\\degree")},
      {"mrad", DsiUnit("\\milli\\radian")},
      {"%", DsiUnit("\\percent")},
  };
  return kUnits;
}

/// Multiples of standard gravity, as a unit.
const std::map<std::string, double> kOfGravity{{"g", 1.0}, {"mg", 1e-3}, {"ug", 1e-6}, {"\u00b5g", 1e-6}};

/// The name of a unit that is not of the SI, as one word behind the bar that D-SI wants.
std::string non_si(const std::string& name) {
  std::string word = one_line(name);
  std::replace(word.begin(), word.end(), ' ', '_');
  return "|" + word;
}

bool take_suffix(std::string& text, const std::string& suffix) {
  if (!text.ends_with(suffix) || text.size() == suffix.size()) return false;
  text.resize(text.size() - suffix.size());
  if (text.size() > 2 && text.front() == '(' && text.back() == ')') text = text.substr(1, text.size() - 2);
  return true;
}

}  // namespace

DsiUnit DsiUnit::to_the(int power) const {
  DsiUnit result = *this;
  for (auto& [name, exponent] : result.factors_) exponent *= power;
  return result;
}

DsiUnit DsiUnit::operator*(const DsiUnit& other) const {
  DsiUnit product = *this;
  for (const auto& [name, exponent] : other.factors_) {
    const auto same = std::find_if(product.factors_.begin(), product.factors_.end(),
                                   [&, of = name](const auto& factor) { return factor.first == of; });
    if (same == product.factors_.end()) {
      product.factors_.emplace_back(name, exponent);
    } else if ((same->second += exponent) == 0) {
      product.factors_.erase(same);
    }
  }
  return product;
}

std::string DsiUnit::text() const {
  if (factors_.empty()) return "\\one";
  std::string text;
  for (const auto& [name, exponent] : factors_)
    text += exponent == 1 ? name : fmt::format("{}\\tothe{{{}}}", name, exponent);
  return text;
}

UnitInDsi unit_in_dsi(const std::string& unit) {
  UnitInDsi in;
  if (const auto known = known_units().find(unit); known != known_units().end()) {
    in.unit = known->second;
    return in;
  }
  if (const auto multiple = kOfGravity.find(unit); multiple != kOfGravity.end()) {
    in.unit = acceleration();
    in.factor = multiple->second * kStandardGravity;
    in.own = DsiUnit(non_si(unit));
    in.definition = fmt::format("1 {} = {} m/s2 (standard gravity 9.80665 m/s2, exact)", unit, in.factor);
    return in;
  }
  std::string output = unit;
  if (take_suffix(output, "/g_loc")) return unit_in_dsi(output);
  if (take_suffix(output, "/(m/s2)")) {
    in = unit_in_dsi(output);
    in.unit = in.unit * per_acceleration();
    if (in.own) {
      in.own = *in.own * per_acceleration();
      const std::string si = in.unit.text();
      in.definition = fmt::format("1 {} = {}{}", unit, in.factor,
                                  si == "\\one" ? ", a plain number in SI units" : " in the SI unit " + si);
    }
    return in;
  }
  if (take_suffix(output, "/g")) {
    in = unit_in_dsi(output);
    in.unit = in.unit * per_acceleration();
    in.factor /= kStandardGravity;
    in.own = DsiUnit(non_si(unit));
    in.definition =
        fmt::format("1 {} = {} of the SI unit; g = 9.80665 m/s2 (standard gravity, exact)", unit, in.factor);
    return in;
  }
  in.note = fmt::format("1 stands for one {} of the output.", unit.empty() ? "digit" : one_line(unit));
  return in;
}

}  // namespace abcal
