// A third-party stage, without bytes, under the installed contract.

#include <array>
#include <cmath>
#include <memory>

#include "tests/contract/instrument_contract.h"

namespace abcal::contract {
namespace {

/// A clock that jumps.
class JumpingClock final : public Clock {
 public:
  Instant now() const override { return now_; }
  void sleep_until(Instant instant) override { now_ = std::max(now_, instant); }
  UtcTime utc_now() const override { return {}; }

 private:
  Instant now_{};
};

class OutsideStage final : public RotationStage {
 public:
  explicit OutsideStage(Clock& clock) : clock_(clock) {}

  StageInfo identify() override {
    StageInfo info;
    info.model = "outside";
    for (StageAxisInfo& axis : info.axes) {
      axis.travel_min = Angle::degrees(-200.0);
      axis.travel_max = Angle::degrees(200.0);
      axis.referenced = true;
    }
    return info;
  }
  void home(StageAxis) override {}
  void move_to(StageAxis axis, Angle target) override {
    if (std::abs(target.deg()) > 200.0) throw InstrumentError("outside", Fault::kOutOfTravel, "200 deg");
    Motion& motion = axes_[index(axis)];
    motion = {encoder_angle(axis).deg(), target.deg(), clock_.now()};
  }
  MotionState motion_state(StageAxis axis) override {
    return encoder_angle(axis).deg() == axes_[index(axis)].to ? MotionState::kStopped : MotionState::kMoving;
  }
  Angle encoder_angle(StageAxis axis) override {
    constexpr double kSpeed = 20.0;  // Degrees per second.
    const Motion& motion = axes_[index(axis)];
    const double way = motion.to - motion.from;
    const double gone = kSpeed * to_seconds(clock_.now() - motion.begin);
    return Angle::degrees(gone >= std::abs(way) ? motion.to : motion.from + std::copysign(gone, way));
  }
  bool halt() noexcept override {
    for (const StageAxis axis : kStageAxes) {
      const double at = encoder_angle(axis).deg();
      axes_[index(axis)] = {at, at, clock_.now()};
    }
    return true;
  }

 private:
  struct Motion {
    double from = 0.0;
    double to = 0.0;
    Clock::Instant begin{};
  };
  Clock& clock_;
  std::array<Motion, 2> axes_{};
};

StageBench make_outside_bench() {
  auto clock = std::make_shared<JumpingClock>();
  return {clock, std::make_shared<OutsideStage>(*clock)};
}

INSTANTIATE_TEST_SUITE_P(Outside, StageContract, testing::Values(StageCase{"stage", make_outside_bench}),
                         [](const auto& one) { return one.param.name; });

}  // namespace

// No accelerometer here.
GTEST_ALLOW_UNINSTANTIATED_PARAMETERIZED_TEST(AccelerometerContract);

}  // namespace abcal::contract
