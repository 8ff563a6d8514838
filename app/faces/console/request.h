#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <string_view>
#include <variant>

#include "app/faces/console/run_choice.h"
#include "drivers/instrument/angle.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal::console {

// What a page may ask for over its WebSocket, one JSON object each (docs/console.md). Reading a request is
// separate from carrying it out: bytes in, request out, nothing else touched.

/// The longest request that is looked at.
constexpr std::size_t kLongestRequest = 4096;
/// The longest note, in bytes of UTF-8.
constexpr std::size_t kLongestNote = 1000;

/// The page is there; each second, not answered.
struct Beat {};
struct TakeControl {
  bool from_another = false;  ///< Even if another page has it.
};
struct ReleaseControl {};
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
  bool without_missing_items = false;  ///< Of several: those that are not there are left out.
};
struct Jog {
  StageAxis axis = StageAxis::kX;
  Angle by;  ///< From where its encoder says it is; at most one turn.
};
struct Note {
  std::string text;
};

/// Measures the tilt of the Z axis and the zero of X.
struct Level {};
/// Asks every free port who answers; nothing moves.
struct Probe {};

/// What becomes of the queue of items; nothing of it moves but QueueStart.
struct QueueAdd {
  RunChoice choice;  ///< With an item.
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
/// The item is mounted, as a person says: looks at it.
struct QueueMounted {
  std::int64_t entry = 0;
};
struct QueueStart {
  std::int64_t entry = 0;
};
using QueueCommand =
    std::variant<QueueAdd, QueueMove, QueueRemove, QueueRepeat, QueuePause, QueueMounted, QueueStart>;

using Command = std::variant<Beat, TakeControl, ReleaseControl, CheckBench, StartRun, HoldRun, ContinueRun,
                             Stop, ResumeRun, Jog, Note, Level, Probe, QueueCommand>;

struct Request {
  std::int64_t id = 0;  ///< Comes back with the answer.
  Command command;
  nlohmann::json json;  ///< As it came, for the process that holds the bench.
};

/// A request that is not understood. what() says what was found and required.
class RequestError : public std::runtime_error {
 public:
  explicit RequestError(const std::string& why, std::uint64_t id = 0) : std::runtime_error(why), id_(id) {}
  /// The id that the request states; 0: none that could be one.
  std::uint64_t id() const { return id_; }

 private:
  std::uint64_t id_;
};

/// Reads one request. What moves hardware must carry "confirmed": true; a key that does not belong is
/// refused, so that a slip of the pen never becomes a default.
/// @throws RequestError
Request parse_request(std::string_view text);

/// The same for a request that is JSON already.
/// @throws RequestError
Request read_request(nlohmann::json json);

}  // namespace abcal::console
