#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal {

/// Holds an instrument's driver that can be made again after its port vanished: the state that a driver knew
/// of an unplugged instrument is no longer valid. While there is no driver, calls throw kLinkLost.
/// @tparam Instrument RotationStage or Accelerometer.
template <class Instrument>
class Replaceable {
 public:
  /// Opens those of its ports that are gone and makes a driver. @throws InstrumentError kCannotOpen,
  /// kLinkLost.
  using Make = std::function<std::unique_ptr<Instrument>()>;

  /// Makes the first one at once.
  Replaceable(std::string_view name, Make make) : name_(name), make_(std::move(make)), instrument_(make_()) {}

  /// A call has thrown kLinkLost since the driver was made.
  bool lost() const { return lost_; }

  /// Makes a new driver in place of the old one. @throws InstrumentError kCannotOpen, kLinkLost: not yet.
  void replace() {
    set(nullptr);  // Its last bytes go to the port that has vanished, not to the new one.
    std::unique_ptr<Instrument> made = make_();
    const std::lock_guard lock(between_drivers_);
    set(std::move(made));
    lost_ = false;
  }

  /// Makes `call` while there is no driver, and prevents a replacement meanwhile; nullopt if there is a
  /// driver.
  template <class Call>
  auto without_driver(const Call& call) -> std::optional<decltype(call())> {
    const std::lock_guard lock(between_drivers_);
    if (get()) return std::nullopt;
    return call();
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
  std::mutex between_drivers_;  ///< Taken before mutex_ where both are.
  std::shared_ptr<Instrument> instrument_;
  std::atomic<bool> lost_ = false;
};

/// A stage whose driver can be replaced. halt() may be called from any thread, also during the replacement.
///
/// The ports outlive the driver: while there is none, `halt_ports` halts the instruments on the remaining
/// ports by the drivers' recipes.
class ReplaceableStage final : public RotationStage {
 public:
  using HaltPorts = std::function<HaltReport()>;

  /// `halt_ports` must not throw; absent: without a driver nothing can be halted.
  explicit ReplaceableStage(Replaceable<RotationStage>::Make make, HaltPorts halt_ports = {})
      : stage_("stage", std::move(make)), halt_ports_(std::move(halt_ports)) {}

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
  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    stage_.guarded([&](RotationStage& stage) { stage.set_speed(axis, deg_per_s); });
  }
  MotionState motion_state(StageAxis axis) override {
    return stage_.guarded([&](RotationStage& stage) { return stage.motion_state(axis); });
  }
  Angle encoder_angle(StageAxis axis) override {
    return stage_.guarded([&](RotationStage& stage) { return stage.encoder_angle(axis); });
  }
  bool halt() noexcept override { return halt_axes().all_halted(); }
  HaltReport halt_axes() noexcept override {
    try {
      for (;;) {
        if (const std::shared_ptr<RotationStage> stage = stage_.get()) return stage->halt_axes();
        if (!halt_ports_) return {};
        if (const auto report = stage_.without_driver(halt_ports_)) return *report;
      }
    } catch (...) {  // A mutex failed, or memory is short: not acknowledged.
      return {};
    }
  }
  std::vector<HaltRecipe> halt_recipes() override {
    return stage_.guarded([](RotationStage& stage) { return stage.halt_recipes(); });
  }
  Clock::Duration reply_deadline() const override {
    const std::shared_ptr<RotationStage> stage = stage_.get();
    return stage ? stage->reply_deadline() : Clock::Duration{};
  }
  std::vector<StageEvent> take_events() override {
    const std::shared_ptr<RotationStage> stage = stage_.get();
    return stage ? stage->take_events() : std::vector<StageEvent>{};
  }

 private:
  Replaceable<RotationStage> stage_;
  HaltPorts halt_ports_;
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
  std::map<std::string, std::string> correction_registers() override {
    return accelerometer_.guarded([](Accelerometer& a) { return a.correction_registers(); });
  }
  CorrectionRegisters* corrections() override {
    return accelerometer_.guarded([](Accelerometer& a) { return a.corrections(); });
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
