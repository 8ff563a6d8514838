#include "app/console/request.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "app/console/visible_text.h"

namespace abcal::console {
namespace {

using Json = nlohmann::json;

/// The keys of one request. finish() refuses a key that was not asked for.
class Keys {
 public:
  explicit Keys(const Json& object) : object_(object) {}

  std::string text(const char* key) {
    const Json& value = need(key);
    if (!value.is_string()) throw RequestError(fmt::format("\"{}\" is no text", key));
    return value.get<std::string>();
  }
  double number(const char* key) {
    const Json& value = need(key);
    if (!value.is_number()) throw RequestError(fmt::format("\"{}\" is no number", key));
    return value.get<double>();
  }
  bool has(const char* key) const { return object_.contains(key); }
  bool flag(const char* key) {
    seen_.insert(key);
    const auto found = object_.find(key);
    if (found == object_.end()) return false;
    if (!found->is_boolean()) throw RequestError(fmt::format("\"{}\" is neither true nor false", key));
    return found->get<bool>();
  }
  std::int64_t id() {
    seen_.insert("id");
    const auto found = object_.find("id");
    if (found == object_.end()) return 0;
    if (!found->is_number_unsigned() || found->get<std::uint64_t>() > 1'000'000'000)
      throw RequestError("\"id\" is no whole number from 0 to 1000000000");
    return found->get<std::int64_t>();
  }
  /// A person's choices for a run; parse_run_choice() checks their keys.
  RunChoice choice() {
    seen_.insert(
        {"item", "steps", "dwell_readings", "estimator", "without_missing_items", "bench_sha256", "form"});
    return parse_run_choice(object_);
  }
  void require_confirmation() {
    if (!flag("confirmed"))
      throw RequestError("this moves the stage; required: \"confirmed\": true, which a person has given");
  }
  void finish() const {
    for (const auto& item : object_.items()) {
      if (!seen_.contains(item.key()))
        throw RequestError(fmt::format("\"{}\" does not belong to this request", item.key()));
    }
  }

 private:
  const Json& need(const char* key) {
    seen_.insert(key);
    const auto found = object_.find(key);
    if (found == object_.end()) throw RequestError(fmt::format("\"{}\" is missing", key));
    return *found;
  }

  const Json& object_;
  std::set<std::string, std::less<>> seen_;
};

/// The id that a request states; 0: no valid one.
std::uint64_t stated_id(const Json& object) {
  const auto found = object.is_object() ? object.find("id") : object.end();
  return found != object.end() && found->is_number_unsigned() ? found->get<std::uint64_t>() : 0;
}

/// Reads JSON. Refuses an object with the same key twice, as either value could be meant.
Json parse_unambiguous(std::string_view text) {
  std::vector<std::set<std::string>> open;  // The keys of each unfinished object.
  std::string twice;
  const auto note_key = [&](int /*depth*/, Json::parse_event_t event, const Json& parsed) {
    if (event == Json::parse_event_t::object_start) open.emplace_back();
    if (event == Json::parse_event_t::object_end) open.pop_back();
    if (event != Json::parse_event_t::key) return true;
    const auto key = parsed.get<std::string>();
    if (!open.back().insert(key).second && twice.empty()) twice = key;
    return true;
  };
  Json json = Json::parse(text, note_key, /*allow_exceptions=*/false);
  if (!twice.empty()) throw RequestError(fmt::format("\"{}\" is given twice", twice), stated_id(json));
  return json;
}

StageAxis axis_of(const std::string& name) {
  if (name == "x") return StageAxis::kX;
  if (name == "z") return StageAxis::kZ;
  throw RequestError(R"("axis" must be "x" or "z")");
}

/// Reads the travel of a jog from exactly one of three keys.
Jog jog_of(Keys& keys) {
  Jog jog;
  jog.axis = axis_of(keys.text("axis"));
  const bool has_to = keys.has("to_deg"), is_held = keys.has("while_held");
  if (is_held) {
    jog.how = Jog::How::kWhileHeld;
    const std::string direction = keys.text("while_held");
    if (direction != "up" && direction != "down")
      throw RequestError(R"("while_held" must be "up" or "down": towards larger or smaller angles)");
    jog.angle = Angle::degrees(direction == "up" ? 360.0 : -360.0);
    return jog;
  }
  const char* key = has_to ? "to_deg" : "by_deg";
  jog.how = has_to ? Jog::How::kTo : Jog::How::kBy;
  const double degrees = keys.number(key);
  // Written so that NaN is refused as well.
  if (!(std::abs(degrees) <= 360.0))
    throw RequestError(fmt::format("\"{}\" must be from -360 to 360 degrees", key));
  jog.angle = Angle::degrees(degrees);
  return jog;
}

std::string note_of(std::string text) {
  const bool unprintable = std::any_of(text.begin(), text.end(), [](char c) {
    return static_cast<unsigned char>(c) < 0x20 || static_cast<unsigned char>(c) == 0x7F;
  });
  if (text.empty() || text.size() > kLongestNote || unprintable)
    throw RequestError(fmt::format("a note has 1 to {} bytes in one line", kLongestNote));
  if (has_direction_controls(text))
    throw RequestError("a note has no characters that turn the direction of writing (Unicode Bidi_Control)");
  return text;
}

constexpr double kMostEntry = 1e9, kMostPage = 1e9;
constexpr int kMostRunsOfEntry = 100;
constexpr int kMostPlaces = 200;

int whole(const char* key, double number, double least, double most) {
  if (!(number >= least && number <= most) || number != std::floor(number))
    throw RequestError(fmt::format("\"{}\" is no whole number from {} to {}", key, least, most));
  return static_cast<int>(number);
}

QueueCommand queue_command_of(const std::string& what, Keys& keys) {
  if (what == "queue_add") {
    QueueAdd add{keys.choice(), whole("runs", keys.number("runs"), 1, kMostRunsOfEntry)};
    if (!add.choice.item) throw RequestError("\"item\" is missing");
    return add;
  }
  if (what == "queue_pause") return QueuePause{!keys.flag("go_on")};
  if (what == "queue_start") keys.require_confirmation();
  const std::int64_t entry = whole("entry", keys.number("entry"), 1, kMostEntry);
  if (what == "queue_move")
    return QueueMove{entry, whole("by", keys.number("by"), -kMostPlaces, kMostPlaces)};
  if (what == "queue_remove") return QueueRemove{entry};
  if (what == "queue_repeat") return QueueRepeat{entry};
  if (what == "queue_mounted") return QueueMounted{entry};
  if (what == "queue_start") return QueueStart{entry};
  throw RequestError(
      "of the queue, \"do\" must be queue_add, queue_move, queue_remove, queue_repeat, queue_pause, "
      "queue_mounted or queue_start");
}

Command command_of(const std::string& what, Keys& keys) {
  if (what.starts_with("queue_")) return queue_command_of(what, keys);
  if (what == "beat") return Beat{};
  if (what == "control") {
    if (keys.flag("release")) return ReleaseControl{};
    if (keys.flag("ask")) return AskControl{};
    for (const char* answer : {"hand_over_to", "not_to"}) {
      if (keys.has(answer))
        return AnswerControl{whole(answer, keys.number(answer), 1, kMostPage), answer[0] == 'h'};
    }
    return TakeControl{keys.flag("from_another")};
  }
  if (what == "check") {
    const bool with_motion = keys.flag("with_motion");
    if (with_motion) keys.require_confirmation();
    return CheckBench{with_motion};
  }
  if (what == "start") {
    keys.require_confirmation();
    return StartRun{keys.choice()};
  }
  if (what == "level") {
    keys.require_confirmation();
    return Level{};
  }
  if (what == "probe") return Probe{};
  if (what == "hold") return HoldRun{};
  if (what == "continue") {
    keys.require_confirmation();
    return ContinueRun{};
  }
  if (what == "stop") return Stop{};
  if (what == "resume") {
    keys.require_confirmation();
    return ResumeRun{keys.text("run"), keys.flag("without_missing_items")};
  }
  if (what == "jog") {
    keys.require_confirmation();
    return jog_of(keys);
  }
  if (what == "keep_turning") return KeepTurning{keys.flag("let_go")};
  if (what == "acknowledge") return Acknowledge{keys.text("run")};
  if (what == "note") return Note{note_of(keys.text("text"))};
  throw RequestError(
      "\"do\" must be beat, control, check, start, hold, continue, stop, resume, jog, keep_turning, note, "
      "acknowledge, level, probe or queue_...");
}

}  // namespace

Request parse_request(std::string_view text) {
  if (text.size() > kLongestRequest)
    throw RequestError(fmt::format("{} bytes; a request has at most {}", text.size(), kLongestRequest));
  return read_request(parse_unambiguous(text));
}

Request read_request(Json json) {
  if (!json.is_object()) throw RequestError("this is no JSON object");
  try {
    Keys keys(json);
    Request request;
    request.id = keys.id();
    request.command = command_of(keys.text("do"), keys);
    keys.finish();
    request.json = std::move(json);
    return request;
  } catch (const RequestError& error) {
    throw RequestError(error.what(), stated_id(json));
  }
}

}  // namespace abcal::console
