#include "drivers/instrument/correction_registers.h"

#include <charconv>
#include <cmath>
#include <stdexcept>

#include "drivers/text/text.h"

namespace abcal {
namespace {

/// "+01.5" too, as some instruments write it.
bool read_number(std::string_view word, double& value) {
  if (word.starts_with('+')) word.remove_prefix(1);
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  return error == std::errc{} && end == word.data() + word.size() && std::isfinite(value);
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
    double value = 0.0;
    if (read_number(word, value)) {
      numbers.push_back(value);
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
