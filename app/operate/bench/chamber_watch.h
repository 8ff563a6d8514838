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

/// The chamber of a bench, whose driver can be made again, and which is looked at while a run measures: an
/// alarm, an open door or silence ends the run, whose end halts the stage. All in the measuring thread: the
/// watched stage and accelerometer look at it between their own calls.
class ChamberWatch {
 public:
  ChamberWatch(Replaceable<ThermalChamber>::Make make, Clock& clock, double poll_s);

  /// Asks what it is; from then on poll() reads it.
  ChamberInfo identify();
  const ChamberInfo& info() const { return info_; }

  /// Sets and starts it. What was set last is remembered, for messages.
  void set_temperature(double degc, std::optional<double> rate_k_per_min);
  /// Hold: nothing; 23 degC; or 23 degC first, then off (`warm_enough`: it is there, so off at once).
  void apply(ChamberPolicy policy, bool warm_enough);
  ChamberReading read();
  /// Takes effect at the next poll().
  void want_pause(bool paused) { wanted_pause_ = paused; }
  /// At once, without an error: the run may be ending because of the chamber. @return false: it did not
  bool end_pause() noexcept;

  /// Reads it if the last reading is `poll_s` old. @throws InstrumentError
  void poll();
  /// The driver is made anew, its port opened again. @throws InstrumentError
  void reconnect();
  std::optional<ChamberReading> last() const { return last_; }
  std::optional<double> last_set_degc() const { return set_degc_; }
  /// Why poll() ended the run; empty: it did not.
  const std::string& trouble() const { return trouble_; }
  bool unreachable() const { return unreachable_; }

 private:
  [[noreturn]] void give_up(const std::string& detail, bool unreachable);
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

/// A stage and an accelerometer that let the chamber be looked at between their calls. Halting never does.
/// @{
std::unique_ptr<RotationStage> watched_stage(std::unique_ptr<RotationStage> stage, ChamberWatch& watch);
std::unique_ptr<Accelerometer> watched_accelerometer(std::unique_ptr<Accelerometer> accelerometer,
                                                     ChamberWatch& watch);
/// @}

}  // namespace abcal
