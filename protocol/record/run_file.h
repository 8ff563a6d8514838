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
#include "protocol/record/results_file.h"
#include "protocol/record/run_record.h"
#include "protocol/record/sqlite.h"
#include "protocol/record/witnessed_line.h"

namespace abcal {

/// "2026-03-01T12:00:00.000Z".
std::string format_utc(Clock::UtcTime time);

/// Identity that an instrument reported.
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

/// An accelerometer under calibration: a row of the table `item`.
struct RunItem {
  int k = 1;  ///< Counts the items of a run from 1.
  std::string maker, model, serial_number, firmware;
  std::string driver, port;
  std::string mounting;  ///< How it sits on the stage, in words.
  std::string response_unit;
  std::optional<double> rate_hz;
  std::optional<double> full_scale;  ///< Response unit.
  std::optional<double> resolution;  ///< Response unit.
  /// Correction registers in force at the start (bias, scale, misalignment ...), by name, as the instrument
  /// reported.
  std::map<std::string, std::string> registers;
};

/// Facts of a header that each of several items has for itself.
struct ItemFacts {
  std::map<std::string, std::string> labels;  ///< "item.serial_number", ...
  std::string response_unit = "R";
  Tolerances tolerances;  ///< The sizes of the stage are the same for all items.
  LimitsConfig limits;
  ExpectedItem expected;
};

/// The computer's clock when a session begins. All unknown for simulated time.
struct HostClock {
  std::string boot_id;                        ///< Names the start of the computer; empty: not known.
  std::optional<Clock::Duration> since_boot;  ///< Asleep or awake.
  std::optional<double> offset_s;             ///< System clock less UTC, as the time service estimates it.
  std::optional<double> error_s;              ///< Its bound of the error of the system clock.
};

/// The time, clocks and program with which measuring begins or continues.
struct SessionStart {
  std::optional<Clock::UtcTime> utc;        ///< UTC of the system clock.
  std::optional<Clock::Instant> monotonic;  ///< The same moment by the clock of the run.
  HostClock host;
  std::string program_version;
  /// Everything is simulated and the clock jumps: the same command makes the same angles again, bit for bit.
  bool repeatable = false;
};

/// One spell of measuring: from the start of a run, or of its continuation, to its end.
struct StoredSession {
  std::int64_t id = 0;
  std::optional<Clock::UtcTime> begun;  ///< The UTC from which the times of its dwells are counted.
  double origin_s = 0.0;                ///< True time from the beginning of the first session to its own.
  std::string program_version;
  std::string ended_utc;   ///< Empty: its program was killed, or is at work.
  std::string end_reason;  ///< Empty: as above.
};

/// Facts known before the first angle.
struct RunHeader {
  std::string program_version;
  std::string created_utc;
  std::string bench_toml;                     ///< The bench file with every default written out.
  std::map<std::string, std::string> labels;  ///< "item.serial_number", "operator.name", ...
  std::vector<InstrumentIdentity> instruments;
  /// As read: one at least. To be written, empty: one, as the labels "item.*" name it.
  std::vector<RunItem> items;
  /// To be written: those of items 2, 3, ...; the header's own are those of item 1. When read, empty: labels,
  /// response unit, tolerances, limits and expectation are those of the item that was asked for.
  std::vector<ItemFacts> further_items;
  std::string response_unit = "R";
  LocalGravity g_loc;
  Tolerances tolerances;
  LimitsConfig limits;
  ExpectedItem expected;
  MeasuredAlignment measured_alignment;
  std::string stage_record;  ///< The file of the record of the stage, as it was read; empty: none is used.
  Angle step = Angle::degrees(5.0);
  int steps = 72;
  /// From how far below every angle is reached; 0: from either side. Absent: files of before version 1.0.
  std::optional<Angle> approach;
  AxesOrder axes_order = AxesOrder::kXThenZ;  ///< Files of before version 1.2 do not state it.
  std::vector<PlannedAngle> plan;
};

/// One stored reading.
struct StoredReading {
  std::uint64_t sequence = 0;
  double time_s = 0.0;                               ///< Arrival, on the scale of DwellRecord::time_s.
  Eigen::Vector3d output = Eigen::Vector3d::Zero();  ///< R
  std::optional<double> temperature_degc;
};

/// The kind of the event that reports the return of a port that had vanished; the analysis counts them.
inline constexpr std::string_view kReconnectedEvent = "reconnected";
/// The kind of the event that reports that the run continued without an item.
inline constexpr std::string_view kItemDroppedEvent = "item dropped";
/// The kind of the event that names the person who has taken note of the interruption of the run.
inline constexpr std::string_view kAcknowledgedEvent = "alarm acknowledged";
/// The kind of the event that reports that the system clock was moved.
inline constexpr std::string_view kClockStepEvent = "clock step";

/// One observation of the room.
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
  int face = 1;  ///< 1 or 2 (protocol/plan/faces.h).
  int item = 1;  ///< Item of the run, from 1.
  Angle alpha;
  bool repeat = false;  ///< The angle was measured again, for comparison: its first dwell counts.
  std::vector<StoredReading> readings;
};

struct RunEvent {
  std::string utc;
  std::string kind;  ///< "started", "interrupted", "flag", ...
  Message text;      ///< bare where the file states no sentence of it: of a person, of an earlier version.
};

/// One call on the byte stream of an instrument and its result, as the layer of the wire describes it.
struct WireRow {
  std::string role;                        ///< Owner of the stream: "stage", "accelerometer".
  std::int64_t time_ns = 0;                ///< Time since the start of the transcript.
  std::optional<std::int64_t> arrival_ns;  ///< Arrival of the last byte received.
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

/// How far an item of a run was measured.
struct ItemProgress {
  int k = 1;
  std::size_t measured = 0;  ///< Angles.
  /// The angle, by its position in the plan, before which it was dropped from the run; absent: it was not.
  std::optional<std::size_t> dropped_at;
  Message reason;  ///< Why it was dropped.
};

/// An encoder angle of an axis while it turned.
struct EncoderSample {
  double time_s = 0.0;  ///< On the scale of DwellRecord::time_s.
  double angle_deg = 0.0;
};

/// One item's part of a measured angle.
struct ItemDwell {
  int item = 1;
  DwellRecord dwell;
  std::vector<StoredReading> readings;
  std::vector<EncoderSample> encoder{};  ///< Those of a whole sweep, with the first of its angles.
};

/// The parts of all items at one angle of a sweep.
struct PassedAngle {
  std::size_t position = 0;  ///< In the plan.
  std::vector<ItemDwell> dwells;
};

/// Contents of a run file except the single readings and the transcript of the wire. The parts that belong to
/// one item are those of the requested item.
struct StoredRun {
  RunHeader header;
  RunState state = RunState::kInterrupted;
  RunTiming timing;
  RunRecord record;
  int item = 1;                         ///< The item of `record`.
  std::vector<ItemProgress> items;      ///< Progress of all items, in the order of header.items.
  std::vector<StoredSession> sessions;  ///< None in a file of version 2.
  std::vector<std::size_t> measured;    ///< Positions in header.plan that have a dwell, in order of time.
  std::vector<DwellRecord> dwells;      ///< Their dwells: those of the record and its check poses.
  std::vector<RunEvent> events;
  std::vector<StoredEnvironment> environment;

  /// The item of the record, and the extent of its measurement.
  const RunItem& own_item() const { return header.items.at(static_cast<std::size_t>(item) - 1); }
  const ItemProgress& own_progress() const { return items.at(static_cast<std::size_t>(item) - 1); }
  /// The item as results files and certificates name it: 0 where the run has one.
  int named_item() const { return items.size() > 1 ? item : 0; }
};

/// A run on disk: one SQLite file (docs/run_file.md), append-only, each angle committed before the next move.
/// One writer at a time (a lock on the file); readers at any time. All functions throw RunFileError.
class RunFile {
 public:
  /// Creates a new file. Refuses a file that exists, since a run is never overwritten, a name that is not
  /// UTF-8 or that SQLite does not take for a file's, and a name for which results of another run exist,
  /// since the results of this run could not be stored then.
  static RunFile create(const std::filesystem::path& path, const RunHeader& header);

  /// Words for a run whose program ended without closing it, and whose write-ahead log is gone: the angles of
  /// its last minute may be lost. Ask before open_for_append(), which begins another log.
  static std::optional<Message> missing_log(const std::filesystem::path& path);

  /// Opens an interrupted run to continue it; one of version 2 becomes one of version 3. Refuses a closed
  /// run, a run that another process is writing, and a run for which results exist, since they must belong to
  /// another run.
  static RunFile open_for_append(const std::filesystem::path& path);

  /// Opens a run that is complete, but whose program was killed before it had closed it.
  /// @throws RunFileError also for a run in another state
  static RunFile open_to_close(const std::filesystem::path& path);

  /// Reads a run in any state, for one of its items.
  static StoredRun load(const std::filesystem::path& path, int item = 1);

  /// Like load(), for every item of a run in their order; the file is checked for damage once.
  static std::vector<StoredRun> load_items(const std::filesystem::path& path);
  /// Like load_items(), from the file that open_run_file() has opened.
  /// @param item  this one alone, from 1; 0: all
  static std::vector<StoredRun> load_items(SqliteDatabase& database, const std::filesystem::path& path,
                                           int item = 0);

  /// The number of items of a run. Nothing else is read, and the file is not checked for damage.
  static std::size_t count_items(const std::filesystem::path& path);

  /// Gives every dwell of an item (0: of all) with its readings to `each`, one after the other in the order
  /// of measurement: all readings of a long run at once may not fit into memory.
  static void read_dwells(const std::filesystem::path& path,
                          const std::function<void(const StoredDwell& dwell)>& each, int item = 0);

  /// The transcript of the wire, if the run was recorded with one.
  static std::optional<WireTranscript> load_transcript(const std::filesystem::path& path);

  /// Whether a file is SQLite, and no bag of ROS 2: to distinguish a run file from a table or log.
  static bool looks_like_run_file(const std::filesystem::path& path);

  RunFile(RunFile&&) noexcept;
  RunFile& operator=(RunFile&&) noexcept;
  ~RunFile();

  /// Begins a session: all that is measured from now on belongs to it. The time since the session before is
  /// known from the computer's clock since its start, else from UTC; a system clock that was moved in between
  /// is an event.
  void begin_session(const SessionStart& start);
  /// Whether begin_session() was called since the file was opened.
  bool in_session() const;
  /// True time from the beginning of the first session to an instant of this one: DwellRecord::time_s.
  double time_s(Clock::Instant instant) const;
  /// UTC of an instant of this session, which advances evenly even if the system clock is moved.
  Clock::UtcTime utc(Clock::Instant instant) const;
  /// UTC of now: as utc() in a session that knows it, else by the system clock.
  Clock::UtcTime utc_now(const Clock& clock) const;

  /// Keeps a transcript from now on. The rows from `take` (all since its last call) are written at once, with
  /// each angle, and with each change of state.
  void keep_transcript(Clock::UtcTime start, std::function<std::vector<WireRow>()> take);

  /// Has every angle witnessed from now on. @param ask  called after the commit of an angle with the link
  /// before it and its last link; must not block. @param take  statements since its last call; they are
  /// stored with the next angle and with each change of state
  void keep_witness(std::function<void(const std::string& before, const std::string& link)> ask,
                    std::function<std::vector<WitnessedLine>()> take);
  /// Stores a statement of the witness.
  void append_witness(const WitnessedLine& row);
  /// head_link() of the run, which identifies it.
  std::string head();
  /// The last link of the dwells; head() before the first angle.
  std::string last_link();
  /// closing_link() of a run that is complete.
  std::string closing();
  /// All statements of the witness about a run, in the order of their arrival; none in files of before
  /// version 4.
  static std::vector<WitnessedLine> witnessed(const std::filesystem::path& path);

  /// Commits one angle with its readings and the time spent so far; on return it is on the disk. Angles of a
  /// repeatable session survive the end of the program at once, and a failure of the computer from the next
  /// other entry on.
  void append_dwell(std::size_t plan_position, const DwellRecord& dwell,
                    std::span<const StoredReading> readings, const RunTiming& timing);
  /// Commits one angle of several items: all of them are on the disk, or none is.
  void append_dwells(std::size_t plan_position, std::span<const ItemDwell> dwells, const RunTiming& timing);
  /// Commits a sweep: all of its angles are on the disk, or none is.
  void append_sweep(std::span<const PassedAngle> angles, const RunTiming& timing);
  /// The run continues without an item, from the angle at a position of the plan on.
  void drop_item(int item, std::size_t plan_position, const std::string& utc, const Message& why);
  void append_event(const std::string& utc, std::string_view kind, const Message& text);
  void append_environment(const std::string& utc, std::string_view when,
                          std::optional<double> temperature_degc, std::optional<double> humidity_percent,
                          std::optional<double> pressure_hpa);

  /// Where the file is that is being written.
  enum class Place {
    kInPlace,       ///< At its name.
    kMoved,         ///< Renamed, or its folder is gone: it would be lost with the end of this program.
    kReplaced,      ///< Another file has its name.
    kWrittenAgain,  ///< It was deleted, and has been written again at its name, with everything in it.
  };
  /// Looks where the file is, and writes it again if it was deleted. Requires that no angle is being stored.
  Place look_for_file();

  /// Sets the state and gives the reason in an event. For a state in which the run does not continue, space
  /// is kept from the beginning, also on a disk that has become full.
  void set_state(RunState state, const std::string& utc, const Message& why);

  /// Called each time that another program, which reads the run, prevents closing, with the number of times
  /// so far: waits for a while and returns whether to try again.
  using TryAgain = std::function<bool(int)>;
  /// Waits 50 ms; 10 s in all.
  static bool wait_for_readers(int failures);

  /// All angles are measured: on return this is on the disk, with the last links of the chains (table
  /// `seal`). The run can be loaded and analysed from now on.
  void complete(const std::string& utc, const RunTiming& timing);

  /// Closes a run that is complete: checkpoint, one single file again, read-only. Its results are begun.
  /// @return SHA-256 of the closed file's bytes, in hexadecimal; nothing where readers keep the file open: it
  /// stays complete, and close() or finish_closing() closes it later.
  std::optional<std::string> close(const TryAgain& try_again = wait_for_readers);

  /// complete() and close(). If the readers do not leave, it throws; the run is complete on the disk then,
  /// and finish_closing() closes it.
  std::string close_complete(const std::string& utc, const RunTiming& timing,
                             const TryAgain& try_again = wait_for_readers);

  /// Whether a run is complete and closed: one file whose bytes no longer change, so that they have a hash.
  static bool is_closed(const std::filesystem::path& path);

  /// Closes a run that is complete, but whose program was killed before it had closed it; does nothing to one
  /// that is closed. @return SHA-256 of the closed file's bytes.
  static std::string finish_closing(const std::filesystem::path& path,
                                    const TryAgain& try_again = wait_for_readers);

  const std::filesystem::path& path() const;

 private:
  struct Impl;
  explicit RunFile(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace abcal
