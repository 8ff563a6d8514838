#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace abcal {

/// A value, as a rule of an enum, and its name.
template <class Value>
struct Named {
  Value value;
  std::string_view name;
};

/// The names of some values, each stated once: names() makes it. Every layer may include this.
template <class Value, std::size_t count>
struct Names {
  std::array<Named<Value>, count> rows;

  /// Name of `value`; `otherwise` if it has none.
  constexpr std::string_view of(Value value, std::string_view otherwise = {}) const {
    for (const Named<Value>& row : rows)
      if (row.value == value) return row.name;
    return otherwise;
  }

  /// The value with this name, if there is one.
  constexpr std::optional<Value> value(std::string_view name) const {
    for (const Named<Value>& row : rows)
      if (row.name == name) return row.value;
    return std::nullopt;
  }

  /// All names in their order.
  std::vector<std::string> all() const {
    std::vector<std::string> all;
    for (const Named<Value>& row : rows) all.emplace_back(row.name);
    return all;
  }
};

/// names<Fruit>({{Fruit::kApple, "apple"}, {Fruit::kPear, "pear"}}). A value or a name that stands in it
/// twice does not compile.
template <class Value, std::size_t count>
consteval Names<Value, count> names(const Named<Value> (&rows)[count]) {
  for (std::size_t i = 0; i < count; ++i)
    for (std::size_t k = 0; k < i; ++k)
      if (rows[i].value == rows[k].value || rows[i].name == rows[k].name) throw "stated twice";
  return {std::to_array(rows)};
}

}  // namespace abcal
