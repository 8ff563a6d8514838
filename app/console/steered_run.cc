#include "app/console/steered_run.h"

#include <boost/asio/io_context.hpp>
#include <boost/asio/post.hpp>
#include <condition_variable>
#include <mutex>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string_view>
#include <thread>
#include <utility>

#include "app/console/bench_link.h"
#include "app/console/bench_service.h"
#include "app/console/request.h"
#include "app/system/output.h"
#include "protocol/record/run_interrupted.h"

namespace abcal::console {
namespace {

/// Twice the longest halt that a driver waits for, as a console waits.
constexpr std::chrono::seconds kLongestClose{60};

}  // namespace

struct SteeredRun::Impl {
  Impl(const Session::Options& bench, Listener the_listener)
      : listener(std::move(the_listener)), link(io, {bench, default_bench_socket(bench), true}, callbacks()) {
    link.begin();
    thread = std::jthread([this] { io.run(); });
  }

  BenchLink::Listener callbacks() {
    return {[this](std::string_view json) { see(nlohmann::json::parse(json)); },
            [this](std::string_view json) { see(nlohmann::json::parse(json)); },
            [this](const nlohmann::json& reply) { see_reply(reply); },
            [this](BenchState now, const Message& words) { see_state(now, words); },
            [this](bool) { change([this] { ended = true; }); }};
  }

  /// In the thread of the link: changes what the caller waits for.
  template <class Change>
  void change(const Change& make) {
    {
      const std::lock_guard lock(mutex);
      make();
    }
    changed.notify_all();
  }

  void see(const nlohmann::json& message) {
    if (listener) listener(message);
    const std::string type = message.value("type", "");
    const std::string event = message.value("event", "");
    change([&] {
      if (type == "activity") {
        const bool idle = message.value("activity", "") == "idle";
        if (!idle) begun = true;
        if (idle && begun) over = true;
      } else if (type == "fault") {
        run.instrument_failed = true;
        run.why = message.value("words", "");
      } else if (type == "log" && message["line"].value("grade", "") != "info") {
        problem = message["line"].value("text", "");
      } else if (event == "finished") {
        run.file = message.value("file", "");
        run.complete = message.value("complete", false);
        if (!run.complete) run.why = message.value("reason", "");
      }
    });
  }

  void see_reply(const nlohmann::json& reply) {
    change([&] {
      if (!reply.value("ok", false)) refusal = reply.value("why", "it was refused without a reason");
    });
  }

  void see_state(BenchState now, const Message& words) {
    change([&] {
      on = now == BenchState::kOn;
      if (now == BenchState::kGone) gone = words;
    });
  }

  /// Waits until `have` holds, or the process is gone. @throws RunInterrupted, std::runtime_error
  template <class Have>
  void wait(const Have& have, const std::stop_token& stop) {
    std::unique_lock lock(mutex);
    const auto done = [&] { return have() || !gone.empty(); };
    if (!changed.wait(lock, stop, done)) throw RunInterrupted(Message("interrupted"));
    if (!have()) throw std::runtime_error(gone);
  }

  Listener listener;
  boost::asio::io_context io;
  BenchLink link;
  std::mutex mutex;
  std::condition_variable_any changed;
  bool on = false;  ///< The process answers.
  bool begun = false, over = false, ended = false;
  std::string gone, refusal, problem;
  RunEnd run;
  std::jthread thread;
};

SteeredRun::SteeredRun(const Session::Options& bench, Listener listener, const std::stop_token& stop)
    : impl_(std::make_unique<Impl>(bench, std::move(listener))) {
  try {
    impl_->wait([this] { return impl_->on; }, stop);
  } catch (...) {
    close();
    throw;
  }
}

SteeredRun::~SteeredRun() {
  close();
}

RunEnd SteeredRun::measure(const std::string& who, const std::stop_token& stop) {
  const Request start = read_request({{"id", 1U}, {"do", "start"}, {"confirmed", true}});
  boost::asio::post(impl_->io, [this, who, start] {
    if (impl_->link.is_on()) impl_->link.request(1, {who, {}, {}}, start);
  });
  impl_->wait([this] { return impl_->over || !impl_->refusal.empty(); }, stop);
  const std::lock_guard lock(impl_->mutex);
  if (!impl_->refusal.empty()) throw std::runtime_error("the bench refuses the run: " + impl_->refusal);
  RunEnd end = impl_->run;
  if (!end.complete && end.why.empty()) end.why = impl_->problem;
  return end;
}

void SteeredRun::close() noexcept {
  if (!impl_->thread.joinable()) return;
  boost::asio::post(impl_->io, [impl = impl_.get()] {
    if (!impl->link.close_bench()) impl->change([impl] { impl->ended = true; });
  });
  {
    std::unique_lock lock(impl_->mutex);
    if (!impl_->changed.wait_for(lock, kLongestClose, [this] { return impl_->ended; }))
      print_error("the process that holds the bench does not answer: its stage may be moving");
  }
  impl_->io.stop();
  impl_->thread.join();
  if (!impl_->link.wait_for_process(kLongestClose))
    print_error("the process that holds the bench does not end");
}

}  // namespace abcal::console
