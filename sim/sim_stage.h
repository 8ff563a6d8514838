#pragma once

#include <array>
#include <memory>
#include <string>

#include "drivers/instrument/rotation_stage.h"
#include "sim/sim_bench.h"

namespace abcal::sim {

/// The simulated stage behind the driver interface directly, with no bytes in between, in protocol angles.
class SimStage final : public RotationStage {
 public:
  SimStage(std::shared_ptr<SimBench> bench, Clock& clock, std::string serial_number = "SIM-1");

  StageInfo identify() override;
  void home(StageAxis axis) override;
  /// @throws InstrumentError kNotReady before home(), kOutOfTravel.
  void move_to(StageAxis axis, Angle target) override;
  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override;
  MotionState motion_state(StageAxis axis) override;
  Angle encoder_angle(StageAxis axis) override;
  bool halt() noexcept override;

 private:
  struct Axis {
    bool referenced = false;
    std::optional<Clock::Instant> homing_until;
  };
  void update(StageAxis axis, Clock::Instant now);

  std::shared_ptr<SimBench> bench_;
  Clock& clock_;
  std::string serial_number_;
  std::mutex mutex_;
  std::array<Axis, 2> axes_;
};

}  // namespace abcal::sim
