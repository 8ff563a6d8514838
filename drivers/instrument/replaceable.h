#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal {

/// Holds an instrument's driver that can be made anew after its port vanished: what a driver knew of an
/// instrument that was unplugged is worth nothing. While there is none, calls throw kLinkLost.
/// @tparam Instrument RotationStage or Accelerometer.
template <class Instrument>
class Replaceable {
 public:
  /// Opens what is gone of its ports and makes a driver. @throws InstrumentError kCannotOpen, kLinkLost.
  using Make = std::function<std::unique_ptr<Instrument>()>;

  /// Makes the first one at once.
  Replaceable(std::string_view name, Make make) : name_(name), make_(std::move(make)), instrument_(make_()) {}

  /// A call has thrown kLinkLost since the driver was made.
  bool lost() const { return lost_; }

  /// Makes a new driver in place of the old one. @throws InstrumentError kCannotOpen, kLinkLost: not yet.
  void replace() {
    set(nullptr);  // Its last words go to the port that is gone, not to the one that comes.
    set(make_());
    lost_ = false;
  }

  template <class Call>
  auto guarded(const Call& call) {
    const std::shared_ptr<Instrument> used = get();
    if (!used) throw InstrumentError(name_, Fault::kLinkLost, "its port is gone");
    try {
      return call(*used);
    } catch (const InstrumentError& error) {
      if (error.fault() == Fault::kLinkLost) lost_ = true;
      throw;
    }
  }

  /// Null: between two drivers.
  std::shared_ptr<Instrument> get() const {
    const std::lock_guard lock(mutex_);
    return instrument_;
  }

 private:
  void set(std::shared_ptr<Instrument> instrument) {
    {
      const std::lock_guard lock(mutex_);
      std::swap(instrument_, instrument);
    }
    // The old one is destroyed here, outside the lock: a halt must not wait for it.
  }

  std::string name_;
  Make make_;
  mutable std::mutex mutex_;
  std::shared_ptr<Instrument> instrument_;
  std::atomic<bool> lost_ = false;
};

/// A stage whose driver can be replaced. halt() from any thread, also meanwhile.
class ReplaceableStage final : public RotationStage {
 public:
  explicit ReplaceableStage(Replaceable<RotationStage>::Make make) : stage_("stage", std::move(make)) {}

  bool lost() const { return stage_.lost(); }
  void replace() { stage_.replace(); }

  StageInfo identify() override {
    return stage_.guarded([](RotationStage& stage) { return stage.identify(); });
  }
  void home(StageAxis axis) override {
    stage_.guarded([&](RotationStage& stage) { stage.home(axis); });
  }
  void move_to(StageAxis axis, Angle target) override {
    stage_.guarded([&](RotationStage& stage) { stage.move_to(axis, target); });
  }
  MotionState motion_state(StageAxis axis) override {
    return stage_.guarded([&](RotationStage& stage) { return stage.motion_state(axis); });
  }
  Angle encoder_angle(StageAxis axis) override {
    return stage_.guarded([&](RotationStage& stage) { return stage.encoder_angle(axis); });
  }
  bool halt() noexcept override {
    const std::shared_ptr<RotationStage> stage = stage_.get();
    return stage && stage->halt();
  }

 private:
  Replaceable<RotationStage> stage_;
};

/// An accelerometer whose driver can be replaced.
class ReplaceableAccelerometer final : public Accelerometer {
 public:
  explicit ReplaceableAccelerometer(Replaceable<Accelerometer>::Make make)
      : accelerometer_("accelerometer", std::move(make)) {}

  bool lost() const { return accelerometer_.lost(); }
  void replace() { accelerometer_.replace(); }

  AccelerometerInfo identify() override {
    return accelerometer_.guarded([](Accelerometer& a) { return a.identify(); });
  }
  void start() override {
    accelerometer_.guarded([](Accelerometer& a) { a.start(); });
  }
  std::optional<Reading> next(Clock::Instant deadline) override {
    return accelerometer_.guarded([&](Accelerometer& a) { return a.next(deadline); });
  }
  void discard_pending() override {
    accelerometer_.guarded([](Accelerometer& a) { a.discard_pending(); });
  }
  StreamHealth health() const override {
    const std::shared_ptr<Accelerometer> accelerometer = accelerometer_.get();
    return accelerometer ? accelerometer->health() : StreamHealth{};
  }
  void stop() noexcept override {
    if (const std::shared_ptr<Accelerometer> accelerometer = accelerometer_.get()) accelerometer->stop();
  }

 private:
  Replaceable<Accelerometer> accelerometer_;
};

}  // namespace abcal
