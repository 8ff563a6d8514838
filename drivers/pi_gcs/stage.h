#pragma once

#include <chrono>
#include <memory>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/wire/byte_stream.h"

namespace abcal::pi_gcs {

/// How long a reply may take. Controllers answer within tens of milliseconds also while moving; PIPython
/// waits 7 s because some of its queries start a self-test, which none of ours does.
inline constexpr Clock::Duration kReplyDeadline = std::chrono::seconds(2);

/// For queries that a controller need not know: one that does not know a query stays silent (and sets error
/// 2).
inline constexpr Clock::Duration kOptionalReplyDeadline = std::chrono::milliseconds(500);

/// Within this time after the call halt() has returned (a write that is stuck adds its own deadline of 2 s).
inline constexpr Clock::Duration kHaltDeadline = std::chrono::seconds(5);

/// Two axes of a PI controller that speaks GCS 2.0 (C-884, C-863, E-861, ...), over serial or TCP.
///
/// Angles are the controller's own, in degrees: the controller's unit is checked before anything else. The
/// controller is identified at the first call, whichever it is. StageSettings::axis_names may leave one name
/// empty: that axis is then not on this controller, and calls for it throw kNotReady.
///
/// One owner thread; halt() from any.
class PiGcsStage final : public RotationStage {
 public:
  /// Sends nothing yet.
  /// @throws std::invalid_argument for settings that cannot be meant: no axis, one axis twice, a speed that
  /// is
  ///   not a positive number, an address that is not a number.
  PiGcsStage(std::unique_ptr<wire::ByteStream> stream, Clock& clock, const StageSettings& settings);
  ~PiGcsStage() override;

  /// @throws InstrumentError kWrongIdentity: no PI controller, an axis that it does not have (lists those it
  /// has),
  ///   a unit other than degrees.
  StageInfo identify() override;

  /// By the reference switch (FRF), or where there is none by the negative limit switch (FNL).
  void home(StageAxis axis) override;

  /// @throws InstrumentError kNotReady if the axis has lost its reference or its servo (errors 5 and 31),
  ///   kOutOfTravel (error 7), kRefused for any other error code, with its text.
  void move_to(StageAxis axis, Angle target) override;

  /// As the controller says now (#5, or #4, or ONT? where these are not known). Stopped is not yet "on
  /// target": an axis that has stopped outside the window is stopped, and the encoder angle says where.
  MotionState motion_state(StageAxis axis) override;

  Angle encoder_angle(StageAxis axis) override;

  /// Sends #24 at once, without waiting for an exchange that is under way; then asks until the controller
  /// says that it was stopped (error 10) or that nothing moves. The exchange under way ends with its reply or
  /// InstrumentError.
  bool halt() noexcept override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace abcal::pi_gcs
