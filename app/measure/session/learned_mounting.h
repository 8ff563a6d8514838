#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/measure/session/small_turn.h"
#include "drivers/instrument/angle.h"

namespace abcal {

/// The readings do not show how the item is mounted, or show a mounting that cannot be used. The message
/// states what was found, what is required and what to do.
class MountingUnclear : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Largest turn of the item from the nearest mounting along the platter's axes: `abcal check` accepts a
/// little more.
inline constexpr double kLargestLearnedTiltDeg = 10.0;

/// The mounting of an item on its stage, as gravity shows it.
struct LearnedMounting {
  std::string mounting;          ///< "-y x z", as [item] mounting: the nearest of the 24 right-handed ones.
  int sign_x = +1;               ///< [stage.x] sign
  int sign_z = +1;               ///< [stage.z] sign
  bool is_sign_x_known = false;  ///< By MountingSearch::known; else +1 by definition.
  Angle tilt;                    ///< Turn of the item from that mounting.
  double response = 0.0;         ///< Change of an output (R) for one g_loc along it.
  double offset = 0.0;           ///< Length of the offset vector, in g_loc; includes what the zeros are off.
};

/// Knowledge before the turn.
struct MountingSearch {
  std::string response_unit;               ///< R, for messages.
  std::optional<double> nominal_response;  ///< R for one g_loc; absent if the unit does not imply it.
  std::string known;  ///< The mounting as a person states it ([item] mounting); empty: not stated.
};

/// Finds the nearest mounting and the signs of both axes from the readings of a small turn: at zero, with X
/// turned, and with Z turned as well. Only changes of the readings are fitted; of the reading at zero only
/// the side is used on which gravity lies, so that an offset of a third of g_loc does no harm.
///
/// Gravity does not show the sign of X: an axis X that counts the other way, and an item turned by half a
/// turn about z, give the same readings. Without `known`, sign_x is +1 by definition: x of the platter is the
/// direction about which X turns right-handed when its controller counts up. Outputs are taken as
/// right-handed, so that the sign of Z is unique.
/// @param poses  three poses in the angles of the controllers (sign 1, zero where they were homed)
/// @throws MountingUnclear; std::invalid_argument for other than three poses, or a `known` that is not a
/// mounting
LearnedMounting learn_mounting(const std::vector<PoseReading>& poses, const MountingSearch& search);

}  // namespace abcal
