#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "app/measure/bench/make_bench.h"
#include "app/measure/bench/transcript.h"
#include "app/measure/session/notifier.h"
#include "app/measure/session/run_bench.h"
#include "app/measure/session/run_witness.h"
#include "app/measure/session/session_events.h"
#include "app/witness/laboratory_link.h"
#include "protocol/record/results_file.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_operator.h"

namespace abcal {

/// Begins a new run.
struct StartRequest {
  BenchConfig bench;
  std::string run_file;                         ///< Path of the file to create.
  bool record = false;                          ///< Store every byte to and from the instruments.
  std::map<std::string, std::string> labels{};  ///< Added to those of the bench file.
  bool without_missing_items = false;           ///< Items that do not answer are left out.
};

/// Continues an interrupted run; closes and analyses one whose angles are all measured.
struct ResumeRequest {
  std::string run_file;
  bool without_missing_items = false;  ///< As in StartRequest.
};

/// Drives a recorded run again from its own bytes.
struct ReplayRequest {
  std::string recorded_file;
  std::string run_file;  ///< Path of the file to create; empty: RUN-replay.run in the same folder.
};

/// A person's note, for the events of the run.
struct NoteRequest {
  std::string text, by;
};

/// A complete run: each item as it was measured.
struct MeasuredRun {
  std::vector<StoredRun> items;
  std::filesystem::path path;
  std::string sha256;  ///< SHA-256 of the closed file; empty: readers keep it open, it is closed later.
  bool measured_before = false;  ///< The angles were measured earlier; now only closed and analysed.

  bool is_levelling() const;
  /// Data common to all items (state, plan, timing, events), and the first item's own.
  const StoredRun& stored() const { return items.front(); }
};

/// The analysis of complete runs, which a session knows by this interface only. Not asked for a levelling.
class RunAnalyst {
 public:
  /// The worst verdict of the items, and its reason.
  struct Conclusion {
    std::string verdict;
    Message reason;
  };

  RunAnalyst() = default;
  virtual ~RunAnalyst() = default;
  RunAnalyst(const RunAnalyst&) = delete;
  RunAnalyst& operator=(const RunAnalyst&) = delete;

  /// Analyses a run. The calls below are about the run that was analysed last.
  virtual Conclusion analyse(const MeasuredRun& run) = 0;
  /// Called once for each run, levellings included: when the file is closed, or before waiting for programs
  /// that read it.
  virtual void announce(const MeasuredRun& run) = 0;
  /// Adds the analyses to the results file of the closed run.
  virtual void keep(ResultsFile& results, const MeasuredRun& run, const std::string& utc) const = 0;
  /// Least number of analyses that a run has once keep() was called.
  virtual std::size_t least_analyses() const = 0;
};

/// A person's action during a run, for its event log.
struct PersonEvent {
  std::string kind;      ///< "stop asked for", "control taken", ...
  std::string text;      ///< The person, and from where.
  RunOperator operates;  ///< Operator from then on; without a name: as before.
};

/// Owns the life of a run: opens the bench, identifies, plans, begins or resumes, measures, closes, and has
/// the run analysed. Passes events to a listener and prints nothing. Every way to run (`run`, `resume`,
/// `replay`, a campaign, the console) is a listener of the same events.
///
/// One thread carries out start(), resume() and replay(); hold(), continue_run(), add_note(),
/// add_person_event() and request_stop() may be called from any thread. The instruments stay open as long as
/// the session lives: start() with the same bench file uses them again.
class MeasuringSession {
 public:
  struct Options {
    /// Opens the instruments of a bench file; empty: make_bench().
    std::function<Bench(const BenchConfig& config, BenchStreams streams)> open_bench;
    SessionListener listener;  ///< Empty: none.
    std::stop_token stop;      ///< As request_stop().
    std::string login;  ///< Login of the operator at a console, as LaboratoryLink::find_operator takes it.
    /// Questions to the laboratory's register. Empty: refused where ABCAL_REGISTER names a register.
    LaboratoryLink laboratory;
    std::shared_ptr<RunAnalyst> analyst;  ///< Null: runs are closed without an analysis.
    /// Finds the witness of the runs, which may be null; empty: WitnessClient::find().
    std::function<std::unique_ptr<WitnessClient>()> find_witness;
    /// Free space for a file, in bytes; nullopt if unknown. Empty: by the file system.
    std::function<std::optional<std::uintmax_t>(const std::filesystem::path&)> free_disk_space;
  };

  explicit MeasuringSession(Options options);
  ~MeasuringSession();
  MeasuringSession(const MeasuringSession&) = delete;
  MeasuringSession& operator=(const MeasuringSession&) = delete;

  /// Opens and identifies the instruments; nothing moves. start() and level() with the same bench file use
  /// them without opening them again.
  /// @throws as start()
  Identities identify_instruments(const StartRequest& request);

  /// Reads again the corrections that the accelerometers apply, after these were changed. Reads nothing else;
  /// the next run on the open bench has the new ones.
  void ask_corrections_again();

  /// Measures a new run to its end. All foreseeable errors are reported before the first move: an existing
  /// file or results, too little disk space, an instrument of another serial number.
  /// @throws BenchError, PlanError, InstrumentError, RunFileError, RunInterrupted, std::invalid_argument,
  /// std::runtime_error (disk space). Once the run file exists, FinishedEvent has the reason too.
  MeasuredRun start(const StartRequest& request);

  /// Measures the angles of a levelling (level_plan()) to a closed run file, as start() does. No estimator of
  /// a calibration analyses it.
  /// @throws as start()
  MeasuredRun level(const StartRequest& request);

  /// Continues an interrupted run to its end. A run whose angles are all measured is closed and analysed.
  /// @throws as start()
  MeasuredRun resume(const ResumeRequest& request);

  /// Drives a recorded run again from its own bytes, and compares (ReplayComparedEvent).
  /// @throws as start()
  MeasuredRun replay(const ReplayRequest& request);

  /// Requests that the stage stops after the current angle.
  void hold();
  void continue_run();
  bool is_hold_wanted() const;
  /// Adds a note to the event log of the run; the measuring thread stores it soon.
  /// @return false: too many wait to be stored.
  bool add_note(NoteRequest note);
  /// Adds a person's action to the event log; stored soon, at the latest when the run ends.
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
  MeasuredRun run_plan(const StartRequest& request, Planner planner);
  void open_and_identify(const StartRequest& request);
  Identities identify_or_keep_recording(const StartRequest& request, const OpenedBench& opened);
  RunFile create_file(const OpenedBench& opened, const StartRequest& request);
  void require_disk_space(const OpenedBench& opened, const StartRequest& request);
  void require_same_instruments(const Identities& now, const StoredRun& stored) const;
  void drop_missing_items(RunFile& file, std::size_t position) const;
  void notify_begun(const OpenedBench& opened, const std::filesystem::path& path, const StoredRun* resumed);
  MeasuredRun measure_and_finish(RunFile file, const RunProgress& so_far);
  void close_and_keep(RunFile file, MeasuredRun& run, const std::string& utc) const;
  void have_witnessed(RunFile& file);
  RegisteredStart find_operator(const std::string& stated) const;
  void notify_charts(const MeasuredRun& run) const;
  MeasuredRun replay_to_the_end(const StoredRun& recorded, const ReplayRequest& request);
  void notify_comparison(const StoredRun& recorded, const std::filesystem::path& replayed);
  void close_ended_replay(const StoredRun& recorded, const std::filesystem::path& path);
  void notify(const SessionEvent& event) const;
  void warn(const std::string& kind, const Message& text) const;
  void store_notes(RunFile& file, const Clock& clock);
  void store_last_notes(RunFile& file, const Clock& clock) noexcept;

  Options options_;
  std::stop_source stop_;
  std::unique_ptr<Notifier> notifier_;  ///< Null: a replay, or no recipient.
  mutable std::mutex mutex_;
  bool hold_wanted_ = false;
  std::vector<NoteRequest> notes_;          ///< To be stored.
  std::vector<PersonEvent> person_events_;  ///< To be stored.
  // Destroyed from the last to the first: the objects that the byte streams of a bench use outlive it.
  std::unique_ptr<Transcript> transcript_;
  std::unique_ptr<RecordedWire> recorded_wire_;
  std::unique_ptr<RunWitness> witness_;  ///< Null: a replay.
  std::unique_ptr<OpenedBench> opened_;
  std::optional<std::stop_callback<std::function<void()>>> stop_link_;
};

/// The witness of the runs of sessions with these options; the listener receives what is not witnessed.
/// @throws std::runtime_error if the witness that is configured cannot be reached; std::invalid_argument: its
/// key cannot be used
std::unique_ptr<RunWitness> find_witness(const MeasuringSession::Options& options);

/// A run whose angles are all measured, but whose program ended before the file was closed and analysed.
struct FinishedRun {
  MeasuredRun run;
  RunAnalyst::Conclusion conclusion;
};

/// Closes and analyses a run whose angles are all measured, if its program ended before that.
/// @param analyst  null: only closed
/// @param witness  has the end witnessed; null: nothing is witnessed
/// @return nullopt if nothing is left to do, or if not all angles are measured
/// @throws RunFileError also if the file was changed since it was written
std::optional<FinishedRun> finish_measured_run(const std::filesystem::path& path, RunAnalyst* analyst,
                                               RunWitness* witness);

}  // namespace abcal
