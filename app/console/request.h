#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <string_view>
#include <variant>

#include "app/console/run_choice.h"
#include "drivers/instrument/angle.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal::console {

// Requests of a page over its WebSocket, one JSON object each (docs/console_programs.md). Reading a request
// is separate from carrying it out: bytes in, request out, no side effects.

/// The longest request that is accepted, in bytes.
constexpr std::size_t kLongestRequest = 4096;
/// The longest note, in bytes of UTF-8.
constexpr std::size_t kLongestNote = 1000;

/// Sign of life of the page, sent each second and not answered.
struct Beat {};
struct TakeControl {
  bool from_another = false;  ///< Even if another page has it.
};
struct ReleaseControl {};
/// Asks the page that steers to hand control over.
struct AskControl {};
/// The page that steers answers the page that has asked.
struct AnswerControl {
  std::int64_t page = 0;  ///< Number of the page that has asked.
  bool hand_over = false;
};
struct CheckBench {
  bool with_motion = false;
};
struct StartRun {
  RunChoice choice;
};
struct HoldRun {};
struct ContinueRun {};
struct Stop {};
struct ResumeRun {
  std::string run;                     ///< Name of a file in the run folder.
  bool without_missing_items = false;  ///< Missing ones of several items are left out.
};
struct Jog {
  enum class How {
    kBy,        ///< By an angle relative to the encoder angle.
    kTo,        ///< To an angle of the protocol.
    kWhileHeld  ///< As long as signs of life arrive (KeepTurning), at most by this angle or to the travel's
                ///< end.
  };
  StageAxis axis = StageAxis::kX;
  How how = How::kBy;
  Angle angle;  ///< At most one turn.
};
/// A person still holds the button of a jog; sent each 100 ms and not answered.
struct KeepTurning {
  bool let_go = false;  ///< The button was released: halt now.
};
struct Note {
  std::string text;
};

/// A person has taken note of the interruption of a run.
struct Acknowledge {
  std::string run;  ///< Name of a file in the run folder.
};

/// Measures the tilt of the Z axis and the zero of X.
struct Level {};
/// Asks every free port which instrument answers; nothing moves.
struct Probe {};

/// Requests about the queue of items follow; only QueueStart moves the stage.
struct QueueAdd {
  RunChoice choice;  ///< Contains an item.
  int runs = 1;
};
struct QueueMove {
  std::int64_t entry = 0;
  int by = 0;  ///< Places towards the end.
};
struct QueueRemove {
  std::int64_t entry = 0;
};
struct QueueRepeat {
  std::int64_t entry = 0;
};
struct QueuePause {
  bool paused = true;
};
/// A person states that the item is mounted; it is checked.
struct QueueMounted {
  std::int64_t entry = 0;
};
struct QueueStart {
  std::int64_t entry = 0;
};
using QueueCommand =
    std::variant<QueueAdd, QueueMove, QueueRemove, QueueRepeat, QueuePause, QueueMounted, QueueStart>;

using Command = std::variant<Beat, TakeControl, ReleaseControl, AskControl, AnswerControl, CheckBench,
                             StartRun, HoldRun, ContinueRun, Stop, ResumeRun, Jog, KeepTurning, Note,
                             Acknowledge, Level, Probe, QueueCommand>;

struct Request {
  std::int64_t id = 0;  ///< Returned with the reply.
  Command command;
  nlohmann::json json;  ///< As received, for the process that holds the bench.
};

/// A request that is not understood. what() states what was found and required.
class RequestError : public std::runtime_error {
 public:
  explicit RequestError(const std::string& why, std::uint64_t id = 0) : std::runtime_error(why), id_(id) {}
  /// The id that the request states; 0: no valid one.
  std::uint64_t id() const { return id_; }

 private:
  std::uint64_t id_;
};

/// Reads one request. A request that moves hardware must carry "confirmed": true. An unknown key is refused,
/// so that a misspelt key is never silently ignored.
/// @throws RequestError
Request parse_request(std::string_view text);

/// Reads a request that is already parsed JSON.
/// @throws RequestError
Request read_request(nlohmann::json json);

}  // namespace abcal::console
