#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "app/console/interrupted_run.h"
#include "app/console/watched.h"
#include "app/session/bench_check.h"
#include "app/session/item_check.h"
#include "app/session/session_events.h"
#include "drivers/instrument/clock.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_record.h"
#include "protocol/run/experiment_run.h"

namespace abcal::console {

// Events of the measuring thread for pages. Each is a copy: nothing is shared.

enum class Activity { kIdle, kChecking, kRunning, kJogging, kAnalysing };

struct ActivitySeen {
  Activity activity = Activity::kIdle;
  bool hold_asked = false;
  bool stop_asked = false;
};

struct DwellSeen {
  std::size_t position = 0;
  DwellRecord dwell;                 ///< Of several items that of the first of `items`.
  Clock::UtcTime told;               ///< When the measuring thread reported it, in real time.
  std::vector<ItemReading> items{};  ///< Of several: those that were measured. Empty: the first.
};

struct RunBegan {
  std::string file;  ///< Name in the run folder; empty for the small turn of a check.
  std::string bench, item, operator_name;
  std::string unit;  ///< R
  std::vector<PlannedAngle> plan;
  std::vector<DwellSeen> measured;   ///< Before an interruption; `told` is not known.
  double estimated_s = 0.0;          ///< Of real time, for the whole plan.
  std::string simulated;             ///< Which instruments are: "stage, accelerometer"; empty: none.
  std::optional<double> pace;        ///< If everything is simulated: simulated time over real time.
  std::string stage, accelerometer;  ///< Who they are, in words.
  std::vector<ItemSummary> items{};  ///< Of several; empty: there is one.
};

/// One of several items takes no part any more.
struct ItemDropped {
  int k = 1;
  std::string words;  ///< Why.
};

/// How long a phase may last before the run gives up.
struct TimeLimit {
  double seconds = 0.0;  ///< In the time of the bench.
  std::string words;     ///< What happens then, or what it is beyond: "beyond the time that its speed needs".
  bool simulated = false;  ///< Everything is simulated, and so is the time.
};

struct PhaseSeen {
  std::size_t position = 0;
  RunPhase phase = RunPhase::kHoming;
  std::optional<TimeLimit> limit;
};

/// An instrument failed, which ended what was in progress.
struct FaultSeen {
  std::string instrument;  ///< As it names itself in messages.
  std::string fault;       ///< to_string(Fault)
  std::string words;
};

/// Whether another process halts the stage if this one dies.
struct GuardSeen {
  std::string words;
};

/// A run that a person may go on with, or nothing.
struct InterruptedSeen {
  std::optional<InterruptedRun> run;
};

struct LogLine {
  enum class Grade { kInfo, kWarning, kProblem };
  Grade grade = Grade::kInfo;
  std::string text;
};

struct ChecksSeen {
  std::vector<Finding> findings;
};

/// An item that waits in the queue was looked at.
struct ItemChecked {
  std::int64_t entry = 0;
  ItemCheck check;
};

/// The ports of this computer and who answered on them, for pages.
struct PortsSeen {
  nlohmann::ordered_json ports;
};

/// A levelling and its outcome, for pages.
struct LevelSeen {
  std::string file;                  ///< For `level_file` in the bench file; empty: none was written.
  nlohmann::ordered_json levelling;  ///< As in the file.
  std::string words;
};

/// The queue as it is now, for pages.
struct QueueSeen {
  nlohmann::ordered_json queue;
};

struct RunEnded {
  std::string file;
  bool complete = false;
  std::string words;  ///< Verdict and reason, or the cause of its end.
};

using Event = std::variant<ActivitySeen, RunBegan, PhaseSeen, DwellSeen, StageSeen, StripSeen, LogLine,
                           ChecksSeen, RunEnded, HaltSeen, FaultSeen, GuardSeen, InterruptedSeen, ItemChecked,
                           ItemDropped, QueueSeen, PortsSeen, LevelSeen>;

}  // namespace abcal::console
