#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace abcal {

/// A value, as a rule of an enum, and its name.
template <class Value, class Name>
struct Named {
  Value value;
  Name name;
};

/// The names of some values, each stated once: names() makes it. Every layer may include this.
template <class Value, class Name, std::size_t count>
struct Names {
  std::array<Named<Value, Name>, count> rows;

  /// Name of `value`; `otherwise` if it has none.
  constexpr Name of(Value value, Name otherwise = {}) const {
    for (const auto& row : rows)
      if (row.value == value) return row.name;
    return otherwise;
  }

  /// The value with this name, if there is one.
  constexpr std::optional<Value> value(std::string_view name) const {
    for (const auto& row : rows)
      if (row.name == name) return row.value;
    return std::nullopt;
  }

  /// All names in their order.
  std::vector<std::string> all() const {
    std::vector<std::string> all;
    for (const auto& row : rows) all.emplace_back(row.name);
    return all;
  }
};

/// names<Fruit>({{Fruit::kApple, "apple"}, {Fruit::kPear, "pear"}}). A value or a name that stands in it
/// twice does not compile. names<Fruit, Term>(...): names that have translations (message.h).
template <class Value, class Name = std::string_view, std::size_t count>
consteval Names<Value, Name, count> names(const Named<Value, Name> (&rows)[count]) {
  for (std::size_t i = 0; i < count; ++i)
    for (std::size_t k = 0; k < i; ++k)
      if (rows[i].value == rows[k].value || rows[i].name == std::string_view(rows[k].name))
        throw "stated twice";
  return {std::to_array(rows)};
}

}  // namespace abcal
