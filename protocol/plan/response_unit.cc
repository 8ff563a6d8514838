#include "protocol/plan/response_unit.h"

#include <fmt/format.h>

#include <numbers>

#include "protocol/plan/limits.h"

namespace abcal {
namespace {

// Prefixes with two spellings: u, and the micro sign and the Greek letter, which look the same.
constexpr std::array<UnitPrefix, 11> kUnitPrefixes{{{"m", "milli", 1e-3},
                                                    {"u", "micro", 1e-6},
                                                    {"\u00b5", "micro", 1e-6},
                                                    {"\u03bc", "micro", 1e-6},
                                                    {"n", "nano", 1e-9},
                                                    {"p", "pico", 1e-12},
                                                    {"c", "centi", 1e-2},
                                                    {"d", "deci", 1e-1},
                                                    {"k", "kilo", 1e3},
                                                    {"M", "mega", 1e6},
                                                    {"G", "giga", 1e9}}};

constexpr std::array<NamedUnit::Power, 2> kAcceleration{{{"metre", 1}, {"second", -2}}};

/// The units that outputs of accelerometers and their certificates have.
constexpr std::array<NamedUnit, 19> kNamedUnits{{
    {"V", "volt", 1.0, {{{"volt", 1}}}, true},
    {"A", "ampere", 1.0, {{{"ampere", 1}}}, true},
    {"g", "", kStandardGravity, kAcceleration, true},
    {"m/s2", "", 1.0, kAcceleration, false},
    {"m/s^2", "", 1.0, kAcceleration, false},
    {"m/s\u00b2", "", 1.0, kAcceleration, false},
    {"m s-2", "", 1.0, kAcceleration, false},
    {"rad", "radian", 1.0, {{{"radian", 1}}}, true},
    {"degree", "degree", std::numbers::pi / 180.0, {{{"radian", 1}}}, false},
    {"%", "percent", 1e-2, {}, false},
    {"1", "one", 1.0, {}, false},
    {"", "metre", 1.0, {{{"metre", 1}}}, false},
    {"", "second", 1.0, {{{"second", 1}}}, false},
    {"", "coulomb", 1.0, {{{"coulomb", 1}}}, false},
    {"", "kilogram", 1.0, {{{"kilogram", 1}}}, false},
    {"", "kelvin", 1.0, {{{"kelvin", 1}}}, false},
    {"", "hertz", 1.0, {{{"hertz", 1}}}, false},
    {"", "ohm", 1.0, {{{"ohm", 1}}}, false},
    {"LSB", "", 1.0, {{{"LSB", 1}}}, false},
}};

const NamedUnit* row_named(std::string_view name) {
  if (name.empty()) return nullptr;
  if (name == "count" || name == "counts" || name == "digit" || name == "digits") name = "LSB";
  for (const NamedUnit& unit : kNamedUnits) {
    if (unit.name == name) return &unit;
  }
  return nullptr;
}

}  // namespace

UnitMeaning UnitMeaning::operator*(const UnitMeaning& other) const {
  UnitMeaning product{factor * other.factor, powers};
  for (const auto& [base, exponent] : other.powers) {
    if ((product.powers[base] += exponent) == 0) product.powers.erase(base);
  }
  return product;
}

UnitMeaning NamedUnit::meaning() const {
  UnitMeaning meaning{factor, {}};
  for (const Power& power : powers) {
    if (power.exponent != 0) meaning.powers.emplace(power.base, power.exponent);
  }
  return meaning;
}

UnitMeaning metre_per_second_squared() {
  return {1.0, {{"metre", 1}, {"second", -2}}};
}

std::optional<PrefixedUnit> find_unit(std::string_view name) {
  if (const NamedUnit* unit = row_named(name)) return PrefixedUnit{nullptr, unit};
  for (const UnitPrefix& prefix : kUnitPrefixes) {
    if (!name.starts_with(prefix.letters)) continue;
    const NamedUnit* unit = row_named(name.substr(prefix.letters.size()));
    if (unit != nullptr && unit->takes_prefix) return PrefixedUnit{&prefix, unit};
  }
  return std::nullopt;
}

const NamedUnit* find_d_si_unit(std::string_view word) {
  for (const NamedUnit& unit : kNamedUnits) {
    if (!word.empty() && unit.d_si == word) return &unit;
  }
  return nullptr;
}

const UnitPrefix* find_d_si_prefix(std::string_view word) {
  for (const UnitPrefix& prefix : kUnitPrefixes) {
    if (prefix.d_si == word) return &prefix;
  }
  return nullptr;
}

UnitMeaning meaning_of_response_unit(std::string_view name) {
  const auto found = find_unit(name);
  if (!found) return {1.0, {{std::string(name), 1}}};
  UnitMeaning meaning = found->unit->meaning();
  meaning.factor *= found->prefix_factor();
  return meaning;
}

std::optional<double> unit_ratio(std::string_view from, std::string_view to) {
  const auto a = find_unit(from), b = find_unit(to);
  // For equal units only the prefixes are divided, so that powers of ten stay exact.
  if (a && b && a->unit == b->unit) return a->prefix_factor() / b->prefix_factor();
  const UnitMeaning first = meaning_of_response_unit(from), second = meaning_of_response_unit(to);
  if (!first.same_kind(second)) return std::nullopt;
  return first.factor / second.factor;
}

std::optional<double> acceleration_unit_mps2(std::string_view name) {
  const UnitMeaning meaning = meaning_of_response_unit(name);
  return meaning.same_kind(metre_per_second_squared()) ? std::optional(meaning.factor) : std::nullopt;
}

std::string name_of(const UnitMeaning& unit) {
  std::string name;
  if (unit.powers.empty()) {
    name = "1";
  } else if (unit.same_kind(metre_per_second_squared())) {
    name = "m/s2";
  } else if (unit.powers == std::map<std::string, int>{{"volt", 1}}) {
    name = "V";
  } else if (unit.powers == std::map<std::string, int>{{"ampere", 1}}) {
    name = "A";
  } else {
    for (const auto& [base, power] : unit.powers) {
      if (!name.empty()) name += " ";
      name += power == 1 ? base : fmt::format("{}^{}", base, power);
    }
  }
  return unit.factor == 1.0 ? name : fmt::format("{:g} {}", unit.factor, name);
}

}  // namespace abcal
