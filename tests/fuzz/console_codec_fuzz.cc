// Fuzz target of the requests that pages send: whatever the bytes, they are a request or refused with a
// reason; what moves hardware carries the person's yes; and a request that was understood, written out again,
// is understood as the same.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// console_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "app/console/request.h"

namespace {

using namespace abcal::console;
using Json = nlohmann::json;

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "a request of a page: %s\n", what);
  std::abort();
}

struct Write {
  Json operator()(const Beat&) const { return {{"do", "beat"}}; }
  Json operator()(const TakeControl& c) const {
    return {{"do", "control"}, {"from_another", c.from_another}};
  }
  Json operator()(const ReleaseControl&) const { return {{"do", "control"}, {"release", true}}; }
  Json operator()(const AskControl&) const { return {{"do", "control"}, {"ask", true}}; }
  Json operator()(const AnswerControl& c) const {
    return {{"do", "control"}, {c.hand_over ? "hand_over_to" : "not_to", c.page}};
  }
  Json operator()(const CheckBench& c) const {
    Json json = {{"do", "check"}, {"with_motion", c.with_motion}};
    if (c.with_motion) json["confirmed"] = true;
    return json;
  }
  Json operator()(const StartRun& s) const {
    Json json = with_choice("start", s.choice);
    json["confirmed"] = true;
    return json;
  }
  Json operator()(const HoldRun&) const { return {{"do", "hold"}}; }
  Json operator()(const ContinueRun&) const { return {{"do", "continue"}, {"confirmed", true}}; }
  Json operator()(const Stop&) const { return {{"do", "stop"}}; }
  Json operator()(const ResumeRun& r) const {
    return {{"do", "resume"}, {"run", r.run}, {"confirmed", true}};
  }
  Json operator()(const Jog& j) const {
    require(std::abs(j.angle.deg()) <= 360.0, "a jog of more than one turn");
    Json json = {{"do", "jog"}, {"axis", j.axis == abcal::StageAxis::kX ? "x" : "z"}, {"confirmed", true}};
    if (j.how == Jog::How::kWhileHeld)
      json["while_held"] = j.angle.deg() > 0.0 ? "up" : "down";
    else
      json[j.how == Jog::How::kTo ? "to_deg" : "by_deg"] = j.angle.deg();
    return json;
  }
  Json operator()(const KeepTurning& k) const { return {{"do", "keep_turning"}, {"let_go", k.let_go}}; }
  Json operator()(const Acknowledge& a) const { return {{"do", "acknowledge"}, {"run", a.run}}; }
  Json operator()(const Note& n) const {
    require(!n.text.empty() && n.text.size() <= kLongestNote, "a note too long");
    require(n.text.find('\n') == std::string::npos, "a note of several lines");
    return {{"do", "note"}, {"text", n.text}};
  }
  Json operator()(const Level&) const { return {{"do", "level"}, {"confirmed", true}}; }
  Json operator()(const Probe&) const { return {{"do", "probe"}}; }
  Json operator()(const QueueAdd& q) const {
    require(q.choice.item.has_value(), "an entry of the queue without an item");
    Json json = with_choice("queue_add", q.choice);
    json["runs"] = q.runs;
    return json;
  }
  Json operator()(const QueueMove& q) const {
    return {{"do", "queue_move"}, {"entry", q.entry}, {"by", q.by}};
  }
  Json operator()(const QueueRemove& q) const { return {{"do", "queue_remove"}, {"entry", q.entry}}; }
  Json operator()(const QueueRepeat& q) const { return {{"do", "queue_repeat"}, {"entry", q.entry}}; }
  Json operator()(const QueuePause& q) const { return {{"do", "queue_pause"}, {"go_on", !q.paused}}; }
  Json operator()(const QueueMounted& q) const { return {{"do", "queue_mounted"}, {"entry", q.entry}}; }
  Json operator()(const QueueStart& q) const {
    return {{"do", "queue_start"}, {"entry", q.entry}, {"confirmed", true}};
  }
  Json operator()(const QueueCommand& command) const { return std::visit(*this, command); }

 private:
  static Json with_choice(const char* what, const RunChoice& choice) {
    if (choice.item) {
      require(!choice.item->serial_number.empty(), "an item without a serial number");
      require(choice.item->serial_number.size() <= kLongestItemText, "a serial number too long");
    }
    Json json = to_json(choice);
    json["do"] = what;
    return json;
  }
};

bool moves(const Command& command) {
  if (const auto* check = std::get_if<CheckBench>(&command)) return check->with_motion;
  if (const auto* queue = std::get_if<QueueCommand>(&command))
    return std::holds_alternative<QueueStart>(*queue);
  return std::holds_alternative<StartRun>(command) || std::holds_alternative<ContinueRun>(command) ||
         std::holds_alternative<ResumeRun>(command) || std::holds_alternative<Jog>(command) ||
         std::holds_alternative<Level>(command);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  Request request;
  try {
    request = parse_request(text);
  } catch (const RequestError& error) {
    require(*error.what() != '\0', "refused without a reason");
    return 0;
  }
  require(size <= kLongestRequest, "longer than allowed");
  // Escapes may hide the letters of a key, but then there is a backslash.
  require(!moves(request.command) || text.find("confirmed") != text.npos || text.find('\\') != text.npos,
          "moves without a yes");
  Json again = std::visit(Write{}, request.command);
  again["id"] = request.id;
  if (again.dump().size() > kLongestRequest) return 0;  // Escapes made it longer.
  const Request same = parse_request(again.dump());
  Json once_more = std::visit(Write{}, same.command);
  once_more["id"] = same.id;
  require(once_more == again, "read otherwise the second time");
  return 0;
}
