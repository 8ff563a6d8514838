#include "protocol/analysis/effect_fit.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <utility>

#include "protocol/analysis/known_acs_fit.h"

namespace abcal {
namespace {

constexpr int kOwnFixed = 4;  ///< s_jx, s_jy, s_jz, O_j come first among an output's own unknowns.
/// Gauss-Newton stops when the next step would lower chi2 by less than this: 1e-4 standard uncertainties.
constexpr double kEffectDecrement = 1e-8;
constexpr int kEffectIterations = 40;
/// Two responses closer than this (relative) are the same: no direction to come from.
constexpr double kSamePose = 1e-6;
/// The grid of the noise process: tau in units of u, rho in angles.
constexpr std::array<double, 5> kTauGrid{0.3, 0.8, 2.0, 5.0, 12.0};
constexpr std::array<double, 4> kRhoGrid{2.0, 10.0, 50.0, 400.0};
/// A process whose whole neighbourhood is less probable than this is not worth a fit.
constexpr double kNegligibleWeight = 1e-6;
/// Estimated noise is at least this times S_j, or a noise-free record would leave nothing but round-off.
constexpr double kSmallestRelativeNoise = 1e-9;

using Vector12 = Eigen::Matrix<double, 12, 1>;
using Rows12 = Eigen::Matrix<double, 12, Eigen::Dynamic>;

void effect_require(bool holds, const std::string& message) {
  if (!holds) throw std::invalid_argument("joint fit: " + message);
}

struct StageUnknown {
  const StageEffect* effect;
  int index;
};
struct OwnUnknown {
  const ItemEffect* effect;
  int index;
};

/// The unknowns that take part. Columns: output u (s, O, its effects), v, w, then the stage, then step errors
/// that several readings share.
struct Layout {
  std::vector<OwnUnknown> own;
  std::vector<StageUnknown> stage;
  int maps = 0;
  int own_count() const { return kOwnFixed + static_cast<int>(own.size()); }
  int first_stage() const { return 3 * own_count(); }
  int first_map() const { return first_stage() + static_cast<int>(stage.size()); }
  int count() const { return first_map() + maps; }
};

/// The model at one angle, relative units.
struct ModelAt {
  Eigen::Vector3d reading;
  Eigen::Vector3d by_step;
};

class EffectProblem {
 public:
  EffectProblem(std::span<const EffectReading> readings, const EffectFitOptions& options);

  EffectFit solve();

 private:
  void check_readings() const;
  void choose_unknowns();
  void start_from_linear_fit();
  void find_directions();
  ItemPoint item_point(std::size_t n, const Eigen::Vector3d& y) const;
  /// The model at all angles; `jacobian` (3 N x unknowns) is filled where it is not null.
  void evaluate(ReadingRows* jacobian);
  ModelAt evaluate_at(std::size_t n, const Eigen::Matrix3d& rows, ReadingRows* jacobian) const;
  std::vector<NoiseAtAngle> noise_at_angles(const Eigen::Vector3d& white) const;
  NoiseProcess process_of(double tau, double rho) const;

  bool iterate(EffectFit& fit);
  struct Point;
  Point at_noise(double tau, double rho, const Eigen::Vector3d& white) const;
  Eigen::Vector3d estimate_white(const Eigen::Vector3d& from) const;
  void average_noise(EffectFit& fit);
  Rows12 line_rows() const;
  Vector12 line_values(const Eigen::VectorXd& value) const;
  void finish(EffectFit& fit, const Point& best);

  std::span<const EffectReading> readings_;
  EffectFitOptions options_;
  Layout layout_;
  std::vector<EffectUnknown> unknowns_;
  std::vector<StagePose> poses_;
  std::vector<StageShare> shares_;  ///< Stage unknowns of reading 0, of reading 1, ...
  Eigen::Vector3d unit_;
  std::vector<Eigen::Vector3d> came_from_;
  Eigen::VectorXd prior_weight_, prior_mean_;
  double step_sd_ = 0.0;  ///< 0: step errors are unknowns of the layout (maps).

  Eigen::VectorXd value_;
  std::vector<double> step_;    ///< f of each reading.
  std::vector<ModelAt> model_;  ///< At value_, step_.
  ReadingRows jacobian_;
  Eigen::VectorXd residual_;  ///< 3 N: reading - model + by_step f.
  std::vector<Eigen::Vector3d> by_step_;
};

/// The linear problem at one noise: everything that its fit gives.
struct EffectProblem::Point {
  double log_likelihood = 0.0;  ///< Restricted.
  double tau = 0.0, rho = 1.0;
  Eigen::Vector3d white = Eigen::Vector3d::Ones();
  double chi2 = 0.0;
  Eigen::VectorXd change;                   ///< Of value_.
  Vector12 line_change = Vector12::Zero();  ///< Relative units, with the mean of the process.
  Covariance12 covariance = Covariance12::Zero();
  std::optional<NoiseWhitener> whitener;
  ReadingRows whitened_jacobian;
  Eigen::VectorXd whitened_residual;
  Eigen::VectorXd scale;
  Eigen::LLT<Eigen::MatrixXd> llt;
  Eigen::MatrixXd response;  ///< C T' (unknowns x 12), with the mean of the process.
  ReadingRows mean_weights;  ///< V^-1 cov(readings, means of the process), 3 N x 3.
};

EffectProblem::EffectProblem(std::span<const EffectReading> readings, const EffectFitOptions& options)
    : readings_(readings), options_(options) {
  check_readings();
  choose_unknowns();
  start_from_linear_fit();
  find_directions();
}

void EffectProblem::check_readings() const {
  effect_require(!readings_.empty(), "no readings");
  for (const EffectReading& at : readings_) {
    effect_require(at.experiment >= 1 && at.experiment <= 3,
                   fmt::format("experiment {}; 1, 2 or 3 is required", at.experiment));
    effect_require(at.value.allFinite() && std::isfinite(at.sin_alpha) && std::isfinite(at.cos_alpha) &&
                       std::isfinite(at.t),
                   "a reading, its angle or its time is not a finite number");
    effect_require(at.u.allFinite() && at.u.minCoeff() > 0.0,
                   "the standard uncertainty of a reading is not a finite number greater than zero");
  }
  for (const EffectSizeKey& key : effect_size_keys()) {
    const double size = key.get(options_.sizes);
    const bool required = key.was_tolerance && key.key != "drift";
    effect_require(std::isfinite(size) && (required ? size > 0.0 : size >= 0.0),
                   fmt::format("{} is {}; a finite number {} zero is required", key.key, size,
                               required ? "greater than" : "not below"));
  }
}

void EffectProblem::choose_unknowns() {
  const EffectSizes& sizes = options_.sizes;
  for (const ItemEffect& effect : item_effects()) {
    const bool of_drift = effect.key == "drift" || effect.key == "sensitivity_drift";
    const bool of_curvature = effect.key == "k2" || effect.key == "k3";
    if (!(effect.prior(sizes) > 0.0) || (of_drift && !options_.drift) ||
        (of_curvature && !options_.nonlinearity))
      continue;
    for (int i = 0; i < effect.count; ++i) layout_.own.push_back({&effect, i});
  }
  for (const StageEffect& effect : stage_effects()) {
    if (!(effect.prior(sizes) > 0.0) || (effect.key == "zero_deg" && !options_.mean_step)) continue;
    for (int i = 0; i < effect.count; ++i) layout_.stage.push_back({&effect, i});
  }
  for (const EffectReading& at : readings_) layout_.maps = std::max(layout_.maps, at.map + 1);
  step_sd_ = layout_.maps > 0 ? 0.0 : step_prior(sizes);

  for (int j = 0; j < 3; ++j) {
    const char output = "uvw"[j];
    for (const char axis : {'x', 'y', 'z'})
      unknowns_.push_back(
          {"s", fmt::format("s_{}{}", output, axis), "", j, 0.0, std::numeric_limits<double>::infinity()});
    unknowns_.push_back(
        {"O", fmt::format("O_{}", output), "", j, 0.0, std::numeric_limits<double>::infinity()});
    for (const OwnUnknown& own : layout_.own) {
      const std::string which = own.effect->unknown_name(own.index);
      unknowns_.push_back(
          {std::string(own.effect->name),
           fmt::format("{} of {}{}{}", own.effect->name, output, which.empty() ? "" : ", ", which),
           std::string(own.effect->key), j, 0.0, own.effect->prior(sizes)});
    }
  }
  const std::optional<MeasuredValue>* measured[3] = {
      &options_.measured_alignment.zx, &options_.measured_alignment.zy, &options_.measured_alignment.xz};
  static constexpr const char* kMeasuredNames[3] = {"Zx", "Zy", "Xz"};
  for (const StageUnknown& of_stage : layout_.stage) {
    const std::string which = of_stage.effect->unknown_name(of_stage.index);
    EffectUnknown unknown{std::string(of_stage.effect->name),
                          fmt::format("{}{}{}", of_stage.effect->name, which.empty() ? "" : ", ", which),
                          std::string(of_stage.effect->key),
                          -1,
                          0.0,
                          of_stage.effect->prior(sizes)};
    for (int i = 0; i < 3; ++i) {
      if (unknown.name != kMeasuredNames[i] || !*measured[i]) continue;
      const MeasuredValue& value = **measured[i];
      effect_require(std::isfinite(value.value) && std::isfinite(value.standard_uncertainty) &&
                         value.standard_uncertainty > 0.0,
                     fmt::format("measured {} = {} with standard uncertainty {}; a finite value and an "
                                 "uncertainty greater than zero are required",
                                 kMeasuredNames[i], value.value, value.standard_uncertainty));
      unknown.prior_mean = value.value;
      unknown.prior_sd = value.standard_uncertainty;
    }
    unknowns_.push_back(std::move(unknown));
  }
  for (int i = 0; i < layout_.maps; ++i) {
    unknowns_.push_back(
        {"step errors", fmt::format("step error of pose {}", i + 1), "step_deg", -1, 0.0, step_prior(sizes)});
  }
  prior_weight_ = Eigen::VectorXd::Zero(layout_.count());
  prior_mean_ = Eigen::VectorXd::Zero(layout_.count());
  for (std::size_t i = 0; i < unknowns_.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    prior_mean_(at) = unknowns_[i].prior_mean;
    if (std::isfinite(unknowns_[i].prior_sd))
      prior_weight_(at) = 1.0 / (unknowns_[i].prior_sd * unknowns_[i].prior_sd);
  }
}

void EffectProblem::start_from_linear_fit() {
  std::vector<Eigen::Vector3d> gravity;
  std::vector<Eigen::Vector3d> values;
  const StageInputs perfect = StageInputs::Zero();
  for (const EffectReading& at : readings_) {
    poses_.push_back(StagePose::of(at.experiment, at.sin_alpha, at.cos_alpha));
    gravity.push_back(gravity_at(poses_.back(), perfect).g);
    values.push_back(at.value);
    for (const StageUnknown& of_stage : layout_.stage)
      shares_.push_back(of_stage.effect->share(poses_.back(), of_stage.index));
  }
  const KnownAcsFit start = linear_fit_given_acs(gravity, values);
  unit_ = start.sensitivity_matrix.rowwise().norm();
  for (int j = 0; j < 3; ++j) {
    // An output that never changes leaves a row of round-off: some ulp of what it reads.
    if (!(unit_(j) > 1e-12 * std::abs(start.offset(j)))) {
      throw std::runtime_error(
          fmt::format("joint fit: accelerometer {} does not respond to gravity at all", "uvw"[j]));
    }
  }
  value_ = prior_mean_;
  for (int j = 0; j < 3; ++j) {
    value_.segment<3>(layout_.own_count() * j) = start.sensitivity_matrix.row(j).transpose() / unit_(j);
    value_(layout_.own_count() * j + 3) = start.offset(j) / unit_(j);
  }
  step_.assign(readings_.size(), 0.0);
  model_.resize(readings_.size());
  by_step_.resize(readings_.size());
  residual_.resize(3 * static_cast<Eigen::Index>(readings_.size()));
}

/// Signs for the hysteresis, once, from the linear solution.
void EffectProblem::find_directions() {
  came_from_.assign(readings_.size(), Eigen::Vector3d::Zero());
  Eigen::Matrix3d rows;
  for (int j = 0; j < 3; ++j) rows.row(j) = value_.segment<3>(layout_.own_count() * j).transpose();
  const StageInputs perfect = StageInputs::Zero();
  Eigen::Vector3d before = Eigen::Vector3d::Zero();
  for (std::size_t n = 0; n < readings_.size(); ++n) {
    const Eigen::Vector3d y = rows * gravity_at(poses_[n], perfect).g;
    for (int j = 0; n > 0 && j < 3; ++j) {
      const double change = y(j) - before(j);
      if (std::abs(change) > kSamePose) came_from_[n](j) = std::copysign(1.0, change);
    }
    before = y;
  }
}

ItemPoint EffectProblem::item_point(std::size_t n, const Eigen::Vector3d& y) const {
  return {readings_[n].t, y, came_from_[n]};
}

ModelAt EffectProblem::evaluate_at(std::size_t n, const Eigen::Matrix3d& rows, ReadingRows* jacobian) const {
  const int own_count = layout_.own_count();
  const auto stage_count = static_cast<int>(layout_.stage.size());
  const StageShare* shares = shares_.data() + n * layout_.stage.size();
  const int moving = moving_angle_input(readings_[n].experiment);
  StageInputs inputs = StageInputs::Zero();
  for (int k = 0; k < stage_count; ++k) {
    const double p = value_(layout_.first_stage() + k);
    inputs(shares[k].input) += shares[k].value * p;
    inputs(shares[k].second_input) += shares[k].second_value * p;
  }
  const int map = readings_[n].map;
  inputs(moving) += map >= 0 ? value_(layout_.first_map() + map) : step_[n];
  const GravityAt gravity = gravity_at(poses_[n], inputs);
  const Eigen::Vector3d y = rows * gravity.g;
  const ItemPoint point = item_point(n, y);
  const Eigen::Matrix<double, 3, kStageInputs> by_input = rows * gravity.by_input;

  ModelAt out;
  for (int j = 0; j < 3; ++j) {
    double* row = jacobian != nullptr ? jacobian->row(static_cast<Eigen::Index>(3 * n) + j).data() : nullptr;
    if (row != nullptr) std::fill_n(row, layout_.count(), 0.0);
    const int first = own_count * j;
    double reading = y(j) + value_(first + 3);
    double slope = 1.0;
    for (std::size_t i = 0; i < layout_.own.size(); ++i) {
      const ItemShare share = layout_.own[i].effect->share(point, j, layout_.own[i].index);
      const int column = first + kOwnFixed + static_cast<int>(i);
      reading += share.value * value_(column);
      slope += share.by_y * value_(column);
      if (row != nullptr) row[column] = share.value;
    }
    out.reading(j) = reading;
    out.by_step(j) = slope * by_input(j, moving);
    if (row == nullptr) continue;
    for (int k = 0; k < 3; ++k) row[first + k] = slope * gravity.g(k);
    row[first + 3] = 1.0;
    double* of_stage = row + layout_.first_stage();
    for (int k = 0; k < stage_count; ++k) {
      of_stage[k] = slope * (by_input(j, shares[k].input) * shares[k].value +
                             by_input(j, shares[k].second_input) * shares[k].second_value);
    }
    if (map >= 0) row[layout_.first_map() + map] = out.by_step(j);
  }
  return out;
}

void EffectProblem::evaluate(ReadingRows* jacobian) {
  if (jacobian != nullptr) jacobian->resize(3 * static_cast<Eigen::Index>(readings_.size()), layout_.count());
  Eigen::Matrix3d rows;
  for (int j = 0; j < 3; ++j) rows.row(j) = value_.segment<3>(layout_.own_count() * j).transpose();
  for (std::size_t n = 0; n < readings_.size(); ++n) {
    model_[n] = evaluate_at(n, rows, jacobian);
    if (jacobian != nullptr) by_step_[n] = model_[n].by_step;
    residual_.segment<3>(3 * static_cast<Eigen::Index>(n)) =
        readings_[n].value.cwiseQuotient(unit_) - model_[n].reading + by_step_[n] * step_[n];
  }
}

std::vector<NoiseAtAngle> EffectProblem::noise_at_angles(const Eigen::Vector3d& white) const {
  std::vector<NoiseAtAngle> out(readings_.size());
  const double intervals = static_cast<double>(std::max<std::size_t>(readings_.size(), 2) - 1);
  for (std::size_t n = 0; n < readings_.size(); ++n) {
    out[n].white = readings_[n].u.cwiseQuotient(unit_).cwiseProduct(white).cwiseAbs2();
    out[n].by_step = layout_.maps > 0 ? Eigen::Vector3d::Zero() : by_step_[n];
    if (n > 0) out[n].distance = std::max(0.0, (readings_[n].t - readings_[n - 1].t) * intervals);
  }
  return out;
}

NoiseProcess EffectProblem::process_of(double tau, double rho) const {
  NoiseProcess process;
  process.rho = rho;
  for (int j = 0; j < 3; ++j) {
    std::vector<double> u;
    for (const EffectReading& at : readings_) u.push_back(at.u(j) / unit_(j));
    const auto middle = u.begin() + static_cast<std::ptrdiff_t>(u.size() / 2);
    std::nth_element(u.begin(), middle, u.end());
    process.tau(j) = tau * *middle;
  }
  return process;
}

/// Rows of the line response by the unknowns, relative units.
Rows12 EffectProblem::line_rows() const {
  Rows12 out = Rows12::Zero(12, layout_.count());
  Eigen::Matrix3d rows;
  for (int j = 0; j < 3; ++j) rows.row(j) = value_.segment<3>(layout_.own_count() * j).transpose();
  for (int j = 0; j < 3; ++j) {
    const int first = layout_.own_count() * j;
    double scale = 1.0;
    for (std::size_t i = 0; i < layout_.own.size(); ++i) {
      const LineShare share = layout_.own[i].effect->line(rows, j, layout_.own[i].index);
      const int column = first + kOwnFixed + static_cast<int>(i);
      scale += share.scale * value_(column);
      for (int k = 0; k < 3; ++k) out(3 * j + k, column) = share.scale * value_(first + k);
      out(9 + j, column) = share.offset;
    }
    for (int k = 0; k < 3; ++k) out(3 * j + k, first + k) = scale;
    out(9 + j, first + 3) = 1.0;
  }
  return out;
}

Vector12 EffectProblem::line_values(const Eigen::VectorXd& value) const {
  Vector12 out;
  Eigen::Matrix3d rows;
  for (int j = 0; j < 3; ++j) rows.row(j) = value.segment<3>(layout_.own_count() * j).transpose();
  for (int j = 0; j < 3; ++j) {
    const int first = layout_.own_count() * j;
    double scale = 1.0;
    double offset = value(first + 3);
    for (std::size_t i = 0; i < layout_.own.size(); ++i) {
      const LineShare share = layout_.own[i].effect->line(rows, j, layout_.own[i].index);
      const double p = value(first + kOwnFixed + static_cast<int>(i));
      scale += share.scale * p;
      offset += share.offset * p;
    }
    out.segment<3>(3 * j) = scale * value.segment<3>(first);
    out(9 + j) = offset;
  }
  return out;
}

/// Gauss-Newton with white noise. The matrix is assembled again only where the steps do not shrink.
bool EffectProblem::iterate(EffectFit& fit) {
  Eigen::VectorXd scale;
  Eigen::LLT<Eigen::MatrixXd> llt;
  ReadingRows whitened;
  std::optional<NoiseWhitener> whitener;
  double last = std::numeric_limits<double>::infinity();
  bool assemble = true;
  bool fresh = false;
  while (fit.iterations < kEffectIterations) {
    ++fit.iterations;
    if (assemble) {
      evaluate(&jacobian_);
      whitener.emplace(noise_at_angles(Eigen::Vector3d::Ones()), step_sd_, NoiseProcess{});
      whitened = jacobian_;
      whitener->whiten(whitened);
      Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(layout_.count(), layout_.count());
      normal.selfadjointView<Eigen::Lower>().rankUpdate(whitened.transpose());
      normal.diagonal() += prior_weight_;
      scale = normal.diagonal().cwiseSqrt().cwiseInverse();
      normal = scale.asDiagonal() * normal * scale.asDiagonal();
      llt.compute(normal);
      if (!scale.allFinite() || llt.info() != Eigen::Success) return false;
    } else {
      evaluate(nullptr);
    }
    fresh = assemble;
    ReadingRows residual = residual_;
    whitener->whiten(residual);
    Eigen::VectorXd right = whitened.transpose() * residual;
    right -= prior_weight_.cwiseProduct(value_ - prior_mean_);
    const Eigen::VectorXd change = scale.cwiseProduct(llt.solve(scale.cwiseProduct(right)));
    double decrement = right.dot(change);
    // Step errors at the new point: f = step^2 v' V^-1 (residual - J change).
    ReadingRows left = residual - whitened * change;
    const double chi2 = left.squaredNorm();
    whitener->whiten_transposed(left);
    for (std::size_t n = 0; n < step_.size() && step_sd_ > 0.0; ++n) {
      const double f =
          step_sd_ * step_sd_ * by_step_[n].dot(left.col(0).segment<3>(3 * static_cast<Eigen::Index>(n)));
      const double moved = (f - step_[n]) / step_sd_;
      decrement += moved * moved;
      step_[n] = f;
    }
    value_ += change;
    const Eigen::Index stage = layout_.first_stage();
    if (!value_.allFinite() || !(value_.segment<3>(stage).cwiseAbs().maxCoeff() < 0.7)) return false;
    // The round-off of chi2 itself (u may be far below the readings' last digit) bounds what a step can show.
    if (decrement < kEffectDecrement + 1e-12 * chi2) {
      fit.reciprocal_condition = std::sqrt(llt.rcond());
      fit.converged = true;
      evaluate(&jacobian_);
      return true;
    }
    assemble = !(decrement < 0.05 * last) && !(fresh && fit.iterations == 1);
    last = decrement;
  }
  return false;
}

EffectProblem::Point EffectProblem::at_noise(double tau, double rho, const Eigen::Vector3d& white) const {
  Point out;
  out.tau = tau;
  out.rho = rho;
  out.white = white;
  const NoiseWhitener& whitener =
      out.whitener.emplace(noise_at_angles(white), step_sd_, process_of(tau, rho));
  out.whitened_jacobian = jacobian_;
  whitener.whiten(out.whitened_jacobian);
  ReadingRows residual = residual_;
  whitener.whiten(residual);
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(layout_.count(), layout_.count());
  normal.selfadjointView<Eigen::Lower>().rankUpdate(out.whitened_jacobian.transpose());
  normal.diagonal() += prior_weight_;
  out.scale = normal.diagonal().cwiseSqrt().cwiseInverse();
  normal = out.scale.asDiagonal() * normal * out.scale.asDiagonal();
  out.llt.compute(normal);
  Eigen::VectorXd right = out.whitened_jacobian.transpose() * residual;
  const Eigen::VectorXd from_prior = value_ - prior_mean_;
  right -= prior_weight_.cwiseProduct(from_prior);
  out.change = out.scale.cwiseProduct(out.llt.solve(out.scale.cwiseProduct(right)));
  out.whitened_residual = residual - out.whitened_jacobian * out.change;
  out.chi2 = out.whitened_residual.squaredNorm() + prior_weight_.dot((from_prior + out.change).cwiseAbs2());
  const Eigen::MatrixXd lower = out.llt.matrixL();
  const double log_normal = 2.0 * (lower.diagonal().array().log().sum() - out.scale.array().log().sum());
  out.log_likelihood = -0.5 * (whitener.log_determinant() + log_normal + out.chi2);

  // The mean of the process over the run belongs to the offset.
  Rows12 rows = line_rows();
  Covariance12 beyond = Covariance12::Zero();
  out.line_change = rows * out.change;
  out.mean_weights = ReadingRows::Zero(jacobian_.rows(), 3);
  if (tau > 0.0) {
    const ReadingRows with_mean = whitener.covariance_with_mean();
    ReadingRows weights = with_mean;
    whitener.whiten(weights);
    out.line_change.tail<3>() += weights.transpose() * out.whitened_residual;
    rows.bottomRows<3>() -= weights.transpose() * out.whitened_jacobian;
    beyond.bottomRightCorner<3, 3>() = -(weights.transpose() * weights);
    beyond.bottomRightCorner<3, 3>().diagonal() += whitener.mean_variance();
    whitener.whiten_transposed(weights);
    out.mean_weights = weights;
  }
  out.response = out.scale.asDiagonal() * out.llt.solve(out.scale.asDiagonal() * rows.transpose());
  const Covariance12 covariance = rows * out.response + beyond;
  out.covariance = 0.5 * (covariance + covariance.transpose());
  return out;
}

/// White noise of each output, in units of u: repeated until the weighted squares of the residuals equal
/// their expectation (restricted likelihood).
Eigen::Vector3d EffectProblem::estimate_white(const Eigen::Vector3d& from) const {
  const Eigen::Vector3d floor = kSmallestRelativeNoise * unit_.cwiseQuotient(readings_.front().u);
  Eigen::Vector3d white = from;
  for (int pass = 0; pass < 60; ++pass) {
    const Point point = at_noise(0.0, 1.0, white);
    // P = V^-1 - V^-1 J C J' V^-1: sums of its squared products with the noise of each output.
    ReadingRows product = point.whitened_residual;
    point.whitener->whiten_transposed(product);
    ReadingRows weighted = point.whitened_jacobian;
    point.whitener->whiten_transposed(weighted);
    const Eigen::MatrixXd solved =
        point.scale.asDiagonal() *
        point.llt.solve(Eigen::MatrixXd(point.scale.asDiagonal() * weighted.transpose()));
    const std::vector<NoiseAtAngle> angles = noise_at_angles(white);
    Eigen::Vector3d squares = Eigen::Vector3d::Zero();
    Eigen::Vector3d redundancy = Eigen::Vector3d::Zero();
    for (std::size_t n = 0; n < angles.size(); ++n) {
      Eigen::Matrix3d v = step_sd_ * step_sd_ * angles[n].by_step * angles[n].by_step.transpose();
      v.diagonal() += angles[n].white;
      const Eigen::Matrix3d inverse = v.llt().solve(Eigen::Matrix3d::Identity());
      for (int j = 0; j < 3; ++j) {
        const auto row = static_cast<Eigen::Index>(3 * n) + j;
        squares(j) += angles[n].white(j) * product(row, 0) * product(row, 0);
        redundancy(j) += angles[n].white(j) * (inverse(j, j) - weighted.row(row).dot(solved.col(row)));
      }
    }
    const double least = redundancy.minCoeff();
    if (!(least >= 0.5)) {
      throw std::runtime_error(
          fmt::format("{} angles leave nothing to estimate the noise from; more angles or the uncertainties "
                      "of the readings are required",
                      readings_.size()));
    }
    const Eigen::Vector3d before = white;
    white = white.cwiseProduct(squares.cwiseQuotient(redundancy).cwiseSqrt()).cwiseMax(floor);
    if ((white.cwiseQuotient(before).array() - 1.0).abs().maxCoeff() < 1e-3) break;
  }
  return white;
}

void EffectProblem::average_noise(EffectFit& fit) {
  Eigen::Vector3d white = Eigen::Vector3d::Ones();
  if (!options_.white_known) white = estimate_white(white);
  std::vector<Point> points;
  points.push_back(at_noise(0.0, 1.0, white));
  std::vector<double> weights{std::log(0.5)};
  if (options_.noise_process) {
    const double prior = std::log(0.5 / static_cast<double>(kTauGrid.size() * kRhoGrid.size()));
    for (const double tau : kTauGrid) {
      double best_of_tau = -std::numeric_limits<double>::infinity();
      for (const double rho : kRhoGrid) {
        Point point = at_noise(tau, rho, white);
        const double gain = point.log_likelihood - points.front().log_likelihood + prior;
        best_of_tau = std::max(best_of_tau, gain);
        if (gain < std::log(kNegligibleWeight) || !std::isfinite(gain)) continue;
        points.push_back(std::move(point));
        weights.push_back(gain);
      }
      // Larger processes are less likely still.
      const double best = *std::max_element(weights.begin(), weights.end());
      if (tau > 0.5 && best_of_tau < best - 20.0) break;
    }
  }
  const double largest = *std::max_element(weights.begin(), weights.end());
  double sum = 0.0;
  for (double& weight : weights) sum += weight = std::exp(weight - largest);
  Vector12 mean = Vector12::Zero();
  Covariance12 covariance = Covariance12::Zero();
  std::size_t best = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    weights[i] /= sum;
    if (weights[i] > weights[best]) best = i;
    mean += weights[i] * points[i].line_change;
    covariance += weights[i] * points[i].covariance;
  }
  Vector12 spread_of_variance = Vector12::Zero();
  const Vector12 variance = covariance.diagonal();
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vector12 off = points[i].line_change - mean;
    covariance += weights[i] * off * off.transpose();
    spread_of_variance += weights[i] * (points[i].covariance.diagonal() - variance).cwiseAbs2();
  }
  for (Eigen::Index i = 0; i < 12; ++i) {
    if (spread_of_variance(i) > 1e-12 * variance(i) * variance(i))
      fit.degrees_of_freedom(i) = 2.0 * variance(i) * variance(i) / spread_of_variance(i);
  }
  fit.noise.process_probability = 1.0 - weights.front();
  fit.noise.tau = points[best].tau;
  fit.noise.rho = points[best].rho;
  fit.noise.white = points[best].white;
  fit.noise.white_estimated = !options_.white_known;
  fit.line = line_values(value_) + mean;
  fit.covariance_line = covariance;
  finish(fit, points[best]);
}

/// What only the most probable noise gives, and the units.
void EffectProblem::finish(EffectFit& fit, const Point& best) {
  fit.unknowns = unknowns_;
  fit.unit = unit_;
  fit.value = value_ + best.change;
  Eigen::MatrixXd covariance = best.llt.solve(Eigen::MatrixXd::Identity(layout_.count(), layout_.count()));
  covariance = best.scale.asDiagonal() * covariance * best.scale.asDiagonal();
  fit.covariance = 0.5 * (covariance + covariance.transpose());
  fit.chi2 = best.chi2;
  fit.chi2_degrees_of_freedom = 3 * static_cast<int>(readings_.size()) - 12;

  ReadingRows gain = best.whitened_jacobian * best.response;
  best.whitener->whiten_transposed(gain);
  gain.rightCols<3>() += best.mean_weights;
  ReadingRows left = best.whitened_residual;
  best.whitener->whiten_transposed(left);
  Covariance12 type_b = best.response.transpose() * prior_weight_.asDiagonal() * best.response;
  const std::vector<NoiseAtAngle> angles = noise_at_angles(best.white);
  Covariance12 white_noise[3] = {Covariance12::Zero(), Covariance12::Zero(), Covariance12::Zero()};
  ReadingRows by_unknown = best.whitened_jacobian;
  best.whitener->whiten_transposed(by_unknown);
  // D = J C^(1/2), with the Cholesky factor of the normal matrix.
  Eigen::MatrixXd design = best.scale.asDiagonal() * best.whitened_jacobian.transpose();
  best.llt.matrixL().solveInPlace(design);
  fit.whitened_design = design.transpose();
  fit.residuals.resize(readings_.size());
  fit.whitened.resize(readings_.size());
  fit.step_error.assign(readings_.size(), 0.0);
  fit.u_step_error.assign(readings_.size(), 0.0);
  for (std::size_t n = 0; n < readings_.size(); ++n) {
    const auto first = 3 * static_cast<Eigen::Index>(n);
    const auto three = gain.middleRows<3>(first);
    const Vector12 by_f = three.transpose() * angles[n].by_step * step_sd_;
    type_b.noalias() += by_f * by_f.transpose();
    for (int j = 0; j < 3; ++j)
      white_noise[j].diagonal() += angles[n].white(j) * three.row(j).transpose().cwiseAbs2();
    const Eigen::Vector3d v = angles[n].by_step;
    const double variance = step_sd_ * step_sd_;
    const double f = variance * v.dot(left.col(0).segment<3>(first));
    // Var(f) = step^2 - step^4 v' P v, with P of all readings; the process's part of V^-1 is left out.
    Eigen::Matrix3d local = variance * v * v.transpose();
    local.diagonal() += angles[n].white;
    const Eigen::VectorXd link = by_unknown.middleRows<3>(first).transpose() * v;
    const double known = v.dot(local.llt().solve(v));
    const double u2 = variance - variance * variance * (known - link.dot(fit.covariance * link));
    fit.step_error[n] = f;
    fit.u_step_error[n] = std::sqrt(std::max(0.0, u2));
    if (const int map = readings_[n].map; map >= 0) {
      const Eigen::Index at = layout_.first_map() + map;
      fit.step_error[n] = fit.value(at);
      fit.u_step_error[n] = std::sqrt(fit.covariance(at, at));
    }
    const Eigen::Vector3d shift = jacobian_.middleRows<3>(first) * best.change;
    fit.residuals[n] = (residual_.segment<3>(first) - shift - v * f).cwiseProduct(unit_);
    fit.whitened[n] = best.whitened_residual.segment<3>(first);
  }
  if (fit.noise.white_estimated) {
    // The white noise of output j is known to 2/nu_j (relative, of its variance).
    for (Eigen::Index i = 0; i < 12; ++i) {
      double spread = std::isfinite(fit.degrees_of_freedom(i))
                          ? 2.0 * std::pow(fit.covariance_line(i, i), 2) / fit.degrees_of_freedom(i)
                          : 0.0;
      const double redundancy =
          std::max(1.0, (3.0 * static_cast<double>(readings_.size()) - 12.0) / 3.0 -
                            (step_sd_ > 0.0 ? static_cast<double>(readings_.size()) / 3.0 : 0.0) - 5.0 / 3.0);
      for (const Covariance12& part : white_noise) spread += 2.0 * part(i, i) * part(i, i) / redundancy;
      if (spread > 0.0) fit.degrees_of_freedom(i) = 2.0 * std::pow(fit.covariance_line(i, i), 2) / spread;
    }
  }

  Vector12 units;
  for (int j = 0; j < 3; ++j) {
    units.segment<3>(3 * j).setConstant(unit_(j));
    units(9 + j) = unit_(j);
  }
  for (Eigen::Index row = 0; row < gain.rows(); ++row)
    gain.row(row) = gain.row(row).cwiseProduct(units.transpose()) / unit_(row % 3);
  fit.gain = std::move(gain);
  fit.line = fit.line.cwiseProduct(units);
  fit.covariance_line = units.asDiagonal() * fit.covariance_line * units.asDiagonal();
  fit.covariance_line_type_b = units.asDiagonal() * type_b * units.asDiagonal();
}

EffectFit EffectProblem::solve() {
  EffectFit fit;
  if (!iterate(fit)) return fit;
  average_noise(fit);
  return fit;
}

}  // namespace

EffectFit effect_fit(std::span<const EffectReading> readings, const EffectFitOptions& options) {
  return EffectProblem(readings, options).solve();
}

}  // namespace abcal
