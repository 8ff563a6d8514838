#include "app/formats/dsi_unit.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <stdexcept>

#include "app/formats/typed_unit.h"
#include "app/formats/xml_tree.h"
#include "drivers/text/number.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

DsiUnit acceleration() {
  return DsiUnit("\\metre") * DsiUnit("\\second").to_the(-2);
}

/// Per m/s2, in the order of the examples of the PTB.
DsiUnit per_acceleration() {
  return DsiUnit("\\second").to_the(2) * DsiUnit("\\metre").to_the(-1);
}

/// The name of a unit that is not of the SI, as one word after the bar that D-SI requires.
std::string non_si(const std::string& name) {
  std::string word = one_line(name);
  std::replace(word.begin(), word.end(), ' ', '_');
  return "|" + word;
}

std::string without_parentheses(const std::string& text) {
  const bool has_both = text.size() > 2 && text.front() == '(' && text.back() == ')';
  return has_both ? text.substr(1, text.size() - 2) : text;
}

bool take_suffix(std::string& text, const std::string& suffix) {
  if (!text.ends_with(suffix) || text.size() == suffix.size()) return false;
  text = without_parentheses(text.substr(0, text.size() - suffix.size()));
  return true;
}

UnitMeaning meaning_to_the(UnitMeaning unit, int power) {
  UnitMeaning result;
  for (int i = 0; i < std::abs(power); ++i)
    result.factor = power > 0 ? result.factor * unit.factor : result.factor / unit.factor;
  for (auto& [base, exponent] : unit.powers) {
    if (exponent * power != 0) result.powers[base] = exponent * power;
  }
  return result;
}

/// Units of changes with temperature: "urad/K", "ug/K", and "ppm/K", parts in a million of a sensitivity.
UnitInDsi per_kelvin(const std::string& unit, const std::string& output) {
  const DsiUnit per_kelvin = DsiUnit("\\kelvin").to_the(-1);
  UnitInDsi in;
  if (output == "ppm") {
    in.own = DsiUnit("|ppm");
    in.factor = 1e-6;
  } else {
    in = unit_in_dsi(output);
  }
  in.unit = in.unit * per_kelvin;
  if (!in.own) return in;
  in.own = *in.own * per_kelvin;
  in.definition = Message("1 {unit} = {value} in the SI unit {si_unit}", unit, in.factor, in.unit.text());
  return in;
}

/// Per standard gravity, or per local gravity where its value is given.
UnitInDsi per_gravity(const std::string& unit, const std::string& output, double gravity_mps2,
                      bool standard) {
  UnitInDsi in = unit_in_dsi(output);
  in.unit = in.unit * per_acceleration();
  in.factor /= gravity_mps2;
  in.own = DsiUnit(non_si(unit));
  in.definition = !standard ? Message(
                                  "1 {unit} is a change of the output by 1 {output_unit} for an acceleration "
                                  "of one local gravity, which is among the conditions",
                                  unit, output)
                  : in.unit.text() == "\\one"
                      ? Message(
                            "1 {unit} = {value}, a plain number in SI units (g_n = 9.80665 m/s2, standard "
                            "gravity, exact)",
                            unit, in.factor)
                      : Message("1 {unit} = {value} {in_unit} (g_n = 9.80665 m/s2, standard gravity, exact)",
                                unit, 1.0 / gravity_mps2, TypedUnit{output, PerAcceleration::kSi}.name());
  return in;
}

Message definition_of(const std::string& unit, const Number& value, const std::string& si) {
  if (si == "\\one") return {"1 {unit} = {value}, a plain number in SI units", unit, value};
  return {"1 {unit} = {value} in the SI unit {si_unit}", unit, value, si};
}

/// Units of the inverse of a sensitivity: "(m/s2)/V".
UnitInDsi acceleration_per(const std::string& unit, const std::string& output) {
  const UnitInDsi of_output = unit_in_dsi(output);
  UnitInDsi in;
  in.unit = acceleration() * of_output.unit.to_the(-1);
  in.note = of_output.note;
  if (!of_output.own) return in;
  in.factor = 1.0 / of_output.factor;
  in.own = DsiUnit(non_si(unit));
  in.definition = definition_of(unit, Number{fmt::format("{:.12g}", in.factor)}, in.unit.text());
  return in;
}

/// A unit of the table, with its D-SI form.
UnitInDsi from_table(const PrefixedUnit& found, const std::string& name) {
  UnitInDsi in;
  const NamedUnit& unit = *found.unit;
  if (!unit.d_si.empty()) {
    const std::string prefix = found.prefix == nullptr ? "" : fmt::format("\\{}", found.prefix->d_si);
    in.unit = unit.d_si == "one" ? DsiUnit() : DsiUnit(fmt::format("{}\\{}", prefix, unit.d_si));
  } else {
    in.unit = acceleration();
    in.factor = found.prefix_factor() * unit.factor;
    if (in.factor == 1.0) return in;
    in.own = DsiUnit(non_si(name));
    in.definition =
        Message("1 {unit} = {value} m/s2 (standard gravity 9.80665 m/s2, exact)", name, in.factor);
  }
  return in;
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

UnitInDsi unit_in_dsi(const std::string& unit, std::optional<double> g_loc_mps2) {
  UnitInDsi in;
  const auto found = find_unit(unit);
  if (found && (!found->unit->d_si.empty() || acceleration_unit_mps2(unit))) return from_table(*found, unit);
  const TypedUnit typed = typed_unit(unit);
  // "(m/s2)/g_n" is a sensitivity of an output in m/s2.
  const bool is_per_gravity = typed.per == PerAcceleration::kLocal || typed.per == PerAcceleration::kStandard;
  if (constexpr std::string_view kAcceleration = "(m/s2)/";
      !is_per_gravity && unit.starts_with(kAcceleration) && unit.size() > kAcceleration.size())
    return acceleration_per(unit, without_parentheses(unit.substr(kAcceleration.size())));
  std::string output = unit;
  if (take_suffix(output, "/K")) return per_kelvin(unit, output);
  if (take_suffix(output, "/V")) {
    in = unit_in_dsi(output);
    in.unit = in.unit * DsiUnit("\\volt").to_the(-1);
    return in;
  }
  if (typed.per == PerAcceleration::kLocal) {
    if (!g_loc_mps2) return unit_in_dsi(typed.output);
    return per_gravity(unit, typed.output, *g_loc_mps2, false);
  }
  if (typed.per == PerAcceleration::kStandard) return per_gravity(unit, typed.output, kStandardGravity, true);
  if (typed.per == PerAcceleration::kSi) {
    in = unit_in_dsi(typed.output);
    in.unit = in.unit * per_acceleration();
    if (in.own) {
      in.own = *in.own * per_acceleration();
      in.definition = definition_of(unit, Number{fmt::format("{}", in.factor)}, in.unit.text());
    }
    return in;
  }
  in.note = fmt::format("1 stands for one {} of the output.", unit.empty() ? "digit" : one_line(unit));
  return in;
}

UnitMeaning meaning_of_d_si(std::string_view text) {
  const auto refuse = [&](const std::string& why) {
    throw std::invalid_argument(fmt::format("D-SI unit \"{}\": {}", text, why));
  };
  UnitMeaning product;
  double prefix = 1.0;
  UnitMeaning last;  // Not yet multiplied in: a power may follow.
  bool power_may_follow = false;
  const auto take_last = [&] {
    product = product * last;
    last = {};
    power_may_follow = false;
  };
  std::string_view rest = text;
  if (rest.empty()) refuse("empty");
  while (!rest.empty()) {
    if (rest.front() != '\\') refuse("every word begins with \\");
    const std::size_t end = std::min(rest.find('\\', 1), rest.size());
    const std::string_view word = rest.substr(1, end - 1);
    rest.remove_prefix(end);
    if (word.starts_with("tothe{") && word.ends_with("}")) {
      const std::string_view digits = word.substr(6, word.size() - 7);
      const auto power = pieces::number<int>(digits);
      if (!power || std::abs(*power) > 12)
        refuse(fmt::format("power \"{}\"; required: a whole number", digits));
      if (!power_may_follow) refuse("a power without a unit before it");
      last = meaning_to_the(last, *power);
    } else if (const UnitPrefix* known = find_d_si_prefix(word)) {
      take_last();
      prefix *= known->factor;
    } else if (const NamedUnit* unit = find_d_si_unit(word)) {
      take_last();
      last = unit->meaning();
      last.factor *= prefix;
      prefix = 1.0;
      power_may_follow = true;
    } else {
      refuse(fmt::format("\\{} is not a unit of an accelerometer output", word));
    }
  }
  if (prefix != 1.0) refuse("a prefix without a unit after it");
  take_last();
  return product;
}

}  // namespace abcal
