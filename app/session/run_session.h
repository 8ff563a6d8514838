#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "app/bench/make_bench.h"
#include "app/bench/transcript.h"
#include "app/results/tray_results.h"
#include "app/session/notifier.h"
#include "app/session/run_bench.h"
#include "app/session/session_events.h"
#include "protocol/analysis/calibration_result.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_operator.h"

namespace abcal {

/// One of several items of a complete run. Its joint result is that of the common fit.
struct ItemOutcome {
  StoredRun stored;                        ///< As it is for this item.
  std::vector<CalibrationResult> results;  ///< As in RunOutcome; empty: it was dropped.
};

/// A complete run and its results.
struct RunOutcome {
  std::filesystem::path path;
  std::string sha256;  ///< Of the closed file; empty: readers keep the file open, it is closed later.
  StoredRun stored;
  std::vector<CalibrationResult> results;  ///< One an estimator, the declared one first. Levelling: none.
  /// Of several items: all; `stored` and `results` are those of the first that was measured to the end.
  std::vector<ItemOutcome> items;
  std::optional<TrayRun> tray;   ///< Of several items: all of them together. Levelling: nothing.
  bool measured_before = false;  ///< Nothing was measured now: only closed and analysed.

  bool is_levelling() const;
  /// Of the estimator that was chosen before the first angle. Not for a levelling.
  const CalibrationResult& result() const;
};

/// What a person did during a run, for its event log.
struct PersonEvent {
  std::string kind;      ///< "stop asked for", "control taken", ...
  std::string text;      ///< Who, and from where.
  RunOperator operates;  ///< Who operates from then on; no name: nobody else than before.
};

/// Owns the life of a run: opens the bench, identifies, plans, begins or resumes, measures, closes, analyses.
/// Passes events to a listener and prints nothing. Every way to run (`run`, `resume`, `replay`, a campaign,
/// the console) is a listener of the same events.
///
/// One thread carries out start(), resume() and replay(); hold(), continue_run(), add_note(),
/// add_person_event() and request_stop() may be called from any thread. The instruments stay open as long as
/// the session lives: start() with the same bench file uses them again.
class RunSession {
 public:
  struct Options {
    /// Opens the instruments of a bench file; empty: make_bench().
    std::function<Bench(const BenchConfig& config, BenchStreams streams)> open_bench;
    SessionListener listener;  ///< Empty: nobody listens.
    std::stop_token stop;      ///< As request_stop().
    std::string login;         ///< Of the operator, as in find_operator().
    /// Called once with a complete run and its result: when the file is closed, or before waiting for
    /// programs that read it. May be empty.
    std::function<void(const RunOutcome& outcome)> result_listener;
    /// Free space for a file, in bytes; nothing: not known. Empty: as the file system says.
    std::function<std::optional<std::uintmax_t>(const std::filesystem::path&)> free_disk_space;
  };

  explicit RunSession(Options options);
  ~RunSession();
  RunSession(const RunSession&) = delete;
  RunSession& operator=(const RunSession&) = delete;

  /// Opens the instruments and asks who they are; nothing moves. start() and level() with the same bench file
  /// use them as they are.
  /// @throws as start()
  Identities identify_instruments(const StartRequest& request);

  /// Asks the accelerometer again for the corrections that it applies, since they were changed. Nothing else
  /// is asked: the bench is open, and the next run with it has them.
  void ask_corrections_again();

  /// Measures a new run to its end. Everything that can be known to fail is refused before the first move: a
  /// existing file or results, too little disk space, an instrument of another serial number.
  /// @throws BenchError, PlanError, InstrumentError, RunFileError, RunInterrupted, std::invalid_argument,
  /// std::runtime_error (disk space). Once there is a run file, FinishedEvent has the reason too.
  RunOutcome start(const StartRequest& request);

  /// Measures the angles of a levelling (level_plan()) to a closed run file, as start() does. No estimator of
  /// a calibration analyses it.
  /// @throws as start()
  RunOutcome level(const StartRequest& request);

  /// Continues an interrupted run to its end. A run whose angles are all measured is closed and analysed.
  /// @throws as start()
  RunOutcome resume(const ResumeRequest& request);

  /// Drives a recorded run again from its own bytes, and compares (ReplayComparedEvent).
  /// @throws as start()
  RunOutcome replay(const ReplayRequest& request);

  /// The same for requests as data. @return nothing for a request that is no run.
  std::optional<RunOutcome> carry_out(const SessionRequest& request);

  /// Requests that the stage stands still after the current angle.
  void hold();
  void continue_run();
  bool is_hold_wanted() const;
  /// A note for the event log of the run; stored by the measuring thread soon.
  /// @return false: too many wait to be stored.
  bool add_note(NoteRequest note);
  /// What a person does now; stored soon, at the latest when the run ends.
  /// @return false: too many wait to be stored.
  bool add_person_event(PersonEvent event);
  /// Halts the stage at once and ends the run. Waits for the answer to the halt.
  void request_stop();

  /// The instruments that are open, or null.
  Bench* bench();

 private:
  struct OpenedBench;
  /// How the angles follow from the bench file and the travel of the stage.
  using Planner = std::vector<PlannedAngle> (*)(const ProtocolConfig&, const std::array<AxisTravel, 2>&);
  OpenedBench& open(const BenchConfig& config, BenchStreams streams);
  RunOutcome run_plan(const StartRequest& request, Planner planner);
  void open_and_identify(const StartRequest& request, const BenchConfig& config);
  Identities identify_or_keep_recording(const StartRequest& request, const OpenedBench& opened);
  RunFile create_file(const OpenedBench& opened, const StartRequest& request);
  void require_disk_space(const OpenedBench& opened, const StartRequest& request);
  void require_same_instruments(const Identities& now, const StoredRun& stored) const;
  void drop_missing_items(RunFile& file, std::size_t position) const;
  void tell_begun(const OpenedBench& opened, const std::filesystem::path& path, const StoredRun* resumed);
  RunOutcome measure_and_finish(RunFile file, const RunProgress& so_far);
  void close_and_keep(RunFile file, RunOutcome& outcome, const std::string& utc) const;
  void tell_charts(const RunOutcome& outcome) const;
  RunOutcome replay_to_the_end(const StoredRun& recorded, const ReplayRequest& request);
  void tell_comparison(const StoredRun& recorded, const std::filesystem::path& replayed);
  void close_ended_replay(const StoredRun& recorded, const std::filesystem::path& path);
  void tell(SessionEvent event) const;
  void warn(const std::string& kind, const std::string& text) const;
  void store_notes(RunFile& file, const Clock& clock);
  void store_last_notes(RunFile& file, const Clock& clock) noexcept;

  Options options_;
  std::stop_source stop_;
  std::unique_ptr<Notifier> notifier_;  ///< Of a run or levelling; a replay has none.
  mutable std::mutex mutex_;
  bool hold_wanted_ = false;
  std::vector<NoteRequest> notes_;          ///< To be stored.
  std::vector<PersonEvent> person_events_;  ///< To be stored.
  // Destroyed from the last to the first: the objects that the byte streams of a bench use outlive it.
  std::unique_ptr<Transcript> transcript_;
  std::unique_ptr<RecordedWire> recorded_wire_;
  std::unique_ptr<OpenedBench> opened_;
  std::optional<std::stop_callback<std::function<void()>>> stop_link_;
};

/// Where every angle is measured, but the program ended before it had closed the run and analysed it: does
/// so. `result_listener`: as in RunSession::Options.
/// @return nothing if nothing of this is left to do.
std::optional<RunOutcome> finish_measured_run(
    const std::filesystem::path& path,
    const std::function<void(const RunOutcome& outcome)>& result_listener = {});

}  // namespace abcal
