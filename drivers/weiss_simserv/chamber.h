#pragma once

#include <memory>
#include <optional>
#include <string_view>

#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/thermal_chamber.h"
#include "drivers/weiss_simserv/dialect.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/query_exchange.h"

namespace abcal::weiss_simserv {

/// A Weiss or Voetsch chamber: S!MPAC simserv, or ASCII-2 if it does not answer that
/// (docs/drivers/weiss_simserv.md). The external mode must be enabled at its panel.
class WeissChamber final : public ThermalChamber {
 public:
  /// @throws std::invalid_argument for invalid settings, or if stream is null.
  WeissChamber(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const ChamberSettings& settings);

  ChamberInfo identify() override;
  void set_temperature(double degc, std::optional<double> rate_k_per_min) override;
  void run() override { dialect().switch_run(true); }
  void stop() override { dialect().switch_run(false); }
  ChamberReading read() override { return dialect().read(); }
  bool pause(bool paused) override;
  std::optional<HaltRecipe> rest_recipe(ChamberPolicy policy) override {
    return dialect().rest_recipe(policy);
  }

 private:
  Dialect& dialect();
  void choose(bool simserv);

  ChamberSettings settings_;
  Clock& clock_;
  wire::QueryExchange exchange_;
  std::unique_ptr<Dialect> dialect_;
  std::optional<ChamberInfo> info_;
};

}  // namespace abcal::weiss_simserv
