#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/estimators/circle/curvature_fit.h"
#include "protocol/estimators/circle/diagnostics.h"
#include "protocol/estimators/circle/first_order.h"
#include "protocol/estimators/circle/harmonic_fit.h"
#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// The ABC result of both faces together, as far as each face is compared with it.
struct BothFaces {
  std::span<const DwellRecord* const> dwells;  ///< In use.
  /// Nine each, index 3 (experiment - 1) + accelerometer: the series minus the effects of k2 and k3, and fits
  /// of one harmonic to them.
  std::span<const ReadingSeries> cleaned;
  std::span<const HarmonicFit> fits;
  const CurvatureFit* curvature = nullptr;
  std::span<const InputEffect> effects;
  /// Variance of a reading of each output (R^2) where the fits are not weighted.
  std::array<std::optional<double>, 3> reading_variance;
  AbcOutputs outputs;  ///< The line response.
  double resolution = 0.0;
  std::string response_unit, per_g;  ///< Units of offset and sensitivity.
};

/// The ABC result of each face, from its own angles, and their difference, which an error of the stage larger
/// than stated makes larger than its uncertainty. k2 and k3 are those of both faces together.
/// @throws UndeterminedFit the angles of a face do not determine its circles
FaceResults results_of_faces(const BothFaces& both);

}  // namespace abcal
