#include "app/commands/apply/apply_session.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "app/bench_file/not_real.h"
#include "app/results/analysis/analysed_file.h"
#include "app/results/analysis/load_record.h"
#include "app/system/real_clock.h"
#include "drivers/instrument/instrument_error.h"

namespace abcal {
namespace {

bool is_simulated(const BenchConfig& config) {
  const std::vector<std::string> simulated = simulated_instruments(config);
  return std::ranges::find(simulated, "accelerometer") != simulated.end();
}

const InstrumentIdentity* accelerometer_of(const StoredRun& run) {
  const auto& all = run.header.instruments;
  const auto found = std::ranges::find(all, "accelerometer", &InstrumentIdentity::role);
  return found == all.end() ? nullptr : &*found;
}

std::string in_words(const RegisterTexts& registers) {
  std::string words;
  for (const auto& [name, value] : registers)
    words += fmt::format("{}{} = {}", words.empty() ? "" : "; ", name, value);
  return words;
}

}  // namespace

ApplySession::ApplySession(RunSession& session, Options options)
    : session_(session), options_(std::move(options)) {}

Accelerometer& ApplySession::accelerometer() const {
  return *std::ranges::find(session_.bench()->items, item_.k, &BenchItem::k)->accelerometer;
}

CorrectionRegisters& ApplySession::registers() const {
  CorrectionRegisters* found = accelerometer().corrections();
  if (found != nullptr) return *found;
  throw InstrumentError(
      "accelerometer " + item_.accelerometer.model, Fault::kRefused,
      "this program can write no register of such an instrument; required: a driver of the list in "
      "docs/apply.md. abcal export writes the constants for a program that corrects readings");
}

CalibrationResult ApplySession::find_result(const ApplyRequest& request, StoredRun& run) const {
  AnalysedRun analysed = analyse_file_by(request.run, request.estimator);
  const int chosen = chosen_item(request.run, request.item);
  run = analysed.item(chosen).stored;
  if (!RunFile::looks_like_run_file(request.run) && analysed.runs.empty())
    throw std::invalid_argument(fmt::format(
        "{}: a CSV, which does not say what was measured; required: a run file", request.run.string()));
  if (run.state != RunState::kComplete)
    throw std::invalid_argument(fmt::format("{}: the run is not complete; required: abcal resume {} first",
                                            request.run.string(), request.run.string()));
  if (run.own_item().registers.empty())
    throw std::invalid_argument(
        fmt::format("{}: does not say which corrections the instrument applied; required: a run of an "
                    "instrument that tells them (docs/apply.md), by version 1.0 or later",
                    request.run.string()));
  CalibrationResult result = std::move(analysed.item(chosen).results.front());
  if (result.verdict == Verdict::kNotUsable)
    throw std::invalid_argument(fmt::format("{}: the result of {} is not usable: {}. Nothing was written",
                                            request.run.string(), result.estimator, result.why));
  if (result.verdict == Verdict::kDoubtful && !request.accept_doubtful)
    throw std::invalid_argument(
        fmt::format("{}: the result of {} is doubtful: {}; required: a usable one, or --accept-doubtful, if "
                    "this reason does not matter here. Nothing was written",
                    request.run.string(), result.estimator, result.why));
  return result;
}

/// @param item           its number in the run; also its number on the bench, unless the serial number is
///                        that of another item on it
/// @param serial_number  as the instrument reported it; empty: it reports none
void ApplySession::open(const ApplyRequest& request, int item, const std::string& serial_number) {
  start_ = {request.bench, request.as_left.string()};
  start_.labels["apply.of"] = request.run.filename().string();
  start_.without_missing_items = true;  // Others on the bench do not matter.
  const Identities found = session_.identify_instruments(start_);
  item_ = found.first();
  for (const ItemIdentity& each : found.items) {
    if (each.k == item) item_ = each;
  }
  for (const ItemIdentity& each : found.items) {
    if (!serial_number.empty() && each.accelerometer.serial_number == serial_number) item_ = each;
  }
  if (!item_.missing.empty())
    throw InstrumentError("item " + std::to_string(item_.k), Fault::kNotReady,
                          Message("{why}. Nothing was written", item_.missing));
}

/// The settings of the instrument in the bench file.
const AccelerometerConfig& ApplySession::config_of(const BenchConfig& config) const {
  const auto place = static_cast<std::size_t>(item_.k) - 1;
  return config.items.at(place < config.items.size() ? place : 0).accelerometer;
}

/// @param wanted  as the instrument reported it during the run; empty: it reports none, and `on_label`, as
/// the bench file had it, must be given again
void ApplySession::require_serial_number(const std::string& wanted, const std::string& on_label,
                                         const std::string& given) const {
  const AccelerometerInfo& now = item_.accelerometer;
  const auto refuse = [&](const std::string& why) {
    throw InstrumentError("accelerometer " + now.model, Fault::kWrongIdentity, why + ". Nothing was written");
  };
  if (now.serial_number != wanted)
    refuse(fmt::format("serial number {}; required: {}, which was calibrated",
                       now.serial_number.empty() ? "not reported" : now.serial_number,
                       wanted.empty() ? "none reported" : wanted));
  if (!wanted.empty()) return;
  if (on_label.empty())
    refuse(
        "it reports no serial number, and the run has none; required: serial_number under [item] of the "
        "bench file of the run");
  if (given != on_label)
    refuse(
        fmt::format("it reports no serial number; required: --label SERIAL, as it stands on the instrument "
                    "that is connected now: that of the run is {}{}",
                    on_label, given.empty() ? "" : ", " + given + " was given"));
}

void ApplySession::require_same_item(const StoredRun& run, const ApplyRequest& request) const {
  const BenchConfig& config = request.bench;
  const RunItem& item = run.own_item();
  const std::string& driver = config_of(config).driver;
  if (item.driver != driver)
    throw std::invalid_argument(fmt::format("{}: driver of the accelerometer is {}; required: {}, as in {}",
                                            request.bench_file, driver, item.driver, request.run.string()));
  if (is_simulated(parse_bench(run.header.bench_toml, request.run.string())) != is_simulated(config))
    throw std::invalid_argument(fmt::format(
        "{}: of the run and of this bench, one has a simulated accelerometer; required: both or none",
        request.bench_file));
  const InstrumentIdentity* before = accelerometer_of(run);
  if (before == nullptr || before->model != item_.accelerometer.model)
    throw InstrumentError("accelerometer " + item_.accelerometer.model, Fault::kWrongIdentity,
                          fmt::format("another model than in the run, {}. Nothing was written",
                                      before == nullptr ? "which names none" : before->model));
  require_serial_number(before->serial_number, item.serial_number, request.label);
}

ApplyReport ApplySession::compute(const ApplyRequest& request) {
  ApplyReport report;
  StoredRun run;
  report.found = find_result(request, run);
  const CorrectionConstants constants = constants_of(report.found, request.frame);
  const InstrumentIdentity* before = accelerometer_of(run);
  open(request, run.item, before == nullptr ? std::string() : before->serial_number);
  require_same_item(run, request);
  CorrectionRegisters& corrections = registers();
  ability_ = report.ability = corrections.ability();
  if (request.frame == ExportFrame::kPlatter && ability_.shape != CorrectionShape::kFull)
    throw std::invalid_argument(
        "--frame platter: these registers hold no matrix, so that they cannot correct the mounting; "
        "required: --frame item");
  report.item = run.item;
  report.driver = run.own_item().driver;
  report.model = item_.accelerometer.model;
  report.serial_number = item_.accelerometer.serial_number;
  report.unit = constants.response_unit;
  report.unit_mps2 = constants.unit_mps2.value_or(1.0);
  report.in_force = run.own_item().registers;
  report.before = item_.corrections;
  const OutputCorrection in_force = corrections.decode(report.in_force);
  (void)corrections.decode(report.before);  // Fails before anything is written.
  report.after = corrections.encode(composed(constants, in_force, ability_.shape), report.before);
  report.as_found = errors_of(constants);
  report.predicted = errors_with(constants, in_force, corrections.decode(report.after));
  return report;
}

ApplyReport ApplySession::apply(const ApplyRequest& request) {
  ApplyReport report = compute(request);
  if (request.dry_run) return report;
  const std::string who = "accelerometer " + report.model;
  if (ability_.keeps_at_once && !request.save)
    throw InstrumentError(who, Fault::kRefused,
                          "it keeps what is written when it is switched off: nothing can be tried first; "
                          "required: --save, if this is wanted. Nothing was written");
  if (request.save && !ability_.can_save)
    throw InstrumentError(
        who, Fault::kRefused,
        "it cannot keep its registers when it is switched off; required: no --save. Nothing was written");
  registers().require_writable();
  AdjustmentLog log(request.run);
  if (const Adjustment* last = log.last_to_undo(report.item); last != nullptr && last->is_unfinished())
    throw std::invalid_argument(fmt::format(
        "{}: an adjustment of {} ended half-way ({}); required: abcal apply {} --to {} --undo first",
        log.path().string(), last->utc, to_string(last->state), request.run.string(), request.bench_file));
  if (std::filesystem::exists(request.as_left))
    throw std::invalid_argument(
        fmt::format("{}: exists already; choose another name with -o", request.as_left.string()));
  report.log = log.path();
  carry_out(request, log, report);
  return report;
}

void ApplySession::store(AdjustmentLog& log, const Adjustment& adjustment, ApplyReport& report) const {
  log.update(adjustment);
  report.state = adjustment.state;
  if (options_.progress) options_.progress(adjustment);
}

void ApplySession::carry_out(const ApplyRequest& request, AdjustmentLog& log, ApplyReport& report) {
  Adjustment adjustment;
  adjustment.item = report.item;
  adjustment.utc = format_utc(RealClock().utc_now());
  adjustment.driver = report.driver;
  adjustment.model = report.model;
  adjustment.serial_number = report.serial_number;
  adjustment.label = request.label;
  adjustment.before = report.before;
  adjustment.after = report.after;
  adjustment.saved = ability_.keeps_at_once;
  log.begin(adjustment);
  if (options_.confirm && !options_.confirm(report)) {
    adjustment.state = AdjustmentState::kDeclined;
    store(log, adjustment, report);
    return;
  }
  const auto reach = [&](AdjustmentState state) {
    adjustment.state = state;
    store(log, adjustment, report);
  };
  try {
    write(report.after);
    reach(AdjustmentState::kWritten);
    verify(request, report);
    adjustment.as_left = report.as_left_run.string();
    reach(AdjustmentState::kVerified);
    if (!request.save) return;
    adjustment.saved = true;
    reach(AdjustmentState::kSaving);
    (void)accelerometer().identify();
    registers().save(report.after);
    require_read_back(report.after);
    reach(AdjustmentState::kSaved);
  } catch (const std::exception& error) {
    report.interrupted = dynamic_cast<const RunInterrupted*>(&error) != nullptr;
    report.failure = adjustment.why = error.what();
    take_back(log, adjustment, report);
  }
}

void ApplySession::write(const RegisterTexts& content) {
  (void)accelerometer().identify();
  registers().write(content);
  require_read_back(content);
}

void ApplySession::require_read_back(const RegisterTexts& wanted) {
  const AccelerometerInfo now = accelerometer().identify();
  if (now.serial_number != item_.accelerometer.serial_number)
    throw InstrumentError("accelerometer " + now.model, Fault::kWrongIdentity,
                          fmt::format("serial number {} meanwhile; required: {}", now.serial_number,
                                      item_.accelerometer.serial_number));
  const RegisterTexts found = accelerometer().correction_registers();
  CorrectionRegisters& corrections = registers();
  if (same_correction(corrections.decode(found), corrections.decode(wanted), ability_)) return;
  throw InstrumentError(
      "accelerometer " + now.model, Fault::kRefused,
      fmt::format("its registers read back as {}; required: {}", in_words(found), in_words(wanted)));
}

void ApplySession::verify(const ApplyRequest& request, ApplyReport& report) {
  session_.ask_corrections_again();
  const RunOutcome outcome = session_.start(start_);
  report.as_left_run = outcome.path;
  const AnalysedItem& item = outcome.item(item_.k);
  if (item.results.empty())
    throw std::runtime_error(fmt::format("the verification {} went on without the item: {}",
                                         outcome.path.string(), item.stored.own_progress().reason));
  report.left = request.estimator.empty() ? item.result() : result_of(item.results, request.estimator);
  if (report.left->verdict == Verdict::kNotUsable)
    throw std::runtime_error(
        fmt::format("the verification {} is not usable: {}", outcome.path.string(), report.left->why));
  report.as_left = errors_of(constants_of(*report.left, request.frame));
  if (const std::string words = disagreement(*report.as_left, report.predicted, ability_); !words.empty())
    throw std::runtime_error(
        fmt::format("the verification {} contradicts what was written: {}", outcome.path.string(), words));
}

void ApplySession::restore(const Adjustment& adjustment) {
  write(adjustment.before);
  if (!adjustment.saved) return;
  (void)accelerometer().identify();
  registers().save(adjustment.before);
  require_read_back(adjustment.before);
}

void ApplySession::take_back(AdjustmentLog& log, Adjustment adjustment, ApplyReport& report) {
  try {
    restore(adjustment);
    adjustment.state = AdjustmentState::kUndone;
    report.failure += ". The old registers are back, and were read back";
  } catch (const std::exception& error) {
    adjustment.state = AdjustmentState::kUndoFailed;
    report.failure += fmt::format(
        ". THE OLD REGISTERS COULD NOT BE BROUGHT BACK: {}. They are kept in {}; required: connect the "
        "instrument, and --undo",
        error.what(), log.path().string());
  }
  report.state = adjustment.state;
  try {
    store(log, adjustment, report);
  } catch (const std::exception& error) {
    report.failure += fmt::format(". This could not be stored: {}", error.what());
  }
}

ApplyReport ApplySession::undo(const ApplyRequest& request) {
  AdjustmentLog log(request.run);
  const Adjustment* last = log.last_to_undo(chosen_item(request.run, request.item));
  if (last == nullptr)
    throw std::invalid_argument(
        fmt::format("{}: nothing to undo", AdjustmentLog::path_beside(request.run).string()));
  Adjustment adjustment = *last;
  open(request, adjustment.item, adjustment.serial_number);
  const BenchConfig& config = request.bench;
  if (const std::string& driver = config_of(config).driver; driver != adjustment.driver)
    throw std::invalid_argument(fmt::format("{}: driver of the accelerometer is {}; required: {}",
                                            request.bench_file, driver, adjustment.driver));
  require_serial_number(adjustment.serial_number, adjustment.label, request.label);
  CorrectionRegisters& corrections = registers();
  ability_ = corrections.ability();
  corrections.require_writable();
  ApplyReport report;
  report.item = adjustment.item;
  report.driver = adjustment.driver;
  report.model = item_.accelerometer.model;
  report.serial_number = item_.accelerometer.serial_number;
  report.ability = ability_;
  report.before = item_.corrections;
  report.after = adjustment.before;
  report.log = log.path();
  if (!request.dry_run) {
    if (options_.confirm && !options_.confirm(report)) {
      report.state = AdjustmentState::kDeclined;
      return report;
    }
    restore(adjustment);
    adjustment.state = AdjustmentState::kUndone;
    store(log, adjustment, report);
  }
  report.state = adjustment.state;
  return report;
}

}  // namespace abcal
