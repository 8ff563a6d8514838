#pragma once

#include <gtest/gtest.h>

#include <array>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "protocol/run/run_context.h"
#include "protocol/run/run_instruments.h"
#include "sim/sim_clock.h"
#include "tests/support/temporary_folder.h"

namespace abcal::test {

/// Keeps the reports of a part of a run.
class KeepingObserver final : public RunObserver {
 public:
  void phase(std::size_t position, RunPhase phase) override { phases.emplace_back(position, phase); }
  void dwells(std::size_t, std::span<const ItemDwell>) override {}
  void notice(std::string_view kind, const Message& text, std::optional<int>) override {
    notices.emplace_back(kind, text);
  }
  std::vector<std::pair<std::size_t, RunPhase>> phases;
  std::vector<std::pair<std::string, std::string>> notices;
};

/// A stage whose axes do exactly what the test says.
class ScriptedStage final : public RotationStage {
 public:
  struct Axis {
    Angle encoder;
    Angle error;               ///< Stop position minus target.
    int polls_until_stop = 1;  ///< After a command.
    bool finds_reference = true;
    int polls_left = 0;
    bool referenced = false;
  };

  StageInfo identify() override {
    if (on_identify) on_identify();
    StageInfo info;
    info.model = model;
    info.serial_number = "1";
    for (std::size_t k = 0; k < 2; ++k) {
      info.axes[k].speed_deg_per_s = 10.0;
      info.axes[k].referenced = axes[k].referenced;
    }
    return info;
  }
  void home(StageAxis axis) override {
    Axis& a = axes[index(axis)];
    a.polls_left = a.polls_until_stop;
    a.referenced = a.finds_reference;
    ++homed;
  }
  void move_to(StageAxis axis, Angle target) override {
    Axis& a = axes[index(axis)];
    a.encoder = target + a.error;
    a.polls_left = a.polls_until_stop;
    moves.emplace_back(axis, target);
  }
  MotionState motion_state(StageAxis axis) override {
    return axes[index(axis)].polls_left-- > 0 ? MotionState::kMoving : MotionState::kStopped;
  }
  Angle encoder_angle(StageAxis axis) override { return axes[index(axis)].encoder; }
  bool halt() noexcept override {
    ++halts;
    return acknowledges_halt;
  }

  std::string model = "scripted";
  std::array<Axis, 2> axes;
  std::vector<std::pair<StageAxis, Angle>> moves;
  std::function<void()> on_identify;
  bool acknowledges_halt = true;
  int halts = 0, homed = 0;
};

/// An accelerometer that gives the readings of a function, one each 10 ms.
class ScriptedAccelerometer final : public Accelerometer {
 public:
  explicit ScriptedAccelerometer(Clock& clock) : clock_(clock) {}
  AccelerometerInfo identify() override {
    AccelerometerInfo info;
    info.model = "scripted";
    info.serial_number = serial_number;
    info.output_unit = "g";
    info.rate_hz = 100.0;
    return info;
  }
  void start() override {}
  std::optional<Reading> next(Clock::Instant deadline) override {
    const Clock::Instant due = clock_.now() + std::chrono::milliseconds(10);
    if (!output || due > deadline) {
      clock_.sleep_until(deadline);
      return std::nullopt;
    }
    clock_.sleep_until(due);
    Reading reading;
    reading.output = output(count);
    reading.sequence = count++;
    reading.arrival = due;
    reading.temperature_degc = temperature_degc;
    return reading;
  }
  void discard_pending() override { ++discards; }
  StreamHealth health() const override { return {count, lost, 0, 0}; }
  void stop() noexcept override {}

  std::function<Eigen::Vector3d(std::uint64_t)> output;  ///< Empty: silent.
  std::optional<double> temperature_degc;
  std::string serial_number = "2";
  std::uint64_t count = 0, lost = 0;
  int discards = 0;

 private:
  Clock& clock_;
};

/// Surroundings that the parts of a run need.
class RunPartsTest : public testing::Test {
 protected:
  RunContext& context() {
    if (!context_) {
      file_.emplace(RunFile::create(folder / "a.run", RunHeader{}));
      context_ = std::make_unique<RunContext>(StoppableClock(clock, token_), settings, RunTiming{}, *file_,
                                              observer);
      context_->stage_info = stage.identify();
      context_->accelerometer_info = accelerometer.identify();
    }
    return *context_;
  }

  RunInstruments instruments(Reconnector* reconnector = nullptr) {
    return {stage,
            clock,
            {{1, accelerometer, settings.limits, settings.tolerances, settings.expected}},
            false,
            reconnector};
  }

  /// Noise of 1e-4 that differs from reading to reading, the same in each test.
  static Eigen::Vector3d noisy(std::uint64_t k) {
    const auto part = [&](std::uint64_t seed) {
      const std::uint64_t mixed = (k + 1) * 6364136223846793005U + seed * 1442695040888963407U;
      return static_cast<double>((mixed >> 33U) % 2001U) / 1000.0 - 1.0;
    };
    return {0.1 + 1e-4 * part(1), 0.2 + 1e-4 * part(2), 1.0 + 1e-4 * part(3)};
  }

  /// The fault that `call` ends with, and its words.
  template <class Call>
  static std::pair<Fault, std::string> failure_of(Call call) {
    try {
      call();
    } catch (const InstrumentError& error) {
      return {error.fault(), error.what()};
    }
    ADD_FAILURE() << "nothing was thrown";
    return {Fault::kRefused, ""};
  }

  TemporaryFolder folder;
  sim::SimClock clock;
  RunSettings settings;
  KeepingObserver observer;
  ScriptedStage stage;
  ScriptedAccelerometer accelerometer{clock};
  std::stop_source stop;

 private:
  std::stop_token token_ = stop.get_token();
  std::optional<RunFile> file_;
  std::unique_ptr<RunContext> context_;
};

}  // namespace abcal::test
