#include "app/units/response_unit.h"

#include <fmt/format.h>

#include <array>
#include <charconv>
#include <optional>
#include <stdexcept>
#include <utility>

#include "app/certificate/derived.h"

namespace abcal {
namespace {

constexpr double kPi = 3.14159265358979323846;

struct Prefix {
  std::string_view word, letters;
  double factor;
};
constexpr std::array<Prefix, 11> kPrefixes{{{"nano", "n", 1e-9},
                                            {"micro", "u", 1e-6},
                                            {"micro", "\u00b5", 1e-6},
                                            {"micro", "\u03bc", 1e-6},
                                            {"milli", "m", 1e-3},
                                            {"centi", "c", 1e-2},
                                            {"deci", "d", 1e-1},
                                            {"kilo", "k", 1e3},
                                            {"mega", "M", 1e6},
                                            {"giga", "G", 1e9},
                                            {"pico", "p", 1e-12}}};

/// Units that outputs of accelerometers and their certificates have.
std::optional<UnitMeaning> unit_word(std::string_view word) {
  if (word == "one") return UnitMeaning{};
  if (word == "percent") return UnitMeaning{1e-2, {}};
  if (word == "degree") return UnitMeaning{kPi / 180.0, {{"radian", 1}}};
  for (const std::string_view base :
       {"metre", "second", "volt", "ampere", "coulomb", "kilogram", "kelvin", "radian", "hertz", "ohm"}) {
    if (word == base) return UnitMeaning{1.0, {{std::string(base), 1}}};
  }
  return std::nullopt;
}

std::optional<double> prefix_word(std::string_view word) {
  for (const Prefix& prefix : kPrefixes) {
    if (word == prefix.word) return prefix.factor;
  }
  return std::nullopt;
}

std::optional<UnitMeaning> plain_unit(std::string_view name) {
  if (name == "V") return UnitMeaning{1.0, {{"volt", 1}}};
  if (name == "A") return UnitMeaning{1.0, {{"ampere", 1}}};
  if (name == "g") return UnitMeaning{kStandardGravity, metre_per_second_squared().powers};
  if (name == "m/s2" || name == "m/s^2" || name == "m s-2" || name == "m/s\u00b2")
    return metre_per_second_squared();
  return std::nullopt;
}

UnitMeaning to_the(UnitMeaning unit, int power) {
  UnitMeaning result;
  for (int i = 0; i < std::abs(power); ++i)
    result.factor = power > 0 ? result.factor * unit.factor : result.factor / unit.factor;
  for (auto& [base, exponent] : unit.powers) {
    if (exponent * power != 0) result.powers[base] = exponent * power;
  }
  return result;
}

}  // namespace

UnitMeaning UnitMeaning::operator*(const UnitMeaning& other) const {
  UnitMeaning product{factor * other.factor, powers};
  for (const auto& [base, exponent] : other.powers) {
    if ((product.powers[base] += exponent) == 0) product.powers.erase(base);
  }
  return product;
}

UnitMeaning metre_per_second_squared() {
  return {1.0, {{"metre", 1}, {"second", -2}}};
}

UnitMeaning meaning_of_response_unit(std::string_view name) {
  if (const auto unit = plain_unit(name)) return *unit;
  for (const Prefix& prefix : kPrefixes) {
    if (!name.starts_with(prefix.letters)) continue;
    auto unit = plain_unit(name.substr(prefix.letters.size()));
    if (!unit || name.find('/') != std::string_view::npos) continue;
    unit->factor *= prefix.factor;
    return *unit;
  }
  for (const std::string_view count : {"count", "counts", "digit", "digits"}) {
    if (name == count) return {1.0, {{"LSB", 1}}};
  }
  return {1.0, {{std::string(name), 1}}};
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
      int power = 0;
      const auto [stop, error] = std::from_chars(digits.data(), digits.data() + digits.size(), power);
      if (error != std::errc() || stop != digits.data() + digits.size() || std::abs(power) > 12)
        refuse(fmt::format("power \"{}\"; required: a whole number", digits));
      if (!power_may_follow) refuse("a power without a unit before it");
      last = to_the(last, power);
    } else if (const auto factor = prefix_word(word)) {
      take_last();
      prefix *= *factor;
    } else if (auto unit = unit_word(word)) {
      take_last();
      unit->factor *= prefix;
      prefix = 1.0;
      last = *unit;
      power_may_follow = true;
    } else {
      refuse(fmt::format("\\{} is not a unit that outputs of accelerometers have", word));
    }
  }
  if (prefix != 1.0) refuse("a prefix without a unit after it");
  take_last();
  return product;
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
