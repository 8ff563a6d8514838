#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/rotation_stage.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/plan/run_config.h"
#include "protocol/plan/tolerances.h"
#include "protocol/record/clock_watch.h"
#include "protocol/record/run_file.h"
#include "protocol/run/run_observer.h"
#include "protocol/run/stoppable_clock.h"

namespace abcal {

/// How a run is measured and judged: sections of the bench file.
struct RunSettings {
  ProtocolConfig protocol;
  LimitsConfig limits;
  Tolerances tolerances;
  ExpectedItem expected;
  double g_loc_mps2 = kStandardGravity;
};

/// Reports events to the run file and to the observer, and keeps the present activity for messages.
class RunJournal {
 public:
  /// Both must outlive this.
  RunJournal(RunFile& file, RunObserver& observer, const StoppableClock& clock)
      : file_(file), observer_(observer), clock_(clock), clock_watch_(clocks()) {}

  /// Activity for error messages: "homing axis X", "experiment 1, alpha = 5 deg".
  void set_activity(Message activity) { activity_ = std::move(activity); }
  const Message& activity() const { return activity_; }

  void phase(std::size_t position, RunPhase phase) { observer_.phase(position, phase); }
  void dwells(std::size_t position, std::span<const ItemDwell> dwells) { observer_.dwells(position, dwells); }
  bool hold_wanted() { return observer_.hold_wanted(); }

  /// Writes an event to the run file only.
  void record(std::string_view kind, const Message& text) {
    file_.append_event(format_utc(file_.utc(clock_.now())), kind, text);
  }
  /// Writes an event to the run file and reports it to the observer.
  /// @param item  as in RunObserver::notice()
  void notify(std::string_view kind, const Message& text, std::optional<int> item = {}) {
    record(kind, text);
    observer_.notice(kind, text, item);
  }
  /// Writes to the run file and reports to the observer that the run continues without an item.
  void drop_item(int item, std::size_t position, const Message& text) {
    file_.drop_item(item, position, format_utc(file_.utc(clock_.now())), text);
    observer_.notice(kItemDroppedEvent, text, item);
  }
  /// Reports a step of the system clock since the last call.
  void check_system_clock() {
    if (const auto step = clock_watch_.find_step(clocks())) notify(kClockStepEvent, *step);
  }

 private:
  ClockPair clocks() const { return {clock_.utc_now(), clock_.now().time_since_epoch()}; }

  RunFile& file_;
  RunObserver& observer_;
  const StoppableClock& clock_;
  ClockWatch clock_watch_;
  Message activity_{"starting"};
};

/// Time spent on each activity of a run, including the time before an interruption.
class RunStopwatch {
 public:
  RunStopwatch(const StoppableClock& clock, const RunTiming& spent_before)
      : clock_(clock), spent_before_(spent_before), timing_(spent_before), begin_(clock.now()) {}

  void add_moving(Clock::Duration time) { timing_.moving_s += to_seconds(time); }
  void add_settling(Clock::Duration time) { timing_.settling_s += to_seconds(time); }
  void add_dwelling(Clock::Duration time) { timing_.dwelling_s += to_seconds(time); }

  /// Seconds of measuring; the time between two parts of an interrupted run does not count.
  double spent_s(Clock::Instant instant) const {
    return spent_before_.total_s() + to_seconds(instant - begin_);
  }

  /// Times so far. Overhead is the time that motions, settling and dwells do not account for.
  RunTiming timing() const {
    RunTiming timing = timing_;
    const double accounted = timing.moving_s + timing.settling_s + timing.dwelling_s;
    timing.overhead_s = std::max(0.0, spent_s(clock_.now()) - accounted);
    return timing;
  }

 private:
  const StoppableClock& clock_;
  RunTiming spent_before_;
  RunTiming timing_;
  Clock::Instant begin_;
};

/// Data that all parts of one run share, and data of one item. A copy belongs to the same run, but its
/// settings and accelerometer may be those of another item.
struct RunContext {
 private:
  struct Shared {
    StoppableClock clock;
    RunJournal journal;
    RunStopwatch stopwatch;
    StageInfo stage_info;
    const RunFile& file;

    Shared(const StoppableClock& run_clock, const RunTiming& spent_before, RunFile& run_file,
           RunObserver& observer)
        : clock(run_clock),
          journal(run_file, observer, clock),
          stopwatch(clock, spent_before),
          file(run_file) {}
  };
  std::shared_ptr<Shared> shared_;

 public:
  StoppableClock& clock;
  RunJournal& journal;
  RunStopwatch& stopwatch;
  StageInfo& stage_info;
  RunSettings settings;
  AccelerometerInfo accelerometer_info;
  int item = 1;                ///< Number in the run file.
  bool beside_others = false;  ///< The bench has several items.
  /// Largest standard deviation, during the run, of the rate at which the outputs drift by the stated
  /// effects, relative to S_j. 0: not known.
  double drift_per_s = 0.0;

  RunContext(const StoppableClock& run_clock, RunSettings run_settings, const RunTiming& spent_before,
             RunFile& file, RunObserver& observer)
      : shared_(std::make_shared<Shared>(run_clock, spent_before, file, observer)),
        clock(shared_->clock),
        journal(shared_->journal),
        stopwatch(shared_->stopwatch),
        stage_info(shared_->stage_info),
        settings(std::move(run_settings)) {
    if (!file.in_session()) file.begin_session({clock.utc_now(), clock.now(), {}, {}});
  }
  RunContext(const RunContext&) = default;
  RunContext& operator=(const RunContext&) = delete;

  /// True time from the beginning of the run, pauses included: DwellRecord::time_s.
  double time_s(Clock::Instant instant) const { return shared_->file.time_s(instant); }

  /// Names for messages.
  std::string stage_name() const { return "stage " + stage_info.model; }
  std::string accelerometer_name() const { return accelerometer_words(); }
  /// The same as a message; it begins with the number of the item if the bench has several.
  Message accelerometer_words() const;
  /// Writes a message about this item to the run file and reports it to the observer. It names the item if
  /// the bench has several.
  void notify(std::string_view kind, const Message& text) const;
};

/// "experiment 1, alpha = 5 deg", "check pose 1, X = 54.7356 deg, Z = 45 deg".
Message describe(const PlannedAngle& angle);

}  // namespace abcal
