#include "tests/app/in_process_run.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "drivers/instrument/clock.h"
#include "protocol/plan/rotation_plan.h"

namespace abcal::test {

class InProcessRun::Observer final : public RunObserver {
 public:
  Observer(InProcessRun& run, const Clock& clock) : run_(run), clock_(clock), last_(clock.now()) {}
  void phase(std::size_t, RunPhase) override {}
  void dwell(std::size_t position, const DwellRecord&) override {
    run_.reported_.insert(position);
    note_time();
  }
  void notice(std::string_view, std::string_view) override {}
  void note_time() {
    const Clock::Instant now = clock_.now();
    run_.longest_angle_s_ = std::max(run_.longest_angle_s_, to_seconds(now - std::exchange(last_, now)));
  }

 private:
  InProcessRun& run_;
  const Clock& clock_;
  Clock::Instant last_;
};

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
  bench.accelerometer = std::make_unique<WatchedAccelerometer>(std::move(bench.accelerometer), *this);
}

void InProcessRun::go_on() {
  calls_ = halts_ = 0;
  left_moving_ = false;
  longest_angle_s_ = 0.0;
  finished_.reset();
  if (exists()) {
    finished_ = finish_killed_run(path_);
    if (finished_ || RunFile::load(path_).state == RunState::kComplete) return;
    InterruptedRun run = open_interrupted_run(path_);
    if (change_bench) change_bench(run.config);
    Bench bench = make_bench(run.config);
    watch(bench);
    continue_run(run, bench);
    measure_to_the_end(bench, run.config, std::move(run.file), run.stored.header.plan, run.so_far);
  } else {
    BenchConfig config = parse_bench(bench_toml_, "bench.toml");
    if (change_bench) change_bench(config);
    Bench bench = make_bench(config);
    watch(bench);
    const Identities who = identify(bench, config);
    const std::vector<PlannedAngle> plan = make_rotation_plan(config.protocol, who.travel());
    measure_to_the_end(bench, config, begin_run(bench, config, who, plan, path_, nullptr), plan, {});
  }
}

void InProcessRun::measure_to_the_end(Bench& bench, const BenchConfig& config, RunFile file,
                                      const std::vector<PlannedAngle>& plan, const RunProgress& so_far) {
  Observer observer(*this, *bench.clock);
  // Once the run is left, the bench goes on by itself: nothing may turn any more but for coming to rest.
  const auto look = [&] {
    constexpr Clock::Duration kToRest = std::chrono::milliseconds(500);
    const Clock::Instant now = bench.clock->now();
    observer.note_time();
    simulated_s_ = to_seconds(now - bench.world->start());
    for (const StageAxis axis : kStageAxes) {
      left_moving_ = left_moving_ || bench.world->motion_end(axis, now) > now + kToRest;
    }
  };
  try {
    const RunTiming timing =
        measure(bench, config, file, plan, so_far, observer, std::stop_source().get_token());
    finished_ = finish_run(bench, config, std::move(file), timing);
  } catch (...) {
    look();
    throw;
  }
  look();
}

}  // namespace abcal::test
