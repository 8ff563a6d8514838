#include "tests/app/in_process_run.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "drivers/instrument/clock.h"

namespace abcal::test {

class InProcessRun::WatchedStage final : public RotationStage {
 public:
  WatchedStage(std::unique_ptr<RotationStage> inner, InProcessRun& run)
      : inner_(std::move(inner)), run_(run) {}
  StageInfo identify() override {
    run_.before("identify");
    return inner_->identify();
  }
  void home(StageAxis axis) override {
    run_.before("home");
    inner_->home(axis);
  }
  void move_to(StageAxis axis, Angle target) override {
    run_.before("move_to");
    inner_->move_to(axis, target);
  }
  MotionState motion_state(StageAxis axis) override {
    run_.before("motion_state");
    return inner_->motion_state(axis);
  }
  Angle encoder_angle(StageAxis axis) override {
    run_.before("encoder_angle");
    return inner_->encoder_angle(axis);
  }
  bool halt() noexcept override {
    ++run_.halts_;
    return inner_->halt();
  }

 private:
  std::unique_ptr<RotationStage> inner_;
  InProcessRun& run_;
};

class InProcessRun::WatchedAccelerometer final : public Accelerometer {
 public:
  WatchedAccelerometer(std::unique_ptr<Accelerometer> inner, InProcessRun& run)
      : inner_(std::move(inner)), run_(run) {}
  AccelerometerInfo identify() override {
    run_.before("identify accelerometer");
    return inner_->identify();
  }
  void start() override {
    run_.before("start");
    inner_->start();
  }
  std::optional<Reading> next(Clock::Instant deadline) override {
    run_.before("next");
    return inner_->next(deadline);
  }
  void discard_pending() override {
    run_.before("discard_pending");
    inner_->discard_pending();
  }
  std::map<std::string, std::string> correction_registers() override {
    run_.before("correction_registers");
    return inner_->correction_registers();
  }
  CorrectionRegisters* corrections() override { return inner_->corrections(); }
  StreamHealth health() const override { return inner_->health(); }
  void stop() noexcept override { inner_->stop(); }

 private:
  std::unique_ptr<Accelerometer> inner_;
  InProcessRun& run_;
};

void InProcessRun::before(std::string_view call) {
  ++calls_;
  if (before_call) before_call(call, calls_);
}

void InProcessRun::watch(Bench& bench) {
  bench.stage = std::make_unique<WatchedStage>(std::move(bench.stage), *this);
  std::unique_ptr<Accelerometer>& accelerometer = bench.first().accelerometer;
  accelerometer = std::make_unique<WatchedAccelerometer>(std::move(accelerometer), *this);
}

void InProcessRun::run_to_end() {
  calls_ = halts_ = 0;
  left_moving_ = false;
  longest_angle_s_ = 0.0;
  finished_.reset();
  if (exists() && RunFile::load(path_).state == RunState::kComplete) {
    const auto analyst = make_run_analyst([this](const RunOutcome& outcome) { finished_ = outcome; });
    (void)finish_measured_run(path_, analyst.get(), nullptr);
    return;
  }
  std::optional<Clock::Instant> last;  // When an angle was measured.
  const Bench* bench = nullptr;
  const auto note_time = [&] {
    const Clock::Instant now = bench->clock->now();
    if (last) longest_angle_s_ = std::max(longest_angle_s_, to_seconds(now - *last));
    last = now;
  };
  RunSession::Options options;
  options.open_bench = [this](const BenchConfig& config, BenchStreams streams) {
    BenchConfig changed = config;
    if (change_bench) change_bench(changed);
    Bench made = make_bench(changed, std::move(streams));
    watch(made);
    return made;
  };
  std::optional<RunSession> session;
  options.listener = [&](const SessionEvent& event) {
    bench = session->bench();
    if (std::holds_alternative<RunBeganEvent>(event)) last = bench->clock->now();
    if (const auto* done = std::get_if<DwellDoneEvent>(&event)) {
      reported_.insert(done->position);
      note_time();
    }
  };
  session.emplace(std::move(options));
  // After the end of the run the bench continues: no axis may turn any more except to come to rest.
  const auto look = [&] {
    constexpr Clock::Duration kToRest = std::chrono::milliseconds(500);
    if (bench == nullptr) return;  // It ended before there was a run.
    const Clock::Instant now = bench->clock->now();
    note_time();
    simulated_s_ = to_seconds(now - bench->world->start());
    for (const StageAxis axis : kStageAxes) {
      left_moving_ = left_moving_ || bench->world->motion_end(axis, now) > now + kToRest;
    }
  };
  try {
    if (exists()) {
      finished_ = session->resume({path_.string()});
    } else {
      BenchConfig config = parse_bench(bench_toml_, "bench.toml");
      if (change_bench) change_bench(config);
      finished_ = session->start({config, path_.string()});
    }
  } catch (...) {
    look();
    throw;
  }
  look();
}

}  // namespace abcal::test
