#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/replaceable.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/instrument/thermal_chamber.h"

namespace abcal {

/// The chamber of a bench, whose driver can be made again, and which is monitored while a run measures: an
/// alarm, an open door or silence ends the run, which halts the stage. Everything happens in the measuring
/// thread: the watched stage and accelerometer call poll() before their own calls.
class ChamberWatch {
 public:
  ChamberWatch(Replaceable<ThermalChamber>::Make make, Clock& clock, double poll_s);

  /// Asks for its identity; from then on poll() reads it.
  ChamberInfo identify();
  const ChamberInfo& info() const { return info_; }

  /// Sets the temperature and starts the chamber. The last set point is kept for messages.
  void set_temperature(double degc, std::optional<double> rate_k_per_min);
  /// Hold: does nothing. Off with `warm_enough`: switches off. Otherwise: sets 23 degC.
  void apply(ChamberPolicy policy, bool warm_enough);
  ChamberReading read();
  /// Takes effect at the next poll().
  void want_pause(bool paused) { wanted_pause_ = paused; }
  /// Ends a pause at once. Never throws: the run may be ending because of the chamber. @return false: failed
  bool end_pause() noexcept;

  /// Reads it if the last reading is `poll_s` old. @throws InstrumentError
  void poll();
  /// Makes the driver again, opens its port again, and identifies the chamber. @throws InstrumentError
  void reconnect();
  std::optional<ChamberReading> last() const { return last_; }
  std::optional<double> last_set_degc() const { return set_degc_; }
  /// Why poll() ended the run; empty: it did not.
  const std::string& trouble() const { return trouble_; }
  bool unreachable() const { return unreachable_; }

 private:
  [[noreturn]] void give_up(const Message& detail, bool unreachable);
  template <class Call>
  auto reached(const Call& call);

  Replaceable<ThermalChamber> chamber_;
  Clock& clock_;
  Clock::Duration period_;
  bool watching_ = false;
  ChamberInfo info_;
  std::optional<ChamberReading> last_;
  Clock::Instant looked_{};
  std::optional<double> set_degc_;
  bool wanted_pause_ = false, paused_ = false;
  std::string trouble_;
  bool unreachable_ = false;
};

/// A stage and an accelerometer that poll the chamber before their calls, but never before a halt.
/// @{
std::unique_ptr<RotationStage> watched_stage(std::unique_ptr<RotationStage> stage, ChamberWatch& watch);
std::unique_ptr<Accelerometer> watched_accelerometer(std::unique_ptr<Accelerometer> accelerometer,
                                                     ChamberWatch& watch);
/// @}

}  // namespace abcal
