#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <functional>
#include <span>
#include <vector>

#include "protocol/model/stage_model.h"
#include "protocol/plan/effect_sizes.h"

namespace abcal {

/// One motion of one axis from rest to rest, while the other one is at rest. Commanded angles, radian.
struct StageLeg {
  bool about_x = true;
  double from = 0.0, to = 0.0;
  double other = 0.0;  ///< Position of the other axis.
};

/// The motions by which the stage reached a pose.
struct Arrival {
  /// Whether the first of them began at the reading before. Otherwise the motions before the first one are
  /// unknown; without motions, all are unknown.
  bool since_reading_before = false;
  std::vector<StageLeg> legs;  ///< In the order of time.
};

/// A reading at rest with the way to it.
struct ReadingArrival {
  int experiment = 1;
  int face = 1;
  Arrival arrival;
};

/// A change of the responses between two poses on the way.
struct ResponseChange {
  const StagePose &from, &to;
};

/// The rules of ArrivalSigns.
enum class SignRule { kArrival, kLastMotion };

/// The signs with which the hysteresis of u, v, w acts at readings at rest. The hysteresis of an output
/// depends on the direction of its last change, and reverses within some width of change. It is unknown which
/// of two rules an item follows; both are used, and the uncertainty of the sign is their difference.
///  - The direction of arrival: that of the change since the last extremum of the output on its way, approach
///    stops included. Where the change is a share of the width, the sign before has turned round by that
///    share.
///  - The sign of the change over the last motion as a whole.
/// The result is the mean over both rules and over what is not known of the changes: from -1 to 1, and 0
/// where the way is not known.
class ArrivalSigns {
 public:
  /// Linear responses of u, v, w at a pose, relative to S_j.
  using Responses = std::function<Eigen::Vector3d(const StagePose&)>;
  /// Standard uncertainty of the change of one output.
  using Uncertainty = std::function<double(const ResponseChange&, int output)>;

  ArrivalSigns() = default;
  /// @param width  changes of a relative response within which the sign may turn round
  ArrivalSigns(std::vector<ReadingArrival> readings, double width);

  /// Finds the extrema of the outputs on the way, and the changes that decide the signs.
  void find(const Responses& responses);
  /// Takes the uncertainties of these changes; without, they are known exactly.
  /// @param certain  a change that is larger is not asked for: it has its sign
  void take_uncertainties(const Responses& responses, const Uncertainty& uncertainty, double certain);

  /// Mean signs of u, v, w at each reading.
  std::vector<Eigen::Vector3d> mean(const Responses& responses) const;
  /// Signs of an item that follows one of the rules; 1 where they are not known.
  std::vector<Eigen::Vector3d> of_one_item(const Responses& responses, SignRule rule) const;

 private:
  /// A change between two poses on the way, by their places in poses_.
  struct Known {
    std::size_t from = 0, to = 0;
    double u = 0.0;
  };
  /// The changes that decide the sign of one output at one reading.
  struct Deciding {
    bool known = false;         ///< False: the way is not known.
    int certain = 0;            ///< 1, -1: the sign, independent of the fit; 0: by the changes.
    std::vector<Known> swings;  ///< From extremum to extremum; the last ends at the reading.
    Known whole;                ///< Over the last motion.
  };
  class Follower;
  class AtPoses;
  double direction_of_arrival(const Deciding& deciding, AtPoses& responses, int output) const;

  std::vector<ReadingArrival> readings_;
  double width_ = 0.0;
  std::vector<StagePose> poses_;  ///< On the way: ends of the motions, and extrema of the outputs.
  std::vector<std::array<Deciding, 3>> deciding_;
};

/// The width of ArrivalSigns for hysteresis of the size that is stated: an output that has turned by ten
/// times its hysteresis has it with the other sign.
double turning_width(const EffectSizes& sizes);

/// The mean signs on a perfect stage whose errors are known by their sizes only.
/// @param rows  of the linear responses, each relative to its S_j
std::vector<Eigen::Vector3d> signs_by_sizes(std::vector<ReadingArrival> readings, const Eigen::Matrix3d& rows,
                                            const EffectSizes& sizes);

}  // namespace abcal
