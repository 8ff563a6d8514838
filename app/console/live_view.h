#pragma once

#include <array>
#include <deque>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/console/event.h"
#include "app/console/interrupted_run.h"
#include "drivers/instrument/clock.h"

namespace abcal::console {

/// Findings of a check, for pages.
nlohmann::ordered_json findings_json(const std::vector<Finding>& findings);

/// The state of the bench that pages show, made from events. Each event becomes one message; that of a
/// session is its own JSON with members derived from it. snapshot() is all that a page needs at first, or to
/// catch up. Messages are JSON (docs/console_programs.md). Only the latest of unbounded data are kept. For
/// one thread.
class LiveView {
 public:
  /// `about` never changes: names, pace, versions. `clock` is real time, for log and time left.
  LiveView(const nlohmann::ordered_json& about, const Clock& clock);

  /// Sets the run from before the first event that a person may resume.
  void offer(std::optional<InterruptedRun> run) { interrupted_ = std::move(run); }

  /// @param seen  when the measuring thread reported the event, in real time
  /// @return the message for pages; empty if none is needed
  std::string apply(const Event& event, Clock::UtcTime seen = {});
  std::string snapshot() const;

 private:
  using Json = nlohmann::json;

  Json on(const SessionEvent& event);
  Json on(const ActivitySeen& seen);
  Json on(const BenchOpened& opened);
  Json on(const StageSeen& seen);
  Json on(const StripSeen& seen);
  Json on(const LogLine& line);
  Json on(const ChecksSeen& seen);
  Json on(const ItemChecked& seen) { return on(ChecksSeen{seen.check.findings}); }
  Json on(const HaltSeen& seen);
  Json on(const FaultSeen& seen);
  Json on(const StateSeen& seen);
  Json on(const InterruptionAcknowledged& seen);

  // Each changes the state by an event of the session, and returns members to add to its JSON.
  Json fold(const RunBeganEvent& began);
  Json fold(const PhaseEvent& phase);
  Json fold(const DwellDoneEvent& done);
  Json fold(const NoticeEvent& notice);
  Json fold(const FinishedEvent& end);
  template <class Other>
  Json fold(const Other&) {
    return Json::object();
  }

  bool store(const DwellDoneEvent& done);
  Json keep(const LogLine& line);
  Json fit_of(int experiment) const;
  Json progress() const;
  double pace() const;

  Json about_;
  const Clock& clock_;
  ActivitySeen activity_;
  BenchOpened bench_;
  /// The run. `measured` (in the order of the plan) and the progress of `items` are updated with each angle.
  std::optional<RunBeganEvent> run_;
  std::optional<FinishedEvent> ended_;
  std::optional<HaltSeen> halt_;  ///< Last halt of the current or last activity.
  std::optional<FaultSeen> fault_;
  Message guard_;
  std::optional<InterruptedRun> interrupted_;
  std::optional<ChecksSeen> checks_;
  Json phase_;                          ///< The message of the last phase, or null.
  std::map<std::string, Json> states_;  ///< The latest message of each type of StateSeen.
  std::array<StageSeen, 2> stage_{StageSeen{StageAxis::kX, {}, {}}, StageSeen{StageAxis::kZ, {}, {}}};
  std::deque<Json> strip_;              ///< Groups of readings of all items.
  std::map<int, std::size_t> streams_;  ///< Stream in the strip, by item.
  std::deque<Json> log_;
  std::optional<Clock::Instant> last_dwell_;  ///< Its end; absent if the run was held since.
  std::deque<double> dwell_intervals_s_;      ///< Real time from one angle to the next.
};

}  // namespace abcal::console
