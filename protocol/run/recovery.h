#pragma once

#include <cstddef>
#include <string>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/rotation_stage.h"
#include "protocol/run/run_context.h"

namespace abcal {

/// Reopens ports of a run that vanished: a cable was unplugged, or a hub was reset.
class Reconnector {
 public:
  virtual ~Reconnector() = default;
  /// Whether the stage is one of those that are gone.
  virtual bool stage_lost() const = 0;
  /// Opens the lost ports, with new drivers that have not identified their instruments yet.
  /// @throws InstrumentError kCannotOpen, kLinkLost: not back yet; what is back stays open.
  virtual void reconnect() = 0;
};

/// The instruments of a run, and their clock.
struct RunInstruments {
  RotationStage& stage;
  Accelerometer& accelerometer;
  Clock& clock;
  Reconnector* reconnector = nullptr;  ///< Null: a port that vanishes ends the run.
};

/// Waits for ports that vanished and makes sure that what comes back has the same model and the
/// same serial number, if it has one.
class Recovery {
 public:
  /// Both must outlive this.
  Recovery(RunContext& context, const RunInstruments& instruments)
      : context_(context), instruments_(instruments) {}

  /// Whether the run can wait for what was lost.
  bool is_possible(const InstrumentError& error) const;

  /// Halts what can be halted, waits until what was unplugged is back (replug_timeout_s), and halts the stage
  /// again, so that it is at rest when the run continues.
  /// @param position  In the plan, for the observer.
  /// @return whether the axes must be homed again: the stage was lost, and may have lost its supply.
  /// @throws InstrumentError kLinkLost: it did not come back, or vanished more often than max_replugs;
  /// kWrongIdentity: another instrument came back; kNoReply: the stage does not acknowledge the halt.
  bool wait_for_ports(const InstrumentError& lost, std::size_t position);

 private:
  void reopen(const InstrumentError& lost, bool& stage_lost);
  void require_same_instruments();
  std::string lost_name(bool stage_lost) const;

  RunContext& context_;
  const RunInstruments& instruments_;
  int times_lost_ = 0;
};

}  // namespace abcal
