#pragma once

#include <cstddef>
#include <string>

#include "drivers/instrument/instrument_error.h"
#include "protocol/run/item_channels.h"
#include "protocol/run/run_context.h"
#include "protocol/run/run_instruments.h"

namespace abcal {

/// Waits for ports that vanished and verifies that the instrument that returns has the same model and the
/// same serial number, if it has one.
class Recovery {
 public:
  /// All must outlive this.
  Recovery(RunContext& context, const RunInstruments& instruments, const ItemChannels& items)
      : context_(context), instruments_(instruments), items_(items) {}

  /// Whether the run can wait for the lost instrument.
  bool is_possible(const InstrumentError& error) const;

  /// Halts the stage if possible, waits until the lost ports are back (replug_timeout_s), and halts the stage
  /// again, so that it is at rest when the run continues.
  /// @param position  In the plan, for the observer.
  /// @return whether the axes must be homed again: the stage was lost, and may have lost its supply.
  /// @throws InstrumentError kLinkLost: it did not return, or vanished more often than max_replugs;
  /// kWrongIdentity: another instrument returned; kNoReply: the stage does not acknowledge the halt.
  bool wait_for_ports(const InstrumentError& lost, std::size_t position);

 private:
  void reopen(const InstrumentError& lost, bool& stage_lost);
  void require_same_instruments();
  const std::string& serial_number_of(const std::string& name) const;
  std::string lost_name(const InstrumentError& lost, bool stage_lost) const;

  RunContext& context_;
  const RunInstruments& instruments_;
  const ItemChannels& items_;
  int times_lost_ = 0;
};

}  // namespace abcal
