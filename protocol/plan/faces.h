#pragma once

#include <string>

#include "drivers/instrument/angle.h"
#include "drivers/text/message.h"

namespace abcal {

// Two faces (docs/measurement.md, "Two faces"): each experiment is measured in two circles. In the second the
// axis at rest is turned by half a turn more, so that errors of the stage act on the item with the opposite
// sign.

inline constexpr int kFaces = 2;

/// The face in which alpha(n) is measured: with two faces odd n in face 1, even n in face 2, so that the
/// angles of both interleave.
/// @param n  1..N
/// @param faces  1 or 2
int face_of(int n, int faces);

/// Position of the axis that does not turn: Z at 0 (face 2: 180) degrees in experiment 1, Z at -90 (90) in
/// experiment 2, X at -90 (90) in experiment 3.
Angle held_angle(int experiment, int face);

/// The angle at which the item sees the same gravity in face 1 of the experiment, on a perfect stage: -alpha
/// in experiments 1 and 2, alpha + 180 degrees in experiment 3. In face 1 alpha itself.
Angle angle_in_face_1(int experiment, int face, Angle alpha);

/// "experiment 1"; in the second face "experiment 1, face 2".
Message circle_words(int experiment, int face);

/// Whether two angles, of a plan or measured, belong to one circle.
template <typename First, typename Second>
bool is_same_circle(const First& a, const Second& b) {
  return a.experiment == b.experiment && a.face == b.face;
}

}  // namespace abcal
