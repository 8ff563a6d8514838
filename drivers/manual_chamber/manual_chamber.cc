#include "drivers/manual_chamber/manual_chamber.h"

#include <fmt/format.h>

#include <cmath>
#include <stdexcept>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal::manual_chamber {
namespace {

constexpr std::string_view kWho = "manual chamber";
/// Limits of chambers in general; those of this one are not known to the program.
constexpr double kLeastDegc = -100.0, kMostDegc = 250.0;
/// An answer farther from the set point than this is a slip of the fingers.
constexpr double kPlausibleK = 5.0;

std::optional<double> number_in(std::string_view text) {
  std::string plain(pieces::trimmed(text));
  for (char& c : plain)
    if (c == ',') c = '.';
  const auto value = pieces::number<double>(plain);
  return value && std::isfinite(*value) ? value : std::nullopt;
}

}  // namespace

ManualChamber::ManualChamber(Person person, const ChamberSettings& settings) : person_(std::move(person)) {
  if (settings.pause_output != 0 || settings.door_input != 0)
    throw std::invalid_argument(
        "manual_chamber: found pause_output or door_input; required: neither, as a person sets the chamber");
}

ChamberInfo ManualChamber::identify() {
  return {.maker = "none",
          .model = std::string(kWho),
          .serial_number = {},
          .firmware = {},
          .least_set_degc = kLeastDegc,
          .most_set_degc = kMostDegc};
}

double ManualChamber::confirmed(const std::string& question, double expected) {
  person_.tell(question);
  for (;;) {
    const std::optional<std::string> line = person_.answer();
    if (!line)
      throw InstrumentError(kWho, Fault::kLinkLost, "nobody answers, so the temperature is not known");
    if (pieces::trimmed(*line).empty()) return expected;
    const auto typed = number_in(*line);
    if (typed && std::abs(*typed - expected) <= kPlausibleK) return *typed;
    person_.tell(fmt::format("Found \"{}\"; required: a temperature within {:g} K of {:g} degC, or Enter: ",
                             pieces::trimmed(*line), kPlausibleK, expected));
  }
}

void ManualChamber::set_temperature(double degc, std::optional<double> rate_k_per_min) {
  const std::string rate = rate_k_per_min ? fmt::format(", ramp {:g} K/min", *rate_k_per_min) : std::string();
  set_degc_.reset();
  air_degc_ = confirmed(fmt::format("Set the chamber to {:g} degC{}. Press Enter when it is there, or type "
                                    "the temperature that it shows: ",
                                    degc, rate),
                        degc);
  set_degc_ = degc;
  running_ = true;
}

void ManualChamber::stop() {
  (void)confirmed("Switch the chamber off, then press Enter: ", air_degc_);
  running_ = false;
}

ChamberReading ManualChamber::read() {
  if (!set_degc_) throw InstrumentError(kWho, Fault::kNotReady, "no temperature has been set");
  return {.air_degc = air_degc_,
          .humidity_percent = std::nullopt,
          .set_degc = *set_degc_,
          .running = running_,
          .door_open = false,
          .alarms = {}};
}

}  // namespace abcal::manual_chamber
