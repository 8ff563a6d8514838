#pragma once

#include <array>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "app/system/real_clock.h"
#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal::console {

/// An encoder angle or a commanded angle of one axis.
struct StageSeen {
  StageAxis axis = StageAxis::kX;
  std::optional<Angle> encoder;  ///< As the run read it.
  std::optional<Angle> target;   ///< As the run commanded it.
};

/// A halt command to the stage, from any source.
struct HaltSeen {
  HaltReport report;
  double took_s = 0.0;   ///< Real time until the last axis had answered, or was given up.
  Clock::UtcTime since;  ///< Real time.
};

/// The readings of a short while of real time.
struct StripSeen {
  int item = 1;            ///< Number of the item.
  std::size_t stream = 0;  ///< Grows with each start of the stream: the times of two streams do not compare.
  double time_s = 0.0;     ///< Last reading, in the bench's time since the first one of the stream.
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Vector3d lowest = Eigen::Vector3d::Zero();
  Eigen::Vector3d highest = Eigen::Vector3d::Zero();  ///< R, all three.
  int readings = 0;
  std::string unit;  ///< R, as the accelerometer named it; empty: not asked.
  std::optional<double> temperature_degc;
};

/// A stage that publishes its commands and replies. It sends no queries of its own: a watched run sends the
/// same bytes as an unwatched one.
class WatchedStage final : public RotationStage {
 public:
  /// `see` and `see_halt` must return at once; halts are seen from any thread.
  WatchedStage(std::unique_ptr<RotationStage> stage, std::function<void(const StageSeen&)> see,
               std::function<void(const HaltSeen&)> see_halt);

  StageInfo identify() override { return stage_->identify(); }
  void home(StageAxis axis) override { stage_->home(axis); }
  void move_to(StageAxis axis, Angle target) override;
  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    stage_->set_speed(axis, deg_per_s);
  }
  MotionState motion_state(StageAxis axis) override { return stage_->motion_state(axis); }
  Angle encoder_angle(StageAxis axis) override;
  bool halt() noexcept override { return halt_axes().all_halted(); }
  HaltReport halt_axes() noexcept override;
  std::vector<HaltRecipe> halt_recipes() override { return stage_->halt_recipes(); }
  Clock::Duration reply_deadline() const override { return stage_->reply_deadline(); }
  std::vector<StageEvent> take_events() override { return stage_->take_events(); }

 private:
  std::unique_ptr<RotationStage> stage_;
  std::function<void(const StageSeen&)> see_;
  std::function<void(const HaltSeen&)> see_halt_;
};

/// The number of an accelerometer's item, and the number of items of the bench.
struct ItemOfBench {
  int k = 1;
  std::size_t of = 1;  ///< Number of items.
};

/// An accelerometer whose readings are also passed on, in groups. All items of a bench together have at most
/// 20 groups a second, so that several cost a page no more than one.
class WatchedAccelerometer final : public Accelerometer {
 public:
  /// `see` must return at once.
  WatchedAccelerometer(std::unique_ptr<Accelerometer> accelerometer,
                       std::function<void(const StripSeen&)> see, ItemOfBench item);

  AccelerometerInfo identify() override;
  void start() override;
  std::optional<Reading> next(Clock::Instant deadline) override;
  void discard_pending() override { accelerometer_->discard_pending(); }
  std::map<std::string, std::string> correction_registers() override {
    return accelerometer_->correction_registers();
  }
  CorrectionRegisters* corrections() override { return accelerometer_->corrections(); }
  StreamHealth health() const override { return accelerometer_->health(); }
  void stop() noexcept override { accelerometer_->stop(); }

 private:
  void note(const Reading& reading);

  std::unique_ptr<Accelerometer> accelerometer_;
  std::function<void(const StripSeen&)> see_;
  ItemOfBench item_;
  RealClock real_;  // Real time, for people.
  Clock::Instant last_seen_{};
  std::optional<Clock::Instant> first_arrival_;
  std::string unit_;
  StripSeen group_;
  std::size_t streams_ = 0;
};

}  // namespace abcal::console
