#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <variant>
#include <vector>

#include "app/console/interrupted_run.h"
#include "app/console/watched.h"
#include "app/measure/session/bench_check.h"
#include "app/measure/session/item_check.h"
#include "app/measure/session/session_events.h"
#include "protocol/plan/run_config.h"

namespace abcal::console {

// Events of the measuring thread for pages: those of the session of a run, and those that only a console has.
// Each is a copy: nothing is shared.

enum class Activity { kIdle, kChecking, kRunning, kJogging, kAnalysing };

struct ActivitySeen {
  Activity activity = Activity::kIdle;
  bool hold_asked = false;
  bool stop_asked = false;
};

/// The instruments of a bench file are open.
struct BenchOpened {
  ProtocolConfig protocol;      ///< How long each phase of a run may last.
  bool simulated_time = false;  ///< Everything is simulated, and so is the time.
};

/// An instrument failed, which ended the current activity.
struct FaultSeen {
  std::string instrument;  ///< As it names itself in messages.
  std::string fault;       ///< to_string(Fault)
  Message words;
};

struct LogLine {
  enum class Grade { kInfo, kWarning, kProblem };
  Grade grade = Grade::kInfo;
  Message text;
};

struct ChecksSeen {
  std::vector<Finding> findings;
};

/// The item of an entry of the queue was checked.
struct ItemChecked {
  std::int64_t entry = 0;
  ItemCheck check;
};

/// A state of which a page needs the latest value only.
struct StateSeen {
  const char* type = "";  ///< "queue", "ports", "levelling": the type of the message to the page.
  nlohmann::ordered_json contents;
};

/// A person has taken note of the interruption of the run that can be resumed.
struct InterruptionAcknowledged {
  InterruptedRun run;
};

using Event = std::variant<SessionEvent, ActivitySeen, BenchOpened, StageSeen, StripSeen, LogLine, ChecksSeen,
                           ItemChecked, HaltSeen, FaultSeen, StateSeen, InterruptionAcknowledged>;

}  // namespace abcal::console
