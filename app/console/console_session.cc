#include "app/console/console_session.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "app/bench_file/bench_records.h"
#include "app/bench_file/not_real.h"
#include "app/console/chosen_run.h"
#include "app/console/jog.h"
#include "app/console/last_check.h"
#include "app/console/paced_clock.h"
#include "app/laboratory/issuing/register_link.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/measure/bench/probe_ports.h"
#include "app/measure/guard/guarded_stage.h"
#include "app/measure/session/levelling.h"
#include "app/measure/session/run_bench.h"
#include "app/results/analysis/result_text.h"
#include "app/system/read_file.h"
#include "app/system/real_clock.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/record/message_json.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"

namespace abcal::console {
namespace {

/// After this time without a jog the ports are released for other programs.
constexpr std::chrono::seconds kKeepAfterJog{60};

constexpr Term kBusy = "another activity is in progress at the bench; stop it first, or wait for its end";

/// "BENCH-20260301T120000Z.run"; "BENCH-...Z-2.run" for a further run that begins within the same second.
std::string free_name(const Session::Options& options, const std::string& extension) {
  const std::string stem = output_path("", options.bench_file.filename().string(), "").filename().string();
  std::string name = stem + extension;
  for (int n = 2; std::filesystem::exists(options.runs / name); ++n)
    name = fmt::format("{}-{}{}", stem, n, extension);
  return name;
}

std::string file_name(const std::string& path) {
  return std::filesystem::path(path).filename().string();
}

/// The readings of each accelerometer are passed on to `see`.
void watch_accelerometers(Bench& bench, const std::function<void(const StripSeen&)>& see) {
  const auto open = static_cast<std::size_t>(std::ranges::count_if(bench.items, &BenchItem::is_open));
  for (BenchItem& item : bench.items) {
    if (!item.is_open()) continue;
    item.accelerometer =
        std::make_unique<WatchedAccelerometer>(std::move(item.accelerometer), see, ItemOfBench{item.k, open});
  }
}

}  // namespace

Session::Session(Options options, std::function<void(Event)> notify)
    : options_(std::move(options)), notify_(std::move(notify)) {
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
      // An accepted job is still carried out, so that it ends in order; its stop is requested already.
      if (!job_) return;
      job = std::exchange(job_, nullptr);
    }
    carry_out(job);
  }
}

void Session::log(Message text) {
  notify_(LogLine{LogLine::Grade::kInfo, std::move(text)});
}

void Session::carry_out(const std::function<void()>& job) {
  const auto problem = [this](const std::exception& error) {
    notify_(LogLine{LogLine::Grade::kProblem, message_of(error)});
  };
  try {
    if (stop_.stop_requested()) throw RunInterrupted(Message("stopped before it began"));
    job();
  } catch (const RunInterrupted& error) {
    notify_(LogLine{LogLine::Grade::kWarning, error.message()});
  } catch (const InstrumentError& error) {
    problem(error);
    notify_(FaultSeen{error.instrument(), std::string(to_string(error.fault())), error.message()});
    jog_bench_.reset();  // After a fault the instruments are opened and asked again.
  } catch (const std::exception& error) {
    problem(error);
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
  notify_activity();
}

void Session::notify_activity() {
  ActivitySeen seen;
  {
    const std::lock_guard lock(mutex_);
    seen = {activity_, activity_ == Activity::kRunning && run_ && run_->is_hold_wanted(),
            activity_ != Activity::kIdle && stop_.stop_requested()};
  }
  notify_(seen);
}

bool Session::is_idle() const {
  const std::lock_guard lock(mutex_);
  return activity_ == Activity::kIdle;
}

Session::Refusal Session::begin(Activity activity, std::function<void()> job, const Asker& by) {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ != Activity::kIdle) return kBusy;
    if (closing_) return Message("the console is being closed");
    activity_ = activity;
    stop_ = std::stop_source();
    if (activity == Activity::kRunning) {
      RunSession::Options options;
      options.open_bench = [this, by](const BenchConfig& config, BenchStreams) {
        return open(config, "a run by " + by.for_people());
      };
      options.listener = [this](const SessionEvent& event) { show(event); };
      options.stop = stop_.get_token();
      options.login = by.login;
      options.laboratory = laboratory_link();
      operator_ = by;
      run_ = std::make_shared<RunSession>(std::move(options));
    }
    job_ = std::move(job);
  }
  notify_activity();
  wake_.notify_all();
  return std::nullopt;
}

Session::Refusal Session::check(bool with_motion, const Asker& by) {
  return begin(Activity::kChecking, [this, with_motion, by] { do_check(with_motion, by); });
}

Session::Refusal Session::check_item(std::int64_t entry, const RunChoice& choice, const ItemBefore& before) {
  return begin(Activity::kChecking, [this, entry, choice, before] { do_check_item(entry, choice, before); });
}

/// Why a form cannot start a run any more; nullopt if it can.
Session::Refusal Session::stale(const RunChoice& choice) const {
  if (!choice.form.empty()) {
    const std::lock_guard lock(mutex_);
    if (std::find(forms_.begin(), forms_.end(), choice.form) != forms_.end())
      return Message("this form has started a run already; open the form again");
  }
  if (choice.bench_sha256.empty()) return std::nullopt;
  try {
    if (sha256_of(read_file(options_.bench_file)) == choice.bench_sha256) return std::nullopt;
  } catch (const std::invalid_argument& unreadable) {
    return message_of(unreadable);
  }
  return Message("the bench file has changed since the form was opened; open the form again");
}

Session::Refusal Session::start(const RunChoice& choice, const Asker& by) {
  if (Refusal refusal = stale(choice)) return refusal;
  const std::string name = free_name(options_, ".run");
  Refusal refusal = begin(
      Activity::kRunning, [this, name, choice] { do_start(name, choice); }, by);
  if (refusal || choice.form.empty()) return refusal;
  constexpr std::size_t kMostForms = 100;
  const std::lock_guard lock(mutex_);
  forms_.push_back(choice.form);
  if (forms_.size() > kMostForms) forms_.pop_front();
  return std::nullopt;
}

Session::Refusal Session::resume(const ResumeRequest& request, const Asker& by) {
  return begin(
      Activity::kRunning, [this, request] { run_->resume(request); }, by);
}

Session::Refusal Session::level(const Asker& by) {
  const std::filesystem::path run = options_.runs / free_name(options_, ".level.run");
  return begin(
      Activity::kRunning, [this, run] { do_level(run); }, by);
}

Session::Refusal Session::probe() {
  return begin(Activity::kChecking, [this] { do_probe(); });
}

Session::Refusal Session::jog(const Jog& jog, const Asker& by) {
  const auto button = jog.how == Jog::How::kWhileHeld ? std::make_shared<HeldButton>() : nullptr;
  Refusal refusal = begin(Activity::kJogging, [this, jog, by, button] { do_jog(jog, by, button.get()); });
  const std::lock_guard lock(mutex_);
  if (!refusal) button_ = button;
  return refusal;
}

Session::Refusal Session::keep_turning(const KeepTurning& sign) {
  const std::lock_guard lock(mutex_);
  if (activity_ != Activity::kJogging || !button_) return Message("no button is held for a jog");
  button_->hear(sign);
  return std::nullopt;
}

void Session::record(const char* kind, const Asker& by, RunOperator operates) {
  if (run_) (void)run_->add_person_event({kind, by.for_record(), std::move(operates)});
}

Session::Refusal Session::hold(const Asker& by) {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ != Activity::kRunning || !run_) return Message("no run is in progress");
    run_->hold();
    record("hold asked for", by);
  }
  log(Message("Hold: the stage will stand still after this angle."));
  notify_activity();
  return std::nullopt;
}

Session::Refusal Session::continue_run(const Asker& by) {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ != Activity::kRunning || !run_ || !run_->is_hold_wanted()) return Message("no run is held");
    run_->continue_run();
    record("continue asked for", by);
  }
  log(Message("Continue: the stage moves on."));
  notify_activity();
  return std::nullopt;
}

void Session::control_taken(const Asker& by) {
  const std::lock_guard lock(mutex_);
  if (activity_ == Activity::kRunning) record("control taken", by, by.who);
}

Session::Refusal Session::stop(const Asker& by) {
  {
    const std::lock_guard lock(mutex_);
    if (activity_ == Activity::kIdle) return Message("nothing is in progress that could be stopped");
    if (activity_ == Activity::kAnalysing) return Message("the stage is at rest; the run is being analysed");
    if (stop_.stop_requested()) return std::nullopt;
    record("stop asked for", by);
    // In a thread of its own, as the request sends the halt to the stage and waits for its answer.
    stopper_ = std::jthread([source = stop_]() mutable { source.request_stop(); });
  }
  notify_(LogLine{LogLine::Grade::kWarning,
                  Message("Stop, asked for by {who}: the halt is sent to the stage.", by.for_people())});
  return std::nullopt;
}

Session::Refusal Session::note(std::string text, const Asker& by) {
  const std::lock_guard lock(mutex_);
  if (activity_ != Activity::kRunning || !run_)
    return Message("no run is in progress: a note goes into the event log of a run");
  if (!run_->add_note({std::move(text), by.for_record()}))
    return Message("many notes wait to be stored already");
  return std::nullopt;
}

Session::Refusal Session::acknowledge(const std::filesystem::path& run, const Asker& by) {
  if (!is_idle()) return kBusy;
  try {
    acknowledge_interrupted_run(run, format_utc(RealClock().utc_now()), by.for_record());
  } catch (const RunFileError& error) {
    return message_of(error);
  }
  log(Message("The interruption of {run} is acknowledged by {who}.", run.filename().string(),
              by.for_people()));
  if (auto now = find_interrupted_run(options_.runs)) notify_(InterruptionAcknowledged{*std::move(now)});
  return std::nullopt;
}

Bench Session::open(const BenchConfig& config, const std::string& owner) {
  jog_bench_.reset();  // It would keep the ports occupied.
  const Clock::UtcTime utc = RealClock().utc_now();
  BenchStreams streams;
  streams.owner = owner;
  Bench bench = make_bench(config, std::move(streams), std::make_unique<PacedClock>(options_.pace, utc));
  notify_(BenchOpened{config.protocol, bench.simulated_time});
  const auto see = [this](const auto& seen) { notify_(seen); };
  bench.stage = std::make_unique<WatchedStage>(std::move(bench.stage), see, see);
  watch_accelerometers(bench, see);
  return bench;
}

void Session::show(SessionEvent event) {
  if (auto* began = std::get_if<RunBeganEvent>(&event)) {
    if (began->file.empty()) return;  // It belongs to the small turn of a check.
    began->file = file_name(began->file);
    if (operator_.login.empty() && !began->operator_name.empty())
      began->operator_name += fmt::format(" ({})", kNotVerified);
  }
  if (auto* end = std::get_if<FinishedEvent>(&event)) end->file = file_name(end->file);
  if (std::holds_alternative<AllMeasuredEvent>(event)) {
    {
      const std::lock_guard lock(mutex_);
      activity_ = Activity::kAnalysing;
    }
    notify_activity();
  }
  notify_(std::move(event));
}

void Session::do_check(bool with_motion, const Asker& by) {
  const BenchConfig config = read_bench(options_.bench_file, register_records());
  Bench bench = open(config, "a check by " + by.for_people());
  std::vector<Finding> findings = check_bench(
      bench, config, {!with_motion, [this](const SessionEvent& event) { show(event); }, stop_.get_token()});
  LastCheck check = count_findings(findings);
  check.utc = format_utc(RealClock().utc_now());
  check.by = by.for_people();
  check.with_motion = with_motion;
  log(Message("The bench is checked: {good} good, {warnings} warnings, {problems} problems.", check.good,
              check.warnings, check.problems));
  if (!keep_check(options_.runs, options_.bench_file, check))
    notify_(LogLine{LogLine::Grade::kWarning,
                    Message("The outcome of the check cannot be kept in the run folder.")});
  notify_(ChecksSeen{std::move(findings)});
}

void Session::do_check_item(std::int64_t entry, const RunChoice& choice, const ItemBefore& before) {
  const BenchConfig config = choose_run(read_bench(options_.bench_file, register_records()), choice).config;
  Bench bench = open(config, "a check of an item");
  ItemCheck check = check_mounted_item(bench, config, before, stop_.get_token());
  log(Message("The item is checked: {outcome}.",
              check.passed() ? Message("nothing speaks against starting") : Message("there is a problem")));
  notify_(ItemChecked{entry, std::move(check)});
}

void Session::do_start(const std::string& name, const RunChoice& choice) {
  ChosenRun chosen = choose_run(read_bench(options_.bench_file, register_records()), choice);
  const BenchConfig& config = chosen.config;
  for (Message& warning : chosen.warnings) notify_(LogLine{LogLine::Grade::kWarning, std::move(warning)});
  for (const std::string& warning : config.warnings)
    notify_(LogLine{LogLine::Grade::kWarning, Message::bare(warning)});
  run_->start({config, (options_.runs / name).string(), false, {}, choice.without_missing_items});
}

void Session::do_level(const std::filesystem::path& run) {
  const BenchConfig config = read_bench(options_.bench_file, register_records());
  const StartRequest request{config, run.string()};
  const std::string unit = run_->identify_instruments(request).first().accelerometer.output_unit;
  const auto sensitivity = nominal_sensitivity(unit, config.g_loc.value_mps2);
  if (!sensitivity)
    throw Telling<std::invalid_argument>(
        Message("the output is in {unit}; required on this page: g or m/s2. Level it by `abcal level "
                "--sensitivity RUN`",
                unit));
  const RunOutcome outcome = run_->level(request);
  const Levelling levelling = evaluate_levelling(outcome.stored(), *sensitivity);
  const LevelFile level = level_file_of(levelling, outcome.stored());
  const std::filesystem::path file = std::filesystem::path(run).replace_extension(".json");
  write_level_file(file, level);
  const std::string stored = file.filename().string();
  const auto words = [](const Message& name, const Quantity& q) {
    return Message("{name} {value} {unit}", name, value_with_uncertainty(q), q.unit);
  };
  const std::vector<Message> found = {words(Message("tilt of the Z axis"), levelling.tilt.delta_z),
                                      words(Message("{zx}", "Zx"), levelling.tilt.zx),
                                      words(Message("{zy}", "Zy"), levelling.tilt.zy),
                                      words(Message("zero of X"), levelling.x_zero.error)};
  log(Message("Levelled: {found}. Stored in {file}.", found, stored));
  nlohmann::ordered_json lines = nlohmann::ordered_json::array();
  for (const Message& line : found) lines.push_back(line.english());
  notify_(StateSeen{"levelling",
                    {{"file", stored},
                     {"levelling", level_json(level)},
                     {"words", in_sequence(found).english()},
                     {"lines", std::move(lines)},
                     {"messages", messages_json(found)}}});
}

void Session::do_probe() {
  jog_bench_.reset();  // Its ports are probed as well.
  const std::vector<wire::PortInfo> ports = wire::list_ports();
  const std::vector<Probed> probed = probe_ports(ports_to_ask(ports), [](const auto&, const auto&) {});
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const wire::PortInfo& port : ports) {
    nlohmann::ordered_json json = port_json(port);
    const auto found =
        std::find_if(probed.begin(), probed.end(), [&](const Probed& one) { return one.port == port.path; });
    json["found"] = found == probed.end() ? "" : in_words(*found);
    list.push_back(std::move(json));
  }
  log(Message("{asked} ports are asked, of {all}.", probed.size(), ports.size()));
  notify_(StateSeen{"ports", {{"ports", std::move(list)}}});
}

void Session::do_jog(const Jog& jog, const Asker& by, HeldButton* button) {
  if (jog_bench_ && jog_bench_->by != by.for_people())
    jog_bench_.reset();  // The guard's log names the person.
  if (!jog_bench_) {
    BenchConfig config = read_bench(options_.bench_file, register_records());
    Bench bench = open(config, "a jog by " + by.for_people());
    jog_bench_.emplace(JogBench{std::move(config), std::move(bench), by.for_people()});
  }
  Bench& bench = jog_bench_->bench;
  std::optional<std::stop_callback<std::function<void()>>> halt_at_once;
  if (!bench.simulated_time) halt_at_once.emplace(stop_.get_token(), [&] { bench.stage->halt(); });
  const std::stop_token let_go = button == nullptr ? std::stop_token() : button->let_go();
  std::optional<std::stop_callback<std::function<void()>>> halt_when_let_go;
  if (!bench.simulated_time) halt_when_let_go.emplace(let_go, [&] { bench.stage->halt(); });
  const Angle angle =
      turn_axis(jog, *bench.stage, *bench.clock, jog_bench_->config.protocol, {stop_.get_token(), let_go});
  log(Message("Axis {axis} is at {angle:.4f} degrees (encoder), turned by {who}.", to_string(jog.axis),
              angle.deg(), by.for_people()));
}

}  // namespace abcal::console
