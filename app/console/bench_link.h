#pragma once

#include <sys/types.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

#include "app/console/bench_channel.h"
#include "app/console/console_session.h"
#include "app/console/request.h"
#include "app/system/real_clock.h"

namespace abcal::console {

/// The state of the process that holds the bench, as known to the console.
enum class BenchState {
  kStarting,  ///< Not found yet; it is being started.
  kOn,
  kSilent,  ///< Connected, but nothing was received for 3 s.
  kGone,    ///< It has died, or cannot be started.
};
std::string_view to_string(BenchState state);

/// A console's connection to the process that holds the bench (BenchService). Finds or starts the process,
/// and again after it has died. For the thread of `io`.
class BenchLink {
 public:
  struct Listener {
    std::function<void(std::string_view json)> message;   ///< For every page.
    std::function<void(std::string_view json)> snapshot;  ///< A requested snapshot.
    std::function<void(const nlohmann::json& reply)> reply;
    std::function<void(BenchState state, const Message& words)> state;
    std::function<void(bool was_on)> end;  ///< The bench was closed.
  };
  struct Options {
    Session::Options bench;
    std::filesystem::path socket;
    bool start = true;  ///< False: another program starts it (a service of its own).
  };

  BenchLink(boost::asio::io_context& io, Options options, Listener listener);

  void begin();
  bool is_on() const { return channel_ != nullptr; }
  void ask_snapshot();
  void request(std::uint64_t id, const Asker& by, const Request& request);
  /// Reports to the process who steers from now on.
  void control_taken(const Asker& by);
  /// Stops the current activity, halts the stage and ends the process. @return false if there is no process
  bool close_bench();
  /// Waits for the end of the process that was started here, once nothing runs in the thread of `io` any
  /// more.
  /// @return false: it has not ended after `longest`
  bool wait_for_process(std::chrono::milliseconds longest);
  /// Disconnects; the process continues alone.
  void leave();

 private:
  void connect();
  void connected(Descriptor socket);
  void received(std::string_view line);
  void lost();
  void watch();
  void try_again(std::chrono::milliseconds after);
  void start_process();
  void notify(BenchState state, const Message& words);

  boost::asio::io_context& io_;
  Options options_;
  Listener listener_;
  RealClock clock_;
  boost::asio::steady_timer again_;
  boost::asio::steady_timer next_watch_;
  std::shared_ptr<BenchChannel> channel_;
  Clock::Instant heard_{}, begun_{};
  BenchState state_ = BenchState::kStarting;
  bool started_ = false;  ///< A process was started and has not been reached yet.
  bool leaving_ = false;
  pid_t process_ = -1;  ///< Process that was started here; -1: none.
};

}  // namespace abcal::console
