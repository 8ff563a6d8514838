#pragma once

// A stage that is reached through its maker's library. Here the library is a table of two axes that turn at
// constant speed; in earnest each function calls it.

#include <abcal/instrument.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <mutex>
#include <string>

namespace factory {

class Stage final : public abcal::RotationStage {
 public:
  Stage(abcal::Clock& clock, double speed_deg_per_s) : clock_(clock), speed_(speed_deg_per_s) {}

  abcal::StageInfo identify() override {
    abcal::StageInfo info;
    info.maker = "factory";
    info.model = "turntable";
    info.serial_number = "7";
    for (abcal::StageAxisInfo& axis : info.axes) {
      axis.travel_min = abcal::Angle::degrees(-kTravel);
      axis.travel_max = abcal::Angle::degrees(kTravel);
      axis.speed_deg_per_s = speed_;
      axis.referenced = true;
    }
    return info;
  }

  void home(abcal::StageAxis) override {}

  void move_to(abcal::StageAxis axis, abcal::Angle target) override {
    if (std::abs(target.deg()) > kTravel)
      throw abcal::InstrumentError(
          "factory stage", abcal::Fault::kOutOfTravel,
          "found " + std::to_string(target.deg()) + " deg; required: within 360 deg");
    const std::lock_guard lock(mutex_);
    Motion& motion = axes_[abcal::index(axis)];
    motion = {at(motion), target.deg(), clock_.now()};
  }

  abcal::MotionState motion_state(abcal::StageAxis axis) override {
    const std::lock_guard lock(mutex_);
    const Motion& motion = axes_[abcal::index(axis)];
    return at(motion) == motion.to ? abcal::MotionState::kStopped : abcal::MotionState::kMoving;
  }

  abcal::Angle encoder_angle(abcal::StageAxis axis) override {
    const std::lock_guard lock(mutex_);
    return abcal::Angle::degrees(at(axes_[abcal::index(axis)]));
  }

  // From any thread.
  bool halt() noexcept override {
    const std::lock_guard lock(mutex_);
    for (Motion& motion : axes_) {
      const double here = at(motion);
      motion = {here, here, clock_.now()};
    }
    return true;
  }

 private:
  static constexpr double kTravel = 360.0;
  struct Motion {
    double from = 0.0;
    double to = 0.0;
    abcal::Clock::Instant begin{};
  };

  double at(const Motion& motion) const {
    const double way = motion.to - motion.from;
    const double gone = speed_ * abcal::to_seconds(clock_.now() - motion.begin);
    return gone >= std::abs(way) ? motion.to : motion.from + std::copysign(gone, way);
  }

  abcal::Clock& clock_;
  double speed_;
  std::mutex mutex_;
  std::array<Motion, 2> axes_{};
};

}  // namespace factory
