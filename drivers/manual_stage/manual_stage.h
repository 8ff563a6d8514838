#pragma once

#include <array>
#include <atomic>
#include <functional>
#include <iosfwd>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/instrument/instrument_settings.h"
#include "drivers/instrument/rotation_stage.h"

namespace abcal::manual_stage {

/// An angle as a person types it, in degrees: "89.98", "89,98", or degrees, minutes and seconds ("89 58 48",
/// "89 58.8"; a minus sign before the degrees holds for all). Nullopt for any other text.
std::optional<Angle> parse_typed_angle(std::string_view text);

/// An answer farther from the asked angle than this is asked for again: a slip of the fingers, not a reading.
inline constexpr double kPlausibleDeg = 1.0;

/// A stage that a person turns by hand: a dividing head, or a table with a scale. The program prints which
/// axis to turn to which angle; the person presses Enter once it is there, or types the angle read off.
/// Angles are those of the scales.
///
/// There is nothing to halt: halt() returns false, always, and only ends the question that is open.
class ManualStage final : public RotationStage {
 public:
  /// Asks on `out`, reads lines from `in`; both must outlive it. Writes nothing yet.
  /// @param wake Makes a read of `in` that is under way end with end of file, from any thread; may be empty.
  /// @throws std::invalid_argument for invalid settings: no axis, a speed or an address.
  ManualStage(std::istream& in, std::ostream& out, const StageSettings& settings,
              std::function<void()> wake = {});

  /// Never asks; travel without end, and referenced once home() is confirmed.
  StageInfo identify() override;

  /// Asks the person to set the axis to the zero of its scale; returns once confirmed.
  void home(StageAxis axis) override;

  /// Returns once the person has confirmed; there is no time limit.
  /// @throws InstrumentError kLinkLost if the input ends, kNotReady if the axis is not confirmed to be at its
  ///   zero, or if halt() is called meanwhile.
  void move_to(StageAxis axis, Angle target) override;

  /// Stopped, as the person confirmed.
  /// @throws InstrumentError kNotReady after a move that was not confirmed: its position is then unknown.
  MotionState motion_state(StageAxis axis) override;

  /// The angle typed, or the one confirmed. @throws InstrumentError kNotReady before home().
  Angle encoder_angle(StageAxis axis) override;

  /// @return false: a person has no halt. A question that is open ends with an error, and so does every
  /// other one before the next identify().
  bool halt() noexcept override;

 private:
  std::string name_of(StageAxis axis) const;
  Angle ask(StageAxis axis, const std::string& question, Angle expected);
  std::string read_line();

  std::istream& in_;
  std::ostream& out_;
  StageSettings settings_;
  std::function<void()> wake_;
  std::array<std::optional<Angle>, 2> known_angle_;  ///< Absent: not known.
  std::array<bool, 2> referenced_{};
  std::atomic<bool> halted_ = false;
};

/// A manual stage at the terminal of this process: asks with `show`, which writes to standard error (standard
/// output belongs to results) and must not throw; reads standard input; a halt (Ctrl-C) ends an open question
/// at once.
/// @throws InstrumentError kCannotOpen, at once, if standard input or standard error is not a terminal: then
/// no
///   person can turn the stage.
std::unique_ptr<RotationStage> at_terminal(const StageSettings& settings,
                                           std::function<void(std::string_view)> show);

}  // namespace abcal::manual_stage
