#pragma once

#include <condition_variable>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "app/bench/make_bench.h"
#include "app/console/event.h"
#include "app/session/run_session.h"

namespace abcal::console {

/// The bench that a console steers. One thread of its own does all that touches the instruments; the
/// functions here only tell it, and return at once: they say why something cannot be begun, or nothing. What
/// comes of it is told by events.
class Session {
 public:
  struct Options {
    std::filesystem::path bench_file;  ///< Read again for each check, run and jog.
    std::filesystem::path runs;        ///< Folder of the run files.
    double pace = 1.0;                 ///< Where nothing real takes part: simulated over real time.
  };
  using Refusal = std::optional<std::string>;

  /// `tell` is called from the measuring thread and must return at once.
  Session(Options options, std::function<void(Event)> tell);
  ~Session() { close(); }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  /// Stops what goes on, the stage halted, and waits for it to end. Nothing can be begun any more.
  void close();

  Refusal check(bool with_motion);
  Refusal start();
  Refusal resume(const std::filesystem::path& run);
  Refusal hold();
  Refusal continue_run();
  Refusal jog(StageAxis axis, Angle by);
  /// Into the event log of the run that is on; `by` says who.
  Refusal note(std::string text, std::string by);
  /// Halts the stage at once and ends what goes on.
  Refusal stop();

 private:
  Refusal begin(Activity activity, std::function<void()> job);
  void work(const std::stop_token& end);
  void carry_out(const std::function<void()>& job);
  void tell_activity();
  void log(std::string text);  ///< For the pages.
  /// What a run session tells, for the pages.
  void show(const SessionEvent& event);
  RunBegan describe(const RunBeganEvent& event) const;

  Bench open(const BenchConfig& config);
  void do_check(bool with_motion);
  void do_start(const std::string& name);
  void do_resume(const std::filesystem::path& run);
  void do_jog(StageAxis axis, Angle by);

  Options options_;
  std::function<void(Event)> tell_;

  mutable std::mutex mutex_;
  std::condition_variable_any wake_;
  std::function<void()> job_;  ///< To be begun.
  Activity activity_ = Activity::kIdle;
  bool closing_ = false;
  std::stop_source stop_;            ///< Of what goes on.
  std::shared_ptr<RunSession> run_;  ///< Null: no run is on.

  /// Kept open between jogs; of the measuring thread alone.
  struct JogBench {
    BenchConfig config;
    Bench bench;
  };
  std::optional<JogBench> jog_bench_;

  std::jthread stopper_;  ///< Sends the halt, for which nobody else has to wait.
  std::jthread worker_;
};

}  // namespace abcal::console
