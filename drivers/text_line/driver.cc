#include <algorithm>
#include <memory>
#include <system_error>
#include <utility>

#include "drivers/registry.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "drivers/text_line/accelerometer.h"
#include "drivers/text_line/environment.h"

namespace abcal {
namespace {

bool is_number(std::string_view word) {
  word = pieces::trimmed(word);
  if (word.starts_with('+')) word.remove_prefix(1);
  return pieces::number<double>(word).has_value();
}

/// Two whole lines of three numbers or more. The first line may have lost its beginning.
bool prints_numbers(std::string_view received) {
  const std::vector<std::string_view> lines = pieces::split(received, '\n');
  int found = 0;
  for (std::size_t n = 1; n + 1 < lines.size(); ++n) {
    const std::vector<std::string_view> words = pieces::split(lines[n], ',');
    if (words.size() >= 3 && std::all_of(words.begin(), words.end(), is_number)) ++found;
  }
  return found >= 2;
}

}  // namespace

void register_text_line(DriverList& drivers) {
  drivers.accelerometers.push_back(
      {.name = "text_line",
       .description = "boards that print lines of numbers, output in the unit of the bench file",
       .serial = {115200, false},
       .make = make_accelerometer_of<TextLineAccelerometer>,
       .generic = true,
       .recognition = {"", prints_numbers}});
  drivers.traits["text_line"] = {.reports_maker = false, .reports_model = false};
  drivers.environments.push_back(
      {.name = "text_line",
       .serial = {9600, false},
       .make = [](auto stream, Clock& clock,
                  const EnvironmentSettings& settings) -> std::unique_ptr<EnvironmentSensor> {
         return std::make_unique<TextLineEnvironment>(std::move(stream), clock, settings);
       }});
}

}  // namespace abcal
