#include "protocol/estimators/checks/change_scan.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>
#include <optional>
#include <set>
#include <utility>

#include "protocol/estimators/joint/collect_readings.h"
#include "protocol/estimators/joint/effect_model.h"
#include "protocol/estimators/joint/noise_search.h"
#include "protocol/estimators/joint/white_noise_fit.h"
#include "protocol/estimators/shared/normal_matrix.h"
#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/model/effects.h"
#include "protocol/plan/limits.h"
#include "protocol/statistics/distributions.h"
#include "protocol/statistics/median.h"

namespace abcal {
namespace {

using Columns = Eigen::Matrix<double, 3, Eigen::Dynamic>;

/// Largest number of changes that are accounted for one after the other: single changes do not explain a run
/// with more.
constexpr std::size_t kMostChanges = 8;
/// A larger lasting turn leaves errors beyond the usual limits when it is accounted for linearly.
constexpr double kLargestLinearTurnDeg = 1.5;
/// Below this fraction of its own information a change cannot be distinguished from the other unknowns.
constexpr double kUndetermined = 1e-8;
constexpr double kDegrees = 180.0 / std::numbers::pi;

/// Positions of the columns within the block of lasting changes.
constexpr Eigen::Index kSlipColumn = 0, kAxisXColumn = 3, kOutputColumn = 4, kGainColumn = 7,
                       kLastingColumns = 10;

bool lasts(ChangeKind kind) {
  return kind == ChangeKind::kSlip || kind == ChangeKind::kAxisX || kind == ChangeKind::kAxisZ ||
         kind == ChangeKind::kOutput || kind == ChangeKind::kGain;
}

bool is_turn(ChangeKind kind) {
  return kind == ChangeKind::kSlip || kind == ChangeKind::kAxisX || kind == ChangeKind::kAxisZ ||
         kind == ChangeKind::kAngle;
}

/// Best size of a change and the fall of chi2 that it makes.
struct Gain {
  Eigen::VectorXd size;
  double fall = 0.0;
  int degrees_of_freedom = 0;
};

/// @param own  information about the change if all other unknowns were known
Gain gain_of(const Eigen::MatrixXd& information, const Eigen::VectorXd& right, const Eigen::VectorXd& own) {
  Gain gain;
  gain.size = Eigen::VectorXd::Zero(right.size());
  if (right.size() == 1) {
    if (!(own(0) > 0.0 && information(0, 0) / own(0) > kUndetermined)) return gain;
    gain.size(0) = right(0) / information(0, 0);
    gain.fall = right(0) * gain.size(0);
    gain.degrees_of_freedom = 1;
    return gain;
  }
  const Eigen::VectorXd scale =
      own.unaryExpr([](double value) { return value > 0.0 ? 1.0 / std::sqrt(value) : 0.0; });
  const SymmetricEigen eigen = symmetric_eigen(scaled_on_both_sides(information, scale));
  for (Eigen::Index k = 0; k < right.size(); ++k) {
    const double value = eigen.values(k);
    if (!(value > kUndetermined)) continue;
    const Eigen::VectorXd direction = scale.cwiseProduct(eigen.vectors.col(k));
    const double along = direction.dot(right);
    gain.size += direction * (along / value);
    gain.fall += along * along / value;
    ++gain.degrees_of_freedom;
  }
  return gain;
}

/// The model of the joint fit, linear at one point, with the step errors inside the covariance of each
/// angle's readings, and everything whitened by it. Relative units, as in the fit.
class LinearModel {
 public:
  /// @param fitted  the model at the point of linearisation
  /// @param white   standard deviations of the outputs' white noise, over the u of the readings
  LinearModel(const EffectModel& fitted, const std::vector<EffectReading>& readings,
              const Eigen::Vector3d& white)
      : fitted_(fitted),
        first_change_(fitted.layout().count()),
        prior_weight_(fitted.prior_weight()),
        prior_distance_(-fitted.from_prior()),
        x_(fitted.jacobian()) {
    const std::vector<NoiseAtAngle> angles = fitted.noise_at_angles(white);
    const NoiseWhitener whitener(angles, fitted.step_sd(), NoiseProcess{});
    whitener.whiten(x_);
    ReadingRows residual = fitted.residual();
    whitener.whiten(residual);
    y_ = residual;
    // With white noise every angle is whitened by a matrix of its own.
    ReadingRows whitening = Eigen::Matrix3d::Identity().replicate(row(readings.size()) / 3, 1);
    whitener.whiten(whitening);
    const Eigen::Matrix3d rows = fitted.rows();
    for (std::size_t i = 0; i < readings.size(); ++i) {
      whiten_.emplace_back(whitening.middleRows<3>(row(i)));
      by_step_.push_back(angles[i].by_step);
      const GravityAt gravity = fitted.gravity(i);
      Eigen::Matrix<double, 3, kLastingColumns> lasting;
      lasting.middleCols<3>(kSlipColumn) = rows * cross_matrix(gravity.g);
      lasting.col(kAxisXColumn) = rows * gravity.by_input.col(kInputAngleX);
      lasting.middleCols<3>(kOutputColumn) = outputs();
      lasting.middleCols<3>(kGainColumn) = (rows * gravity.g).asDiagonal();
      lasting_.push_back(lasting);
    }
  }

  std::size_t size() const { return whiten_.size(); }

  void solve() {
    Eigen::MatrixXd normal = products_of_columns(x_);
    normal.diagonal() += prior_weight_;
    const Eigen::VectorXd right =
        transposed_product_by_rows_with_vector(x_, y_) + prior_weight_.cwiseProduct(prior_distance_);
    const NormalMatrix solved(std::move(normal));
    if (!solved.solvable()) {
      throw UnusableData("the readings do not determine the model that changes are looked for with");
    }
    root_ = solved.covariance_root();
    const Eigen::VectorXd change = product_with_vector(root_, transposed_product_with_vector(root_, right));
    solution_ = fitted_.value() + change.head(first_change_);
    residual_ = y_ - product_with_vector(x_, change);
    chi2_ = prior_weight_.dot((prior_distance_ - change).cwiseAbs2()) + residual_.squaredNorm();
    taken_ = times_upper(x_, root_);
  }

  double chi2() const { return chi2_; }
  /// |s_j|, R/g_loc.
  double sensitivity(int output) const { return unit(output) * row_of(output).norm(); }
  double u_sensitivity(int output) const {
    return unit(output) * u_along(first_of(output), row_of(output).normalized());
  }
  /// The drift of an output over the run, R; 0 where it is stated as zero.
  double drift(int output) const {
    const auto place = drift_of(output);
    return place ? unit(output) * solution_(*place) : 0.0;
  }
  double u_drift(int output) const {
    const auto place = drift_of(output);
    return place ? unit(output) * u_along(*place, Eigen::Vector<double, 1>(1.0)) : 0.0;
  }
  double degrees_of_freedom() const {
    return 3.0 * static_cast<double>(size()) - 12.0 -
           static_cast<double>(prior_weight_.size() - first_change_);
  }

  /// The best of each kind: the largest fall of chi2 for its number of unknowns.
  std::vector<std::pair<Change, Gain>> best_of_each() const {
    std::vector<std::pair<Change, Gain>> best;
    for (const ChangeKind kind : kChangeKinds) best.emplace_back().first.kind = kind;
    const auto offer = [&](ChangeKind kind, std::size_t at, int accelerometer, Gain gain) {
      auto& [change, so_far] = best[static_cast<std::size_t>(kind)];
      if (gain.degrees_of_freedom == 0 || !(gain.fall > so_far.fall)) return;
      change.at = at;
      change.accelerometer = accelerometer;
      change.size.setZero();
      change.size.head(gain.size.size()) = gain.size;
      so_far = std::move(gain);
    };
    lasting_changes(offer);
    single_changes(offer);
    return best;
  }

  /// Adds the change to the unknowns of the model, without a prior.
  void account_for(const Change& change) {
    const Eigen::Index before = prior_weight_.size();
    const Eigen::Index columns = columns_of(change, change.at).cols();
    prior_weight_.conservativeResize(before + columns);
    prior_distance_.conservativeResize(before + columns);
    prior_weight_.tail(columns).setZero();
    prior_distance_.tail(columns).setZero();
    x_.conservativeResize(x_.rows(), before + columns);
    for (std::size_t i = 0; i < size(); ++i)
      x_.block(row(i), before, 3, columns) = whiten_[i] * columns_of(change, i);
    // A direction that the readings do not determine must not make the normal matrix singular.
    for (Eigen::Index k = before; k < before + columns; ++k)
      prior_weight_(k) = kUndetermined * x_.col(k).squaredNorm();
  }

 private:
  static Eigen::Index row(std::size_t i) { return 3 * static_cast<Eigen::Index>(i); }

  double unit(int output) const { return fitted_.unit()(output); }
  /// Change of the readings (relative units) for a jump of each output by one R.
  Eigen::Matrix3d outputs() const { return fitted_.unit().cwiseInverse().asDiagonal(); }
  Eigen::Index first_of(int output) const { return fitted_.layout().own_count() * output; }
  Eigen::Vector3d row_of(int output) const { return solution_.segment<3>(first_of(output)); }
  std::optional<Eigen::Index> drift_of(int output) const {
    const std::vector<EffectLayout::OwnUnknown>& own = fitted_.layout().own;
    for (std::size_t i = 0; i < own.size(); ++i) {
      if (own[i].effect->name == "drift" && own[i].index == 0)
        return first_of(output) + EffectLayout::kOwnFixed + static_cast<Eigen::Index>(i);
    }
    return std::nullopt;
  }
  /// Standard uncertainty of a combination of successive unknowns.
  double u_along(Eigen::Index first, const Eigen::VectorXd& direction) const {
    return (root_.middleRows(first, direction.size()).transpose() * direction).norm();
  }

  /// Derivatives of the readings at angle i by the sizes of the change.
  Columns columns_of(const Change& change, std::size_t i) const {
    const bool touched = lasts(change.kind) ? i >= change.at : i == change.at;
    Columns columns;
    switch (change.kind) {
      case ChangeKind::kSlip:
        columns = lasting_[i].middleCols<3>(kSlipColumn);
        break;
      case ChangeKind::kAxisX:
        columns = lasting_[i].col(kAxisXColumn);
        break;
      case ChangeKind::kAxisZ:
        columns = lasting_[i].col(kSlipColumn + 2);
        break;
      case ChangeKind::kOutput:
      case ChangeKind::kReading:
        columns = outputs().col(change.accelerometer);
        break;
      case ChangeKind::kGain:
        columns = lasting_[i].col(kGainColumn + change.accelerometer);
        break;
      case ChangeKind::kAngle:
        columns = by_step_[i];
        break;
      case ChangeKind::kReadings:
        columns = outputs();
        break;
    }
    if (!touched) columns.setZero();
    return columns;
  }

  template <class Offer>
  void lasting_changes(const Offer& offer) const {
    using Square = Eigen::Matrix<double, kLastingColumns, kLastingColumns>;
    Square own = Square::Zero();
    Eigen::MatrixXd taken = Eigen::MatrixXd::Zero(kLastingColumns, prior_weight_.size());
    Eigen::Matrix<double, kLastingColumns, 1> right = Eigen::Matrix<double, kLastingColumns, 1>::Zero();
    for (std::size_t at = size(); at-- > 1;) {  // from angle 0 on it is not a change
      const Eigen::Matrix<double, kLastingColumns, 3> whitened = (whiten_[at] * lasting_[at]).transpose();
      own += whitened * whitened.transpose();
      taken += product(whitened, taken_.middleRows<3>(row(at)));
      right += whitened * residual_.segment<3>(row(at));
      const Square information = own - covariance_of_root(taken);
      const auto block = [&](Eigen::Index first, Eigen::Index count) {
        return gain_of(information.block(first, first, count, count), right.segment(first, count),
                       own.diagonal().segment(first, count));
      };
      offer(ChangeKind::kSlip, at, -1, block(kSlipColumn, 3));
      offer(ChangeKind::kAxisX, at, -1, block(kAxisXColumn, 1));
      offer(ChangeKind::kAxisZ, at, -1, block(kSlipColumn + 2, 1));
      for (int j = 0; j < 3; ++j) {
        offer(ChangeKind::kOutput, at, j, block(kOutputColumn + j, 1));
        offer(ChangeKind::kGain, at, j, block(kGainColumn + j, 1));
      }
    }
  }

  template <class Offer>
  void single_changes(const Offer& offer) const {
    for (std::size_t at = 0; at < size(); ++at) {
      const Eigen::Matrix3d outputs_whitened = whiten_[at] * outputs();
      const auto taken = taken_.middleRows<3>(row(at));
      const Eigen::Matrix3d left = Eigen::Matrix3d::Identity() - covariance_of_root(taken);
      const Eigen::Matrix3d information = outputs_whitened.transpose() * left * outputs_whitened;
      const Eigen::Matrix3d own = outputs_whitened.transpose() * outputs_whitened;
      const Eigen::Vector3d right = outputs_whitened.transpose() * residual_.segment<3>(row(at));
      offer(ChangeKind::kReadings, at, -1, gain_of(information, right, own.diagonal()));
      for (int j = 0; j < 3; ++j) {
        offer(ChangeKind::kReading, at, j,
              gain_of(information.block<1, 1>(j, j), right.segment<1>(j), own.diagonal().segment<1>(j)));
      }
      const Eigen::Vector3d s = fitted_.unit().cwiseProduct(by_step_[at]);
      const auto scalar = [](double value) { return Eigen::VectorXd::Constant(1, value); };
      offer(ChangeKind::kAngle, at, -1,
            gain_of(scalar(s.dot(information * s)), scalar(s.dot(right)), scalar(s.dot(own * s))));
    }
  }

  const EffectModel& fitted_;
  Eigen::VectorXd solution_;
  Eigen::Index first_change_;  ///< First column of the changes that are accounted for.
  Eigen::VectorXd prior_weight_, prior_distance_;
  std::vector<Eigen::Matrix3d> whiten_;  ///< Whitening matrix of the readings at each angle.
  std::vector<Eigen::Matrix<double, 3, kLastingColumns>> lasting_;
  std::vector<Eigen::Vector3d> by_step_;
  ReadingRows x_;  ///< Whitened, like y_ and residual_.
  Eigen::VectorXd y_, residual_;
  Eigen::MatrixXd root_;
  ReadingRows taken_;  ///< x root: the part of a change that the other unknowns absorb.
  double chi2_ = 0.0;
};

/// Compares the best change of each kind with its limits, in units of the remaining scatter.
std::vector<Change> judged(const LinearModel& model, const RunRecord& record,
                           const Eigen::Vector3d& sensitivity) {
  const double drift = drift_limit(record.limits, record.tolerances);
  const auto looks = static_cast<double>(model.size());
  std::vector<Change> changes;
  for (auto& [change, gain] : model.best_of_each()) {
    if (gain.degrees_of_freedom == 0) continue;
    const double left =
        std::max(1.0, (model.chi2() - gain.fall) / (model.degrees_of_freedom() - gain.degrees_of_freedom));
    change.gain = gain.fall / left;
    const double outputs = change.accelerometer >= 0 ? 3.0 : 1.0;
    change.needed = chi2_above(kFalseAlarm / (looks * outputs), gain.degrees_of_freedom);
    double limit = 0.0;
    if (is_turn(change.kind)) {
      change.magnitude = change.size.norm() * kDegrees;
      limit = (change.kind == ChangeKind::kAngle ? angle_limit(record.limits, record.tolerances)
                                                 : slip_limit(record.limits, record.tolerances))
                  .deg();
    } else if (change.kind == ChangeKind::kGain) {
      change.magnitude = std::abs(change.size(0));
      limit = gain_limit(record.tolerances);
    } else if (change.accelerometer >= 0) {
      change.magnitude = std::abs(change.size(0)) / sensitivity(change.accelerometer);
      limit = drift;
    } else {
      change.magnitude = change.size.cwiseQuotient(sensitivity).norm();
      limit = drift;
    }
    change.beyond = change.gain > change.needed && change.magnitude > limit;
    change.limit =
        std::max(limit, change.magnitude * std::sqrt(change.needed / std::max(change.gain, 1e-30)));
    changes.push_back(std::move(change));
  }
  return changes;
}

/// Gain less a penalty for each unknown, as in the Bayesian information criterion.
double worth(const Change& change, double readings) {
  const double unknowns =
      change.kind == ChangeKind::kSlip || change.kind == ChangeKind::kReadings ? 3.0 : 1.0;
  return change.gain - unknowns * std::log(readings);
}

/// Readings in order of time. An uncertainty below the median of its output is raised to it: small by chance.
std::vector<EffectReading> readings_in_time(const RunRecord& record, ChangeScan& scan,
                                            EffectFitOptions& options) {
  const CollectedReadings data = collect_readings(record);
  if (data.readings.size() < 5) throw UnusableData("fewer than 5 usable angles");
  std::vector<std::size_t> order(data.readings.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return data.readings[a].t < data.readings[b].t; });
  std::vector<EffectReading> readings;
  for (const std::size_t i : order) {
    readings.push_back(data.readings[i]);
    scan.dwells.push_back(data.dwells[i]);
  }
  options.white_known = data.u_known;
  options.sweeps = data.sweeps;
  if (!data.u_known) return readings;
  for (int j = 0; j < 3; ++j) {
    std::vector<double> u;
    for (const EffectReading& reading : readings) u.push_back(reading.u(j));
    const double usual = median(std::move(u));
    for (EffectReading& reading : readings) reading.u(j) = std::max(reading.u(j), usual);
  }
  return readings;
}

/// Moves `model` to the point of `fitted`, which lacks the readings left out. Each of these gets the step
/// error that brings the model closest to it, if that is much closer than without, else 0: a step error
/// explains the readings at a wrong angle, but not a wrong output.
void move_to_fit(const EffectModel& fitted, const std::set<std::size_t>& left_out, EffectModel& model) {
  std::vector<double> steps;
  for (std::size_t i = 0, k = 0; i < model.angles(); ++i)
    steps.push_back(left_out.contains(i) ? 0.0 : fitted.steps()[k++]);
  model.move_to(fitted, steps);
  if (left_out.empty()) return;
  const auto distance = [&](std::size_t i) {
    const Eigen::Vector3d u = model.noise_at_angles(Eigen::Vector3d::Ones())[i].white.cwiseSqrt();
    return model.misfit().segment<3>(3 * static_cast<Eigen::Index>(i)).cwiseQuotient(u).squaredNorm();
  };
  std::map<std::size_t, double> without;
  for (const std::size_t i : left_out) without[i] = distance(i);
  for (int iteration = 0; iteration < 20; ++iteration) {
    const std::vector<NoiseAtAngle> angles = model.noise_at_angles(Eigen::Vector3d::Ones());
    for (const std::size_t i : left_out) {
      const Eigen::Vector3d weighted = angles[i].by_step.cwiseQuotient(angles[i].white);
      const double information = weighted.dot(angles[i].by_step);
      if (information > 0.0)
        steps[i] = weighted.dot(model.residual().segment<3>(3 * static_cast<Eigen::Index>(i))) / information;
    }
    model.move_to(fitted, steps);
  }
  constexpr double kMuchCloser = 0.01;
  for (const auto& [i, far] : without) {
    if (!(distance(i) < kMuchCloser * far)) steps[i] = 0.0;
  }
  model.move_to(fitted, steps);
}

/// Moves `model`, which has all readings, to the joint fit of those that are not left out.
/// @return the white noise of the outputs, over the u of the readings; nullopt without convergence
std::optional<Eigen::Vector3d> fit_without(const std::set<std::size_t>& left_out,
                                           const std::vector<EffectReading>& readings, EffectModel& model) {
  std::vector<EffectReading> used;
  for (std::size_t i = 0; i < readings.size(); ++i) {
    if (!left_out.contains(i)) used.push_back(readings[i]);
  }
  // Readings far from the model must not be explained by the further effects.
  EffectFitOptions options = model.options();
  options.sizes = without_further_effects(options.sizes);
  EffectModel fitted(used, options);
  if (!fit_with_white_noise(fitted).minimum.found) return std::nullopt;
  move_to_fit(fitted, left_out, model);
  return model.options().white_known ? Eigen::Vector3d::Ones() : estimate_white(fitted).white;
}

/// Finds one change after the other, and accounts for each before it searches for the next.
void find_changes(LinearModel& model, const RunRecord& record, ChangeScan& scan) {
  scan.found.clear();
  const double count = 3.0 * static_cast<double>(model.size());
  for (std::size_t round = 0;; ++round) {
    model.solve();
    for (int j = 0; j < 3; ++j) scan.sensitivity(j) = model.sensitivity(j);
    scan.largest = judged(model, record, scan.sensitivity);
    const auto best =
        std::max_element(scan.largest.begin(), scan.largest.end(),
                         [&](const Change& a, const Change& b) { return worth(a, count) < worth(b, count); });
    if (round == kMostChanges || best == scan.largest.end() || !(best->gain > best->needed)) break;
    Change found = *best;
    for (const Change& other : scan.largest) {
      const bool as_good = other.gain > other.needed && other.gain > found.gain - found.needed;
      // Two changes of single angles are alternatives only at the same angle.
      const bool comparable = lasts(other.kind) || lasts(found.kind) || other.at == found.at;
      if (other.kind != found.kind && as_good && comparable) found.as_well.push_back(other.kind);
    }
    model.account_for(found);
    scan.too_large = lasts(found.kind) && is_turn(found.kind) && found.magnitude > kLargestLinearTurnDeg;
    if (found.beyond) scan.found.push_back(std::move(found));
    if (scan.too_large) return;
  }
  for (int j = 0; j < 3; ++j) {
    scan.u_sensitivity(j) = model.u_sensitivity(j);
    scan.drift(j) = model.drift(j);
    scan.u_drift(j) = model.u_drift(j);
  }
}

}  // namespace

ChangeScan scan_for_changes(const RunRecord& record) {
  ChangeScan scan;
  EffectFitOptions options{.sizes = record.tolerances, .measured_alignment = record.measured_alignment};
  const std::vector<EffectReading> readings = readings_in_time(record, scan, options);
  EffectModel model(readings, options);
  std::set<std::size_t> left_out;
  // A sound run needs one pass; others need more until the set of wrong angles stays the same.
  constexpr int kMostFits = 4;
  for (int pass = 0; pass < kMostFits; ++pass) {
    const std::optional<Eigen::Vector3d> white = fit_without(left_out, readings, model);
    scan.converged = white.has_value();
    if (!scan.converged) break;
    LinearModel linear(model, readings, *white);
    find_changes(linear, record, scan);
    if (scan.too_large) break;
    std::set<std::size_t> wrong;
    for (const Change& change : scan.found) {
      if (!lasts(change.kind)) wrong.insert(change.at);
    }
    if (wrong == left_out) break;
    left_out = std::move(wrong);
  }
  return scan;
}

}  // namespace abcal
