#include "protocol/run/recovery.h"

#include <fmt/format.h>

#include "protocol/run/halting.h"

namespace abcal {
namespace {

/// Interval between two attempts to open a port that vanished.
constexpr Clock::Duration kReconnectInterval = std::chrono::milliseconds(500);

/// Whether the instrument may be back at the next attempt. No reply: its firmware may still be starting.
bool may_come_back(Fault fault) {
  return fault == Fault::kCannotOpen || fault == Fault::kLinkLost || fault == Fault::kNoReply;
}

/// Throws if the descriptions of the instrument before and now differ.
void require_same(const std::string& name, const std::string& before, const std::string& now) {
  if (before == now) return;
  throw InstrumentError(
      name, Fault::kWrongIdentity,
      fmt::format("\"{}\" was plugged in; required: the instrument that was unplugged, \"{}\"", now, before));
}

}  // namespace

bool Recovery::is_possible(const InstrumentError& error) const {
  return error.fault() == Fault::kLinkLost && instruments_.reconnector != nullptr &&
         !context_.clock.stop_requested();
}

std::string Recovery::lost_name(const InstrumentError& lost, bool stage_lost) const {
  if (stage_lost) return context_.stage_name();
  return items_.several() ? lost.instrument() : items_.first().context.accelerometer_name();
}

const std::string& Recovery::serial_number_of(const std::string& name) const {
  for (const ItemChannel* channel : items_.active())
    if (channel->context.accelerometer_name() == name)
      return channel->context.accelerometer_info.serial_number;
  return items_.first().context.accelerometer_info.serial_number;
}

bool Recovery::wait_for_ports(const InstrumentError& lost, std::size_t position) {
  const LimitsConfig& limits = context_.settings.limits;
  RunJournal& journal = context_.journal;
  if (++times_lost_ > limits.max_replugs) {
    throw InstrumentError(
        lost.instrument(), Fault::kLinkLost,
        Message("{detail}; ports have vanished {times} times in this run; required: at most {allowed} "
                "([limits] max_replugs). Replace the cable, the connector or the hub before continuing",
                lost.detail(), times_lost_, limits.max_replugs));
  }
  bool stage_lost = instruments_.reconnector->stage_lost();
  const std::string name = lost_name(lost, stage_lost);
  // At once: the accelerometer may have been lost while the stage moved, or one of two stage controllers
  // while the other one moved.
  const HaltOutcome halt = halt_stage(instruments_.stage);
  for (const StageEvent& event : instruments_.stage.take_events()) journal.notify(event.kind, event.text);
  journal.notify(kPortLostEvent, Message("the port of {name} is gone: {detail} ({activity}); {halt}; waiting "
                                         "up to {seconds} s for it to come back",
                                         name, lost.detail(), journal.activity(), halt.words,
                                         context_.settings.protocol.replug_timeout_s));
  journal.phase(position, RunPhase::kReconnecting);
  reopen(lost, stage_lost);
  if (!halt_stage(instruments_.stage).acknowledged) {
    throw InstrumentError(
        context_.stage_name(), Fault::kNoReply,
        Message("it came back but does not acknowledge the halt: stop it by its own switch"));
  }
  const std::string& serial_number = stage_lost ? context_.stage_info.serial_number : serial_number_of(name);
  const Message back = serial_number.empty() ? Message(
                                                   "{name} is back (it reports no serial number: another one "
                                                   "of the same model would not be noticed)",
                                                   name)
                                             : Message("{name} is back", name);
  journal.notify(kReconnectedEvent,
                 stage_lost ? Message("{back}; the run continues after homing both axes again", back)
                            : Message("{back}; the run continues", back));
  return stage_lost;
}

void Recovery::reopen(const InstrumentError& lost, bool& stage_lost) {
  const std::string name = lost_name(lost, stage_lost);
  const double timeout_s = context_.settings.protocol.replug_timeout_s;
  const Clock::Instant deadline = context_.clock.now() + from_seconds(timeout_s);
  while (true) {
    context_.clock.wait_until(context_.clock.now() + kReconnectInterval);
    // On a hub that both are on, the stage may be found to be lost only now.
    stage_lost = stage_lost || instruments_.reconnector->stage_lost();
    try {
      instruments_.reconnector->reconnect();
      require_same_instruments();
      return;
    } catch (const InstrumentError& error) {
      if (!may_come_back(error.fault()) || context_.clock.stop_requested()) throw;
      if (context_.clock.now() < deadline) continue;
      context_.journal.notify(kPortLostEvent,
                              Message("the last attempt to open it again: {error}", error.message()));
      throw InstrumentError(name, Fault::kLinkLost,
                            Message("{detail}; it did not come back within {seconds} s (replug_timeout_s)",
                                    lost.detail(), timeout_s));
    }
  }
}

void Recovery::require_same_instruments() {
  const StageInfo stage = instruments_.stage.identify();
  require_same(context_.stage_name(), context_.stage_info.model + " SN " + context_.stage_info.serial_number,
               stage.model + " SN " + stage.serial_number);
  for (const ItemChannel* channel : items_.active()) {
    const AccelerometerInfo& before = channel->context.accelerometer_info;
    const AccelerometerInfo now = channel->accelerometer.identify();
    require_same(channel->context.accelerometer_name(), before.model + " SN " + before.serial_number,
                 now.model + " SN " + now.serial_number);
  }
  context_.stage_info = stage;
}

}  // namespace abcal
