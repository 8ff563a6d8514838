#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/angle.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/halt.h"
#include "drivers/text/message.h"

namespace abcal {

/// The two rotation axes of the stage, named as in the paper: X (outer, horizontal) carries Z (inner).
enum class StageAxis { kX, kZ };

constexpr std::array<StageAxis, 2> kStageAxes{StageAxis::kX, StageAxis::kZ};
constexpr std::size_t index(StageAxis axis) {
  return axis == StageAxis::kX ? 0 : 1;
}
constexpr std::string_view to_string(StageAxis axis) {
  return axis == StageAxis::kX ? "X" : "Z";
}

/// Motion of an axis as the controller reports it now. There is no "unknown": if a controller does not report
/// it, the call throws.
enum class MotionState { kMoving, kStopped };

/// Properties of one axis as the controller reports them, in its own coordinates.
struct StageAxisInfo {
  std::string stage_name;        ///< The positioner's name, e.g. "M-060.PD"; empty if not reported.
  Angle travel_min;              ///< Lowest target that is accepted.
  Angle travel_max;              ///< Highest target that is accepted.
  Angle resolution;              ///< Smallest step of the encoder; zero if not reported.
  double speed_deg_per_s = 0.0;  ///< Speed of moves; 0 if not reported.
  bool referenced = false;       ///< False: home() must be called before move_to().
  /// A longer move is refused, because its sense would not be certain; zero: any move within the travel.
  Angle longest_move{};
};

struct StageInfo {
  std::string maker;
  std::string model;
  std::string serial_number;
  std::string firmware;
  std::array<StageAxisInfo, 2> axes;  ///< By index(StageAxis).
};

/// An event of a stage that its owner did not request, e.g. that a watchdog halted it.
struct StageEvent {
  Clock::Instant at;
  std::string kind;  ///< "watchdog halt"
  Message text;
};

/// A two-axis rotation stage. One owner at a time, except halt().
///
/// Every call either succeeds or throws InstrumentError within the driver's own reply deadline; a silent
/// controller never reads as "stopped". Queries may be retried once by a driver; a move never is.
class RotationStage {
 public:
  virtual ~RotationStage() = default;

  /// Queries the identity of the controller. Moves nothing, changes nothing.
  /// @throws InstrumentError kWrongIdentity if it is not an instrument this driver knows.
  virtual StageInfo identify() = 0;

  /// Starts the search for the reference of an axis (and switches its servo on); returns once accepted. Poll
  /// motion_state() until stopped, then identify().axes[..].referenced reports whether it was found.
  virtual void home(StageAxis axis) = 0;

  /// Starts a move to an absolute angle (and switches the servo on); returns once the controller has accepted
  /// it.
  /// @throws InstrumentError kOutOfTravel, kNotReady (not referenced), kRefused with the controller's own
  /// code.
  virtual void move_to(StageAxis axis, Angle target) = 0;

  /// Sets the speed of the moves of an axis from now on, in degrees/s; absent: the one that it had before the
  /// first such call. The axis must be at rest.
  /// @throws InstrumentError kRefused: not this speed; std::runtime_error: the driver cannot set any
  virtual void set_speed(StageAxis /*axis*/, std::optional<double> /*deg_per_s*/) {
    throw std::runtime_error("stage: its axes cannot be turned at a stated rate");
  }

  virtual MotionState motion_state(StageAxis axis) = 0;

  /// Position of the axis by its encoder: measured, not commanded.
  virtual Angle encoder_angle(StageAxis axis) = 0;

  /// Stops all axes. From any thread, also while another one waits for a reply; never throws.
  /// @return false if the controller did not acknowledge; the caller must report it.
  virtual bool halt() noexcept = 0;

  /// Like halt(), but reports the state of each axis: of two controllers, one may answer and the other not.
  virtual HaltReport halt_axes() noexcept { return HaltReport::of_both(halt()); }

  /// How another process halts the axes on each port of the stage; none for a stage without ports. Called by
  /// the owner, best after identify(). Sends nothing.
  virtual std::vector<HaltRecipe> halt_recipes() { return {}; }

  /// How long a reply of its controller may take; a watchdog of the stage must not give up earlier.
  virtual Clock::Duration reply_deadline() const { return {}; }

  /// Events since the last call, oldest first. The owner puts them into its record.
  virtual std::vector<StageEvent> take_events() { return {}; }
};

}  // namespace abcal
