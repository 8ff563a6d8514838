#include "app/console/guard_watch.h"

#include <chrono>
#include <fstream>
#include <utility>
#include <vector>

#include "app/measure/guard/guard_packets.h"
#include "app/measure/guard/halt_guard.h"

namespace abcal::console {
namespace {

using Json = nlohmann::json;

constexpr std::chrono::milliseconds kInterval{500};
constexpr std::chrono::milliseconds kIntervalAfterStop{50};
constexpr std::chrono::milliseconds kAnswerTime{300};

/// How much a person must know of a state; of several guards the worst counts.
int rank(const std::string& state) {
  if (state == axis_state::kUnreachable) return 3;
  if (state == axis_state::kMayMove) return 2;
  return state == axis_state::kAtRest ? 1 : 0;
}

}  // namespace

GuardWatch::GuardWatch(std::filesystem::path lock_file, std::function<void(const Known&)> notify)
    : lock_file_(std::move(lock_file)), notify_(std::move(notify)) {
  thread_ = std::jthread([this](const std::stop_token& end) { watch(end); });
}

GuardWatch::~GuardWatch() = default;

void GuardWatch::stop(const std::string& by, std::chrono::milliseconds patience) {
  {
    const std::lock_guard lock(mutex_);
    order_ = {by, std::chrono::steady_clock::now() + patience};
  }
  changed_.notify_all();
}

void GuardWatch::watch(const std::stop_token& end) {
  std::string last;
  bool is_halting = false;  // A halt that a person asked for is not confirmed yet.
  while (!end.stop_requested()) {
    std::optional<StopOrder> due;
    {
      std::unique_lock lock(mutex_);
      const auto next = std::chrono::steady_clock::now() + (is_halting ? kIntervalAfterStop : kInterval);
      changed_.wait_until(lock, end, order_ ? std::min(next, order_->at) : next,
                          [this] { return order_ && order_->at <= std::chrono::steady_clock::now(); });
      if (end.stop_requested()) return;
      if (order_ && order_->at <= std::chrono::steady_clock::now()) due = std::exchange(order_, std::nullopt);
    }
    Known known = ask({{"kind", "status"}});
    if (due && !known.is_at_rest) {
      known = ask({{"kind", to_guard::kHalt}, {"by", due->by}});
      is_halting = true;
    }
    is_halting = is_halting && !known.is_at_rest;
    if (std::string text = known.message.dump(); text != last) {
      last = std::move(text);
      notify_(known);
    }
  }
}

GuardWatch::Known GuardWatch::ask(const Json& question) {
  pid_t holder = 0;
  if (std::ifstream(lock_file_) >> holder && holder > 0) owners_.insert(holder);
  Known known{
      {{"type", "guard"},
       {"axes", {{"x", {{"state", axis_state::kNotMoved}}}, {"z", {{"state", axis_state::kNotMoved}}}}}},
      true};
  for (auto owner = owners_.begin(); owner != owners_.end();) {
    const std::vector<Json> answers = ask_guards(*owner, question, kAnswerTime);
    for (const Json& answer : answers) {
      if (!answer.contains("axes")) continue;
      for (const char* axis : {"x", "z"}) {
        Json& kept = known.message["axes"][axis];
        const Json& told = answer["axes"][axis];
        if (rank(told.value("state", "")) > rank(kept.value("state", ""))) kept = told;
        known.is_at_rest = known.is_at_rest && rank(kept.value("state", "")) < 2;
      }
      if (const std::string why = answer.value("halted", ""); !why.empty()) known.message["halted"] = why;
    }
    // A process is forgotten once it and its guards have ended.
    if (answers.empty() && *owner != holder)
      owner = owners_.erase(owner);
    else
      ++owner;
  }
  return known;
}

}  // namespace abcal::console
