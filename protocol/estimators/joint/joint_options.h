#pragma once

#include "protocol/record/run_record.h"

namespace abcal {

/// Whether k2 and k3 are unknowns of the fit.
enum class Nonlinearity {
  kFitted,
  kLeftOut,  ///< Zero exactly; for studies.
};

/// Choices of the joint estimator.
struct JointOptions {
  Nonlinearity nonlinearity = Nonlinearity::kFitted;
  bool drift = true;              ///< false: no drift, of offset and of sensitivity.
  bool mean_step = true;          ///< false: F_X = F_Z = 0 exactly; for studies, not for measurements.
  bool one_map_per_axis = false;  ///< f depends on axis and angle alone: experiments 1 and 2 share it.
  bool noise_process = true;      ///< false: the noise is white; for studies.
  bool stage_of_one = false;      ///< Whether analyse_tray() reports the stage of a single item; for studies.
  MeasuredAlignment measured_alignment;
  /// S_j (R), the relative unit of the fit, so that runs of one item have one. Absent: that of the readings.
  std::optional<Eigen::Vector3d> unit = std::nullopt;
};

}  // namespace abcal
