#include "app/measure/session/measuring_session.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cstdlib>
#include <stdexcept>
#include <utility>

#include "app/bench_file/not_real.h"
#include "app/measure/session/disk_space.h"
#include "app/measure/session/level_plan.h"
#include "app/measure/session/replay_comparison.h"
#include "app/measure/session/session_observer.h"
#include "app/system/output_file.h"
#include "app/system/real_clock.h"
#include "app/system/temporary_folder.h"
#include "app/system/version.h"
#include "app/witness/time_stamp_authority.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/record/run_label.h"
#include "protocol/record/verify_run.h"

namespace abcal {
namespace {

/// Largest numbers of notes and of persons' events that wait to be stored.
constexpr std::size_t kMostNotes = 20;
constexpr std::size_t kMostPersonEvents = 200;

/// A run that is complete, closed or not.
MeasuredRun load_measured(const std::filesystem::path& path) {
  MeasuredRun run;
  run.items = RunFile::load_items(path);
  run.path = path;
  return run;
}

RunAnalyst::Conclusion analyse(RunAnalyst* analyst, const MeasuredRun& run) {
  return analyst == nullptr || run.is_levelling() ? RunAnalyst::Conclusion{} : analyst->analyse(run);
}

/// Announces a run once: before the first wait for programs that read its file, or after closing it.
class Announcement {
 public:
  Announcement(const MeasuredRun& run, RunAnalyst* analyst) : run_(run), analyst_(analyst) {}

  void announce() {
    if (!std::exchange(is_made_, true) && analyst_ != nullptr) analyst_->announce(run_);
  }
  /// Announces the run, then waits.
  RunFile::TryAgain before_waiting() {
    return [this](int failures) {
      announce();
      return RunFile::wait_for_readers(failures);
    };
  }
  bool is_made() const { return is_made_; }

 private:
  const MeasuredRun& run_;
  RunAnalyst* analyst_;
  bool is_made_ = false;
};

/// Keeps the analyses of a run that is closed in its results file.
void keep_analyses(const MeasuredRun& run, RunAnalyst* analyst, const std::string& utc) {
  ResultsFile results_file(run.path, run.sha256);
  if (analyst != nullptr && !run.is_levelling()) analyst->keep(results_file, run, utc);
}

/// The name of the first free "a-replay.run", "a-replay-2.run" ... in the folder of "a.run".
std::filesystem::path replay_path(std::filesystem::path run) {
  return first_free_path(
      run.replace_filename(fmt::format("{}-replay{}", run.stem().string(), run.extension().string())));
}

/// The part of an interrupted run that is measured already.
/// @param of_items  the run of each item that is continued
RunProgress progress_of(const std::vector<StoredRun>& of_items) {
  const StoredRun& first = of_items.front();
  RunProgress so_far;
  so_far.measured = {first.measured.begin(), first.measured.end()};
  so_far.spent = first.timing;
  for (const StoredRun& each : of_items) {
    if (!each.dwells.empty() && each.dwells.front().temperature_degc)
      so_far.first_temperatures_degc[each.item] = *each.dwells.front().temperature_degc;
  }
  // All items have the same angles, in the same order.
  for (std::size_t i = first.measured.size(); i-- > 0;) {
    RunProgress::LastAngle angle{first.measured[i], {}};
    for (const StoredRun& each : of_items)
      if (can_be_compared_with(each.dwells[i])) angle.dwells[each.item] = each.dwells[i];
    if (angle.dwells.size() < of_items.size()) continue;
    so_far.last = std::move(angle);
    break;
  }
  return so_far;
}

/// The run of each item that was not dropped; of item 1 if all were.
std::vector<StoredRun> load_items_in_run(const std::filesystem::path& path) {
  std::vector<StoredRun> of_items;
  for (const ItemProgress& item : RunFile::load(path).items)
    if (!item.dropped_at) of_items.push_back(RunFile::load(path, item.k));
  if (of_items.empty()) of_items.push_back(RunFile::load(path));
  return of_items;
}

/// Items that were dropped stay dropped: their ports are not opened.
void leave_out_dropped(const std::vector<ItemProgress>& items, BenchConfig& config) {
  for (const ItemProgress& item : items) {
    const auto index = static_cast<std::size_t>(item.k) - 1;
    if (item.dropped_at && index < config.items.size()) config.items[index].left_out = item.reason;
  }
}

std::string item_name(const BenchConfig& config, int k, const std::string& reported) {
  std::string name = config.item(k).item.serial_number;
  if (name.empty()) name = reported;
  return name.empty() ? fmt::format("item {}", k) : name;
}

/// Summaries of several items, including those dropped before an interruption; empty for a single item.
/// @param resumed  null: the run is a new one
std::vector<ItemSummary> item_summaries(const BenchConfig& config, const Identities& identities,
                                        const StoredRun* resumed) {
  std::vector<ItemSummary> items;
  if (!config.has_several_items()) return items;
  for (const ItemIdentity& item : identities.items) {
    const AccelerometerInfo& info = item.accelerometer;
    items.push_back({item.k, item_name(config, item.k, info.serial_number), info.model, info.output_unit,
                     info.rate_hz, item.missing});
  }
  if (resumed == nullptr) return items;
  for (const ItemProgress& before : resumed->items) {
    auto item = std::ranges::find(items, before.k, &ItemSummary::k);
    if (item == items.end()) {
      const RunItem& stored = resumed->header.items.at(static_cast<std::size_t>(before.k) - 1);
      items.push_back({before.k, item_name(config, before.k, stored.serial_number), stored.model,
                       stored.response_unit, stored.rate_hz.value_or(0.0), before.reason});
      item = items.end() - 1;
    }
    item->measured = before.measured;
  }
  std::ranges::sort(items, {}, &ItemSummary::k);
  return items;
}

/// The runs of the items that are present.
std::vector<StoredRun> present_items(const std::vector<StoredRun>& of_items, const Identities& identities) {
  std::vector<StoredRun> present;
  for (const StoredRun& each : of_items) {
    const auto item = std::ranges::find(identities.items, each.item, &ItemIdentity::k);
    if (item == identities.items.end() || item->is_present()) present.push_back(each);
  }
  return present;
}

/// Null if [notify] names no recipient: events then take no time.
std::unique_ptr<Notifier> notifier_of(const BenchConfig& config) {
  return config.notify.anybody() ? std::make_unique<Notifier>(config.notify) : nullptr;
}

/// The header as written before the first angle, with the facts of items 2, 3, ...
RunHeader whole_header(const std::filesystem::path& path, const StoredRun& first) {
  RunHeader header = first.header;
  const auto role_of = [](int item) { return fmt::format("item-{}", item); };
  for (InstrumentIdentity& instrument : header.instruments)
    if (first.items.size() > 1 && instrument.role == "accelerometer") instrument.role = role_of(1);
  for (int item = 2; item <= static_cast<int>(first.items.size()); ++item) {
    const RunHeader further = RunFile::load(path, item).header;
    ItemFacts facts{{}, further.response_unit, further.tolerances, further.limits, further.expected};
    for (const auto& label : further.labels)
      if (label.first.starts_with("item.")) facts.labels.insert(label);
    header.further_items.push_back(std::move(facts));
    for (InstrumentIdentity instrument : further.instruments) {
      if (instrument.role != "accelerometer") continue;
      instrument.role = role_of(item);
      header.instruments.push_back(std::move(instrument));
    }
  }
  return header;
}

FinishedEvent finished_event(const MeasuredRun& run, const RunAnalyst::Conclusion& conclusion) {
  FinishedEvent event;
  event.file = run.path.string();
  event.complete = true;
  event.verdict = conclusion.verdict;
  event.reason = conclusion.reason;
  for (const StoredRun& item : run.items) event.measured = std::max(event.measured, item.measured.size());
  event.planned = run.stored().header.plan.size();
  event.measured_before = run.measured_before;
  return event;
}

}  // namespace

bool MeasuredRun::is_levelling() const {
  return !has_experiments(stored().header.plan);
}

std::optional<FinishedRun> finish_measured_run(const std::filesystem::path& path, RunAnalyst* analyst,
                                               RunWitness* witness) {
  std::error_code ignored;
  if (!std::filesystem::exists(path, ignored)) return std::nullopt;
  const StoredRun stored = RunFile::load(path);
  if (stored.state != RunState::kComplete) return std::nullopt;
  const bool was_closed = RunFile::is_closed(path);
  const std::size_t expected =
      analyst != nullptr && has_experiments(stored.header.plan) ? analyst->least_analyses() : 0;
  if (was_closed && ResultsFile(path, RunFile::finish_closing(path)).analyses() >= expected) {
    return std::nullopt;
  }
  if (!was_closed) {
    require_unchanged(path);
    RunFile file = RunFile::open_to_close(path);
    if (witness != nullptr) witness->finish(file);
  }
  FinishedRun finished{load_measured(path), {}};
  MeasuredRun& run = finished.run;
  run.measured_before = true;
  finished.conclusion = analyse(analyst, run);
  Announcement announcement(run, analyst);
  run.sha256 = RunFile::finish_closing(path, announcement.before_waiting());
  announcement.announce();
  keep_analyses(run, analyst, format_utc(RealClock().utc_now()));
  return finished;
}

std::unique_ptr<RunWitness> find_witness(const MeasuringSession::Options& options) {
  const SessionListener listener = options.listener;
  return std::make_unique<RunWitness>(options.find_witness ? options.find_witness() : WitnessClient::find(),
                                      [listener](const std::string& text) {
                                        if (listener) listener(NoticeEvent{"witness", Message::bare(text)});
                                      });
}

/// The instruments of a bench file, their identities and the plan.
struct MeasuringSession::OpenedBench {
  BenchConfig config;
  Bench bench;
  Identities identities;
  std::vector<PlannedAngle> plan;
  RegisteredStart registered;
  bool identified = false;
};

MeasuringSession::MeasuringSession(Options options) : options_(std::move(options)) {
  if (!options_.open_bench) {
    options_.open_bench = [](const BenchConfig& config, BenchStreams streams) {
      return make_bench(config, std::move(streams));
    };
  }
  if (!options_.free_disk_space) options_.free_disk_space = abcal::free_disk_space;
  stop_link_.emplace(options_.stop, [this] { stop_.request_stop(); });
}

MeasuringSession::~MeasuringSession() = default;

Bench* MeasuringSession::bench() {
  return opened_ ? &opened_->bench : nullptr;
}

void MeasuringSession::notify(const SessionEvent& event) const {
  if (options_.listener) options_.listener(event);
  if (!notifier_) return;
  notifier_->send(event, format_utc(RealClock().utc_now()));
  // The last event waits for its message, because no later event could report a failure.
  constexpr std::chrono::seconds kLongestAtEnd{12};
  const bool is_over = std::holds_alternative<FinishedEvent>(event);
  for (const std::string& why : notifier_->failures(is_over ? kLongestAtEnd : std::chrono::seconds(0)))
    if (options_.listener) options_.listener(NoticeEvent{"notify", Message::bare(why)});
}

void MeasuringSession::warn(const std::string& kind, const Message& text) const {
  notify(NoticeEvent{kind, text});
}

void MeasuringSession::hold() {
  const std::lock_guard lock(mutex_);
  hold_wanted_ = true;
}

void MeasuringSession::continue_run() {
  const std::lock_guard lock(mutex_);
  hold_wanted_ = false;
}

bool MeasuringSession::is_hold_wanted() const {
  const std::lock_guard lock(mutex_);
  return hold_wanted_;
}

bool MeasuringSession::add_note(NoteRequest note) {
  const std::lock_guard lock(mutex_);
  if (notes_.size() >= kMostNotes) return false;
  notes_.push_back(std::move(note));
  return true;
}

bool MeasuringSession::add_person_event(PersonEvent event) {
  const std::lock_guard lock(mutex_);
  if (person_events_.size() >= kMostPersonEvents) return false;
  person_events_.push_back(std::move(event));
  return true;
}

void MeasuringSession::request_stop() {
  stop_.request_stop();
}

void MeasuringSession::store_notes(RunFile& file, const Clock& clock) {
  std::vector<NoteRequest> notes;
  std::vector<PersonEvent> person_events;
  {
    const std::lock_guard lock(mutex_);
    notes.swap(notes_);
    person_events.swap(person_events_);
  }
  for (const PersonEvent& event : person_events) {
    const std::string utc = format_utc(file.utc_now(clock));
    file.append_event(utc, event.kind, Message::bare(event.text));
    note_operator(file, event.operates, utc);
  }
  for (const NoteRequest& note : notes) {
    file.append_event(format_utc(file.utc_now(clock)), "note",
                      Message::bare(fmt::format("{} ({})", note.text, note.by)));
    notify(NoteStoredEvent{note.text, note.by});
  }
}

/// Stores the notes of a run that ends early. A failure is a warning only: the run's own reason is reported.
void MeasuringSession::store_last_notes(RunFile& file, const Clock& clock) noexcept {
  try {
    store_notes(file, clock);
  } catch (const std::exception& error) {
    warn("note", Message("not stored in the event log: {why}", message_of(error)));
  }
}

// ---- Begin

MeasuringSession::OpenedBench& MeasuringSession::open(const BenchConfig& config, BenchStreams streams) {
  opened_.reset();  // Its ports must be free before they are opened again.
  auto opened = std::make_unique<OpenedBench>();
  opened->config = config;
  opened->registered.who.name = config.operator_name;
  if (streams.owner.empty())
    streams.owner = config.operator_name.empty() ? "a run" : "a run by " + config.operator_name;
  opened->bench = options_.open_bench(config, std::move(streams));
  opened_ = std::move(opened);
  return *opened_;
}

MeasuredRun MeasuringSession::start(const StartRequest& request) {
  return run_plan(request, make_rotation_plan);
}

MeasuredRun MeasuringSession::level(const StartRequest& request) {
  return run_plan(request, level_plan);
}

Identities MeasuringSession::identify_instruments(const StartRequest& request) {
  const bool is_open =
      opened_ && opened_->identified && !request.record && opened_->config.is_same_bench(request.bench);
  if (!is_open) open_and_identify(request);
  return opened_->identities;
}

void MeasuringSession::ask_corrections_again() {
  if (!opened_ || !opened_->identified) throw std::logic_error("ask_corrections_again: no bench is open");
  for (std::size_t i = 0; i < opened_->identities.items.size(); ++i)
    if (ItemIdentity& item = opened_->identities.items[i]; item.is_present())
      item.corrections = opened_->bench.items[i].accelerometer->correction_registers();
}

MeasuredRun MeasuringSession::run_plan(const StartRequest& request, Planner planner) {
  RegisteredStart registered = find_operator(request.bench.operator_name);
  witness_ = find_witness(options_);  // A key that cannot be read is reported before the first move.
  (void)identify_instruments(request);
  if (!request.without_missing_items) require_all_items(opened_->identities);
  opened_->registered = std::move(registered);
  opened_->plan = planner(opened_->config.protocol, opened_->identities.travel());
  RunFile file = create_file(*opened_, request);
  have_witnessed(file);
  notifier_ = notifier_of(opened_->config);
  notify_begun(*opened_, request.run_file, nullptr);
  MeasuredRun outcome = measure_and_finish(std::move(file), {});
  notify_charts(outcome);
  return outcome;
}

void MeasuringSession::open_and_identify(const StartRequest& request) {
  opened_.reset();
  transcript_ = request.record ? std::make_unique<Transcript>(stop_.get_token()) : nullptr;
  OpenedBench& opened = open(request.bench, transcript_ ? transcript_->streams() : BenchStreams{});
  if (transcript_ && !transcript_->has_streams()) {
    throw std::invalid_argument(
        "--record: nothing on this bench has bytes to record, because both drivers are \"simulated\"; "
        "required: at least one other driver (its port may be \"simulated\")");
  }
  opened.identities = identify_or_keep_recording(request, opened);
  opened.identified = true;
}

Identities MeasuringSession::identify_or_keep_recording(const StartRequest& request,
                                                        const OpenedBench& opened) {
  Bench& bench = opened_->bench;
  try {
    Identities identities = identify(bench, opened.config);
    require_items_as_stated(opened.config, identities);
    return identities;
  } catch (const InstrumentError& error) {
    if (!transcript_) throw;
    // Nothing was measured, but the recorded replies of the instruments are worth keeping.
    try {
      BenchConfig config = opened.config;
      config.stage.level_file.clear();  // Only an identified stage can be compared with them.
      config.stage.record.clear();
      RunHeader header = make_header(config, {}, {}, *bench.clock);
      header.instruments.clear();
      RunFile file = RunFile::create(request.run_file, header);
      transcript_->keep_in(file);
      file.set_state(RunState::kAbandoned, format_utc(bench.clock->utc_now()), error.message());
      warn("recording", Message("Nothing was measured; the recording is kept in {file}", request.run_file));
    } catch (const RunFileError& lost) {
      warn("recording", Message("The recording is lost: {why}", message_of(lost)));
    }
    throw;
  }
}

void MeasuringSession::require_disk_space(const OpenedBench& opened, const StartRequest& request) {
  DiskNeed need;
  need.angles = opened.plan.size();
  for (const ItemIdentity& item : opened.identities.items) {
    if (!item.is_present()) continue;
    const double rate_hz = item.accelerometer.rate_hz;
    need.rate_hz += rate_hz;
    need.readings_per_angle += readings_per_dwell(opened.config.protocol, rate_hz);
  }
  need.duration_s = estimate_duration(opened.plan, opened.config, opened.identities).total_s();
  need.with_recording = request.record;
  const auto warning = check_disk_space(request.run_file, need, options_.free_disk_space(request.run_file));
  if (warning) warn("disk space", *warning);
}

RunFile MeasuringSession::create_file(const OpenedBench& opened, const StartRequest& request) {
  Bench& bench = opened_->bench;
  require_disk_space(opened, request);
  (void)temporary_place();  // The analysis needs it, after hours.
  RunHeader header = make_header(opened.config, opened.identities, opened.plan, *bench.clock);
  const RegisteredStart& registered = opened.registered;
  if (!registered.who.name.empty()) header.labels["operator.name"] = registered.who.name;
  if (!registered.calibrations_json.empty()) header.labels[kCalibrationsLabel] = registered.calibrations_json;
  for (const auto& [key, value] : request.labels) header.labels[key] = value;
  RunFile file = RunFile::create(request.run_file, header);
  if (transcript_) transcript_->keep_in(file);
  file.begin_session(session_start(bench));
  file.append_event(format_utc(file.utc_now(*bench.clock)), "started", Message("run started"));
  note_operator(file, registered.who, format_utc(file.utc_now(*bench.clock)));
  drop_missing_items(file, 0);
  (void)note_environment(bench, opened.config, file, "start");
  return file;
}

/// Drops the items that are missing, from this position in the plan on.
void MeasuringSession::drop_missing_items(RunFile& file, std::size_t position) const {
  const std::string utc = format_utc(file.utc_now(*opened_->bench.clock));
  for (const ItemIdentity& item : opened_->identities.items) {
    if (item.missing.empty()) continue;
    const Message text("item {item} takes no part: {why}", item.k, item.missing);
    file.drop_item(item.k, position, utc, text);
    notify(NoticeEvent{std::string(kItemDroppedEvent), text, item.k});
  }
}

void MeasuringSession::notify_begun(const OpenedBench& opened, const std::filesystem::path& path,
                                    const StoredRun* resumed) {
  const auto summary = [](const auto& info) {
    return InstrumentSummary{info.maker, info.model, info.serial_number};
  };
  const BenchConfig& config = opened.config;
  const Identities& identities = opened.identities;
  RunBeganEvent began;
  began.file = path.string();
  began.resumed = resumed != nullptr;
  began.bench = config.name;
  const AccelerometerInfo& accelerometer = identities.first().accelerometer;
  const std::string& stated = config.items.front().item.serial_number;
  began.item = stated.empty() ? accelerometer.serial_number : stated;
  began.operator_name = opened.registered.who.name;
  began.unit = accelerometer.output_unit;
  began.stage = summary(identities.stage);
  began.accelerometer = summary(accelerometer);
  began.rate_hz = accelerometer.rate_hz;
  began.plan = opened.plan;
  for (std::size_t i = 0; resumed != nullptr && i < resumed->measured.size(); ++i) {
    const DwellRecord& dwell = resumed->dwells[i];
    began.measured.push_back({resumed->measured[i], {{resumed->item, dwell}}});
  }
  began.estimated_s = estimate_duration(opened.plan, config, identities).total_s();
  began.simulated_time = opened.bench.simulated_time;
  began.simulated = fmt::format("{}", fmt::join(simulated_instruments(config), ", "));
  began.items = item_summaries(config, identities, resumed);
  notify(std::move(began));
}

// ---- Resume

MeasuredRun MeasuringSession::resume(const ResumeRequest& request) {
  const std::filesystem::path path = request.run_file;
  // The person who resumes a run need not be the one who began it.
  RegisteredStart registered = find_operator({});
  witness_ = find_witness(options_);
  if (std::optional<FinishedRun> finished =
          finish_measured_run(path, options_.analyst.get(), witness_.get())) {
    notify(finished_event(finished->run, finished->conclusion));
    notify_charts(finished->run);
    return std::move(finished->run);
  }
  require_unchanged(path);
  const std::optional<Message> missing_log = RunFile::missing_log(path);
  RunFile file = RunFile::open_for_append(path);
  const std::vector<StoredRun> of_items = load_items_in_run(path);
  const StoredRun& stored = of_items.front();
  BenchConfig config = parse_bench(stored.header.bench_toml, path.string());
  leave_out_dropped(stored.items, config);
  // Open instruments are used again, unless their bytes go into a recording. With several items all are
  // opened again, because a missing one may be back.
  const bool is_open = opened_ && opened_->identified && !transcript_ && !config.has_several_items() &&
                       opened_->config.is_same_bench(config);
  transcript_.reset();
  if (!registered.who.verified()) registered.who.name = config.operator_name;
  OpenedBench& opened = is_open ? *opened_ : open(config, {});
  opened.registered = registered;
  if (!is_open) opened.identities = identify(opened.bench, opened.config);
  require_items_as_stated(opened.config, opened.identities);
  if (!request.without_missing_items) require_all_items(opened.identities);
  for (const StoredRun& of_item : of_items) require_same_instruments(opened.identities, of_item);
  opened.plan = stored.header.plan;
  file.begin_session(session_start(opened.bench));
  file.set_state(RunState::kRunning, format_utc(file.utc_now(*opened.bench.clock)),
                 Message("resumed with {measured} of {planned} angles measured", stored.measured.size(),
                         stored.header.plan.size()));
  note_operator(file, registered.who, format_utc(file.utc_now(*opened.bench.clock)));
  have_witnessed(file);
  notifier_ = notifier_of(config);
  notify_begun(opened, path, &stored);
  if (missing_log) {
    file.append_event(format_utc(file.utc_now(*opened.bench.clock)), kFileEvent, *missing_log);
    warn(std::string(kFileEvent), *missing_log);
  }
  drop_missing_items(file, stored.measured.size());
  MeasuredRun outcome =
      measure_and_finish(std::move(file), progress_of(present_items(of_items, opened.identities)));
  notify_charts(outcome);
  return outcome;
}

void MeasuringSession::require_same_instruments(const Identities& now, const StoredRun& stored) const {
  const auto found_item = std::ranges::find(now.items, stored.item, &ItemIdentity::k);
  const ItemIdentity& identified = found_item == now.items.end() ? now.first() : *found_item;
  if (!identified.is_present()) return;
  const AccelerometerInfo& accelerometer = identified.accelerometer;
  const std::map<std::string, std::string>& corrections = identified.corrections;
  for (const InstrumentIdentity& before : stored.header.instruments) {
    if (before.role == "stage") {
      require_serial_number(before.role, before.model, now.stage.serial_number, before.serial_number);
    } else if (before.role == "accelerometer") {
      const std::string role = item_words(opened_->config, stored.item) + before.role;
      require_serial_number(role, before.model, accelerometer.serial_number, before.serial_number);
    }
  }
  const auto item = std::ranges::find(stored.header.items, stored.item, &RunItem::k);
  if (item == stored.header.items.end()) return;
  for (const auto& [name, before] : item->registers) {
    const auto found = corrections.find(name);
    const std::string now_in_force = found == corrections.end() ? "not reported" : found->second;
    if (now_in_force == before) continue;
    throw InstrumentError(
        "accelerometer " + accelerometer.model, Fault::kWrongIdentity,
        fmt::format("its {} was {} when the run began and is {}; required: the same, since what is "
                    "calibrated is the instrument with its own corrections. Set it back, or begin a new run",
                    name, before, now_in_force));
  }
}

// ---- Measure, close, analyse

void MeasuringSession::close_and_keep(RunFile file, MeasuredRun& run, const std::string& utc) const {
  Announcement announcement(run, options_.analyst.get());
  const std::string path = run.path.string();
  const auto sha256 = file.close(announcement.before_waiting());
  if (!sha256) {
    warn("closing",
         Message("{run} cannot be closed because another program keeps the file open; its result is not "
                 "stored yet: end that program, then close the run with: abcal resume {name}",
                 path, path));
    return;
  }
  run.sha256 = *sha256;
  if (announcement.is_made())
    warn("closing", Message("{run} is closed now: SHA-256 {digest}", path, *sha256));
  announcement.announce();
  keep_analyses(run, options_.analyst.get(), utc);
  if (const auto why = stamp_if_configured(run.path)) warn("time stamp", Message::bare(*why));
}

/// The angles of a run that begins or continues are witnessed from now on.
void MeasuringSession::have_witnessed(RunFile& file) {
  const std::string& bench = opened_->config.name;
  witness_->begin(file, bench.empty() ? "bench" : bench, opened_->registered.who.name,
                  opened_->bench.simulated_time);
}

/// @param stated  [operator] name of the bench file; empty: none
RegisteredStart MeasuringSession::find_operator(const std::string& stated) const {
  if (options_.laboratory.find_operator)
    return options_.laboratory.find_operator(stated, RealClock().utc_now(), options_.login);
  if (const char* location = std::getenv("ABCAL_REGISTER"); location != nullptr && *location != '\0')
    throw std::invalid_argument(fmt::format(
        "ABCAL_REGISTER names the register {}, but this program has no link to a register and cannot ask who "
        "operates the bench; required: a program with LaboratoryLink, or no ABCAL_REGISTER",
        location));
  return {{stated, {}}, {}};
}

/// Reports the control charts that wait for a run. Not called for a replay, which is not a check.
void MeasuringSession::notify_charts(const MeasuredRun& run) const {
  if (run.is_levelling() || !options_.laboratory.check_run_notices) return;
  for (const StoredRun& item : run.items) {
    if (item.own_progress().dropped_at) continue;
    for (const std::string& text :
         options_.laboratory.check_run_notices({run.path, run.sha256, item}, options_.login))
      warn("check standard", Message::bare(text));
  }
}

MeasuredRun MeasuringSession::measure_and_finish(RunFile file, const RunProgress& so_far) {
  OpenedBench& opened = *opened_;
  Bench& bench = opened.bench;
  const std::filesystem::path path = file.path();
  FinishedEvent ended_early;
  ended_early.file = path.string();
  ended_early.measured = so_far.measured.size();
  ended_early.planned = opened.plan.size();
  const auto listener = [&](const SessionEvent& event) {
    if (std::holds_alternative<DwellDoneEvent>(event)) ++ended_early.measured;
    notify(event);
    store_notes(file, *bench.clock);  // Here, in the thread that writes the run file.
  };
  const auto hold_wanted = [&] {
    store_notes(file, *bench.clock);
    return is_hold_wanted();
  };
  bool all_measured = false;
  try {
    SessionObserver observer(listener, hold_wanted);
    const RunTiming timing =
        measure_plan({bench, opened.config, file, opened.plan, so_far}, observer, stop_.get_token());
    store_notes(file, *bench.clock);
    all_measured = true;
    notify(AllMeasuredEvent{path.string()});
    const std::string utc = format_utc(file.utc_now(*bench.clock));
    if (const auto warning = note_environment(bench, opened.config, file, "end")) {
      warn("environment not read", *warning);
    }
    if (witness_) witness_->await_angles();
    file.complete(utc, timing);
    if (witness_) witness_->end(file);
    MeasuredRun run = load_measured(path);
    const RunAnalyst::Conclusion conclusion = analyse(options_.analyst.get(), run);
    close_and_keep(std::move(file), run, utc);
    notify(finished_event(run, conclusion));
    return run;
  } catch (const std::exception& error) {
    opened.identified = false;  // The next run opens the instruments again.
    if (!all_measured) store_last_notes(file, *bench.clock);
    ended_early.reason = message_of(error);
    notify(ended_early);
    throw;
  }
}

// ---- Replay

MeasuredRun MeasuringSession::replay(const ReplayRequest& request) {
  notifier_.reset();
  witness_.reset();
  const std::filesystem::path recorded_path = request.recorded_file;
  const StoredRun recorded = RunFile::load(recorded_path);
  opened_.reset();
  transcript_.reset();
  recorded_wire_ = std::make_unique<RecordedWire>(recorded_path);
  OpenedBench& opened =
      open(parse_bench(recorded.header.bench_toml, recorded_path.string()), recorded_wire_->streams());
  // Programs before version 1.0 did not ask for corrections. A recording that ends before its first angle may
  // end at this question.
  const bool asked_corrections =
      recorded.header.plan.empty() || !recorded.header.items.front().registers.empty();
  opened.identities = identify(opened.bench, opened.config, asked_corrections);
  if (recorded.header.plan.empty()) {
    require_items_as_stated(opened.config, opened.identities);
    throw std::runtime_error(fmt::format(
        "the recorded run ended before its first angle ({}), but in the replay both instruments were "
        "identified: this program interprets their answers differently from the one that recorded",
        end_of_run(recorded)));
  }
  opened.plan = recorded.header.plan;
  ReplayRequest complete = request;
  if (complete.run_file.empty()) complete.run_file = replay_path(recorded_path).string();
  try {
    return replay_to_the_end(recorded, complete);
  } catch (const InstrumentError& error) {
    close_ended_replay(recorded, complete.run_file);
    if (recorded_wire_->stopped_by_operator() && recorded_wire_->has_ended()) {
      throw RunInterrupted(Message("the recorded run was stopped by its operator here"));
    }
    throw;
  } catch (const RunInterrupted&) {
    close_ended_replay(recorded, complete.run_file);
    throw;
  }
}

MeasuredRun MeasuringSession::replay_to_the_end(const StoredRun& recorded, const ReplayRequest& request) {
  const OpenedBench& opened = *opened_;
  const std::string name = std::filesystem::path(request.recorded_file).filename().string();
  RunHeader header = whole_header(request.recorded_file, recorded);
  header.program_version = program_version();
  header.created_utc = format_utc(opened.bench.clock->utc_now());
  header.labels["replay.of"] = name;
  RunFile file = RunFile::create(request.run_file, header);
  file.begin_session(session_start(opened.bench));
  file.append_event(header.created_utc, "started", Message("replay of {run}", name));
  (void)note_environment(opened_->bench, opened.config, file, "start");
  notify_begun(opened, request.run_file, nullptr);
  MeasuredRun outcome = measure_and_finish(std::move(file), {});
  notify_comparison(recorded, request.run_file);
  return outcome;
}

void MeasuringSession::notify_comparison(const StoredRun& recorded, const std::filesystem::path& replayed) {
  ReplayComparedEvent comparison = compare_replay(recorded, RunFile::load(replayed));
  for (std::size_t k = 2; k <= recorded.items.size(); ++k) {
    const int item = static_cast<int>(k);
    const ReplayComparedEvent of_item =
        compare_replay(RunFile::load(recorded.record.source, item), RunFile::load(replayed, item));
    comparison.same += of_item.same;
    comparison.replayed += of_item.replayed;
  }
  notify(comparison);
}

/// A replayed run must not be resumed: its bench file names real ports.
void MeasuringSession::close_ended_replay(const StoredRun& recorded, const std::filesystem::path& path) {
  try {
    notify_comparison(recorded, path);
    RunFile::open_for_append(path).set_state(RunState::kAbandoned,
                                             format_utc(opened_->bench.clock->utc_now()),
                                             Message("the replay ends here as well"));
  } catch (const RunFileError& error) {
    warn("replay", message_of(error));
  }
}

}  // namespace abcal
