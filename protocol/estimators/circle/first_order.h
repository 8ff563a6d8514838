#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "protocol/model/arrival.h"
#include "protocol/model/effects.h"
#include "protocol/model/forward_model.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// An input quantity that is known only by the size of its effect, and its effect on the readings, to first
/// order.
struct InputEffect {
  std::string name;   ///< "Zx", "d2", "F_X", "f_1(3)", "drift u", "wobble of X, cos 1/rev ..."
  std::string group;  ///< One line of a budget: "wobble of X", "f_1", "drift".
  std::string key;    ///< Key of its size in the bench file.
  std::string unit;   ///< "1", "degree", "urad", "R" (the record's response unit)
  double standard_uncertainty = 0.0;  ///< In that unit.
  std::size_t first_reading = 0;  ///< The effect below begins at this reading; it is zero before and after.
  std::vector<Eigen::Vector3d>
      effect;  ///< Change of r_u, r_v, r_w (R) for a change of the input by one unit.
  /// Change of the measurand (line response; order of Covariance12) for a change of the input by one unit.
  Eigen::Matrix<double, 12, 1> line = Eigen::Matrix<double, 12, 1>::Zero();
  const ItemEffect* item = nullptr;  ///< Entry of the table; null: an effect of the stage.
  int item_unknown = 0;
  int output = -1;  ///< 0, 1, 2 = u, v, w; -1: an effect of the stage.
};

/// Readings in use, in the order of the record, without closing angles: one of each for each reading.
struct FirstOrderReadings {
  std::span<const DwellRecord* const> dwells;
  std::span<const double> time_fractions;    ///< -1/2 to 1/2 over the run.
  std::span<const ReadingArrival> arrivals;  ///< The motions by which the stage reached them.
};

/// One effect for each unknown of protocol/model/effects.h whose size is above zero, and f_i(n) of every
/// reading (each of two readings at the same angle has its own: the stage returned to it), at a perfect stage
/// with the accelerometer as estimated.
/// The hysteresis acts with the mean sign of ArrivalSigns; where it is not certain, what is left is an input
/// of this reading alone.
/// @param accelerometer  estimated sensitivity matrix; its offset is not used
std::vector<InputEffect> first_order_effects(const FirstOrderReadings& readings,
                                             const AccelerometerModel& accelerometer,
                                             const EffectSizes& sizes, const std::string& response_unit);

}  // namespace abcal
