#pragma once

#include <memory>
#include <set>
#include <string>
#include <vector>

#include "app/measure/session/session_events.h"
#include "app/system/progress.h"
#include "app/system/real_clock.h"

namespace abcal {

/// Shows the events of a session to a person at the terminal: a progress bar, and lines on standard error for
/// noteworthy events.
class TerminalListener {
 public:
  struct Options {
    std::string title;                ///< Title of the progress bar: "Calibrating".
    bool introduce = true;            ///< Print instruments, plan and duration when a run begins.
    bool tell_what_is_kept = true;    ///< When a run ends early: how many angles are kept, and where.
    bool tell_how_to_resume = false;  ///< ... and the command that continues it.
  };

  explicit TerminalListener(Options options) : options_(std::move(options)) {}

  void on(const SessionEvent& event);
  /// As a SessionListener; this must outlive it.
  SessionListener listener() {
    return [this](const SessionEvent& event) { on(event); };
  }

  /// Removes the bar.
  void finish();

 private:
  void begin(std::vector<PlannedAngle> plan);
  void show(const RunBeganEvent& event);
  void show(const PhaseEvent& event);
  void show(const DwellDoneEvent& event);
  void show(const FlagEvent& event) { line("flag: " + event.text); }
  void show(const PortLostEvent& event) { line(event.text); }
  void show(const PortBackEvent& event) { line(event.text); }
  void show(const NoticeEvent& event) { line(event.text); }
  void show(const ReplayComparedEvent& event);
  void show(const AllMeasuredEvent&) { finish(); }
  void show(const FinishedEvent& event);
  /// Other events print nothing: the phase shows them.
  template <class Event>
  void show(const Event&) {}
  void line(const std::string& text);

  Options options_;
  RealClock clock_;  // For people: real time, also when the time of the run is simulated.
  std::vector<PlannedAngle> plan_;
  std::set<std::size_t> measured_;  ///< Positions in the plan.
  std::unique_ptr<ProgressBar> bar_;
};

}  // namespace abcal
