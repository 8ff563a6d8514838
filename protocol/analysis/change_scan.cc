#include "protocol/analysis/change_scan.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <set>
#include <utility>

#include "protocol/analysis/joint_data.h"
#include "protocol/analysis/normal_matrix.h"
#include "protocol/analysis/reading_kernels.h"
#include "protocol/analysis/unusable_data.h"
#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/model/effects.h"
#include "protocol/plan/limits.h"
#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

using Columns = Eigen::Matrix<double, 3, Eigen::Dynamic>;

/// At most so many changes are accounted for one after the other: what is left then is not a matter of single
/// changes.
constexpr std::size_t kMostChanges = 8;
/// A lasting turn by more leaves more than the usual limits behind where it is accounted for linearly.
constexpr double kLargestLinearTurnDeg = 1.5;
/// Below this fraction of its own information a change cannot be told from the other unknowns.
constexpr double kUndetermined = 1e-8;
constexpr double kDegrees = 180.0 / std::numbers::pi;

/// Where the columns of the lasting changes stand among each other.
constexpr Eigen::Index kSlipColumn = 0, kAxisXColumn = 3, kOutputColumn = 4, kGainColumn = 7,
                       kLastingColumns = 10;

Eigen::Matrix3d cross_product(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

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

/// @param own  the change's own information, before the other unknowns take theirs
Gain gain_of(const Eigen::MatrixXd& information, const Eigen::VectorXd& right, const Eigen::VectorXd& own) {
  Gain gain;
  gain.size = Eigen::VectorXd::Zero(right.size());
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

/// An effect of the table that is no unknown of the fit from which the search starts.
struct FurtherEffect {
  EffectColumn column;
  double prior = 0.0;
};

/// Smooth step errors, wobble, drifts of higher order and of the sensitivity, higher non-linearity,
/// hysteresis: what may be there must not be taken for a change.
std::vector<FurtherEffect> further_effects(const EffectSizes& sizes) {
  std::vector<FurtherEffect> out;
  for (const StageEffect& effect : stage_effects()) {
    if (effect.key != "step_smooth_deg" && effect.key != "wobble_urad") continue;
    for (int i = 0; i < effect.count; ++i) out.push_back({{&effect, nullptr, i, -1}, effect.prior(sizes)});
  }
  for (const ItemEffect& effect : item_effects()) {
    if (effect.key == "k2" || effect.key == "k3") continue;
    for (int i = effect.key == "drift" ? 1 : 0; i < effect.count; ++i) {
      for (int j = 0; j < 3; ++j) out.push_back({{nullptr, &effect, i, j}, effect.prior(sizes)});
    }
  }
  std::erase_if(out, [](const FurtherEffect& effect) { return !(effect.prior > 0.0); });
  return out;
}

/// The joint model linear about its solution, with the step errors inside the covariance of each angle's
/// readings, and everything whitened by it.
class LinearModel {
 public:
  /// @param step  f of each reading about which its model is linear, radian
  LinearModel(const std::vector<JointReading>& readings, const JointVector& value,
              const std::vector<double>& step, const JointPriors& priors, const EffectSizes& sizes)
      : further_(further_effects(sizes)), value_(value) {
    set_priors(priors);
    const auto count = static_cast<Eigen::Index>(readings.size());
    x_ = ReadingRows::Zero(3 * count, prior_weight_.size());
    y_.resize(3 * count);
    Eigen::Vector3d before = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < readings.size(); ++i) {
      add_reading(readings[i], step[i], priors, i);
      add_further_effects(readings[i], i, before);
      auto three = x_.middleRows<3>(row(i));
      three = (lower_.back().transpose() * three).eval();
    }
  }

  std::size_t size() const { return lower_.size(); }

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
    solution_ = value_ + change.head<kJointUnknowns>();
    residual_ = y_ - product_with_vector(x_, change);
    chi2_ = prior_weight_.dot((prior_distance_ - change).cwiseAbs2()) + residual_.squaredNorm();
    taken_ = times_upper(x_, root_);
  }

  double chi2() const { return chi2_; }
  const JointVector& solution() const { return solution_; }
  JointMatrix covariance() const { return covariance_of_root(root_.topRows<kJointUnknowns>()); }
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

  /// From now on the change is one more unknown of the model, without a prior.
  void account_for(const Change& change) {
    const Eigen::Index before = prior_weight_.size();
    const Eigen::Index columns = columns_of(change, change.at).cols();
    prior_weight_.conservativeResize(before + columns);
    prior_distance_.conservativeResize(before + columns);
    prior_weight_.tail(columns).setZero();
    prior_distance_.tail(columns).setZero();
    x_.conservativeResize(x_.rows(), before + columns);
    for (std::size_t i = 0; i < size(); ++i)
      x_.block(row(i), before, 3, columns) = lower_[i].transpose() * columns_of(change, i);
    // A direction that the readings do not determine must not make the normal matrix singular.
    for (Eigen::Index k = before; k < before + columns; ++k)
      prior_weight_(k) = kUndetermined * x_.col(k).squaredNorm();
  }

 private:
  static Eigen::Index row(std::size_t i) { return 3 * static_cast<Eigen::Index>(i); }

  void set_priors(const JointPriors& priors) {
    first_change_ = kJointUnknowns + static_cast<Eigen::Index>(further_.size());
    prior_weight_ = Eigen::VectorXd::Zero(first_change_);
    prior_distance_ = Eigen::VectorXd::Zero(first_change_);
    const auto prior = [&](Eigen::Index i, double mean, double sd) {
      prior_weight_(i) = 1.0 / (sd * sd);
      prior_distance_(i) = mean - (i < kJointUnknowns ? value_(i) : 0.0);
    };
    for (int j = 0; j < 3; ++j) {
      matrix_.row(j) = value_.segment<3>(kOwnUnknowns * j).transpose();
      const double s = matrix_.row(j).norm();
      prior(kOwnUnknowns * j + kDriftIndex, 0.0, priors.drift * s);
      prior(kOwnUnknowns * j + kK2Index, 0.0, priors.k2 / s);
      prior(kOwnUnknowns * j + kK3Index, 0.0, priors.k3 / (s * s));
    }
    for (int i = 0; i < kGeometryUnknowns; ++i) prior(kZx + i, priors.mean(i), priors.sd(i));
    for (std::size_t k = 0; k < further_.size(); ++k)
      prior(kJointUnknowns + static_cast<Eigen::Index>(k), 0.0, further_[k].prior);
  }

  /// The model of the fit at one reading, and what whitens it.
  void add_reading(const JointReading& reading, double step, const JointPriors& priors, std::size_t i) {
    const JointModelPoint point = joint_model(reading, value_, step);
    auto x = x_.middleRows<3>(row(i));
    x.leftCols<kJointUnknowns>() = point.by_unknown;
    const Eigen::Vector3d information = reading.u.cwiseAbs2().cwiseInverse();
    const Eigen::Vector3d along = information.cwiseProduct(point.by_step_error);
    const double step_information = 1.0 / (priors.step * priors.step) + along.dot(point.by_step_error);
    Eigen::Matrix3d w = information.asDiagonal();
    w -= along * along.transpose() / step_information;
    lower_.emplace_back(w.llt().matrixL());

    Eigen::Matrix<double, 3, kLastingColumns> lasting;
    const Eigen::Vector3d g = point.by_unknown.block<1, 3>(0, 0).transpose();
    lasting.middleCols<3>(kSlipColumn) = matrix_ * cross_product(g);
    lasting.col(kAxisXColumn) =
        reading.experiment == 3 ? Eigen::Vector3d(point.by_unknown.col(kD3)) : point.by_step_error;
    lasting.middleCols<3>(kOutputColumn).setIdentity();
    lasting.middleCols<3>(kGainColumn) = (matrix_ * g).asDiagonal();
    lasting_.push_back(lasting);
    by_step_.push_back(point.by_step_error);
    y_.segment<3>(row(i)) =
        lower_.back().transpose() * (reading.value - point.reading + point.by_step_error * step);
  }

  /// Their columns, at a perfect stage. @param before  relative responses of the reading before, then of this
  void add_further_effects(const JointReading& reading, std::size_t i, Eigen::Vector3d& before) {
    const Eigen::Vector3d unit = matrix_.rowwise().norm();
    const StagePose pose = StagePose::of(reading.experiment, reading.sin_alpha, reading.cos_alpha);
    const GravityAt gravity = gravity_at(pose, StageInputs::Zero());
    ItemPoint point{reading.t, (matrix_ * gravity.g).cwiseQuotient(unit), Eigen::Vector3d::Zero()};
    if (i > 0) point.came_from = signs_of_change(before, point.y);
    before = point.y;
    const Eigen::Matrix<double, 3, kStageInputs> by_input = matrix_ * gravity.by_input;
    for (std::size_t k = 0; k < further_.size(); ++k)
      x_.block<3, 1>(row(i), kJointUnknowns + static_cast<Eigen::Index>(k)) =
          further_[k].column.at(pose, point, by_input, unit);
  }

  /// What a change of one unit does to the readings at angle i.
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
        columns = Eigen::Vector3d::Unit(change.accelerometer);
        break;
      case ChangeKind::kGain:
        columns = lasting_[i].col(kGainColumn + change.accelerometer);
        break;
      case ChangeKind::kAngle:
        columns = by_step_[i];
        break;
      case ChangeKind::kReadings:
        columns = Eigen::Matrix3d::Identity();
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
    for (std::size_t at = size(); at-- > 1;) {  // from the first angle on is no change
      const Eigen::Matrix<double, kLastingColumns, 3> whitened =
          (lower_[at].transpose() * lasting_[at]).transpose();
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
      const Eigen::Matrix3d& lower = lower_[at];
      const auto taken = taken_.middleRows<3>(row(at));
      const Eigen::Matrix3d left = Eigen::Matrix3d::Identity() - covariance_of_root(taken);
      const Eigen::Matrix3d information = lower * left * lower.transpose();
      const Eigen::Matrix3d own = lower * lower.transpose();
      const Eigen::Vector3d right = lower * residual_.segment<3>(row(at));
      offer(ChangeKind::kReadings, at, -1, gain_of(information, right, own.diagonal()));
      for (int j = 0; j < 3; ++j) {
        offer(ChangeKind::kReading, at, j,
              gain_of(information.block<1, 1>(j, j), right.segment<1>(j), own.diagonal().segment<1>(j)));
      }
      const Eigen::Vector3d& s = by_step_[at];
      const auto scalar = [](double value) { return Eigen::VectorXd::Constant(1, value); };
      offer(ChangeKind::kAngle, at, -1,
            gain_of(scalar(s.dot(information * s)), scalar(s.dot(right)), scalar(s.dot(own * s))));
    }
  }

  std::vector<FurtherEffect> further_;
  JointVector value_, solution_ = JointVector::Zero();
  Eigen::Matrix3d matrix_;
  Eigen::VectorXd prior_weight_, prior_distance_;
  Eigen::Index first_change_ = 0;       ///< Columns from here on are of changes that are accounted for.
  std::vector<Eigen::Matrix3d> lower_;  ///< Of the weight of each angle's readings: w = lower lower'.
  std::vector<Eigen::Matrix<double, 3, kLastingColumns>> lasting_;
  std::vector<Eigen::Vector3d> by_step_;
  ReadingRows x_;  ///< Whitened, as the next two.
  Eigen::VectorXd y_, residual_;
  Eigen::MatrixXd root_;
  ReadingRows taken_;  ///< x root: what the unknowns take of a change.
  double chi2_ = 0.0;
};

/// Judges the best of each kind by what is left of chi2.
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

/// Fewest unknowns first: what each is worth, as in the Bayesian information criterion.
double worth(const Change& change, double readings) {
  const double unknowns =
      change.kind == ChangeKind::kSlip || change.kind == ChangeKind::kReadings ? 3.0 : 1.0;
  return change.gain - unknowns * std::log(readings);
}

/// Readings in the order in which they were measured, with uncertainties that are not small by chance.
std::vector<JointReading> readings_in_time(const RunRecord& record, ChangeScan& scan, bool& u_known) {
  const JointData data = collect_joint_data(record, false);
  if (data.readings.size() < 5) throw UnusableData("fewer than 5 usable angles");
  std::vector<std::size_t> order(data.readings.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return data.readings[a].t < data.readings[b].t; });
  std::vector<JointReading> readings;
  for (const std::size_t i : order) {
    readings.push_back(data.readings[i]);
    scan.dwells.push_back(data.dwells[i]);
  }
  if (readings.size() < 5) throw UnusableData("fewer than 5 usable angles");
  u_known = data.u_known;
  if (!u_known) return readings;
  for (int j = 0; j < 3; ++j) {
    std::vector<double> u;
    for (const JointReading& reading : readings) u.push_back(reading.u(j));
    const double usual = median(std::move(u));
    for (JointReading& reading : readings) reading.u(j) = std::max(reading.u(j), usual);
  }
  return readings;
}

struct Fitted {
  bool converged = false;
  JointVector value;
  std::vector<double> step;  ///< f of each reading about which its model is made linear, radian.
};

/// f that brings the model closest to one reading, if it brings it much closer than f = 0; else 0: where the
/// angle is far off another angle explains the readings, where an output is far off none does.
double own_step_error(const JointReading& reading, const JointVector& value) {
  double f = 0.0;
  const auto distance = [&](double step) {
    return (reading.value - joint_model(reading, value, step).reading).cwiseQuotient(reading.u).squaredNorm();
  };
  for (int iteration = 0; iteration < 20; ++iteration) {
    const JointModelPoint point = joint_model(reading, value, f);
    const Eigen::Vector3d slope = point.by_step_error.cwiseQuotient(reading.u);
    const Eigen::Vector3d difference = (reading.value - point.reading).cwiseQuotient(reading.u);
    if (!(slope.squaredNorm() > 0.0)) return 0.0;
    f += slope.dot(difference) / slope.squaredNorm();
  }
  constexpr double kMuchCloser = 0.01;
  return distance(f) < kMuchCloser * distance(0.0) ? f : 0.0;
}

/// The joint fit of all readings but those left out. `readings` get the noise found where none was known.
Fitted fit_without(const std::set<std::size_t>& left_out, const JointPriors& priors, bool u_known,
                   std::vector<JointReading>& readings) {
  std::vector<JointReading> used;
  for (std::size_t i = 0; i < readings.size(); ++i) {
    if (left_out.contains(i)) continue;
    used.push_back(readings[i]);
    used.back().step_error = static_cast<int>(used.size()) - 1;
  }
  const JointFit fit = u_known ? joint_fit(used, priors, {}) : fit_with_unknown_noise(used, priors, {});
  if (!fit.converged) return {};
  Fitted fitted{true, fit.value, std::vector<double>(readings.size())};
  for (std::size_t i = 0, k = 0; i < readings.size(); ++i) {
    if (!u_known) readings[i].u = used.front().u;
    fitted.step[i] = left_out.contains(i) ? own_step_error(readings[i], fit.value) : fit.step_error[k++];
  }
  return fitted;
}

/// Finds one change after the other, each accounted for before the next is looked for.
void find_changes(LinearModel& model, const RunRecord& record, ChangeScan& scan) {
  scan.found.clear();
  const double count = 3.0 * static_cast<double>(model.size());
  for (std::size_t round = 0;; ++round) {
    model.solve();
    for (int j = 0; j < 3; ++j) scan.sensitivity(j) = model.solution().segment<3>(kOwnUnknowns * j).norm();
    scan.largest = judged(model, record, scan.sensitivity);
    const auto best =
        std::max_element(scan.largest.begin(), scan.largest.end(),
                         [&](const Change& a, const Change& b) { return worth(a, count) < worth(b, count); });
    if (round == kMostChanges || best == scan.largest.end() || !(best->gain > best->needed)) break;
    Change found = *best;
    for (const Change& other : scan.largest) {
      const bool as_good = other.gain > other.needed && other.gain > found.gain - found.needed;
      // Two that touch one angle only are alternatives if it is the same.
      const bool comparable = lasts(other.kind) || lasts(found.kind) || other.at == found.at;
      if (other.kind != found.kind && as_good && comparable) found.as_well.push_back(other.kind);
    }
    model.account_for(found);
    scan.too_large = lasts(found.kind) && is_turn(found.kind) && found.magnitude > kLargestLinearTurnDeg;
    if (found.beyond) scan.found.push_back(std::move(found));
    if (scan.too_large) return;
  }
  for (int j = 0; j < 3; ++j) {
    const int own = kOwnUnknowns * j;
    const Eigen::Vector3d direction = model.solution().segment<3>(own).normalized();
    scan.u_sensitivity(j) =
        std::sqrt(std::max(0.0, direction.dot(model.covariance().block<3, 3>(own, own) * direction)));
    scan.drift(j) = model.solution()(own + kDriftIndex);
    scan.u_drift(j) = std::sqrt(std::max(0.0, model.covariance()(own + kDriftIndex, own + kDriftIndex)));
  }
}

}  // namespace

ChangeScan scan_for_changes(const RunRecord& record) {
  ChangeScan scan;
  bool u_known = false;
  std::vector<JointReading> readings = readings_in_time(record, scan, u_known);
  const JointPriors priors = JointPriors::from(record.tolerances, record.measured_alignment);
  std::set<std::size_t> left_out;
  // Once for a sound run; again while other angles are found to be wrong by themselves.
  constexpr int kMostFits = 4;
  for (int pass = 0; pass < kMostFits; ++pass) {
    const Fitted fitted = fit_without(left_out, priors, u_known, readings);
    scan.converged = fitted.converged;
    if (!fitted.converged) break;
    LinearModel model(readings, fitted.value, fitted.step, priors, record.tolerances);
    find_changes(model, record, scan);
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
