#include "protocol/run/experiment_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "protocol/model/effects.h"
#include "protocol/plan/faces.h"
#include "protocol/plan/limits.h"
#include "protocol/run/dwell_measurement.h"
#include "protocol/run/halting.h"
#include "protocol/run/item_channels.h"
#include "protocol/run/motion.h"
#include "protocol/run/recovery.h"
#include "protocol/run/sweep_measurement.h"

namespace abcal {
namespace {

/// Executes the parts of a run in order, and keeps the positions that are measured already.
class ExperimentRun {
 public:
  /// The stage must be identified.
  ExperimentRun(const RunInstruments& instruments, const RunTask& task, RunContext& context, RunFile& file)
      : instruments_(instruments),
        plan_(task.plan),
        context_(context),
        file_(file),
        measured_(task.so_far.measured),
        last_(task.so_far.last),
        items_(context, instruments, task.so_far.first_temperatures_degc),
        motion_(context, instruments.stage),
        measurement_(context, motion_, items_),
        sweeps_(context, motion_, items_),
        recovery_(context, instruments, items_) {
    for (ItemChannel* channel : items_.active()) channel->context.drift_per_s = drift_per_s(channel->context);
  }

  RunTiming run() {
    bool home_again = !measured_.empty();
    bool warm = false;
    while (true) {
      try {
        drop_failed();
        home(home_again);
        items_.start();
        if (!std::exchange(warm, true)) {
          items_.first().settling.warm_up();
          items_.wait_until_stable();
        }
        if (has_dwells_at_rest()) items_.learn_noise();
        drop_failed();
        if (last_) measure_last_again(*last_);
        measure_missing();
        park();
        items_.stop();
        return context_.stopwatch.timing();
      } catch (const InstrumentError& error) {
        if (!recovery_.is_possible(error)) throw;
        home_again = wait_for_ports(error);
        motion_.forget_positions();
      }
    }
  }

 private:
  double drift_per_s(const RunContext& item) const {
    const auto speed = [&](StageAxis axis) {
      return AxisSpeed{context_.stage_info.axes[index(axis)].speed_deg_per_s};
    };
    const double run_s =
        estimate_duration(plan_, context_.settings.protocol, {speed(StageAxis::kX), speed(StageAxis::kZ)},
                          item.accelerometer_info.rate_hz)
            .total_s();
    return run_s > 0.0 ? largest_drift_rate(item.settings.tolerances) / run_s : 0.0;
  }

  /// @param again  also if the controller still knows its reference: the axis may have been turned by hand
  void home(bool again) {
    for (const StageAxis axis : kStageAxes) {
      if (context_.stage_info.axes[index(axis)].referenced && !again) continue;
      context_.journal.set_activity(Message("homing axis {axis}", to_string(axis)));
      context_.journal.phase(0, RunPhase::kHoming);
      const Clock::Instant begin = context_.clock.now();
      motion_.home(axis);
      context_.stopwatch.add_moving(context_.clock.now() - begin);
    }
  }

  /// Noise at rest is learned only if the plan has dwells.
  bool has_dwells_at_rest() const {
    return std::ranges::any_of(plan_, [](const PlannedAngle& angle) { return angle.sweep == 0; });
  }

  void measure_missing() {
    for (std::size_t position = 0; position < plan_.size(); ++position) {
      if (measured_.contains(position)) continue;
      hold_if_wanted(position);
      if (plan_[position].sweep > 0) {
        std::vector<PassedAngle> passed = sweeps_.measure(plan_, position);
        drop_failed();
        commit_sweep(passed);
        continue;
      }
      std::vector<ItemDwell> measured = measurement_.measure(position, plan_[position]);
      drop_failed();
      commit(position, measured);
    }
  }

  /// @return whether the axes must be homed again
  bool wait_for_ports(const InstrumentError& lost) {
    try {
      return recovery_.wait_for_ports(lost, measured_.size());
    } catch (const InstrumentError& gone) {
      Reconnector& ports = *instruments_.reconnector;
      if (gone.fault() != Fault::kLinkLost || !items_.several() || ports.stage_lost()) throw;
      for (ItemChannel* channel : items_.active()) {
        if (!ports.item_lost(channel->k)) continue;
        channel->failure = gone;
        ports.give_up_item(channel->k);
      }
      if (items_.active().size() == items_.size()) throw;
      drop_failed();
      return false;
    }
  }

  /// Drops the items that have failed; the run continues without them.
  void drop_failed() {
    for (const auto& channel : items_.take_failed()) {
      const std::size_t others = items_.active().size();
      channel->accelerometer.stop();
      const Message item = channel->context.accelerometer_words(), fault = channel->failure->message();
      const std::string& serial = channel->context.accelerometer_info.serial_number;
      const Message& activity = context_.journal.activity();
      context_.journal.drop_item(channel->k, next_position(),
                                 others == 1
                                     ? Message("{item} (SN {serial}) is left out from here on: {fault} "
                                               "({activity}); the run goes on with the other",
                                               item, serial, fault, activity)
                                     : Message("{item} (SN {serial}) is left out from here on: {fault} "
                                               "({activity}); the run goes on with the other {others}",
                                               item, serial, fault, activity, others));
    }
  }

  /// Position of the first angle that is not measured.
  std::size_t next_position() const {
    std::size_t position = 0;
    while (measured_.contains(position)) ++position;
    return position;
  }

  /// Waits between two angles while the operator holds the run.
  void hold_if_wanted(std::size_t position) {
    RunJournal& journal = context_.journal;
    if (!journal.hold_wanted()) return;
    journal.set_activity(Message("held before {angle}", describe(plan_[position])));
    journal.record("held", journal.activity());
    journal.phase(position, RunPhase::kHolding);
    while (journal.hold_wanted()) {
      context_.clock.wait_until(context_.clock.now() + StoppableClock::kSlice);
    }
    journal.record("continued", describe(plan_[position]));
  }

  /// A run file that was renamed, moved or deleted would be lost: written again where that is possible, else
  /// the run is held until the file is back.
  void keep_file(std::size_t position) {
    RunFile::Place place = file_.look_for_file();
    if (place == RunFile::Place::kInPlace) return;
    RunJournal& journal = context_.journal;
    const std::string name = file_.path().string();
    if (place != RunFile::Place::kWrittenAgain) {
      journal.set_activity(
          place == RunFile::Place::kMoved
              ? Message("held: {file} is not at its name any more; give it its name and folder back", name)
              : Message("held: {file} is another file now; move that away and give the run its name back",
                        name));
      journal.notify(kFileEvent, journal.activity());
      journal.phase(position, RunPhase::kHolding);
      while (place == RunFile::Place::kMoved || place == RunFile::Place::kReplaced) {
        context_.clock.wait_until(context_.clock.now() + StoppableClock::kSlice);
        place = file_.look_for_file();
      }
    }
    journal.notify(kFileEvent, place == RunFile::Place::kWrittenAgain
                                   ? Message("{file} was deleted, and has been written again whole", name)
                                   : Message("{file} is at its name again", name));
  }

  /// One angle; of a sweep, with the whole of it.
  std::vector<ItemDwell> measure_again(std::size_t position) {
    if (plan_[position].sweep == 0) return measurement_.measure(position, plan_[position]);
    std::size_t first = position;
    while (first > 0 && end_of_sweep(plan_, first - 1) > position) --first;
    std::vector<PassedAngle> passed = sweeps_.measure(plan_, first);
    return std::move(passed.at(position - first).dwells);
  }

  /// After an interruption: measures the last angle again, whose readings must not have changed.
  void measure_last_again(const RunProgress::LastAngle& last) {
    const PlannedAngle& angle = plan_[last.position];
    std::vector<ItemDwell> measured = measure_again(last.position);
    drop_failed();
    for (ItemDwell& each : measured) {
      const auto before = last.dwells.find(each.item);
      if (before != last.dwells.end()) require_unchanged(angle, before->second, each);
      each.dwell.flags |= kFlagRepeated;
    }
    commit(last.position, measured);
  }

  void require_unchanged(const PlannedAngle& angle, const DwellRecord& before, const ItemDwell& now) const {
    const ItemChannel& channel = items_.of(now.item);
    const Eigen::Vector3d change = now.dwell.mean - before.mean;
    const Eigen::Vector3d explained =
        explained_change(before, now.dwell, channel.context.settings.tolerances);
    for (int j = 0; j < 3; ++j) {
      if (std::abs(change[j]) <= explained[j]) continue;
      throw InstrumentError(
          channel.context.accelerometer_name(), Fault::kImplausible,
          Message("output {output} at {angle} reads {now:.7g} now and read {before:.7g} before the "
                  "interruption, a change of {change:.2g}; required: at most {allowed:.2g}, as noise, drift "
                  "and the stated uncertainties of the stage explain. The accelerometer or the reference of "
                  "the stage has moved: begin a new run",
                  "uvw"[j], describe(angle), now.dwell.mean[j], before.mean[j], std::abs(change[j]),
                  explained[j]));
    }
  }

  void commit(std::size_t position, std::vector<ItemDwell>& measured) {
    const bool is_check = measured_.contains(position);  // The file has this angle already.
    if (!is_check) tell_full_scale(position, measured);
    context_.journal.check_system_clock();
    file_.append_dwells(position, measured, context_.stopwatch.timing());
    tell_stage_events();
    for (const ItemDwell& each : measured) remember(each);
    if (!is_check) tell(position, measured);
    keep_file(position);
  }

  /// All angles of a sweep at once.
  void commit_sweep(std::vector<PassedAngle>& passed) {
    for (PassedAngle& angle : passed) tell_full_scale(angle.position, angle.dwells);
    context_.journal.check_system_clock();
    file_.append_sweep(passed, context_.stopwatch.timing());
    tell_stage_events();
    for (PassedAngle& angle : passed) {
      for (const ItemDwell& each : angle.dwells) remember(each);
      tell(angle.position, angle.dwells);
    }
    keep_file(passed.back().position);
  }

  /// No angle is flagged: a whole circle shows the response, and the analysis judges it.
  void tell_full_scale(std::size_t position, const std::vector<ItemDwell>& measured) {
    const bool last = position + 1 == plan_.size() || !is_same_circle(plan_[position + 1], plan_[position]);
    for (const ItemDwell& each : measured) {
      ItemChannel& channel = items_.of(each.item);
      if (const auto excess = channel.plausibility.full_scale_excess(each.dwell, last))
        channel.context.notify("full scale", *excess);
    }
  }

  void tell_stage_events() {
    for (const StageEvent& event : instruments_.stage.take_events())
      context_.journal.notify(event.kind, event.text);
  }

  /// Reports an angle that is on the disk to the observer.
  void tell(std::size_t position, std::vector<ItemDwell>& measured) {
    measured_.insert(position);
    context_.journal.dwells(position, measured);
    const auto comparable = [](const ItemDwell& each) { return can_be_compared_with(each.dwell); };
    if (!std::ranges::all_of(measured, comparable)) return;
    last_ = {position, {}};
    for (const ItemDwell& each : measured) last_->dwells[each.item] = each.dwell;
  }

  void remember(const ItemDwell& measured) {
    ItemChannel& channel = items_.of(measured.item);
    const DwellRecord& dwell = measured.dwell;
    if (dwell.flags != kFlagNone)
      channel.context.notify(kFlagEvent, Message("{activity}: {flags}", context_.journal.activity(),
                                                 describe_flags(dwell.flags)));
    channel.plausibility.remember(dwell);
    if (dwell.motion) return;  // Its spread is that of a moving stage.
    channel.settling.spreads().add(dwell.spread, channel.context.accelerometer_info.resolution.value_or(0.0));
  }

  void park() {
    context_.journal.set_activity(Message("parking the stage"));
    context_.journal.phase(plan_.size(), RunPhase::kParking);
    const Clock::Instant begin = context_.clock.now();
    try {
      for (const StageAxis axis : kStageAxes) motion_.move_to(axis, Angle{});
    } catch (const InstrumentError& error) {
      // All angles are measured: the run is complete nevertheless, but the operator must know.
      const HaltOutcome halt = halt_stage(instruments_.stage);
      context_.journal.notify(
          "park failed",
          Message("all angles are measured, but the stage could not be parked: {fault}; {halt}",
                  error.message(), halt.words));
    }
    context_.stopwatch.add_moving(context_.clock.now() - begin);
  }

  const RunInstruments& instruments_;
  const std::vector<PlannedAngle>& plan_;
  RunContext& context_;
  RunFile& file_;
  std::set<std::size_t> measured_;
  std::optional<RunProgress::LastAngle> last_;
  ItemChannels items_;
  Motion motion_;
  DwellMeasurement measurement_;
  SweepMeasurement sweeps_;
  Recovery recovery_;
};

/// Why a run ended early.
struct RunFailure {
  Message reason;
  std::optional<InstrumentError> instrument_error;
  bool by_operator = false;
};

/// Halts the stage, stops the accelerometer, leaves the run interrupted with the reason in its file, and
/// throws it.
[[noreturn]] void end_early(const RunInstruments& instruments, const RunFailure& failure,
                            const Message& activity, RunFile& file) {
  const HaltOutcome halt = halt_stage(instruments.stage);
  for (const ItemInstrument& item : instruments.items) item.accelerometer.stop();
  std::optional<Message> not_stored;
  const auto with_consequences = [&](const Message& why) {
    const Message all("{why} ({activity}); {halt}", why, activity, halt.words);
    return not_stored ? Message("{all}; the reason could not be stored ({error})", all, *not_stored) : all;
  };
  try {
    const std::string utc = format_utc(file.utc_now(instruments.clock));
    for (const StageEvent& event : instruments.stage.take_events()) {
      file.append_event(utc, event.kind, event.text);
    }
    file.set_state(RunState::kInterrupted, utc, with_consequences(failure.reason));
  } catch (const RunFileError& error) {
    not_stored = message_of(error);
  }
  if (failure.by_operator) throw RunInterrupted(with_consequences(failure.reason));
  if (const auto& error = failure.instrument_error) {
    throw InstrumentError(error->instrument(), error->fault(), with_consequences(error->detail()));
  }
  throw RunFileError(with_consequences(failure.reason));
}

}  // namespace

bool can_be_compared_with(const DwellRecord& dwell) {
  return (dwell.flags & (kFlagStuck | kFlagClipped | kFlagNotFinite)) == 0U;
}

Eigen::Vector3d explained_change(const DwellRecord& before, const DwellRecord& after,
                                 const Tolerances& tolerances) {
  const Eigen::Vector3d none = Eigen::Vector3d::Zero();
  const Eigen::Vector3d u_before = before.u_mean.value_or(none), u_after = after.u_mean.value_or(none);
  // The response to gravity is at most the norm of the outputs, apart from offsets; a turn by a small angle
  // changes it by that times the angle. Zero and step have independent errors in both measurements, hence
  // the factor sqrt 2.
  const double response = std::max(before.mean.norm(), after.mean.norm());
  const double turned = std::hypot(tolerances.zero.rad(), tolerances.step.rad()) * std::numbers::sqrt2;
  const double stage = response * std::hypot(turned, tolerances.drift);
  return kFalseAlarmDeviate *
         (u_before.array().square() + u_after.array().square() + stage * stage).sqrt().matrix();
}

RunTiming run_experiments(const RunInstruments& instruments, const RunTask& task, RunFile& file,
                          RunObserver& observer, const std::stop_token& stop) {
  RunContext context(StoppableClock(instruments.clock, stop), task.settings, task.so_far.spent, file,
                     observer);
  RunFailure failure;
  try {
    context.clock.throw_if_stopped();
    context.stage_info = instruments.stage.identify();
    return ExperimentRun(instruments, task, context, file).run();
  } catch (const RunInterrupted& error) {
    failure = {error.message(), std::nullopt, true};
  } catch (const InstrumentError& error) {
    // A halt from another thread makes the exchange under way fail: that is the operator's stop, not a fault.
    const bool by_operator = stop.stop_requested();
    failure = {by_operator ? Message("stopped by the operator") : error.message(), error, by_operator};
  } catch (const std::exception& error) {
    failure.reason = message_of(error);
  }
  end_early(instruments, failure, context.journal.activity(), file);
}

}  // namespace abcal
