#include "drivers/instrument/correction_registers.h"

#include <cmath>
#include <stdexcept>

#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal {
namespace {

/// "+01.5" too, as some instruments write it.
std::optional<double> number_in(std::string_view word) {
  const auto value = pieces::number<double>(word.starts_with('+') ? word.substr(1) : word);
  return value && std::isfinite(*value) ? value : std::nullopt;
}

}  // namespace

std::vector<double> register_numbers(const RegisterTexts& registers, const std::string& name,
                                     std::size_t count) {
  const auto found = registers.find(name);
  if (found == registers.end())
    throw std::invalid_argument("register \"" + name +
                                "\" is missing; required: its content, as it was read");
  std::vector<double> numbers;
  for (const std::string_view word : pieces::words(found->second, ", \t\r\n")) {
    if (const auto value = number_in(word)) {
      numbers.push_back(*value);
    } else if (numbers.size() < count) {
      break;
    }
  }
  if (numbers.size() != count)
    throw std::invalid_argument("register \"" + name + "\" is \"" + found->second + "\"; required: " +
                                std::to_string(count) + (count == 1 ? " number" : " numbers"));
  return numbers;
}

double register_number(const RegisterTexts& registers, const std::string& name) {
  return register_numbers(registers, name, 1).front();
}

}  // namespace abcal
