#pragma once

#include <array>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/measure/guard/halt_guard.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal {

/// Kind of the events that report whether a stage has a guard.
inline constexpr std::string_view kGuardEvent = "guard";

/// A stage on one port that a guard has opened. The guard knows how to halt it before it moves, and which
/// axis may be moving; it holds the leases of the stage once that has identified itself. After a halt by the
/// guard each call throws kStalled with its reason: a person continues.
class GuardedStage final : public RotationStage {
 public:
  /// @param port  InstrumentPort::name
  /// @param driver  InstrumentPort::driver
  GuardedStage(std::unique_ptr<RotationStage> stage, std::shared_ptr<HaltGuard> guard, std::string port,
               std::string driver)
      : stage_(std::move(stage)),
        guard_(std::move(guard)),
        port_(std::move(port)),
        driver_(std::move(driver)) {}

  StageInfo identify() override;
  void home(StageAxis axis) override;
  void move_to(StageAxis axis, Angle target) override;
  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override;
  MotionState motion_state(StageAxis axis) override;
  Angle encoder_angle(StageAxis axis) override;
  bool halt() noexcept override { return halt_axes().all_halted(); }
  HaltReport halt_axes() noexcept override;
  std::vector<HaltRecipe> halt_recipes() override { return stage_->halt_recipes(); }
  Clock::Duration reply_deadline() const override { return stage_->reply_deadline(); }
  std::vector<StageEvent> take_events() override;

 private:
  template <class Call>
  auto guarded(const Call& call);
  void prepare();

  std::unique_ptr<RotationStage> stage_;
  std::shared_ptr<HaltGuard> guard_;
  const std::string port_, driver_;
  bool is_held_ = false;        ///< The guard has the recipes.
  std::array<bool, 2> axes_{};  ///< Axes behind the port, by index(StageAxis).
  std::vector<StageEvent> events_;
};

}  // namespace abcal
