#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/instrument/thermal_chamber.h"
#include "drivers/wire/query_exchange.h"

namespace abcal::weiss_simserv {

/// One of the two languages of these chambers; the calls are those of ThermalChamber.
class Dialect {
 public:
  virtual ~Dialect() = default;
  virtual ChamberInfo identify() = 0;
  virtual void set_temperature(double degc, std::optional<double> rate_k_per_min) = 0;
  virtual void switch_run(bool on) = 0;
  virtual void switch_output(int number, bool on) = 0;
  virtual ChamberReading read() = 0;
  virtual std::optional<HaltRecipe> rest_recipe(ChamberPolicy policy) = 0;
};

/// The common part of a recipe for either language, without its questions.
inline HaltRecipe rest_recipe_of_lines(Clock::Duration patience, ChamberPolicy policy) {
  return {.driver = "weiss_simserv",
          .axes = {},
          .end_partial = "?\r",  // Half a line with this is not a number, and is refused.
          .stop = {},
          .questions = {},
          .reply_time = std::chrono::duration_cast<std::chrono::milliseconds>(patience),
          .reply_end = {},
          .binary = false,
          .chamber = policy == ChamberPolicy::kHold ? "holds its last set point" : "is driven to 23 degC"};
}

std::unique_ptr<Dialect> make_simserv(wire::QueryExchange& exchange, const ChamberSettings& settings);
std::unique_ptr<Dialect> make_ascii2(wire::QueryExchange& exchange, Clock& clock,
                                     const ChamberSettings& settings);

}  // namespace abcal::weiss_simserv
