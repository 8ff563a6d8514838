#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/thermal_chamber.h"
#include "drivers/watlow_f4/codec.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/query_exchange.h"

namespace abcal::watlow_f4 {

/// A chamber with a Watlow F4 or F4T controller, over Modbus RTU or TCP (docs/drivers/watlow_f4.md).
///
/// The unit of the controller must be degC: an F4T is delivered with degF. It is read before every set point.
/// Written values are read back. An F4 has no ramp of its own for a set point, and each set point wears its
/// memory, so a value that is already there is not written.
class WatlowChamber final : public ThermalChamber {
 public:
  /// @throws std::invalid_argument for invalid settings, or if stream is null.
  WatlowChamber(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const ChamberSettings& settings);

  ChamberInfo identify() override;
  void set_temperature(double degc, std::optional<double> rate_k_per_min) override;
  void run() override { switch_output(settings_.run_output, true); }
  void stop() override { switch_output(settings_.run_output, false); }
  ChamberReading read() override;
  bool pause(bool paused) override;
  std::optional<HaltRecipe> rest_recipe(ChamberPolicy policy) override;

 private:
  HaltRecipe::Question write_step(std::string_view pdu) const;
  Reply exchange(std::string_view pdu, std::string_view shown);
  std::optional<std::vector<std::uint16_t>> try_read(std::uint16_t first, std::uint16_t count);
  std::vector<std::uint16_t> read_at(std::uint16_t first, std::uint16_t count);
  float float_at(std::uint16_t first);
  double decimal_at(std::uint16_t address, std::string_view what);
  void write(std::uint16_t address, std::uint16_t value);
  void write_float(std::uint16_t address, float value);
  void switch_output(int number, bool on);
  bool output_is_on(int number);
  std::uint16_t output_register(int number) const;
  void find_family();
  void read_limits(ChamberInfo& info);
  void verify_unit();
  void set_ramp(std::optional<double> rate_k_per_min);
  std::vector<std::string> alarms();
  InstrumentError failure(Fault fault, std::string_view detail) const;

  ChamberSettings settings_;
  Framing framing_;
  std::uint16_t transaction_ = 0;
  wire::QueryExchange exchange_;
  bool is_f4t_ = false;
  int decimals_ = 1;
  std::optional<ChamberInfo> info_;
};

}  // namespace abcal::watlow_f4
