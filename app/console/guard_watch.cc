#include "app/console/guard_watch.h"

#include <algorithm>
#include <chrono>
#include <fstream>
#include <utility>
#include <vector>

#include "app/measure/guard/guard_log.h"
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
  if (state == axis_state::kUnknown) return 4;
  if (state == axis_state::kUnreachable) return 3;
  if (state == axis_state::kMayMove) return 2;
  return state == axis_state::kAtRest ? 1 : 0;
}

}  // namespace

GuardWatch::GuardWatch(std::filesystem::path lock_file, std::function<std::string()> bench,
                       std::function<void(const Known&)> notify)
    : lock_file_(std::move(lock_file)), bench_(std::move(bench)), notify_(std::move(notify)) {
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
  auto next = std::chrono::steady_clock::now();
  bool is_halting = false;  // A halt that a person asked for is not confirmed yet.
  while (!end.stop_requested()) {
    std::optional<StopOrder> due;
    {
      std::unique_lock lock(mutex_);
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
    next = std::chrono::steady_clock::now() + (is_halting ? kIntervalAfterStop : kInterval);
    if (std::string text = known.message.dump(); text != last) {
      last = std::move(text);
      notify_(known);
    }
  }
}

GuardWatch::Known GuardWatch::ask(const Json& question) {
  pid_t holder = 0;
  if (std::ifstream(lock_file_) >> holder && holder > 0) owners_.insert(holder);
  Known known;
  known.message = {{"type", "guard"}};
  AxesReport axes;
  for (auto owner = owners_.begin(); owner != owners_.end();) {
    const std::vector<Json> answers = ask_guards(*owner, question, kAnswerTime);
    for (const Json& answer : answers) {
      if (!answer.contains("axes")) continue;
      known.has_guard = true;
      const AxesReport told = axes_report_from(answer["axes"]);
      for (std::size_t k = 0; k < 2; ++k)
        if (rank(told[k].state) > rank(axes[k].state)) axes[k] = told[k];
      if (const std::string why = answer.value("halted", ""); !why.empty()) known.message["halted"] = why;
    }
    // A process is forgotten once it and its guards have ended.
    if (answers.empty() && *owner != holder)
      owner = owners_.erase(owner);
    else
      ++owner;
  }
  if (!known.has_guard) axes = logged();
  known.is_at_rest = axes[0].is_at_rest() && axes[1].is_at_rest();
  known.message["axes"] = to_json(axes);
  known.message["has_guard"] = known.has_guard;
  return known;
}

/// The log is read when it has changed, and while an axis may be moving, whose guard may have died since.
const AxesReport& GuardWatch::logged() {
  std::error_code absent;
  const auto written = std::filesystem::last_write_time(motion_log(), absent);
  if (absent) {
    logged_ = {};
    logged_at_.reset();
    return logged_;
  }
  const bool is_watched = std::ranges::any_of(logged_, [](const AxisReport& axis) {
    return !axis.is_at_rest() && axis.state != axis_state::kUnknown;
  });
  if (logged_at_ == written && !is_watched) return logged_;
  const std::string bench = bench_();
  if (bench.empty()) return logged_;
  logged_at_ = written;
  logged_ = read_motion(motion_log(), bench).axes;
  return logged_;
}

}  // namespace abcal::console
