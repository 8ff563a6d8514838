#include "protocol/plan/faces.h"

namespace abcal {

int face_of(int n, int faces) {
  return faces == kFaces && n % kFaces == 0 ? 2 : 1;
}

Angle held_angle(int experiment, int face) {
  if (experiment == 1) return Angle::degrees(face == 2 ? 180.0 : 0.0);
  return Angle::degrees(face == 2 ? 90.0 : -90.0);  // paper, section 2.4: -90 degrees
}

Angle angle_in_face_1(int experiment, int face, Angle alpha) {
  if (face != 2) return alpha;
  return experiment == 3 ? alpha + Angle::degrees(180.0) : Angle::degrees(0.0) - alpha;
}

Message circle_words(int experiment, int face) {
  if (face == 2) return {"experiment {experiment}, face 2", experiment};
  return {"experiment {experiment}", experiment};
}

}  // namespace abcal
