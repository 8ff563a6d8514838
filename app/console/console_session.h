#pragma once

#include <condition_variable>
#include <deque>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "app/analysed_run/run_session.h"
#include "app/console/asker.h"
#include "app/console/event.h"
#include "app/console/jog.h"
#include "app/console/request.h"
#include "app/console/run_choice.h"
#include "app/measure/bench/make_bench.h"

namespace abcal::console {

/// The bench that a console steers. One thread of its own does all that touches the instruments. The
/// functions here only pass requests to it, and return at once: the reason of a refusal, or nothing. Events
/// report the results.
class Session {
 public:
  struct Options {
    std::filesystem::path bench_file;  ///< Read again for each check, run and jog.
    std::filesystem::path runs;        ///< Folder of the run files.
    double pace = 1.0;                 ///< If everything is simulated: simulated time over real time.
  };
  using Refusal = std::optional<Message>;

  /// `notify` is called from the measuring thread and must return at once.
  Session(Options options, std::function<void(Event)> notify);
  ~Session() { close(); }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  /// Stops the current activity, halts the stage, and waits for the end. Nothing can be begun afterwards.
  void close();

  Refusal check(bool with_motion, const Asker& by);
  /// Starts a run of this person: with a register the one logged in, else as the bench file states. Refused
  /// if the form was used already, or the bench file has changed since the person saw it.
  Refusal start(const RunChoice& choice, const Asker& by);
  /// Checks the item of an entry of the queue, which a person has mounted; nothing moves.
  Refusal check_item(std::int64_t entry, const RunChoice& choice, const ItemBefore& before);
  Refusal resume(const ResumeRequest& request, const Asker& by);
  /// Levels as `abcal level` does; the files go into the run folder.
  Refusal level(const Asker& by);
  /// Probes ports as `abcal instruments --probe` does.
  Refusal probe();
  Refusal hold(const Asker& by);
  Refusal continue_run(const Asker& by);
  Refusal jog(const Jog& jog, const Asker& by);
  /// A sign of life of the button that is held for a jog.
  Refusal keep_turning(const KeepTurning& sign);
  /// Adds a note to the event log of the current run.
  Refusal note(std::string text, const Asker& by);
  /// Stores who has taken note of the interruption of a run.
  Refusal acknowledge(const std::filesystem::path& run, const Asker& by);
  /// Halts the stage at once and ends the current activity.
  Refusal stop(const Asker& by);
  /// Whether nothing is in progress now; an older event that contradicts this may still arrive.
  bool is_idle() const;
  /// Another page steers from now on; this is recorded in the event log of the current run.
  void control_taken(const Asker& by);

 private:
  Refusal begin(Activity activity, std::function<void()> job, const Asker& by = {});
  /// Records a person's action in the event log of the current run; the caller holds the mutex.
  void record(const char* kind, const Asker& by, RunOperator operates = {});
  void work(const std::stop_token& end);
  void carry_out(const std::function<void()>& job);
  void notify_activity();
  void log(Message text);  ///< For the pages.
  /// Passes an event of a run session on to the pages.
  void show(SessionEvent event);

  Bench open(const BenchConfig& config, const std::string& owner);
  void do_check(bool with_motion, const Asker& by);
  void do_check_item(std::int64_t entry, const RunChoice& choice, const ItemBefore& before);
  void do_start(const std::string& name, const RunChoice& choice);
  Refusal stale(const RunChoice& choice) const;
  void do_level(const std::filesystem::path& run);
  void do_probe();
  void do_jog(const Jog& jog, const Asker& by, HeldButton* button);

  Options options_;
  std::function<void(Event)> notify_;

  mutable std::mutex mutex_;
  std::condition_variable_any wake_;
  std::function<void()> job_;  ///< Next job of the worker.
  Activity activity_ = Activity::kIdle;
  bool closing_ = false;
  std::stop_source stop_;            ///< Stops the current activity.
  std::shared_ptr<RunSession> run_;  ///< Null: no run is in progress.
  Asker operator_;                   ///< The person who began the run.
  std::deque<std::string> forms_;    ///< The latest forms that have started a run.

  /// The bench, kept open between jogs; used in the measuring thread only.
  struct JogBench {
    BenchConfig config;
    Bench bench;
    std::string by;  ///< Who turned it.
  };
  std::optional<JogBench> jog_bench_;
  std::shared_ptr<HeldButton> button_;  ///< The one that a person holds for the jog in progress; null: none.

  std::jthread stopper_;  ///< Sends the halt, so that no other thread waits for it.
  std::jthread worker_;
};

}  // namespace abcal::console
