#include "protocol/estimators/norm/norm_fit.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "protocol/estimators/norm/norm_model.h"
#include "protocol/estimators/shared/arrivals.h"
#include "protocol/estimators/shared/flagged_angles.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/estimators/shared/known_acs_fit.h"
#include "protocol/estimators/shared/run_time.h"
#include "protocol/estimators/shared/undetermined.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/estimators/shared/voltmeter.h"
#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/plan/limits.h"
#include "protocol/quantities/output_names.h"
#include "protocol/statistics/distributions.h"
#include "protocol/statistics/median.h"

namespace abcal {
namespace {

constexpr int kUnknowns = 9;
/// With the turn of the item in its mount, where the directions of the poses are stated.
constexpr int kDirectedUnknowns = 12;
constexpr int kFewestDirections = 5;
/// With fewer free residuals of the norm, its scatter is taken as that of the directions, which is no
/// smaller.
constexpr double kFewestFreeOfNorm = 2.0;
constexpr int kAngles = 3;
/// Six poses and three angles make nine equations.
constexpr std::size_t kFewestPoses = 6;
/// Below this probability chi2 contradicts the model, as for the joint estimator.
constexpr double kChi2Level = kFalseAlarm;
/// Radii (degrees) of a cap without poses: above the first it is noted, above the second it makes the result
/// doubtful. Six poses, one on each face of a cube, leave 54.7 degrees.
constexpr double kNamedCap = 60.0;
constexpr double kDoubtfulCap = 75.0;
/// With fewer free residuals the scatter is not estimated again after the effects.
constexpr double kFewestFree = 10.0;
/// Part of a pose's variance that its residual must show for a test of that pose.
constexpr double kLeastShown = 1e-6;
/// Least estimated scatter of the norm when effects have priors: a noise-free record leaves only round-off.
constexpr double kSmallestNormScatter = 1e-9;

/// Radius (degrees) and centre of the largest cap without a pose, on a grid of some 1.5 degrees.
std::pair<double, Eigen::Vector3d> largest_empty_cap(const std::vector<Eigen::Vector3d>& directions) {
  constexpr int kGrid = 4000;  // Fibonacci sphere
  const double golden = std::numbers::pi * (3.0 - std::sqrt(5.0));
  std::pair<double, Eigen::Vector3d> largest{2.0, Eigen::Vector3d::UnitZ()};  // cosine
  for (int i = 0; i < kGrid; ++i) {
    const double z = 1.0 - (2.0 * i + 1.0) / kGrid;
    const double r = std::sqrt(1.0 - z * z);
    const Eigen::Vector3d centre(r * std::cos(golden * i), r * std::sin(golden * i), z);
    double nearest = -1.0;
    for (const Eigen::Vector3d& direction : directions) nearest = std::max(nearest, centre.dot(direction));
    if (nearest < largest.first) largest = {nearest, centre};
  }
  // The rounding of acos is negligible against the pitch of the grid.
  largest.first = std::acos(std::clamp(largest.first, -1.0, 1.0)) * 180.0 / std::numbers::pi;
  return largest;
}

bool has_item_effects(const EffectSizes& sizes) {
  return std::any_of(item_effects().begin(), item_effects().end(),
                     [&](const ItemEffect& effect) { return effect.prior(sizes) > 0.0; });
}

bool state_directions(std::span<const Pose> poses) {
  return !poses.empty() && std::ranges::all_of(poses, [](const Pose& pose) { return pose.up.has_value(); });
}

/// The poses shifted and scaled to readings of about 1, so that the columns of the design have the same size
/// in LSB and in volts.
struct ScaledPoses {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double size = 0.0;
  bool u_known = false;
  std::vector<NormPose> poses;
};

/// @param hysteresis  its stated size, relative to S_j
ScaledPoses scaled(std::span<const Pose> poses, double hysteresis) {
  ScaledPoses out;
  for (const Pose& pose : poses) out.centre += pose.reading / static_cast<double>(poses.size());
  for (const Pose& pose : poses) out.size += (pose.reading - out.centre).squaredNorm();
  out.size = std::sqrt(out.size / static_cast<double>(poses.size()));
  if (!(out.size > 1e-12 * out.centre.norm())) throw UnusableData("norm fit: all poses read the same");
  out.u_known = std::all_of(poses.begin(), poses.end(), [](const Pose& pose) { return pose.u.has_value(); });
  const bool timed =
      std::all_of(poses.begin(), poses.end(), [](const Pose& pose) { return pose.t.has_value(); });
  const auto intervals = static_cast<double>(std::max<std::size_t>(poses.size(), 2) - 1);
  const bool directed = state_directions(poses);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    NormPose pose;
    if (directed) pose.up = poses[i].up;
    pose.reading = (poses[i].reading - out.centre) / out.size;
    if (out.u_known) pose.u = *poses[i].u / out.size;
    pose.t = timed ? *poses[i].t : static_cast<double>(i) / intervals - 0.5;
    out.poses.push_back(pose);
  }
  if (!std::ranges::all_of(poses, [](const Pose& pose) { return pose.sign.has_value(); })) {
    find_directions(out.poses);
    return out;
  }
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const Eigen::Vector3d& sign = *poses[i].sign;
    out.poses[i].came_from = sign;
    if (!out.u_known) continue;
    // The rest of the sign is noise of this pose.
    const Eigen::Array3d left = hysteresis * hysteresis * (1.0 - sign.array().square()).max(0.0);
    out.poses[i].u = (out.poses[i].u->array().square() + left).sqrt().matrix();
  }
  return out;
}

/// State of the estimation.
struct Estimate {
  std::vector<NormPose> used;
  std::vector<std::size_t> place;  ///< Index of each pose used among the poses given.
  NormModel model;
  bool u_known = false;
  NormSolution solution;
  /// Degrees of freedom of the variance that the residuals gave to the poses; infinite: it is stated.
  double scatter_degrees = std::numeric_limits<double>::infinity();
  double turn_degrees = std::numeric_limits<double>::infinity();  ///< The same of the directions.
  double stated_turn = 0.0;      ///< Stated variance of a direction, radian squared; 0: not stated.
  bool is_norm_as_turn = false;  ///< The scatter of the norm is taken as that of the directions.
  std::vector<std::pair<std::size_t, double>> left_out;     ///< Index and residual.
  double limit = std::numeric_limits<double>::quiet_NaN();  ///< Limit of |residual|; NaN: none beyond.
  bool too_many = false;

  /// Number of equations minus number of unknowns without prior.
  int degrees_of_freedom() const {
    if (solution.orientation)
      return static_cast<int>(used.size() + 2 * solution.orientation->first.size()) - kDirectedUnknowns;
    return static_cast<int>(used.size()) - kUnknowns + (model.orthogonality > 0.0 ? kAngles : 0);
  }
  bool is_directed() const { return used.front().up.has_value(); }
  /// Sets the variance that all norms have in common, and that of the directions as far as it is not stated.
  void set_variances(double norm, double turn) {
    model.common_variance = norm;
    model.turn_variance = !(stated_turn > 0.0) ? turn
                          : is_norm_as_turn    ? std::max(stated_turn, norm)
                                               : stated_turn + norm;
  }
};

/// Solves with the directions. Variances that nobody states are those that the residuals of the norm and of
/// the directions give.
void solve_directed(Estimate& at) {
  constexpr double kLeast = kSmallestNormScatter * kSmallestNormScatter;
  // First, and where the norm has few free residuals always, the norms have by far the larger weight: they do
  // not hide an error of the directions.
  constexpr double kMuchLess = 1e-2;
  const bool is_turn_known = at.stated_turn > 0.0;
  double of_readings = 0.0;  // mean stated variance
  for (const NormPose& pose : at.used)
    if (pose.u) of_readings += pose.u->squaredNorm() / (3.0 * static_cast<double>(at.used.size()));
  const double first_turn = is_turn_known ? at.stated_turn : at.u_known ? of_readings : 1.0;
  at.is_norm_as_turn = false;
  at.model.norm_weight = 1.0;
  at.set_variances(at.u_known ? 0.0 : kMuchLess * first_turn, first_turn);
  for (int pass = 0; pass < 100; ++pass) {
    at.solution = solve_norm(at.used, at.model, at.solution.unknowns);
    if (at.u_known && is_turn_known) return;
    const NormSolution& fit = at.solution;
    const NormOrientation& turn = *fit.orientation;
    if (pass == 0 && !at.u_known && fit.redundancy < kFewestFreeOfNorm) {
      at.is_norm_as_turn = true;
      at.model.norm_weight = 1.0 / kMuchLess;
    }
    const auto next = [&](double variance, double squares, double free) {
      return std::max(kLeast, variance * squares / std::max(free, 1e-6));
    };
    const double last_norm = at.model.common_variance, last_turn = at.model.turn_variance;
    const double next_turn = next(last_turn, turn.weighted_squares, turn.redundancy);
    const double of_norm = fit.residual.cwiseAbs2().cwiseQuotient(fit.variance).sum();
    const double next_norm = at.u_known           ? 0.0
                             : at.is_norm_as_turn ? next_turn
                                                  : next(last_norm, of_norm, fit.redundancy);
    at.scatter_degrees = at.u_known           ? std::numeric_limits<double>::infinity()
                         : at.is_norm_as_turn ? turn.scatter_degrees
                                              : fit.scatter_degrees;
    at.turn_degrees = is_turn_known ? std::numeric_limits<double>::infinity() : turn.scatter_degrees;
    at.set_variances(next_norm, next_turn);
    const auto settled = [](double last, double now) { return std::abs(last - now) <= 1e-3 * last; };
    if (settled(last_norm, at.model.common_variance) && settled(last_turn, at.model.turn_variance)) break;
  }
  at.solution = solve_norm(at.used, at.model, at.solution.unknowns);
}

/// Solves with the right weights: stated uncertainties, or else the scatter of the norm, which is estimated
/// first without effects, since these could absorb part of it.
void solve(Estimate& at) {
  if (at.is_directed()) {
    solve_directed(at);
    return;
  }
  const Eigen::VectorXd from = at.solution.unknowns;
  if (at.u_known) {
    at.solution = solve_norm(at.used, at.model, from);
    return;
  }
  NormModel plain = at.model;
  plain.sizes = linear_item(plain.sizes);
  plain.common_variance = at.model.orthogonality > 0.0 ? 1e-24 : 0.0;  // Readings far better than the angles.
  NormSolution first = solve_norm(at.used, plain, from);
  const auto free = static_cast<double>(at.used.size()) - kUnknowns;
  at.scatter_degrees = free;
  const bool effects = has_item_effects(at.model.sizes);
  if (free < 1.0 || !effects) {
    if (free >= 1.0 && at.model.orthogonality == 0.0) {
      plain.common_variance = std::max(1e-300, first.residual.squaredNorm() / free);
      first = solve_norm(at.used, plain, first.unknowns);
    }
    at.model.common_variance = plain.common_variance;
    at.solution = std::move(first);
    return;
  }
  const double least = kSmallestNormScatter * kSmallestNormScatter;
  at.model.common_variance = std::max(least, first.residual.squaredNorm() / free);
  at.solution = solve_norm(at.used, at.model, first.unknowns);
  for (int pass = 0; pass < 20 && at.solution.redundancy >= kFewestFree; ++pass) {
    const double next = std::max(least, at.solution.residual.squaredNorm() / at.solution.redundancy);
    const bool settled = std::abs(next / at.model.common_variance - 1.0) < 0.01;
    at.model.common_variance = next;
    at.scatter_degrees = at.solution.scatter_degrees;
    at.solution = solve_norm(at.used, at.model, at.solution.unknowns);
    if (settled) break;
  }
}

/// Leaves out the poses that are far from the others, and repeats this after each solution.
void leave_out_disturbed(Estimate& at) {
  const auto most = at.used.size() / 4;
  for (int round = 0; round < 10; ++round) {
    const NormSolution& fit = at.solution;
    if (static_cast<double>(at.used.size()) - kUnknowns < 1.0) return;
    // Over the standard deviation of the residual, which the leverage of its pose makes smaller. A pose whose
    // residual is nothing but round-off determines an unknown alone, and nothing tests it.
    std::vector<double> deviations;
    for (Eigen::Index i = 0; i < fit.residual.size(); ++i) {
      const double shown = fit.free_share(i) > kLeastShown ? fit.free_share(i) * fit.variance(i) : 0.0;
      deviations.push_back(shown > 0.0 ? std::abs(fit.residual(i)) / std::sqrt(shown) : 0.0);
    }
    // 1.4826: from the median of |x| to the standard deviation of a normal distribution.
    double scale = 1.4826 * median(deviations);
    if (at.u_known) scale = std::max(scale, 1.0);
    // Residuals at the level of rounding (noise-free poses) are not outliers.
    const double limit = std::max(kNormOutlier * scale, 1e-13 / std::sqrt(fit.variance.minCoeff()));
    Estimate kept = at;
    kept.used.clear();
    kept.place.clear();
    for (std::size_t i = 0; i < at.used.size(); ++i) {
      if (deviations[i] > limit) {
        kept.left_out.emplace_back(at.place[i], fit.residual(static_cast<Eigen::Index>(i)));
        continue;
      }
      kept.used.push_back(at.used[i]);
      kept.place.push_back(at.place[i]);
    }
    if (kept.used.size() == at.used.size()) return;
    kept.limit = limit * std::sqrt(median({fit.variance.data(), fit.variance.data() + fit.variance.size()}));
    if (kept.left_out.size() > most || kept.used.size() < kUnknowns) {
      at.too_many = true;
      return;
    }
    at = std::move(kept);
    solve(at);
  }
}

/// Sentences that make the verdict.
struct Judgement {
  std::vector<Message> contradictions;
  Message about_scatter;
};

/// Tests chi2 for stated uncertainties, else reports the scatter. Adds a common scatter where chi2 fails.
void judge_scatter(Estimate& at, Diagnostics& diagnostics, Judgement& judgement) {
  const int dof = at.degrees_of_freedom();
  if (at.is_directed() && !(at.u_known && at.stated_turn > 0.0)) {
    constexpr double kDegree = 180.0 / std::numbers::pi;
    judgement.about_scatter = Message(
        "scatter of the norm {norm:.2g} g_loc with {norm_degrees:.3g} degrees of freedom, of the directions "
        "{turn:.2g} degree with {turn_degrees:.3g}",
        std::sqrt(at.model.common_variance), at.scatter_degrees, kDegree * std::sqrt(at.model.turn_variance),
        at.turn_degrees);
    return;
  }
  if (!at.u_known) {
    if (static_cast<int>(at.used.size()) > kUnknowns) {
      judgement.about_scatter = Message(
          "uncertainties from the scatter of the norm, {scatter:.2g} g_loc with {degrees:.3g} degrees of "
          "freedom",
          std::sqrt(at.model.common_variance), at.scatter_degrees);
    } else {
      judgement.contradictions.push_back(Message(
          "no uncertainty is given: the poses state none, and none are left over to show their scatter"));
    }
    return;
  }
  diagnostics.chi2 = at.solution.weighted_squares;
  if (dof <= 0) {
    judgement.about_scatter = Message("as many equations as unknowns: nothing tests the result");
    return;
  }
  const double probability = chi2_tail(*diagnostics.chi2, dof);
  diagnostics.chi2_probability = probability;
  judgement.about_scatter =
      Message("chi2 {chi2:.4g} for {degrees} degrees of freedom (probability {probability:.2g})",
              *diagnostics.chi2, dof, probability);
  if (probability >= kChi2Level) return;
  // A variance common to all poses that makes chi2 equal its expectation (Paule and Mandel).
  double low = 0.0;
  double high = std::max(1e-30, at.solution.residual.squaredNorm());
  if (at.solution.orientation) high += at.solution.orientation->residual.squaredNorm();
  for (int i = 0; i < 60 && high - low > 1e-6 * high; ++i) {
    at.set_variances(0.5 * (low + high), 0.0);
    at.solution = solve_norm(at.used, at.model, at.solution.unknowns);
    (at.solution.weighted_squares > dof ? low : high) = at.model.common_variance;
  }
  at.scatter_degrees = at.solution.scatter_degrees;
  judgement.contradictions.push_back(Message(
      "{chi2}: the norm is not constant within the readings' uncertainties and the effects of the item; "
      "a scatter of {scatter:.2g} g_loc was added to them",
      judgement.about_scatter, std::sqrt(high)));
}

/// The variance of an output and its parts from the norm and from the directions of the poses.
struct OutputVariance {
  double total = 0.0, of_norm = 0.0, of_turn = 0.0;
};

Quantity quantity_of(const Estimate& at, double value, const OutputVariance& variance,
                     const std::string& unit) {
  // The part of the directions that is stated; the rest of theirs is the scatter of the readings.
  const double stated =
      at.stated_turn > 0.0 ? at.stated_turn / at.model.turn_variance * variance.of_turn : 0.0;
  double norm = variance.of_norm, turn = variance.of_turn - stated;
  const double of_poses = norm + turn;
  if (at.stated_turn > 0.0 || at.is_norm_as_turn) {  // One estimate gives both.
    norm += turn;
    turn = 0.0;
  }
  Quantity out;
  out.value = value;
  out.standard_uncertainty = std::sqrt(variance.total);
  out.type_a = std::sqrt(of_poses);
  out.type_b = std::sqrt(std::max(0.0, variance.total - of_poses));
  out.unit = unit;
  // Welch and Satterthwaite: the parts of the poses have the degrees of freedom of their scatter. The ratio
  // is 1 but for round-off where no effect has a prior, and Student's t has no value below one degree.
  const double parts = norm * norm / at.scatter_degrees + turn * turn / at.turn_degrees;
  if (of_poses > 0.0 && parts > 0.0)
    out.degrees_of_freedom = std::max(of_poses, variance.total) * std::max(of_poses, variance.total) / parts;
  return out;
}

void fill_values(const Estimate& at, const ScaledPoses& scale, CalibrationResult& result) {
  const NormSolution& fit = at.solution;
  Eigen::Matrix<double, 9, 1> units = Eigen::Matrix<double, 9, 1>::Constant(scale.size);
  units.segment<3>(3).setOnes();  // angles
  Covariance9 total = scaled_on_both_sides(fit.covariance, units);
  Covariance9 of_poses = scaled_on_both_sides(fit.covariance_of_poses, units);
  // Nine poses without uncertainties determine the values, but not their uncertainties.
  if (!at.u_known && !fit.orientation && static_cast<int>(at.used.size()) <= kUnknowns) {
    total.setConstant(std::numeric_limits<double>::quiet_NaN());
    of_poses = total;
  }
  Covariance9 of_turn = Covariance9::Zero();
  if (fit.orientation)
    of_turn = scaled_on_both_sides(
        carried_covariance(intrinsic_jacobian(fit.line_sensitivity), fit.orientation->of_turn), units);
  const auto quantity = [&](Eigen::Index i, double value, const std::string& unit) {
    return quantity_of(at, value, {total(i, i), of_poses(i, i) - of_turn(i, i), of_turn(i, i)}, unit);
  };
  const std::string per_g = result.response_unit + "/g_loc";
  for (Eigen::Index j = 0; j < 3; ++j) {
    const auto place = static_cast<std::size_t>(j);
    result.intrinsic_sensitivity[place] = quantity(j, scale.size * fit.intrinsic(j), per_g);
    result.intrinsic_angle[place] = quantity(3 + j, fit.intrinsic(3 + j), "degree");
    result.offset[place] =
        quantity(6 + j, scale.centre(j) + scale.size * fit.intrinsic(6 + j), result.response_unit);
  }
  const double stated = at.stated_turn > 0.0 ? at.stated_turn / at.model.turn_variance : 0.0;
  result.covariance_intrinsic = total;
  result.covariance_intrinsic_type_a = of_poses - stated * of_turn;
  result.covariance_intrinsic_type_b = total - *result.covariance_intrinsic_type_a;
  if (!fit.orientation) return;
  const NormOrientation& orientation = *fit.orientation;
  const double size2 = scale.size * scale.size;
  auto& matrix = result.sensitivity_matrix.emplace();
  for (std::size_t i = 0; i < 9; ++i) {
    const auto at_i = static_cast<Eigen::Index>(i);
    matrix[i / 3][i % 3] =
        quantity_of(at, scale.size * fit.line_sensitivity(at_i / 3, at_i % 3),
                    {size2 * orientation.covariance(at_i, at_i), size2 * orientation.of_norm(at_i, at_i),
                     size2 * orientation.of_turn(at_i, at_i)},
                    per_g);
  }
  result.covariance = size2 * orientation.covariance;
  result.covariance_type_a = size2 * (orientation.of_norm + (1.0 - stated) * orientation.of_turn);
  result.covariance_type_b = *result.covariance - *result.covariance_type_a;
}

/// Judges the uncertainties by the rule of all estimators.
void judge_outputs(const Estimate& at, const ScaledPoses& scale, const EffectSizes& sizes,
                   CalibrationResult& result, Judgement& judgement) {
  constexpr double kRadian = 180.0 / std::numbers::pi;
  std::vector<JudgedOutput> outputs;
  const auto add = [&](const std::string& name, const Quantity& quantity, double unit, Eigen::Index place) {
    JudgedOutput& output = outputs.emplace_back(JudgedOutput{name, quantity, unit, place / 3 == 1, {}});
    const double factor = output.angle ? 1.0 : scale.size * scale.size;
    for (const NormEffectShare& share : at.solution.shares)
      output.shares.push_back({share.effect, share.key, factor * share.variance(place)});
  };
  for (std::size_t i = 0; i < kIntrinsicSymbols.size(); ++i) {
    const std::size_t j = i % 3;
    const std::string name(kIntrinsicSymbols[i]);
    const auto place = static_cast<Eigen::Index>(i);
    const double sensitivity = result.intrinsic_sensitivity[j].value;
    if (i < 3) add(name, result.intrinsic_sensitivity[j], sensitivity, place);
    if (i / 3 == 1) add(name, result.intrinsic_angle[j], kRadian, place);
    if (i >= 6) add(name, result.offset[j], sensitivity, place);
  }
  for (const Undetermined& one : undetermined_outputs(outputs, sizes, EffectsAre::kEstimated))
    (one.doubtful ? judgement.contradictions : result.diagnostics.notes).push_back(one.words);
}

/// Judges how well the poses cover the sphere.
void judge_coverage(const Estimate& at, CalibrationResult& result, Judgement& judgement) {
  NormResult& norm = *result.norm;
  const std::vector<Eigen::Vector3d>& directions = at.solution.direction;
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const Eigen::Vector3d& direction : directions)
    scatter += direction * direction.transpose() / static_cast<double>(directions.size());
  norm.sphere_coverage = std::clamp(3.0 * symmetric_eigen(scatter).values(0), 0.0, 1.0);
  const auto [radius, cap] = largest_empty_cap(directions);
  if (radius > kNamedCap) {
    norm.coverage_words = Message(
        "no pose within {radius:.0f} degrees of the direction (u, v, w) = ({u:.1f}, {v:.1f}, {w:.1f})",
        radius, cap.x(), cap.y(), cap.z());
    result.diagnostics.notes.push_back(norm.coverage_words);
  }
  if (radius > kDoubtfulCap) judgement.contradictions.push_back(norm.coverage_words);
}

/// Lists the poses that were left out, with the rule.
void list_left_out(std::span<const Pose> poses, const Estimate& at, CalibrationResult& result,
                   Judgement& judgement) {
  NormResult& norm = *result.norm;
  norm.poses_left_out = static_cast<int>(at.left_out.size());
  std::vector<Message> words;
  for (const auto& [place, residual] : at.left_out) {
    norm.left_out.emplace_back(static_cast<int>(place) + 1, residual);
    const Message& name = poses[place].name;
    words.push_back(Message("{pose} ({change:+.2g} %)",
                            name.empty() ? Message("pose {number}", place + 1) : name, 100.0 * residual));
  }
  const Message rule =
      at.u_known ? Message(
                       "{times:g} robust standard deviations of the others and more than {own:g} of its own "
                       "uncertainties",
                       kNormOutlier, kNormOutlier)
                 : Message("{times:g} robust standard deviations of the others", kNormOutlier);
  if (!words.empty()) {
    result.diagnostics.notes.push_back(
        Message("{count} of {all} poses left out, whose norm is off by more than {rule}{limit}: {poses}",
                words.size(), poses.size(), rule,
                std::isfinite(at.limit) ? Message(" ({limit:.2g} %)", 100.0 * at.limit) : Message(),
                in_sequence(words, ", ")));
  }
  if (at.too_many) {
    judgement.contradictions.push_back(
        Message("more than a quarter of the poses are off by more than {rule}", rule));
  }
}

/// Names the directions that are off; they are not left out, as nobody knows which of both is wrong.
void judge_directions(std::span<const Pose> poses, const Estimate& at, CalibrationResult& result,
                      Judgement& judgement) {
  if (!at.solution.orientation) return;
  constexpr double kDegree = 180.0 / std::numbers::pi;
  const NormOrientation& turn = *at.solution.orientation;
  const Eigen::VectorXd off = turn.residual.colwise().norm().transpose();
  result.norm->direction_rms_deg =
      kDegree * std::sqrt(off.squaredNorm() / static_cast<double>(2 * off.size()));
  // From the median of the length of two normal errors to their standard deviation.
  double scatter = median({off.data(), off.data() + off.size()}) / 1.1774;
  if (at.stated_turn > 0.0) scatter = std::max(scatter, std::sqrt(at.model.turn_variance));
  for (Eigen::Index k = 0; k < off.size(); ++k) {
    if (!(off(k) > kNormOutlier * scatter) || off(k) < 1e-12) continue;
    const std::size_t place = at.place[turn.first[static_cast<std::size_t>(k)]];
    const Message& name = poses[place].name;
    judgement.contradictions.push_back(Message(
        "the stated direction of {pose} is off by {angle:.2g} degree, more than {times:g} robust standard "
        "deviations of all",
        name.empty() ? Message("pose {number}", place + 1) : name, kDegree * off(k), kNormOutlier));
  }
}

/// The part of the variances that is from the stated uncertainty of the directions.
void add_share_of_directions(const Estimate& at, NormResult& norm) {
  if (!at.solution.orientation || !(at.stated_turn > 0.0)) return;
  const Covariance9 of_turn =
      carried_covariance(intrinsic_jacobian(at.solution.line_sensitivity), at.solution.orientation->of_turn);
  const double stated = at.stated_turn / at.model.turn_variance;
  norm.shares.push_back({"the stated directions of the poses", std::string(kPoseUncertaintyKey),
                         stated * of_turn.diagonal(),
                         stated * at.solution.orientation->of_turn.diagonal().head<9>()});
}

/// Fills the result from checked poses, except for the source of the poses.
void estimate(std::span<const Pose> poses, const EffectSizes& sizes, std::optional<Angle> u_up,
              CalibrationResult& result, std::optional<NormFit>* fit) {
  const ScaledPoses scale = scaled(poses, sizes.hysteresis);
  Estimate at;
  at.u_known = scale.u_known;
  at.model.sizes = sizes;
  if (u_up) at.stated_turn = u_up->rad() * u_up->rad();
  if (poses.size() < kUnknowns && !scale.poses.front().up) at.model.orthogonality = sizes.orthogonality.rad();
  at.used = scale.poses;
  for (std::size_t i = 0; i < poses.size(); ++i) at.place.push_back(i);
  solve(at);
  leave_out_disturbed(at);
  const double rms = std::sqrt(at.solution.residual.squaredNorm() / static_cast<double>(at.used.size()));

  Judgement judgement;
  judge_scatter(at, result.diagnostics, judgement);
  fill_values(at, scale, result);
  Diagnostics& diagnostics = result.diagnostics;
  diagnostics.degrees_of_freedom = at.degrees_of_freedom();
  diagnostics.reciprocal_condition = at.solution.reciprocal_condition;
  diagnostics.rank = at.is_directed() ? kDirectedUnknowns : kUnknowns;
  diagnostics.angles_used = static_cast<int>(at.used.size());
  NormResult& norm = result.norm.emplace();
  norm.poses = static_cast<int>(at.used.size());
  norm.norm_rms = rms;
  norm.shares = at.solution.shares;
  add_share_of_directions(at, norm);
  for (NormEffectShare& share : norm.shares) {
    share.of_matrix *= scale.size * scale.size;
    for (const Eigen::Index i : {0, 1, 2, 6, 7, 8}) share.variance(i) *= scale.size * scale.size;
  }
  judge_outputs(at, scale, sizes, result, judgement);
  judge_coverage(at, result, judgement);
  list_left_out(poses, at, result, judgement);
  judge_directions(poses, at, result, judgement);
  if (at.model.orthogonality > 0.0) {
    diagnostics.notes.push_back(
        Message("{poses} poses are fewer than the nine unknowns: the angles between the axes are taken as 90 "
                "degrees with the stated standard uncertainty of {uncertainty:g} degree ([item_uncertainty] "
                "orthogonality_deg)",
                poses.size(), sizes.orthogonality.deg()));
  }
  if (judgement.contradictions.empty()) {
    result.verdict = Verdict::kUsable;
    result.why = Message("{poses} poses, norm constant to {rms:.2g} (rms); {scatter}", norm.poses, rms,
                         judgement.about_scatter);
  } else {
    result.verdict = Verdict::kDoubtful;
    result.why = in_sequence(judgement.contradictions);
  }
  if (fit != nullptr)
    *fit = NormFit{std::move(at.used), at.model,           std::move(at.solution), scale.centre,
                   scale.size,         at.scatter_degrees, at.turn_degrees};
}

void require_enough(std::size_t poses, bool directed, const EffectSizes& sizes) {
  if (directed && poses < kFewestDirections)
    throw UnusableData(
        fmt::format("norm fit: {} poses of stated directions; {} or more are required, in "
                    "directions that are not in one plane",
                    poses, kFewestDirections));
  if (poses >= kUnknowns || directed) return;
  if (poses >= kFewestPoses && sizes.orthogonality.rad() > 0.0) return;
  throw UnusableData(fmt::format(
      "norm fit: {} poses; nine or more are required, or six or more with the angles between the axes stated "
      "([item_uncertainty] orthogonality_deg)",
      poses));
}

void analyse_into(std::span<const Pose> poses, const EffectSizes& sizes, std::optional<Angle> u_up,
                  CalibrationResult& result, std::optional<NormFit>* fit = nullptr) {
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const Pose& pose = poses[i];
    if (!pose.reading.allFinite()) {
      throw UnusableData(fmt::format("norm fit: pose {}: the reading is not a finite number", i + 1));
    }
    if (pose.u && (!pose.u->allFinite() || !(pose.u->minCoeff() > 0.0))) {
      throw UnusableData(
          fmt::format("norm fit: pose {}: the uncertainty is not a finite number greater than zero", i + 1));
    }
  }
  try {
    require_enough(poses.size(), state_directions(poses), sizes);
    estimate(poses, sizes, u_up, result, fit);
  } catch (const UnusableData& error) {
    result.verdict = Verdict::kNotUsable;
    result.why = error.message();
  }
}

/// The poses of a record in the order of time, and the numbers of poses left out because of their flags.
struct RecordPoses {
  std::vector<Pose> poses;
  std::vector<const DwellRecord*> dwells;  ///< That of each pose.
  int clipped = 0, stuck = 0, not_finite = 0;

  void add(const DwellRecord& dwell, double t) {
    if ((dwell.flags & kFlagNotFinite) != 0U && !dwell.mean.allFinite()) {
      ++not_finite;
      return;
    }
    if ((dwell.flags & kFlagClipped) != 0U) {
      ++clipped;
      return;
    }
    if ((dwell.flags & kFlagStuck) != 0U) {
      ++stuck;
      return;
    }
    Pose pose{dwell.mean, {}, t, {}, {}, dwell.up};
    // An uncertainty of zero means that it is not known (a dwell without any scatter).
    if (dwell.u_mean && !(dwell.u_mean->minCoeff() <= 0.0)) pose.u = dwell.u_mean;
    if (dwell.experiment > 0) {
      pose.name =
          Message("experiment {experiment}, alpha = {angle:g} degrees", dwell.experiment, dwell.alpha.deg());
    } else if (dwell.role == DwellRole::kCheck) {
      pose.name = Message("check pose {number}", dwell.n);
    } else if (dwell.first_line > 0) {
      pose.name = dwell.first_line == dwell.last_line
                      ? Message("line {number}", dwell.first_line)
                      : Message("lines {first} to {last}", dwell.first_line, dwell.last_line);
    }
    poses.push_back(std::move(pose));
    dwells.push_back(&dwell);
  }

  /// The signs of the hysteresis from the motions of the stage, which are known only for the angles of
  /// experiments.
  void take_signs(const RunRecord& record) {
    if (!(record.tolerances.hysteresis > 0.0) || is_at_constant_rate(record)) return;
    std::vector<const DwellRecord*> at_angles;
    for (const DwellRecord* dwell : dwells)
      if (dwell->experiment >= 1 && dwell->mean.allFinite()) at_angles.push_back(dwell);
    constexpr std::size_t kFewest = 9;
    if (at_angles.size() < kFewest) return;
    Eigen::Matrix3d s;
    try {
      s = linear_fit_on_perfect_stage(at_angles).sensitivity_matrix;
    } catch (const UnusableData&) {
      return;  // The angles do not determine a response, but the poses may.
    }
    if (!(s.rowwise().norm().minCoeff() > 0.0)) return;
    const std::vector<Eigen::Vector3d> signs =
        signs_by_sizes(arrivals_at(record, dwells), s.rowwise().normalized(), record.tolerances);
    for (std::size_t i = 0; i < poses.size(); ++i) poses[i].sign = signs[i];
  }
};

}  // namespace

EffectSizes linear_item(EffectSizes sizes) {
  for (const EffectSizeKey& size : effect_size_keys())
    if (std::ranges::any_of(item_effects(), [&](const ItemEffect& effect) { return effect.key == size.key; }))
      size.set(sizes, 0.0);
  return sizes;
}

CalibrationResult analyse_norm(std::span<const Pose> poses, const EffectSizes& sizes,
                               std::optional<Angle> u_up) {
  CalibrationResult result;
  result.estimator = "norm";
  result.g_loc.unit = "m/s2";
  analyse_into(poses, sizes, u_up, result);
  add_voltmeter(sizes, result);
  return result;
}

CalibrationResult analyse_norm(const RunRecord& record, std::optional<NormFit>* fit) {
  CalibrationResult result;
  result.estimator = "norm";
  result.source = record.source;
  result.response_unit = record.response_unit;
  result.g_loc.unit = "m/s2";
  if (record.g_loc_known) {
    result.g_loc.value = record.g_loc.value_mps2;
    result.g_loc.standard_uncertainty = record.g_loc.expanded_uncertainty_mps2 / record.g_loc.coverage_factor;
    result.g_loc.type_b = result.g_loc.standard_uncertainty;
    result.g_loc_source = record.g_loc.source;
  }
  RecordPoses all;
  const std::vector<double> t = run_time_fractions(record);
  const std::vector<double> t_of_checks = check_time_fractions(record);
  std::size_t check = 0;
  for (std::size_t i = 0; i <= record.dwells.size(); ++i) {
    for (; check < record.check_poses.size() && record.check_poses[check].after <= i; ++check)
      all.add(record.check_poses[check].dwell, t_of_checks[check]);
    if (i < record.dwells.size()) all.add(record.dwells[i], t[i]);
  }
  count_flags(record, result.diagnostics);
  if (all.clipped > 0)
    result.diagnostics.notes.push_back(Message("{poses} clipped poses left out", all.clipped));
  if (all.stuck > 0)
    result.diagnostics.notes.push_back(Message("{poses} poses with a stuck output left out", all.stuck));
  if (all.not_finite > 0) {
    result.diagnostics.notes.push_back(
        Message("{poses} poses without finite readings left out", all.not_finite));
  }
  all.take_signs(record);
  analyse_into(all.poses, record.tolerances, record.u_up, result, fit);
  object_to_flags(record, kSuspectFlags & ~kLeftOutFlags, result);
  add_voltmeter(record.tolerances, result);
  return result;
}

}  // namespace abcal
