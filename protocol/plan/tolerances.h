#pragma once

#include "drivers/instrument/angle.h"

namespace abcal {

/// Standard uncertainties of the stage's imperfections, from its maker or from measurement (`[tolerances]` of
/// a bench file). Default: the paper's stage, 0.008 degrees each (Geist & Gaitan 2021, section 1).
struct Tolerances {
  Angle alignment = Angle::degrees(0.008);     ///< Of Zx, Zy, Xz: N(0, sin alignment).
  Angle step = Angle::degrees(0.008);          ///< Of each rotation-step error f_i(n).
  Angle initial_turn = Angle::degrees(0.008);  ///< Of the initial -90 degree turns: d2, d3.
  Angle zero = Angle::degrees(0.008);          ///< Of the mean step errors F_X, F_Z (axis zeros).
  double drift = 1e-4;  ///< Of the drift over the run, relative to the intrinsic sensitivity.
};

}  // namespace abcal
