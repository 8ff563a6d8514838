#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/clock.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_record.h"
#include "protocol/record/sqlite.h"

namespace abcal {

/// "2026-03-01T12:00:00.000Z".
std::string format_utc(Clock::UtcTime time);

/// Who an instrument said it was.
struct InstrumentIdentity {
  std::string role;  ///< "stage", "accelerometer".
  std::string maker, model, serial_number, firmware;
  std::string details;  ///< Travel, rate and so on, in words.
};

enum class RunState {
  kRunning,      ///< Being measured now, or the program died.
  kInterrupted,  ///< Ctrl-C or a fault; can be resumed.
  kComplete,     ///< Closed.
  kAbandoned,    ///< Closed without being complete.
};
std::string_view to_string(RunState state);

/// Where the time of a run went, in seconds.
struct RunTiming {
  double moving_s = 0.0;
  double settling_s = 0.0;
  double dwelling_s = 0.0;
  double overhead_s = 0.0;  ///< Commits, start-up: no motion, settling or dwell was pending.
  double total_s() const { return moving_s + settling_s + dwelling_s + overhead_s; }
};

/// What is known before the first angle.
struct RunHeader {
  std::string program_version;
  std::string created_utc;
  std::string bench_toml;                     ///< The bench file with every default written out.
  std::map<std::string, std::string> labels;  ///< "item.serial_number", "operator.name", ...
  std::vector<InstrumentIdentity> instruments;
  std::string response_unit = "R";
  LocalGravity g_loc;
  Tolerances tolerances;
  LimitsConfig limits;
  ExpectedItem expected;
  MeasuredAlignment measured_alignment;
  Angle step = Angle::degrees(5.0);
  int steps = 72;
  std::vector<PlannedAngle> plan;
};

/// One reading as it is stored.
struct StoredReading {
  std::uint64_t sequence = 0;
  double time_s = 0.0;                               ///< Arrival, from the start of the run.
  Eigen::Vector3d output = Eigen::Vector3d::Zero();  ///< R
  std::optional<double> temperature_degc;
};

/// The kind of the event that says that a port which had vanished is back; the analysis counts them.
inline constexpr std::string_view kReconnectedEvent = "reconnected";

/// One look at the room.
struct StoredEnvironment {
  std::string utc;
  std::string moment;  ///< "start", "end", "resume"
  std::optional<double> temperature_degc, humidity_percent, pressure_hpa;
};

/// The single readings of one dwell.
struct StoredDwell {
  std::size_t plan_position = 0;
  int experiment = 0;
  int n = 0;
  bool closing = false;
  Angle alpha;
  bool repeat = false;  ///< The angle was measured again, for comparison: its first dwell counts.
  std::vector<StoredReading> readings;
};

struct RunEvent {
  std::string utc;
  std::string kind;  ///< "started", "interrupted", "flag", ...
  std::string text;
};

/// One call on the byte stream of an instrument and what came of it, as the layer of the wire describes it.
struct WireRow {
  std::string role;                        ///< Whose stream: "stage", "accelerometer".
  std::int64_t time_ns = 0;                ///< From the start of the transcript.
  std::optional<std::int64_t> arrival_ns;  ///< Of the last of the bytes received.
  char kind = 0;                           ///< docs/run_file.md
  std::string bytes;

  bool operator==(const WireRow&) const = default;
};

/// Every byte of a run in both directions.
struct WireTranscript {
  Clock::UtcTime start;  ///< When time_ns was 0.
  std::vector<WireRow> rows;

  bool operator==(const WireTranscript&) const = default;
};

/// All that a run file holds but the single readings and the transcript of the wire.
struct StoredRun {
  RunHeader header;
  RunState state = RunState::kInterrupted;
  RunTiming timing;
  RunRecord record;
  std::vector<std::size_t> measured;  ///< Positions in header.plan that have a dwell.
  std::vector<RunEvent> events;
  std::vector<StoredEnvironment> environment;
};

/// A run on disk: one SQLite file (docs/run_file.md), append-only, each angle committed before the next move.
/// One writer at a time (a lock on the file); readers at any time. All functions throw RunFileError.
class RunFile {
 public:
  /// Creates a new file. Refuses one that exists: a run is never overwritten.
  static RunFile create(const std::filesystem::path& path, const RunHeader& header);

  /// Opens an interrupted run to go on with it. Refuses a closed one, and one that another process is
  /// writing.
  static RunFile open_for_append(const std::filesystem::path& path);

  /// Reads a run in any state.
  static StoredRun load(const std::filesystem::path& path);

  /// Gives every dwell with its readings to `each`, one after the other in the order of measurement: all
  /// readings of a long run at once may not fit into memory.
  static void read_dwells(const std::filesystem::path& path,
                          const std::function<void(const StoredDwell& dwell)>& each);

  /// The transcript of the wire, if the run was recorded with one.
  static std::optional<WireTranscript> load_transcript(const std::filesystem::path& path);

  /// Whether a file is SQLite at all, so that a run file and a CSV can be told apart.
  static bool looks_like_run_file(const std::filesystem::path& path);

  RunFile(RunFile&&) noexcept;
  RunFile& operator=(RunFile&&) noexcept;
  ~RunFile();

  /// From now on a transcript is kept. What `take` gives (all rows since it was asked last) is written at
  /// once, with each angle, and with each change of state.
  void keep_transcript(Clock::UtcTime start, std::function<std::vector<WireRow>()> take);

  /// Commits one angle with its readings and the time spent so far; on return it is on the disk.
  void append_dwell(std::size_t plan_position, const DwellRecord& dwell,
                    std::span<const StoredReading> readings, const RunTiming& timing);
  void append_event(const std::string& utc, std::string_view kind, std::string_view text);
  void append_environment(const std::string& utc, std::string_view when,
                          std::optional<double> temperature_degc, std::optional<double> humidity_percent,
                          std::optional<double> pressure_hpa);

  /// Sets the state and says why in an event.
  void set_state(RunState state, const std::string& utc, std::string_view why);

  /// Asked each time that another program, which reads the run, keeps it from being closed, with the number
  /// of times so far: waits for a while and says whether to try again.
  using TryAgain = std::function<bool(int)>;
  /// Waits 50 ms; 10 s in all.
  static bool wait_for_readers(int failures);

  /// Closes a complete run: state, checkpoint, one single file again, read-only. If the readers do not leave,
  /// it throws; the run is complete on the disk then, and finish_closing() closes it.
  /// @return SHA-256 of the closed file's bytes, in hexadecimal.
  std::string close_complete(const std::string& utc, const RunTiming& timing,
                             const TryAgain& try_again = wait_for_readers);

  /// Closes a run that is complete, but whose program was killed before it had closed it; does nothing to one
  /// that is closed. @return SHA-256 of the closed file's bytes.
  static std::string finish_closing(const std::filesystem::path& path,
                                    const TryAgain& try_again = wait_for_readers);

  const std::filesystem::path& path() const;

 private:
  struct Impl;
  explicit RunFile(std::unique_ptr<Impl> impl);
  std::string close(const TryAgain& try_again);
  std::unique_ptr<Impl> impl_;
};

/// A certificate as it was issued. Fields in the order in which they are chained.
struct IssuedCertificate {
  std::string utc;  ///< When it was issued.
  std::string number;
  std::string measured_by, approved_by;
  std::string date;      ///< Of issue, as on the certificate: "2026-03-01".
  std::string replaces;  ///< Number of the certificate it replaces; empty: none.
  std::string reason;    ///< Why.
  std::string program_version;
  std::string laboratory_toml;  ///< The laboratory file as it was read.
  std::string xml;              ///< Its bytes, signature included.
};

/// `RUN.results`, beside the run: analyses and issued certificates. Rows are only ever added.
class ResultsFile {
 public:
  /// Opens or creates the results of a run; they name the hash of the closed run they belong to.
  ResultsFile(const std::filesystem::path& run_path, const std::string& run_sha256);

  /// Stores an analysis unless the very same one is there already.
  void add_analysis(const std::string& utc, std::string_view program_version, std::string_view estimator,
                    std::string_view result_json);

  /// How many are stored.
  std::size_t analyses();

  /// Keeps an issued certificate. Refuses a number that is there already, a second certificate that does not
  /// replace the first, and the replacement of one that is replaced already.
  void add_certificate(const IssuedCertificate& certificate);

  static std::filesystem::path path_beside(const std::filesystem::path& run_path);

  /// The certificates issued for a run, oldest first; none where there are no results.
  static std::vector<IssuedCertificate> certificates(const std::filesystem::path& run_path);

 private:
  SqliteDatabase database_;
};

}  // namespace abcal
