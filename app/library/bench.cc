#include "abcal/bench.h"

#include <exception>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <stop_token>
#include <utility>
#include <variant>

#include "app/analysed_run/run_session.h"
#include "app/bench_file/bench_records.h"
#include "app/bench_file/not_real.h"
#include "app/commands/demo_bench.h"
#include "app/document/json_text.h"
#include "app/laboratory/issuing/register_link.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/library/data.h"
#include "app/library/helper_folder.h"
#include "app/measure/bench/make_bench.h"
#include "app/measure/session/bench_check.h"
#include "app/measure/session/run_bench.h"
#include "app/results/analysis/load_record.h"

namespace abcal::v1 {

Stopped::~Stopped() = default;

struct [[gnu::visibility("hidden")]] Bench::Data {
  std::filesystem::path file;
  ::abcal::BenchConfig config;
  /// State of the present call; hold(), go_on() and halt() use it from other threads.
  std::mutex mutex;
  ::abcal::RunSession* session = nullptr;
  std::optional<std::stop_source> stop;

  /// Makes one call to the instruments at a time reachable for halt().
  class Call;
  CompleteRun measured(const Listener& listener,
                       const std::function<::abcal::RunOutcome(::abcal::RunSession&)>& call);
};

namespace {

Event public_event(const ::abcal::SessionEvent& event) {
  const char* const name =
      std::visit([](const auto& each) { return std::decay_t<decltype(each)>::kName; }, event);
  return {name, ::abcal::json_text(::abcal::to_json_object(event))};
}

/// Passes events on; the first exception of the listener requests the stop and is kept.
class Guarded {
 public:
  Guarded(const Listener& listener, std::stop_source& stop) : listener_(listener), stop_(stop) {}

  ::abcal::SessionListener session_listener() {
    if (!listener_) return {};
    return [this](const ::abcal::SessionEvent& event) {
      if (failure_) return;
      try {
        listener_(public_event(event));
      } catch (...) {
        failure_ = std::current_exception();  // thrown again by rethrow()
        stop_.request_stop();
      }
    };
  }
  void rethrow() const {
    if (failure_) std::rethrow_exception(failure_);
  }

 private:
  const Listener& listener_;
  std::stop_source& stop_;
  std::exception_ptr failure_;
};

}  // namespace

class [[gnu::visibility("hidden")]] Bench::Data::Call {
 public:
  Call(Data & data, ::abcal::RunSession * session, const std::stop_source& stop) : data_(data) {
    const std::lock_guard lock(data_.mutex);
    if (data_.stop)
      throw std::runtime_error(data_.file.string() +
                               ": a check or run of this bench is under way; required: its end, or halt()");
    data_.session = session;
    data_.stop = stop;
  }
  ~Call() {
    const std::lock_guard lock(data_.mutex);
    data_.session = nullptr;
    data_.stop.reset();
  }
  Call(const Call&) = delete;
  Call& operator=(const Call&) = delete;

 private:
  Data& data_;
};

CompleteRun Bench::Data::measured(const Listener& listener,
                                  const std::function<::abcal::RunOutcome(::abcal::RunSession&)>& call) {
  find_helpers();
  std::stop_source stop_source;
  Guarded guarded(listener, stop_source);
  std::optional<::abcal::RunOutcome> outcome;
  {
    ::abcal::RunSession::Options options;
    options.listener = guarded.session_listener();
    options.stop = stop_source.get_token();
    options.laboratory = ::abcal::laboratory_link();
    ::abcal::RunSession run_session(std::move(options));
    const Call reachable(*this, &run_session, stop_source);
    try {
      outcome = call(run_session);
    } catch (const ::abcal::RunInterrupted& interrupted) {
      guarded.rethrow();
      throw Stopped(interrupted.what());
    }
  }
  guarded.rethrow();
  // With several items, the first that was measured to the end; load("RUN#K") reads each.
  const ::abcal::AnalysedItem& item = outcome->item(::abcal::shown_item(outcome->stored(), 0));
  if (item.results.empty())
    throw std::runtime_error(outcome->path.string() + ": a levelling, not a calibration; it has no result");
  std::vector<Result> results;
  for (const ::abcal::CalibrationResult& each : item.results)
    results.push_back(public_result(each, item.stored.record));
  return {outcome->path, outcome->sha256, public_result(item.result(), item.stored.record),
          std::move(results)};
}

Bench::Bench(const std::filesystem::path& file) : data_(std::make_unique<Data>()) {
  data_->file = file;
  data_->config = ::abcal::read_bench(file, ::abcal::register_records());
}

Bench::~Bench() = default;
Bench::Bench(Bench&&) noexcept = default;
Bench& Bench::operator=(Bench&&) noexcept = default;

std::string Bench::name() const {
  return data_->config.name;
}
std::string Bench::toml() const {
  return ::abcal::write_bench(data_->config);
}
std::vector<std::string> Bench::warnings() const {
  return data_->config.warnings;
}
std::string demo_bench(int steps) {
  return ::abcal::demo_bench_in_process(steps);
}

std::vector<std::string> Bench::simulated() const {
  return ::abcal::simulated_instruments(data_->config);
}

std::vector<CheckFinding> Bench::check(bool with_motion, const Listener& listener) {
  find_helpers();
  std::stop_source stop;
  Guarded guarded(listener, stop);
  std::vector<CheckFinding> list;
  {
    const Data::Call reachable(*data_, nullptr, stop);
    ::abcal::Bench bench = ::abcal::make_bench(data_->config);
    try {
      for (const ::abcal::Finding& finding : ::abcal::check_bench(
               bench, data_->config, {!with_motion, guarded.session_listener(), stop.get_token()}))
        list.push_back(
            {std::string(::abcal::to_string(finding.grade)), finding.what, finding.found, finding.advice});
    } catch (const ::abcal::RunInterrupted& interrupted) {
      guarded.rethrow();
      throw Stopped(interrupted.what());
    }
  }
  guarded.rethrow();
  return list;
}

CompleteRun Bench::run(const std::filesystem::path& run_file, const Listener& listener) {
  const std::filesystem::path path = ::abcal::output_path(run_file.string(), data_->file.string(), ".run");
  return data_->measured(listener, [&](::abcal::RunSession& session) {
    return session.start({data_->config, path.string()});
  });
}

CompleteRun Bench::resume(const std::filesystem::path& run_file, const Listener& listener) {
  return data_->measured(listener,
                         [&](::abcal::RunSession& session) { return session.resume({run_file.string()}); });
}

void Bench::hold() {
  const std::lock_guard lock(data_->mutex);
  if (data_->session != nullptr) data_->session->hold();
}

void Bench::go_on() {
  const std::lock_guard lock(data_->mutex);
  if (data_->session != nullptr) data_->session->continue_run();
}

void Bench::halt() {
  std::optional<std::stop_source> stop;
  {
    const std::lock_guard lock(data_->mutex);
    stop = data_->stop;
  }
  if (stop) stop->request_stop();
}

}  // namespace abcal::v1
