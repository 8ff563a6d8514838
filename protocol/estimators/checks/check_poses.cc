#include "protocol/estimators/checks/check_poses.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <utility>

#include "drivers/text/letters.h"
#include "protocol/estimators/shared/known_acs_fit.h"
#include "protocol/estimators/shared/run_time.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/linear/cholesky.h"
#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/model/effects.h"
#include "protocol/model/stage_model.h"
#include "protocol/plan/limits.h"
#include "protocol/statistics/distributions.h"
#include "protocol/statistics/median.h"

namespace abcal {
namespace {

/// Largest number of changes that are accounted for one after the other.
constexpr int kMostPoseChanges = 6;
/// Below this part of the largest eigenvalue a direction of a change is not determined.
constexpr double kPoseUndetermined = 1e-9;

/// One usable dwell at a check pose.
struct CheckReading {
  const DwellRecord* dwell = nullptr;
  std::size_t visit = 0;
  double t = 0.0;
  Eigen::Vector3d y = Eigen::Vector3d::Zero();  ///< Relative linear responses.
  Eigen::Vector3d gravity = Eigen::Vector3d::Zero();
  Eigen::Vector3d by_x = Eigen::Vector3d::Zero();  ///< Derivatives of y by the angles of the axes (1/radian).
  Eigen::Vector3d by_z = Eigen::Vector3d::Zero();
};

/// The outputs as the experiments show them at a perfect stage: good to 1e-3, enough for derivatives.
struct RoughOutputs {
  Eigen::Matrix3d rows;     ///< Relative to S_j.
  Eigen::Vector3d unit;     ///< S_j (R/g_loc)
  Eigen::Vector3d usual_u;  ///< Median relative uncertainty of a reading; smaller ones are raised to it.
};

std::optional<RoughOutputs> rough_outputs(const RunRecord& record) {
  std::vector<const DwellRecord*> dwells;
  std::array<std::vector<double>, 3> u;
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.experiment < 1 || dwell.experiment > 3 || !dwell.mean.allFinite() || !dwell.u_mean ||
        !std::isfinite(dwell.alpha.rad()))
      continue;
    dwells.push_back(&dwell);
    for (std::size_t j = 0; j < 3; ++j) u[j].push_back((*dwell.u_mean)(static_cast<Eigen::Index>(j)));
  }
  if (dwells.size() < 5) return std::nullopt;
  const KnownAcsFit fit = linear_fit_on_perfect_stage(dwells);
  RoughOutputs out;
  out.unit = fit.sensitivity_matrix.rowwise().norm();
  if (!(out.unit.minCoeff() > 0.0)) return std::nullopt;
  out.rows = scaled_rows(out.unit.cwiseInverse(), fit.sensitivity_matrix);
  for (std::size_t j = 0; j < 3; ++j)
    out.usual_u(static_cast<Eigen::Index>(j)) = median(u[j]) / out.unit(static_cast<Eigen::Index>(j));
  return out;
}

struct FoundChange {
  PoseChange change;
  Eigen::MatrixXd columns;
};

/// The linear problem. Unknowns are a constant for each pose and output and the changes that are accounted
/// for, without prior; everything else is in the covariance.
class PoseProblem {
 public:
  PoseProblem(const RunRecord& record, const RoughOutputs& outputs)
      : sizes_(record.tolerances), outputs_(outputs), angle_limit_(slip_limit(record.limits, sizes_).rad()) {
    collect(record);
    if (visits_.size() < 2) return;
    fill_covariance(record);
    add_constants();
    tests_ = static_cast<double>((visits_.size() - 1) * 7);
    solve();
    without_changes_ = projector_;
  }

  const std::vector<PoseVisit>& visits() const { return visits_; }

  std::vector<PoseChange> find() {
    std::vector<FoundChange> found;
    for (int round = 0; round < kMostPoseChanges; ++round) {
      solve();
      std::optional<FoundChange> best = best_change();
      if (!best) break;
      append(free_, best->columns);
      found.push_back(*std::move(best));
    }
    solve();
    // Sizes from the fit with all changes accounted for.
    std::vector<PoseChange> out;
    Eigen::Index at = constants_;
    for (FoundChange& each : found) {
      const Eigen::Index count = each.columns.cols();
      const Eigen::VectorXd size = estimate_.segment(at, count);
      const Eigen::MatrixXd covariance = cofactor_.block(at, at, count, count);
      each.change.size = count == 1 ? size(0) : size.norm();
      each.change.standard_uncertainty = std::sqrt(
          std::max(0.0, count == 1 ? covariance(0, 0)
                                   : size.dot(product_with_vector(covariance, size)) / size.squaredNorm()));
      at += count;
      if (each.change.kind == PoseChangeKind::kTurn && each.change.size <= angle_limit_) continue;
      out.push_back(std::move(each.change));
    }
    return out;
  }

  std::vector<PoseDifference> differences() const {
    std::vector<PoseDifference> out;
    for (const CheckReading& reading : readings_) {
      const auto first = std::find_if(readings_.begin(), readings_.end(), [&](const CheckReading& other) {
        return other.dwell->n == reading.dwell->n;
      });
      if (first->visit == reading.visit) continue;
      const auto u2 = reading.dwell->u_mean->cwiseAbs2() + first->dwell->u_mean->cwiseAbs2();
      out.push_back(
          {reading.dwell->n, reading.visit, reading.dwell->mean - first->dwell->mean, u2.cwiseSqrt()});
    }
    return out;
  }

  /// Change from the first visit to the last, with the readings' noise and the stage alone.
  PoseTrend trend(PoseChangeKind kind, int output) const {
    PoseTrend out;
    const std::size_t last = visits_.size() - 1;
    const Eigen::VectorXd column = column_of(kind, output, last - 1);
    // Only the last visit is compared with the first: those between have columns of their own.
    Eigen::MatrixXd free = free_.leftCols(constants_);
    for (std::size_t k = 1; k < last; ++k) {
      for (const PoseChangeKind other : {PoseChangeKind::kGain, PoseChangeKind::kOffset})
        for (int j = 0; j < 3; ++j) append(free, only_at(other, j, k));
    }
    for (const PoseChangeKind other : {PoseChangeKind::kGain, PoseChangeKind::kOffset}) {
      for (int j = 0; j < 3; ++j) {
        if (other != kind || j != output) append(free, column_of(other, j, last - 1));
      }
    }
    append(free, column);
    const Eigen::MatrixXd weighted = Cholesky(without_drift_).solve(free);
    const Cholesky normal(transposed_product(free, weighted));
    const Eigen::VectorXd value = normal.solve_vector(transposed_product_with_vector(weighted, data_));
    const Eigen::MatrixXd covariance = normal.inverse();
    out.change = value(value.size() - 1);
    out.standard_uncertainty = std::sqrt(covariance(value.size() - 1, value.size() - 1));
    double information = std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k < last; ++k) {
      const Eigen::VectorXd step = column_of(kind, output, k);
      information = std::min(information, step.dot(product_with_vector(without_changes_, step)));
    }
    out.smallest_found = std::sqrt(needed(1) / std::max(information, 1e-300));
    return out;
  }

 private:
  static bool is_usable(const DwellRecord& dwell) {
    return dwell.mean.allFinite() && dwell.u_mean && dwell.u_mean->minCoeff() > 0.0 &&
           (dwell.flags & (kFlagClipped | kFlagStuck)) == 0U && dwell.n >= 1 && dwell.n <= 2;
  }

  void collect(const RunRecord& record) {
    const std::vector<double> t = check_time_fractions(record);
    // A visit with one pose alone cannot separate gain from offset.
    std::map<std::size_t, int> poses_seen;
    for (const CheckDwell& check : record.check_poses)
      if (is_usable(check.dwell)) poses_seen[check.after] |= check.dwell.n;
    for (std::size_t i = 0; i < record.check_poses.size(); ++i) {
      const CheckDwell& check = record.check_poses[i];
      const DwellRecord& dwell = check.dwell;
      if (!is_usable(dwell) || poses_seen[check.after] != (1 | 2)) continue;
      if (visits_.empty() || visits_.back().after != check.after) visits_.push_back({check.after, t[i]});
      CheckReading reading{&dwell, visits_.size() - 1, t[i], {}, {}, {}, {}};
      const SinCos x = sincos(dwell.commanded_x);
      const SinCos z = sincos(dwell.commanded_z);
      // Gravity in the frame of the platter: turned back about X, then about Z.
      reading.gravity = Eigen::Vector3d(x.sin * z.sin, x.sin * z.cos, x.cos);
      reading.y = outputs_.rows * reading.gravity;
      reading.by_x = outputs_.rows * Eigen::Vector3d(x.cos * z.sin, x.cos * z.cos, -x.sin);
      reading.by_z = outputs_.rows * Eigen::Vector3d(x.sin * z.cos, -x.sin * z.sin, 0.0);
      readings_.push_back(reading);
    }
    data_.resize(3 * static_cast<Eigen::Index>(readings_.size()));
    for (std::size_t i = 0; i < readings_.size(); ++i)
      data_.segment<3>(row(i)) = readings_[i].dwell->mean.cwiseQuotient(outputs_.unit);
    // Large offsets would only cost digits.
    if (!readings_.empty()) {
      const Eigen::Vector3d first = data_.head<3>();
      for (std::size_t i = 0; i < readings_.size(); ++i) data_.segment<3>(row(i)) -= first;
    }
  }

  void fill_covariance(const RunRecord& record) {
    const Eigen::Index n = data_.size();
    Eigen::MatrixXd v = Eigen::MatrixXd::Zero(n, n);
    // After an interruption the axes are homed again.
    const bool homed_again = record.continuations + record.reconnections > 0;
    const double step = std::hypot(sizes_.step.rad(), homed_again ? sizes_.zero.rad() : 0.0);
    for (std::size_t i = 0; i < readings_.size(); ++i) {
      const CheckReading& at = readings_[i];
      auto block = v.block<3, 3>(row(i), row(i));
      const Eigen::Vector3d u = at.dwell->u_mean->cwiseQuotient(outputs_.unit).cwiseMax(outputs_.usual_u);
      block.diagonal() += u.cwiseAbs2();
      block.diagonal().array() += sizes_.hysteresis * sizes_.hysteresis;
      block += step * step * (at.by_x * at.by_x.transpose() + at.by_z * at.by_z.transpose());
    }
    without_drift_ = v;
    for (const ItemEffect& effect : item_effects()) {
      if (effect.kind != ItemEffectKind::kDrift) continue;
      const double prior = effect.prior(sizes_);
      for (int j = 0; j < 3 && prior > 0.0; ++j) {
        for (int k = 0; k < effect.count; ++k) {
          Eigen::VectorXd column = Eigen::VectorXd::Zero(n);
          for (std::size_t i = 0; i < readings_.size(); ++i)
            column(row(i) + j) =
                prior * effect.share({readings_[i].t, readings_[i].y, Eigen::Vector3d::Zero()}, j, k).value;
          v += covariance_of_root(column);
        }
      }
    }
    covariance_ = std::move(v);
  }

  void add_constants() {
    for (int n = 1; n <= 2; ++n) {
      for (int j = 0; j < 3; ++j) {
        Eigen::VectorXd column = Eigen::VectorXd::Zero(data_.size());
        for (std::size_t i = 0; i < readings_.size(); ++i)
          if (readings_[i].dwell->n == n) column(row(i) + j) = 1.0;
        if (!column.isZero(0.0)) append(free_, column);
      }
    }
    constants_ = free_.cols();
  }

  void solve() {
    const Eigen::MatrixXd inverse = Cholesky(covariance_).inverse();
    const Eigen::MatrixXd weighted = product(inverse, free_);
    cofactor_ = Cholesky(transposed_product(free_, weighted)).inverse();
    estimate_ = product_with_vector(cofactor_, transposed_product_with_vector(weighted, data_));
    projector_ = inverse - carried_covariance(weighted, cofactor_);
  }

  /// The fall of chi2 that a sound run reaches once in 1e6 runs.
  double needed(int degrees_of_freedom) const { return chi2_above(kFalseAlarm / tests_, degrees_of_freedom); }

  std::optional<FoundChange> best_change() const {
    std::vector<FoundChange> all;
    for (std::size_t k = 0; k + 1 < visits_.size(); ++k) {
      for (int j = 0; j < 3; ++j) {
        for (const PoseChangeKind kind : {PoseChangeKind::kGain, PoseChangeKind::kOffset})
          all.push_back(judged(kind, j, k, column_of(kind, j, k)));
      }
      all.push_back(judged(PoseChangeKind::kTurn, -1, k, turn_columns(k)));
    }
    // Fewest unknowns first, as in the Bayesian information criterion.
    const double price = std::log(static_cast<double>(data_.size()));
    const auto worth = [&](const FoundChange& each) {
      return each.change.fall - price * static_cast<double>(each.columns.cols());
    };
    const auto best = std::max_element(all.begin(), all.end(),
                                       [&](const auto& a, const auto& b) { return worth(a) < worth(b); });
    if (!(best->change.fall > best->change.needed)) return std::nullopt;
    FoundChange out = *best;
    for (const FoundChange& other : all) {
      const bool same =
          other.change.kind == out.change.kind && other.change.accelerometer == out.change.accelerometer;
      if (same || other.change.fall < out.change.fall - out.change.needed) continue;
      out.change.as_well.push_back(name_of_change(other.change));
    }
    return out;
  }

 public:
  static Message name_of_change(const PoseChange& change) {
    if (change.kind == PoseChangeKind::kTurn) return Message("a turn of the accelerometer or of an axis");
    const std::string output = kOutputNames[change.accelerometer];
    return change.kind == PoseChangeKind::kGain ? Message("the gain of {output}", output)
                                                : Message("the offset of {output}", output);
  }

 private:
  FoundChange judged(PoseChangeKind kind, int output, std::size_t after_visit,
                     const Eigen::MatrixXd& columns) const {
    FoundChange out;
    out.change.kind = kind;
    out.change.accelerometer = output;
    out.change.after_visit = after_visit;
    const Eigen::MatrixXd information = product(transposed_product(columns, projector_), columns);
    const Eigen::VectorXd right =
        transposed_product_with_vector(columns, product_with_vector(projector_, data_));
    const SymmetricEigen eigen = symmetric_eigen(information);
    const double largest = eigen.values.maxCoeff();
    out.columns.resize(columns.rows(), 0);
    for (Eigen::Index k = 0; k < right.size() && largest > 0.0; ++k) {
      const double value = eigen.values(k);
      if (!(value > kPoseUndetermined * largest)) continue;
      const double along = eigen.vectors.col(k).dot(right);
      out.change.fall += along * along / value;
      append(out.columns, product_with_vector(columns, eigen.vectors.col(k)));
    }
    const auto degrees = static_cast<int>(out.columns.cols());
    out.change.needed = degrees > 0 ? needed(degrees) : std::numeric_limits<double>::infinity();
    return out;
  }

  static Eigen::Index row(std::size_t reading) { return 3 * static_cast<Eigen::Index>(reading); }
  static void append(Eigen::MatrixXd& matrix, const Eigen::MatrixXd& columns) {
    const Eigen::Index before = matrix.cols();
    matrix.conservativeResize(columns.rows(), before + columns.cols());
    matrix.rightCols(columns.cols()) = columns;
  }

  double share_of(PoseChangeKind kind, int output, std::size_t reading) const {
    return kind == PoseChangeKind::kGain ? readings_[reading].y(output) : 1.0;
  }
  /// A change after visit k, from there on.
  Eigen::VectorXd column_of(PoseChangeKind kind, int output, std::size_t after_visit) const {
    Eigen::VectorXd column = Eigen::VectorXd::Zero(data_.size());
    for (std::size_t i = 0; i < readings_.size(); ++i)
      if (readings_[i].visit > after_visit) column(row(i) + output) = share_of(kind, output, i);
    return column;
  }
  Eigen::VectorXd only_at(PoseChangeKind kind, int output, std::size_t visit) const {
    Eigen::VectorXd column = Eigen::VectorXd::Zero(data_.size());
    for (std::size_t i = 0; i < readings_.size(); ++i)
      if (readings_[i].visit == visit) column(row(i) + output) = share_of(kind, output, i);
    return column;
  }
  /// A turn about x, y, z of the platter after visit k.
  Eigen::MatrixXd turn_columns(std::size_t after_visit) const {
    Eigen::MatrixXd columns = Eigen::MatrixXd::Zero(data_.size(), 3);
    for (std::size_t i = 0; i < readings_.size(); ++i) {
      if (readings_[i].visit <= after_visit) continue;
      const Eigen::Vector3d& g = readings_[i].gravity;
      for (int axis = 0; axis < 3; ++axis)
        columns.block<3, 1>(row(i), axis) = outputs_.rows * Eigen::Vector3d::Unit(axis).cross(g);
    }
    return columns;
  }

  const EffectSizes& sizes_;
  const RoughOutputs& outputs_;
  double angle_limit_;
  std::vector<PoseVisit> visits_;
  std::vector<CheckReading> readings_;
  Eigen::VectorXd data_, estimate_;
  Eigen::MatrixXd covariance_, without_drift_, free_, cofactor_, projector_, without_changes_;
  Eigen::Index constants_ = 0;
  double tests_ = 1.0;
};

// ---- Words -----------------------------------------------------------------------------------------------

/// "between the check poses of two visits, those at the start and those before experiment 2, alpha = 0 ...".
Message interval_words(const RunRecord& record, const CheckPoseStudy& study, std::size_t after_visit) {
  const auto visit_words = [&](const PoseVisit& visit) {
    if (visit.after == 0) return Message("those at the start");
    if (visit.after >= record.dwells.size()) return Message("those at the end");
    return Message("those before {where}", dwell_words(record.dwells[visit.after]));
  };
  return {"between the check poses of two visits, {first} and {second}",
          visit_words(study.visits[after_visit]), visit_words(study.visits[after_visit + 1])};
}

Message size_words(const PoseChange& change, const CheckPoseStudy& study, const std::string& unit) {
  switch (change.kind) {
    case PoseChangeKind::kGain:
      return {"changed by {change:+.4f} % (standard uncertainty {uncertainty:.2g} %)", 100.0 * change.size,
              100.0 * change.standard_uncertainty};
    case PoseChangeKind::kOffset: {
      const double s = study.sensitivity[static_cast<std::size_t>(change.accelerometer)];
      return {"changed by {change:+.3g} {unit} (standard uncertainty {uncertainty:.2g} {u_unit})",
              s * change.size, unit, s * change.standard_uncertainty, unit};
    }
    case PoseChangeKind::kTurn:
      return {"is {change:.3f} degrees (standard uncertainty {uncertainty:.2g} degrees)",
              change.size * 180.0 / std::numbers::pi, change.standard_uncertainty * 180.0 / std::numbers::pi};
  }
  return {};
}

Message words_of_change(const RunRecord& record, const CheckPoseStudy& study, const PoseChange& change) {
  std::vector<Message> as_well;
  for (const Message& other : change.as_well)
    as_well.push_back(as_well.empty() ? Message(", or it is {other}", other)
                                      : Message(", or {other}", other));
  return {"{change} {size} {interval}{more}: the result holds for neither before nor after alone",
          PoseProblem::name_of_change(change), size_words(change, study, record.response_unit),
          interval_words(record, study, change.after_visit), in_sequence(as_well, "")};
}

Check trend_check(const CheckPoseStudy& study, PoseChangeKind kind, std::size_t output) {
  const bool gain = kind == PoseChangeKind::kGain;
  const PoseTrend& trend = gain ? study.gain[output] : study.offset[output];
  return {fmt::format("{} of {} at the check poses", gain ? "gain" : "offset", kOutputNames[output]),
          trend.change,
          trend.smallest_found,
          "of the sensitivity, from first to last",
          true,
          {}};
}

}  // namespace

Message dwell_words(const DwellRecord& dwell) {
  return Message("experiment {experiment}, alpha = {angle:g} degrees", dwell.experiment, dwell.alpha.deg());
}

std::optional<CheckPoseStudy> study_check_poses(const RunRecord& record) {
  if (record.check_poses.size() < 2) return std::nullopt;
  const std::optional<RoughOutputs> outputs = rough_outputs(record);
  if (!outputs) return std::nullopt;
  PoseProblem problem(record, *outputs);
  if (problem.visits().size() < 2) return std::nullopt;
  CheckPoseStudy study;
  study.visits = problem.visits();
  study.found = problem.find();
  study.differences = problem.differences();
  for (std::size_t j = 0; j < 3; ++j) {
    study.sensitivity[j] = outputs->unit(static_cast<Eigen::Index>(j));
    study.gain[j] = problem.trend(PoseChangeKind::kGain, static_cast<int>(j));
    study.offset[j] = problem.trend(PoseChangeKind::kOffset, static_cast<int>(j));
  }
  return study;
}

std::optional<CheckPoseStudy> compared_check_poses(const RunRecord& record) {
  try {
    return study_check_poses(record);
  } catch (const UnusableData&) {
    return std::nullopt;
  }
}

std::vector<Check> check_pose_checks(const RunRecord& record) {
  std::vector<Check> checks;
  if (record.check_poses.empty()) return checks;
  const std::optional<CheckPoseStudy> study = study_check_poses(record);
  if (!study) {
    checks.push_back({"check poses", std::numeric_limits<double>::quiet_NaN(),
                      std::numeric_limits<double>::quiet_NaN(), "", true,
                      Message("the check poses were not compared: {why}",
                              Message("two visits with stated uncertainties are needed"))});
    return checks;
  }
  for (std::size_t j = 0; j < 3; ++j) {
    checks.push_back(trend_check(*study, PoseChangeKind::kGain, j));
    checks.push_back(trend_check(*study, PoseChangeKind::kOffset, j));
  }
  for (const PoseChange& change : study->found) {
    Message words = words_of_change(record, *study, change);
    if (change.kind == PoseChangeKind::kTurn) {
      checks.push_back({"turn at the check poses", change.size * 180.0 / std::numbers::pi,
                        slip_limit(record.limits, record.tolerances).deg(), "degree", false,
                        std::move(words)});
      continue;
    }
    const std::size_t place =
        2 * static_cast<std::size_t>(change.accelerometer) + (change.kind == PoseChangeKind::kGain ? 0U : 1U);
    Check& check = checks[place];
    check.passed = false;
    check.found = std::abs(change.size) > std::abs(check.found) ? change.size : check.found;
    check.words = check.words.empty() ? std::move(words) : in_sequence({check.words, words});
  }
  return checks;
}

}  // namespace abcal
