#include "app/console/session.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "app/bench/bench_records.h"
#include "app/bench/guarded_stage.h"
#include "app/bench/real_clock.h"
#include "app/console/jog.h"
#include "app/console/paced_clock.h"
#include "app/session/register_records.h"
#include "app/session/run_bench.h"
#include "drivers/instrument/instrument_error.h"

namespace abcal::console {
namespace {

/// After this time without a jog the ports are released for other programs.
constexpr std::chrono::seconds kKeepAfterJog{60};

constexpr const char* kBusy =
    "another activity is in progress at the bench; stop it first, or wait for its end";

std::string in_words(const InstrumentSummary& instrument) {
  return fmt::format("{} {}, serial number {}", instrument.maker, instrument.model,
                     instrument.serial_number.empty() ? "not reported" : instrument.serial_number);
}

std::string file_name(const std::string& path) {
  return std::filesystem::path(path).filename().string();
}

}  // namespace

Session::Session(Options options, std::function<void(Event)> tell)
    : options_(std::move(options)), tell_(std::move(tell)) {
  worker_ = std::jthread([this](const std::stop_token& end) { work(end); });
}

void Session::close() {
  {
    const std::lock_guard lock(mutex_);
    if (std::exchange(closing_, true)) return;
  }
  stop({"the end of the program", {}, {}});
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
      // An activity that was begun is ended in order: its stop is requested already.
      if (!job_) return;
      job = std::exchange(job_, nullptr);
    }
    carry_out(job);
  }
}

void Session::log(std::string text) {
  tell_(LogLine{LogLine::Grade::kInfo, std::move(text)});
}

void Session::carry_out(const std::function<void()>& job) {
  const auto problem = [this](const char* text) { tell_(LogLine{LogLine::Grade::kProblem, text}); };
  try {
    if (stop_.stop_requested()) throw RunInterrupted("stopped before it began");
    job();
  } catch (const RunInterrupted& error) {
    tell_(LogLine{LogLine::Grade::kWarning, error.what()});
  } catch (const InstrumentError& error) {
    problem(error.what());
    tell_(FaultSeen{error.instrument(), std::string(to_string(error.fault())), error.what()});
    jog_bench_.reset();  // After a fault the instruments are opened and asked again.
  } catch (const std::exception& error) {
    problem(error.what());
    jog_bench_.reset();
  }
  std::shared_ptr<RunSession> ended;
  {
    const std::lock_guard lock(mutex_);
    ended = std::move(run_);
  }
  ended.reset();  // Its ports are closed before the bench is reported as free.
  {
    const std::lock_guard lock(mutex_);
    activity_ = Activity::kIdle;
  }
  tell_activity();
}

void Session::tell_activity() {
  ActivitySeen seen;
  {
    const std::lock_guard lock(mutex_);
    seen = {activity_, activity_ == Activity::kRunning && run_ && run_->is_hold_wanted(),
            activity_ != Activity::kIdle && stop_.stop_requested()};
  }
  tell_(seen);
}

Session::Refusal Session::begin(Activity activity, std::function<void()> job, const Asker& by) {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ != Activity::kIdle) return kBusy;
    if (closing_) return "the console is being closed";
    activity_ = activity;
    stop_ = std::stop_source();
    if (activity == Activity::kRunning) {
      RunSession::Options options;
      options.open_bench = [this](const BenchConfig& config, BenchStreams) { return open(config); };
      options.listener = [this](const SessionEvent& event) { show(event); };
      options.stop = stop_.get_token();
      options.login = by.login;
      operator_ = by;
      run_ = std::make_shared<RunSession>(std::move(options));
    }
    job_ = std::move(job);
  }
  tell_activity();
  wake_.notify_all();
  return std::nullopt;
}

Session::Refusal Session::check(bool with_motion) {
  return begin(Activity::kChecking, [this, with_motion] { do_check(with_motion); });
}

Session::Refusal Session::start(const Asker& by) {
  const std::string name =
      output_path("", options_.bench_file.filename().string(), ".run").filename().string();
  return begin(
      Activity::kRunning, [this, name] { do_start(name); }, by);
}

Session::Refusal Session::resume(const std::filesystem::path& run, const Asker& by) {
  return begin(
      Activity::kRunning, [this, run] { do_resume(run); }, by);
}

Session::Refusal Session::jog(const Jog& jog) {
  return begin(Activity::kJogging, [this, jog] { do_jog(jog); });
}

void Session::record(const char* kind, const Asker& by, RunOperator operates) {
  if (run_) (void)run_->add_person_event({kind, by.for_record(), std::move(operates)});
}

Session::Refusal Session::hold(const Asker& by) {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ != Activity::kRunning || !run_) return "no run is in progress";
    run_->hold();
    record("hold asked for", by);
  }
  log("Hold: the stage will stand still after this angle.");
  tell_activity();
  return std::nullopt;
}

Session::Refusal Session::continue_run(const Asker& by) {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ != Activity::kRunning || !run_ || !run_->is_hold_wanted()) return "no run is held";
    run_->continue_run();
    record("continue asked for", by);
  }
  log("Continue: the stage moves on.");
  tell_activity();
  return std::nullopt;
}

void Session::control_taken(const Asker& by) {
  const std::lock_guard lock(mutex_);
  if (activity_ == Activity::kRunning) record("control taken", by, by.who);
}

Session::Refusal Session::stop(const Asker& by) {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ == Activity::kIdle) return "nothing is in progress that could be stopped";
    if (activity_ == Activity::kAnalysing) return "the stage is at rest; the run is being analysed";
    if (stop_.stop_requested()) return std::nullopt;
    record("stop asked for", by);
    // Requesting the stop sends the halt to the stage and waits for its answer: not in the caller's thread.
    stopper_ = std::jthread([source = stop_]() mutable { source.request_stop(); });
  }
  tell_(LogLine{LogLine::Grade::kWarning,
                fmt::format("Stop, asked for by {}: the halt is sent to the stage.", by.for_people())});
  return std::nullopt;
}

Session::Refusal Session::note(std::string text, const Asker& by) {
  const std::lock_guard lock(mutex_);
  if (activity_ != Activity::kRunning || !run_)
    return "no run is in progress: a note goes into the event log of a run";
  if (!run_->add_note({std::move(text), by.for_record()})) return "many notes wait to be stored already";
  return std::nullopt;
}

Bench Session::open(const BenchConfig& config) {
  jog_bench_.reset();  // Or its ports would be in the way.
  const Clock::UtcTime utc = RealClock().utc_now();
  Bench bench = make_bench(config, {}, std::make_unique<PacedClock>(options_.pace, utc));
  protocol_ = config.protocol;
  simulated_ = fmt::format("{}", fmt::join(simulated_instruments(config), ", "));
  hurry_ = bench.simulated_time ? options_.pace : 1.0;
  const auto see = [this](const auto& seen) { tell_(seen); };
  bench.stage = std::make_unique<WatchedStage>(std::move(bench.stage), see, see);
  bench.accelerometer = std::make_unique<WatchedAccelerometer>(std::move(bench.accelerometer), see);
  return bench;
}

RunBegan Session::describe(const RunBeganEvent& event) const {
  RunBegan began;
  if (event.simulated_time) began.pace = options_.pace;
  began.file = file_name(event.file);
  began.bench = event.bench;
  began.item = event.item;
  began.operator_name = event.operator_name;
  if (operator_.login.empty() && !event.operator_name.empty())
    began.operator_name += fmt::format(" ({})", kNotVerified);
  began.unit = event.unit;
  began.simulated = simulated_;
  began.plan = event.plan;
  for (const DwellDoneEvent& each : event.measured) began.measured.emplace_back(each.position, each.dwell);
  began.estimated_s = event.estimated_s / began.pace.value_or(1.0);
  began.stage = in_words(event.stage);
  began.accelerometer =
      fmt::format("{}, {:g} readings/s in {}", in_words(event.accelerometer), event.rate_hz, event.unit);
  return began;
}

std::optional<TimeLimit> Session::limit_of(RunPhase phase) const {
  const auto limit = [this](double seconds, const char* words) { return TimeLimit{seconds / hurry_, words}; };
  switch (phase) {
    case RunPhase::kHoming:
      return limit(protocol_.homing_timeout_s, "for each axis");
    case RunPhase::kMoving:
    case RunPhase::kParking:
      return limit(protocol_.motion_timeout_s, "beyond the time that the speed of the stage needs");
    case RunPhase::kSettling:
      return limit((protocol_.settle_auto ? 0.0 : protocol_.settle_s) + protocol_.quiet_timeout_s,
                   "then the angle is flagged");
    case RunPhase::kDwelling:
      return limit(protocol_.reading_timeout_s, "without any reading");
    case RunPhase::kReconnecting:
      return limit(protocol_.replug_timeout_s, "then the run ends and can be resumed");
    case RunPhase::kWarmingUp:
      return limit(protocol_.warm_up_s, "of warming up");
    case RunPhase::kTemperature:
      return limit(protocol_.stability_timeout_s, "for outputs and temperature to be stable");
    case RunPhase::kHolding:
      return std::nullopt;
  }
  return std::nullopt;
}

void Session::show(const SessionEvent& event) {
  struct Show {
    Session& session;
    void operator()(const RunBeganEvent& began) const {
      if (began.file.empty()) return;  // The small turn of a check.
      session.tell_(session.describe(began));
      session.log(began.resumed
                      ? fmt::format("Run {} continues: {} of {} angles are measured.", file_name(began.file),
                                    began.measured.size(), began.plan.size())
                      : fmt::format("Run {} begins: {} angles.", file_name(began.file), began.plan.size()));
    }
    void operator()(const PhaseEvent& phase) const {
      session.tell_(PhaseSeen{phase.position, phase.phase, session.limit_of(phase.phase)});
    }
    void operator()(const DwellDoneEvent& done) const {
      session.tell_(DwellSeen{done.position, done.dwell, RealClock().utc_now()});
    }
    void operator()(const FlagEvent& flag) const { warn(flag.text); }
    void operator()(const PortLostEvent& lost) const { warn(lost.text); }
    void operator()(const PortBackEvent& back) const { warn(back.text); }
    void operator()(const NoticeEvent& notice) const {
      if (notice.kind != kGuardEvent) return warn(notice.text);
      session.tell_(GuardSeen{notice.text});
      session.log(notice.text);
    }
    void operator()(const NoteStoredEvent& note) const {
      session.log(fmt::format("Note, stored in the event log: {}", note.text));
    }
    void operator()(const AllMeasuredEvent&) const {
      {
        const std::lock_guard lock(session.mutex_);
        session.activity_ = Activity::kAnalysing;
      }
      session.tell_activity();
    }
    void operator()(const FinishedEvent& end) const {
      const std::string name = file_name(end.file);
      if (end.measured_before) {
        session.log(
            fmt::format("All angles of run {} were measured already; it is closed and analysed now: {}.",
                        name, end.verdict));
      } else if (end.complete) {
        session.log(fmt::format("Run {} is complete: {}.", name, end.verdict));
      }
      session.tell_(RunEnded{name, end.complete,
                             end.complete ? fmt::format("{}: {}", end.verdict, end.reason) : end.reason});
    }
    void operator()(const AngleBegunEvent&) const {}
    void operator()(const HeldEvent&) const {}
    void operator()(const ContinuedEvent&) const {}
    void operator()(const ReplayComparedEvent&) const {}
    void warn(const std::string& text) const { session.tell_(LogLine{LogLine::Grade::kWarning, text}); }
  };
  std::visit(Show{*this}, event);
}

void Session::do_check(bool with_motion) {
  const BenchConfig config = read_bench(options_.bench_file, register_records());
  Bench bench = open(config);
  std::vector<Finding> findings = check_bench(
      bench, config, {!with_motion, [this](const SessionEvent& event) { show(event); }, stop_.get_token()});
  const auto of = [&](Finding::Grade grade) {
    return std::count_if(findings.begin(), findings.end(),
                         [&](const Finding& f) { return f.grade == grade; });
  };
  log(fmt::format("The bench is checked: {} good, {} warnings, {} problems.", of(Finding::Grade::kGood),
                  of(Finding::Grade::kWarning), of(Finding::Grade::kProblem)));
  tell_(ChecksSeen{std::move(findings)});
}

void Session::do_start(const std::string& name) {
  const BenchConfig config = read_bench(options_.bench_file, register_records());
  for (const std::string& warning : config.warnings) tell_(LogLine{LogLine::Grade::kWarning, warning});
  run_->start({write_bench(config), options_.bench_file.string(), (options_.runs / name).string(), false});
}

void Session::do_resume(const std::filesystem::path& path) {
  run_->resume({path.string()});
}

void Session::do_jog(const Jog& jog) {
  if (!jog_bench_) {
    BenchConfig config = read_bench(options_.bench_file, register_records());
    Bench bench = open(config);
    jog_bench_.emplace(JogBench{std::move(config), std::move(bench)});
  }
  Bench& bench = jog_bench_->bench;
  std::optional<std::stop_callback<std::function<void()>>> halt_at_once;
  if (!bench.simulated_time) halt_at_once.emplace(stop_.get_token(), [&] { bench.stage->halt(); });
  const Angle angle =
      turn_axis(jog, *bench.stage, *bench.clock, jog_bench_->config.protocol, stop_.get_token());
  log(fmt::format("Axis {} is at {:.4f} degrees (encoder).", to_string(jog.axis), angle.deg()));
}

}  // namespace abcal::console
