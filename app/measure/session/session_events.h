#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_record.h"
#include "protocol/run/run_observer.h"

// Events of a session: plain data that is sent to other processes as JSON. The session shares no data with
// its listeners.

namespace abcal {

/// One angle that is measured and on the disk.
struct DwellDoneEvent {
  static constexpr const char* kName = "dwell_done";
  std::size_t position = 0;           ///< In the plan.
  std::map<int, DwellRecord> dwells;  ///< By number of the item; at least one.

  /// The item with the lowest number among those that were measured, and its dwell.
  int first_item() const { return dwells.begin()->first; }
  const DwellRecord& first() const { return dwells.begin()->second; }
};

/// The identity that an instrument reported. An empty text: it reports none.
struct InstrumentSummary {
  std::string maker, model, serial_number;
};

/// One of several items.
struct ItemSummary {
  int k = 1;
  std::string name;  ///< Serial number, or "item 3".
  std::string model, unit;
  double rate_hz = 0.0;
  Message missing;           ///< Why it takes no part; empty: it does.
  std::size_t measured = 0;  ///< Its angles before an interruption.
};

/// A run has a file and a plan; nothing has moved yet.
struct RunBeganEvent {
  static constexpr const char* kName = "run_began";
  std::string file;      ///< Path of the run file.
  bool resumed = false;  ///< An interrupted run continues.
  std::string bench, item, operator_name;
  std::string unit;  ///< R
  InstrumentSummary stage, accelerometer;
  double rate_hz = 0.0;
  std::vector<PlannedAngle> plan;
  std::vector<DwellDoneEvent> measured;  ///< Before an interruption.
  double estimated_s = 0.0;              ///< For the whole plan, in the time of the bench.
  bool simulated_time = false;           ///< Everything is simulated.
  std::string simulated;                 ///< The instruments that are: "stage, accelerometer"; empty: none.
  std::vector<ItemSummary> items{};      ///< All of several items; empty: one item.
};

/// The run enters a phase.
struct PhaseEvent {
  static constexpr const char* kName = "phase";
  std::size_t position = 0;  ///< In the plan.
  RunPhase phase = RunPhase::kHoming;
};

/// The stage starts to move to an angle, for the first time or to measure it again.
struct AngleBegunEvent {
  static constexpr const char* kName = "angle_begun";
  std::size_t position = 0;  ///< In the plan.
};

/// An angle was measured with a flag.
struct FlagEvent {
  static constexpr const char* kName = "flag";
  Message text;
  std::optional<int> item{};  ///< As in NoticeEvent.
};

/// A port vanished; the run waits for it.
struct PortLostEvent {
  static constexpr const char* kName = "port_lost";
  Message text;
};

/// The port is back, with an instrument of the same model and serial number; the run continues.
struct PortBackEvent {
  static constexpr const char* kName = "port_back";
  Message text;
};

/// The stage waits before an angle because of a hold request.
struct HeldEvent {
  static constexpr const char* kName = "held";
  std::size_t position = 0;  ///< In the plan.
};

/// The stage continues after a hold.
struct ContinuedEvent {
  static constexpr const char* kName = "continued";
  std::size_t position = 0;  ///< In the plan.
};

/// Something else that a person should know.
struct NoticeEvent {
  static constexpr const char* kName = "notice";
  /// As in the run file's events: "repeated", "temperature", "watchdog", "disk space", "item dropped" ...
  std::string kind;
  Message text;
  std::optional<int> item{};  ///< The number of the item that it is about; absent: the whole bench.
};

/// A person's note is in the run file.
struct NoteStoredEvent {
  static constexpr const char* kName = "note_stored";
  std::string text, by;
};

/// All angles are measured; the run is being closed and analysed.
struct AllMeasuredEvent {
  static constexpr const char* kName = "all_measured";
  std::string file;
};

/// A replay is over: whether it agrees with the recorded run.
struct ReplayComparedEvent {
  static constexpr const char* kName = "replay_compared";
  std::size_t same = 0;      ///< Angles that are exactly as recorded,
  std::size_t replayed = 0;  ///< of this many.
  bool ended_alike = false;
  std::string recorded_end;  ///< How the recorded run ended, in words.
};

/// The run is complete, or ended early.
struct FinishedEvent {
  static constexpr const char* kName = "finished";
  std::string file;
  bool complete = false;
  std::string verdict;                    ///< Worst verdict of the items; empty if the run ended early.
  Message reason;                         ///< Reason for the verdict, or for the early end.
  std::size_t measured = 0, planned = 0;  ///< Angles.
  bool measured_before = false;           ///< Measured earlier; now only closed and analysed.
};

using SessionEvent = std::variant<RunBeganEvent, PhaseEvent, AngleBegunEvent, DwellDoneEvent, FlagEvent,
                                  PortLostEvent, PortBackEvent, HeldEvent, ContinuedEvent, NoticeEvent,
                                  NoteStoredEvent, AllMeasuredEvent, ReplayComparedEvent, FinishedEvent>;

/// Called from the measuring thread; must return at once and must not throw.
using SessionListener = std::function<void(const SessionEvent&)>;

/// One object, whose member "event" names it; `messages` are those of its texts (message_json.h). Numbers
/// that are not finite are the texts "nan", "inf" and
/// "-inf". Text that is not UTF-8 must be replaced when the JSON is written.
nlohmann::json to_json_object(const SessionEvent& event);

}  // namespace abcal
