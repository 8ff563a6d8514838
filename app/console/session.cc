#include "app/console/session.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "app/console/jog.h"
#include "app/console/paced_clock.h"
#include "app/results/result_text.h"
#include "app/session/run_bench.h"
#include "drivers/instrument/instrument_error.h"

namespace abcal::console {
namespace {

/// So long after a jog the ports are free again for other programs.
constexpr std::chrono::seconds kKeepAfterJog{60};

constexpr const char* kBusy = "something else is going on at the bench; stop it first, or wait for its end";

std::string in_words(const StageInfo& info) {
  return fmt::format("{} {}, serial number {}", info.maker, info.model,
                     info.serial_number.empty() ? "not told" : info.serial_number);
}

std::string in_words(const AccelerometerInfo& info) {
  return fmt::format("{} {}, serial number {}, {:g} readings/s in {}", info.maker, info.model,
                     info.serial_number.empty() ? "not told" : info.serial_number, info.rate_hz,
                     info.output_unit);
}

/// Of the default estimator.
std::string verdict_of(const FinishedRun& run) {
  return verdict_words(run.results.front().verdict);
}

RunBegan describe(const BenchConfig& config, const Identities& who, const std::vector<PlannedAngle>& plan,
                  std::optional<double> pace) {
  RunBegan began;
  began.pace = pace;
  began.bench = config.name;
  began.item =
      config.item.serial_number.empty() ? who.accelerometer.serial_number : config.item.serial_number;
  began.operator_name = config.operator_name;
  began.unit = who.accelerometer.output_unit;
  began.plan = plan;
  began.estimated_s =
      estimate_duration(plan, config.protocol,
                        {who.stage.axes[0].speed_deg_per_s, who.stage.axes[1].speed_deg_per_s},
                        who.accelerometer.rate_hz)
          .total_s() /
      pace.value_or(1.0);
  began.stage = in_words(who.stage);
  began.accelerometer = in_words(who.accelerometer);
  return began;
}

}  // namespace

/// Passes on what a run does; the operator's notes and the wish to hold come in the other way.
class Session::Observer final : public RunObserver {
 public:
  Observer(Session& session, RunFile* file, const Clock& clock)
      : session_(session), file_(file), clock_(clock) {}

  void phase(std::size_t position, RunPhase phase) override {
    session_.tell_(PhaseSeen{position, phase});
    store_notes();
  }
  void dwell(std::size_t position, const DwellRecord& dwell) override {
    session_.tell_(DwellSeen{position, dwell, RealClock().utc_now()});
    store_notes();
  }
  void notice(std::string_view, std::string_view text) override {
    session_.tell_(LogLine{LogLine::Grade::kWarning, std::string(text)});
  }
  bool hold_wanted() override {
    store_notes();
    return session_.hold_;
  }

 private:
  // Here, in the thread that writes the run file: one row, where there is a note at all.
  void store_notes() {
    if (file_ != nullptr) session_.store_notes(*file_, clock_);
  }

  Session& session_;
  RunFile* file_;
  const Clock& clock_;
};

Session::Session(Options options, std::function<void(Event)> tell)
    : options_(std::move(options)), tell_(std::move(tell)) {
  worker_ = std::jthread([this](const std::stop_token& end) { work(end); });
}

void Session::close() {
  {
    const std::lock_guard lock(mutex_);
    if (std::exchange(closing_, true)) return;
  }
  stop();
  worker_.request_stop();
  worker_.join();
}

void Session::work(const std::stop_token& end) {
  while (true) {
    std::function<void()> job;
    {
      std::unique_lock lock(mutex_);
      const auto have_job = [this] { return static_cast<bool>(job_); };
      if (!jog_bench_) {
        wake_.wait(lock, end, have_job);
      } else if (!wake_.wait_for(lock, end, kKeepAfterJog, have_job) && !end.stop_requested()) {
        lock.unlock();
        jog_bench_.reset();
        continue;
      }
      // What was begun before the end is ended in order: its stop is requested already.
      if (!job_) return;
      job = std::exchange(job_, nullptr);
    }
    carry_out(job);
  }
}

void Session::say(std::string text) {
  tell_(LogLine{LogLine::Grade::kInfo, std::move(text)});
}

void Session::carry_out(const std::function<void()>& job) {
  const auto problem = [this](const char* text) { tell_(LogLine{LogLine::Grade::kProblem, text}); };
  try {
    if (stop_.stop_requested()) throw RunInterrupted("stopped before it began");
    job();
  } catch (const RunInterrupted& error) {
    tell_(LogLine{LogLine::Grade::kWarning, error.what()});
  } catch (const std::exception& error) {
    problem(error.what());
    jog_bench_.reset();  // After a fault the instruments are opened and asked anew.
  }
  {
    const std::lock_guard lock(mutex_);
    activity_ = Activity::kIdle;
    notes_.clear();
    hold_ = false;
  }
  tell_activity();
}

void Session::tell_activity() {
  ActivitySeen seen;
  {
    const std::lock_guard lock(mutex_);
    seen = {activity_, hold_, activity_ != Activity::kIdle && stop_.stop_requested()};
  }
  tell_(seen);
}

Session::Refusal Session::begin(Activity activity, std::function<void()> job) {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ != Activity::kIdle) return kBusy;
    if (closing_) return "the console is being closed";
    activity_ = activity;
    stop_ = std::stop_source();
    hold_ = false;
    job_ = std::move(job);
  }
  tell_activity();
  wake_.notify_all();
  return std::nullopt;
}

Session::Refusal Session::check(bool with_motion) {
  return begin(Activity::kChecking, [this, with_motion] { do_check(with_motion); });
}

Session::Refusal Session::start() {
  const std::string name =
      output_path("", options_.bench_file.filename().string(), ".run").filename().string();
  return begin(Activity::kRunning, [this, name] { do_start(name); });
}

Session::Refusal Session::resume(const std::filesystem::path& run) {
  return begin(Activity::kRunning, [this, run] { do_resume(run); });
}

Session::Refusal Session::jog(StageAxis axis, Angle by) {
  return begin(Activity::kJogging, [this, axis, by] { do_jog(axis, by); });
}

Session::Refusal Session::hold() {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ != Activity::kRunning) return "no run is on";
    hold_ = true;
  }
  say("Hold: the stage will stand still after this angle.");
  tell_activity();
  return std::nullopt;
}

Session::Refusal Session::go_on() {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ != Activity::kRunning || !hold_) return "no run is held";
    hold_ = false;
  }
  say("Continue: the stage goes on.");
  tell_activity();
  return std::nullopt;
}

Session::Refusal Session::stop() {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ == Activity::kIdle) return "nothing goes on that could be stopped";
    if (activity_ == Activity::kAnalysing) return "the stage stands still already; the run is analysed";
    if (stop_.stop_requested()) return std::nullopt;
    // Requesting the stop sends the halt to the stage and waits for its answer: not in the caller's thread.
    stopper_ = std::jthread([source = stop_]() mutable { source.request_stop(); });
  }
  tell_(LogLine{LogLine::Grade::kWarning, "Stop: the halt is sent to the stage."});
  return std::nullopt;
}

Session::Refusal Session::note(std::string text, std::string by) {
  constexpr std::size_t kMostPending = 20;
  const std::lock_guard lock(mutex_);
  if (activity_ != Activity::kRunning) return "no run is on: a note goes into the event log of a run";
  if (notes_.size() >= kMostPending) return "many notes wait to be stored already";
  notes_.push_back({std::move(text), std::move(by)});
  return std::nullopt;
}

std::vector<Session::PendingNote> Session::take_notes() {
  const std::lock_guard lock(mutex_);
  return std::exchange(notes_, {});
}

void Session::store_notes(RunFile& file, const Clock& clock) {
  for (const PendingNote& note : take_notes()) {
    file.append_event(format_utc(clock.utc_now()), "note", fmt::format("{} ({})", note.text, note.by));
    say(fmt::format("Note, stored in the event log: {}", note.text));
  }
}

Bench Session::open(const BenchConfig& config) {
  jog_bench_.reset();  // Or its ports would be in the way.
  const Clock::UtcTime utc = RealClock().utc_now();
  Bench bench = make_bench(config, {}, std::make_unique<PacedClock>(options_.pace, utc));
  const auto see = [this](const auto& seen) { tell_(seen); };
  bench.stage = std::make_unique<WatchedStage>(std::move(bench.stage), see);
  bench.accelerometer = std::make_unique<WatchedAccelerometer>(std::move(bench.accelerometer), see);
  return bench;
}

std::optional<double> Session::pace_of(const Bench& bench) const {
  return bench.simulated_time ? std::optional(options_.pace) : std::nullopt;
}

void Session::do_check(bool with_motion) {
  const BenchConfig config = read_bench(options_.bench_file);
  Bench bench = open(config);
  const auto turn = [this](Bench& the_bench, const BenchConfig& quick, RunFile& file,
                           const std::vector<PlannedAngle>& plan) {
    Observer observer(*this, nullptr, *the_bench.clock);
    measure(the_bench, quick, file, plan, {}, observer, stop_.get_token());
  };
  std::vector<Finding> findings = check_bench(bench, config, !with_motion, turn);
  const auto of = [&](Finding::Grade grade) {
    return std::count_if(findings.begin(), findings.end(),
                         [&](const Finding& f) { return f.grade == grade; });
  };
  say(fmt::format("The bench is checked: {} good, {} warnings, {} problems.", of(Finding::Grade::kGood),
                  of(Finding::Grade::kWarning), of(Finding::Grade::kProblem)));
  tell_(ChecksSeen{std::move(findings)});
}

void Session::do_start(const std::string& name) {
  const BenchConfig config = read_bench(options_.bench_file);
  for (const std::string& warning : config.warnings) tell_(LogLine{LogLine::Grade::kWarning, warning});
  Bench bench = open(config);
  const Identities who = identify(bench, config);
  const std::vector<PlannedAngle> plan = make_rotation_plan(config.protocol, who.travel());
  RunBegan began = describe(config, who, plan, pace_of(bench));
  began.file = name;
  RunFile file = begin_run(bench, config, who, plan, options_.runs / name, nullptr);
  tell_(began);
  say(fmt::format("Run {} begins: {} angles.", name, plan.size()));
  measure_and_finish(bench, config, std::move(file), plan, {});
}

void Session::do_resume(const std::filesystem::path& path) {
  if (const auto finished = finish_killed_run(path)) {
    say(fmt::format("All angles of run {} were measured already; it is closed and analysed now: {}.",
                    path.filename().string(), verdict_of(*finished)));
    return;
  }
  InterruptedRun run = open_interrupted_run(path);
  Bench bench = open(run.config);
  const std::vector<PlannedAngle>& plan = run.stored.header.plan;
  RunBegan began = describe(run.config, identify(bench, run.config), plan, pace_of(bench));
  began.file = path.filename().string();
  for (std::size_t i = 0; i < run.stored.measured.size(); ++i)
    began.measured.emplace_back(run.stored.measured[i], run.stored.record.dwells[i]);
  tell_(began);
  say(fmt::format("Run {} goes on: {} of {} angles are measured.", began.file, run.stored.measured.size(),
                  plan.size()));
  continue_run(run, bench);
  measure_and_finish(bench, run.config, std::move(run.file), plan, run.so_far);
}

void Session::measure_and_finish(Bench& bench, const BenchConfig& config, RunFile file,
                                 const std::vector<PlannedAngle>& plan, const RunProgress& so_far) {
  const std::string name = file.path().filename().string();
  try {
    RunTiming timing;
    {
      Observer observer(*this, &file, *bench.clock);
      timing = measure(bench, config, file, plan, so_far, observer, stop_.get_token());
    }
    store_notes(file, *bench.clock);
    {
      const std::lock_guard lock(mutex_);
      activity_ = Activity::kAnalysing;
      hold_ = false;
    }
    tell_activity();
    const FinishedRun run = finish_run(bench, config, std::move(file), timing);
    say(fmt::format("Run {} is complete: {}.", name, verdict_of(run)));
    tell_(RunEnded{name, true, fmt::format("{}: {}", verdict_of(run), run.results.front().why)});
  } catch (const std::exception& error) {
    tell_(RunEnded{name, false, error.what()});
    throw;
  }
}

void Session::do_jog(StageAxis axis, Angle by) {
  if (!jog_bench_) {
    BenchConfig config = read_bench(options_.bench_file);
    Bench bench = open(config);
    jog_bench_.emplace(JogBench{std::move(config), std::move(bench)});
  }
  Bench& bench = jog_bench_->bench;
  std::optional<std::stop_callback<std::function<void()>>> halt_at_once;
  if (!bench.simulated_time) halt_at_once.emplace(stop_.get_token(), [&] { bench.stage->halt(); });
  const Angle angle =
      console::jog(*bench.stage, *bench.clock, axis, by, jog_bench_->config.protocol, stop_.get_token());
  say(fmt::format("Axis {} stands at {:.4f} degrees (encoder).", to_string(axis), angle.deg()));
}

}  // namespace abcal::console
