#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "protocol/model/forward_model.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// An input quantity that is known only by its tolerance, and what it does to the readings, to first order.
struct InputEffect {
  std::string name;                   ///< "Zx", "d2", "F_X", "f_1(3)", "drift u"
  std::string unit;                   ///< "1", "degree", "R" (the record's response unit)
  double standard_uncertainty = 0.0;  ///< In that unit.
  std::size_t first_reading = 0;  ///< The effect below begins at this reading; it is zero before and after.
  std::vector<Eigen::Vector3d>
      effect;  ///< Change of r_u, r_v, r_w (R) for a change of the input by one unit.
};

/// One effect for each input of `tolerances`: Zx, Zy, Xz, d2, d3, F_X, F_Z, drift u, v, w, and f_i(n) of
/// every reading (two readings at the same angle have each their own: the stage came back). By central
/// differences of the forward model around a perfect stage with the accelerometer as estimated
/// (metrology.md 1.1).
/// @param dwells          readings in use, in the order of the record; no closing angles
/// @param time_fractions  their times, -1/2 .. 1/2 over the run
/// @param accelerometer   estimated sensitivity matrix; its offset plays no part
std::vector<InputEffect> first_order_effects(std::span<const DwellRecord* const> dwells,
                                             std::span<const double> time_fractions,
                                             const AccelerometerModel& accelerometer,
                                             const Tolerances& tolerances, const std::string& response_unit);

}  // namespace abcal
