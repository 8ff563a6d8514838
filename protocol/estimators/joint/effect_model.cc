#include "protocol/estimators/joint/effect_model.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "protocol/estimators/shared/known_acs_fit.h"
#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/linear/products.h"
#include "protocol/plan/limits.h"
#include "protocol/statistics/median.h"

namespace abcal {
namespace {

/// Least noise in units of S_j: a noise-free record would leave nothing but round-off.
constexpr double kSmallestRelativeNoise = 1e-9;
/// Largest possible inclination of a stage axis (radian): a solution beyond it is rejected.
constexpr double kMostAskew = 0.7;

void effect_require(bool holds, const std::string& message) {
  if (!holds) throw std::invalid_argument("joint fit: " + message);
}
void data_require(bool holds, const std::string& message) {
  if (!holds) throw UnusableData("joint fit: " + message);
}

std::string full_name(std::string_view effect, const std::string& which) {
  return fmt::format("{}{}{}", effect, which.empty() ? "" : ", ", which);
}

Eigen::Matrix3d rows_of_line(const EffectLayout& layout, const Eigen::VectorXd& value) {
  Eigen::Matrix3d out;
  for (int j = 0; j < 3; ++j) out.row(j) = value.segment<3>(layout.own_count() * j).transpose();
  return out;
}

}  // namespace

Rows12 line_rows(const EffectLayout& layout, const Eigen::VectorXd& value) {
  Rows12 out = Rows12::Zero(12, layout.count());
  const Eigen::Matrix3d at_value = rows_of_line(layout, value);
  for (int j = 0; j < 3; ++j) {
    const int first = layout.own_count() * j;
    double scale = 1.0;
    for (std::size_t i = 0; i < layout.own.size(); ++i) {
      const LineShare share = layout.own[i].effect->line(at_value, j, layout.own[i].index);
      const int column = first + EffectLayout::kOwnFixed + static_cast<int>(i);
      scale += share.scale * value(column);
      for (int k = 0; k < 3; ++k) out(3 * j + k, column) = share.scale * value(first + k);
      out(9 + j, column) = share.offset;
    }
    for (int k = 0; k < 3; ++k) out(3 * j + k, first + k) = scale;
    out(9 + j, first + 3) = 1.0;
  }
  return out;
}

Vector12 line_values(const EffectLayout& layout, const Eigen::VectorXd& value) {
  Vector12 out;
  const Eigen::Matrix3d at_value = rows_of_line(layout, value);
  for (int j = 0; j < 3; ++j) {
    const int first = layout.own_count() * j;
    double scale = 1.0;
    double offset = value(first + 3);
    for (std::size_t i = 0; i < layout.own.size(); ++i) {
      const LineShare share = layout.own[i].effect->line(at_value, j, layout.own[i].index);
      const double p = value(first + EffectLayout::kOwnFixed + static_cast<int>(i));
      scale += share.scale * p;
      offset += share.offset * p;
    }
    out.segment<3>(3 * j) = scale * value.segment<3>(first);
    out(9 + j) = offset;
  }
  return out;
}

EffectModel::EffectModel(std::span<const EffectReading> readings, const EffectFitOptions& options)
    : readings_(readings), options_(options) {
  check_readings();
  choose_unknowns();
  list_unknowns();
  start_from_linear_fit();
  find_signs();
  evaluate();
}

void EffectModel::check_readings() const {
  effect_require(!readings_.empty(), "no readings");
  for (const EffectReading& at : readings_) {
    effect_require(at.experiment >= 1 && at.experiment <= 3,
                   fmt::format("experiment {}; 1, 2 or 3 is required", at.experiment));
    effect_require(at.value.allFinite() && std::isfinite(at.sin_alpha) && std::isfinite(at.cos_alpha) &&
                       std::isfinite(at.t),
                   "a reading, its angle or its time is not a finite number");
    effect_require(at.u.allFinite() && at.u.minCoeff() > 0.0,
                   "the standard uncertainty of a reading is not a finite number greater than zero");
    effect_require(at.sweep < static_cast<int>(options_.sweeps.size()) && std::isfinite(at.rate_radps) &&
                       std::isfinite(at.acceleration_radps2),
                   "a reading names a sweep that the options do not have, or a rate that is not finite");
  }
  for (const EffectSizeKey& key : effect_size_keys()) {
    const double size = key.get(options_.sizes);
    data_require(std::isfinite(size) && size >= 0.0,
                 fmt::format("{} is {}; a finite number not below zero is required", key.key, size));
  }
}

/// Alignment measured by other means. It is used even where the stated size is zero.
const std::optional<MeasuredValue>* EffectModel::measured(std::string_view effect) const {
  const MeasuredAlignment& alignment = options_.measured_alignment;
  if (effect == "Zx") return &alignment.zx;
  if (effect == "Zy") return &alignment.zy;
  if (effect == "Xz") return &alignment.xz;
  return nullptr;
}

bool EffectModel::is_in_run(const StageEffect& effect) const {
  if (effect.in_motion && !in_motion()) return false;
  return std::any_of(readings_.begin(), readings_.end(),
                     [&](const EffectReading& at) { return at.face >= effect.face; });
}

/// Effects that are stated as zero are known exactly, and left out.
void EffectModel::choose_unknowns() {
  const EffectSizes& sizes = options_.sizes;
  for (const ItemEffect& effect : item_effects()) {
    if (!is_fitted(effect, sizes, options_.drift, options_.nonlinearity)) continue;
    if (effect.in_motion && !in_motion()) continue;
    for (int i = 0; i < effect.count; ++i) layout_.own.push_back({&effect, i});
  }
  for (const StageEffect& effect : stage_effects()) {
    if (!is_in_run(effect)) continue;
    const auto* of_effect = measured(effect.name);
    const bool known = !(effect.prior(sizes) > 0.0) && !(of_effect != nullptr && *of_effect);
    if (known || (effect.key == "zero_deg" && !options_.mean_step)) continue;
    if (effect.key == "axes_distance_mm") axes_distance_ = static_cast<int>(layout_.stage.size());
    for (int i = 0; i < effect.count; ++i) layout_.stage.push_back({&effect, i});
  }
  const double step = step_prior(sizes);
  if (step > 0.0) {
    for (const EffectReading& at : readings_) layout_.maps = std::max(layout_.maps, at.map + 1);
  }
  step_sd_ = layout_.maps > 0 ? 0.0 : step;
  list_bending();
  layout_.sweeps = static_cast<int>(options_.sweeps.size());
}

/// Finds the effects whose share depends on the response. Others, such as drifts, are the same all around the
/// circle.
void EffectModel::list_bending() {
  ItemPoint point;
  point.t = 0.4;
  point.y = Eigen::Vector3d(0.3, 0.5, 0.7);
  bends_.assign(layout_.own.size(), 0);
  for (std::size_t i = 0; i < layout_.own.size(); ++i) {
    const EffectLayout::OwnUnknown& own = layout_.own[i];
    if (own.effect->key == "sensitivity_drift") sensitivity_drift_ = static_cast<int>(i);
    const ItemShare share = own.effect->share(point, 0, own.index);
    if (own.effect->in_motion || (share.by_y == 0.0 && share.by_next == 0.0 && share.by_last == 0.0))
      continue;
    bending_.push_back(i);
    bends_[i] = own.effect->kind != ItemEffectKind::kDrift;
  }
}

double EffectModel::half_gain(double t, int output, const Eigen::VectorXd& value) const {
  if (sensitivity_drift_ < 0) return 1.0;
  return 1.0 + 0.5 * t * value(layout_.own_count() * output + EffectLayout::kOwnFixed + sensitivity_drift_);
}

EffectUnknown EffectModel::stage_unknown(const StageEffect& effect, int index) const {
  EffectUnknown unknown{
      std::string(effect.name),    unknown_name(effect, index), std::string(effect.key), -1, 0.0,
      effect.prior(options_.sizes)};
  const auto* of_effect = measured(effect.name);
  if (of_effect == nullptr || !*of_effect) return unknown;
  const MeasuredValue& value = **of_effect;
  data_require(std::isfinite(value.value) && std::isfinite(value.standard_uncertainty) &&
                   value.standard_uncertainty > 0.0,
               fmt::format("measured {} = {} with standard uncertainty {}; a finite value and an uncertainty "
                           "greater than zero are required",
                           effect.name, value.value, value.standard_uncertainty));
  unknown.prior_mean = value.value;
  unknown.prior_sd = value.standard_uncertainty;
  return unknown;
}

void EffectModel::list_unknowns() {
  constexpr double kNoPrior = std::numeric_limits<double>::infinity();
  for (int j = 0; j < 3; ++j) {
    const char output = "uvw"[j];
    for (const char axis : {'x', 'y', 'z'})
      unknowns_.push_back({"s", fmt::format("s_{}{}", output, axis), "", j, 0.0, kNoPrior});
    unknowns_.push_back({"O", fmt::format("O_{}", output), "", j, 0.0, kNoPrior});
    for (const EffectLayout::OwnUnknown& own : layout_.own) {
      unknowns_.push_back(
          {std::string(own.effect->name),
           full_name(fmt::format("{} of {}", own.effect->name, output), own.effect->unknown_name(own.index)),
           std::string(own.effect->key), j, 0.0, own.effect->prior(options_.sizes)});
    }
  }
  for (const EffectLayout::StageUnknown& of_stage : layout_.stage)
    unknowns_.push_back(stage_unknown(*of_stage.effect, of_stage.index));
  for (int i = 0; i < layout_.maps; ++i) {
    unknowns_.push_back({"step errors", fmt::format("step error of pose {}", i + 1), "step_deg", -1, 0.0,
                         step_prior(options_.sizes)});
  }
  list_sweeps();
  prior_weight_ = Eigen::VectorXd::Zero(layout_.count());
  prior_mean_ = Eigen::VectorXd::Zero(layout_.count());
  for (std::size_t i = 0; i < unknowns_.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    prior_mean_(at) = unknowns_[i].prior_mean;
    if (std::isfinite(unknowns_[i].prior_sd))
      prior_weight_(at) = 1.0 / (unknowns_[i].prior_sd * unknowns_[i].prior_sd);
  }
}

void EffectModel::list_sweeps() {
  for (std::size_t k = 0; k < options_.sweeps.size(); ++k) {
    const SweepSize& size = options_.sweeps[k];
    for (int i = 0; i < kSweepUnknowns; ++i)
      unknowns_.push_back({"angles of the sweeps", fmt::format("angles of sweep {}, part {}", k + 1, i + 1),
                           "sweep_deg", -1, 0.0, i == 0 ? size.mean : size.course});
  }
}

void EffectModel::start_from_linear_fit() {
  std::vector<Eigen::Vector3d> gravity;
  std::vector<Eigen::Vector3d> values;
  const StageInputs perfect = StageInputs::Zero();
  poses_.reserve(readings_.size());
  shares_.reserve(readings_.size() * layout_.stage.size());
  for (const EffectReading& at : readings_) {
    poses_.push_back(StagePose::of(at.experiment, at.face, at.sin_alpha, at.cos_alpha));
    poses_.back().rate_radps = at.rate_radps;
    poses_.back().acceleration_radps2 = at.acceleration_radps2;
    poses_.back().mean_rate_radps = at.mean_rate_radps;
    if (in_motion()) sweep_shares_.push_back(sweep_shares(at.turned_rad));
    gravity.push_back(gravity_alone(poses_.back(), perfect));
    values.push_back(at.value);
    for (const EffectLayout::StageUnknown& of_stage : layout_.stage)
      shares_.push_back(of_stage.effect->share(poses_.back(), of_stage.index));
    list_input_terms();
  }
  const KnownAcsFit start = linear_fit_given_acs(gravity, values);
  unit_ = options_.unit.value_or(start.sensitivity_matrix.rowwise().norm());
  for (int j = 0; j < 3; ++j) {
    // A constant output leaves a row of round-off: some ulp of its readings.
    data_require(unit_(j) > 1e-12 * std::abs(start.offset(j)),
                 fmt::format("accelerometer {} does not respond to gravity at all", "uvw"[j]));
    std::vector<double> u;
    for (const EffectReading& at : readings_) u.push_back(at.u(j) / unit_(j));
    usual_u_(j) = median(std::move(u));
  }
  value_ = prior_mean_;
  for (int j = 0; j < 3; ++j) {
    value_.segment<3>(layout_.own_count() * j) = start.sensitivity_matrix.row(j).transpose() / unit_(j);
    value_(layout_.own_count() * j + 3) = start.offset(j) / unit_(j);
  }
  step_.assign(readings_.size(), 0.0);
  by_step_.resize(readings_.size());
  residual_.resize(3 * static_cast<Eigen::Index>(readings_.size()));
  jacobian_.resize(residual_.size(), layout_.count());
}

/// Lists the shares of the reading that was added last, without zeros.
void EffectModel::list_input_terms() {
  const auto count = static_cast<int>(layout_.stage.size());
  const StageShare* shares = shares_.data() + shares_.size() - layout_.stage.size();
  for (int k = 0; k < count; ++k) {
    if (k == axes_distance_) continue;
    if (shares[k].value != 0.0) input_terms_.push_back({shares[k].input, k, shares[k].value});
    if (shares[k].second_value != 0.0)
      input_terms_.push_back({shares[k].second_input, k, shares[k].second_value});
  }
  std::stable_sort(input_terms_.begin() + static_cast<std::ptrdiff_t>(first_term_.back()), input_terms_.end(),
                   [](const InputTerm& a, const InputTerm& b) { return a.input < b.input; });
  first_term_.push_back(input_terms_.size());
}

/// First signs for the hysteresis: those of the linear solution, on a stage that is known by the stated
/// sizes.
void EffectModel::find_signs() {
  std::vector<ReadingArrival> arrivals;
  for (const EffectReading& at : readings_) arrivals.push_back({at.experiment, at.face, at.arrival});
  arrival_signs_ = ArrivalSigns(std::move(arrivals), turning_width(options_.sizes));
  signs_.variance.assign(readings_.size(), Eigen::Vector3d::Zero());
  if (options_.signs) {
    signs_ = *options_.signs;
    return;
  }
  if (hysteresis_unknowns().empty()) {
    signs_.mean = signs_.variance;
    return;
  }
  Eigen::MatrixXd sizes = Eigen::MatrixXd::Zero(layout_.count(), layout_.count());
  sizes.diagonal() = prior_weight_.unaryExpr([](double w) { return w > 0.0 ? 1.0 / std::sqrt(w) : 0.0; });
  take_uncertainties_of_arrival(sizes);
  use_signs(mean_signs_at(value_, step_), sizes);
}

void EffectModel::use_signs(std::vector<Eigen::Vector3d> mean, const Eigen::MatrixXd& covariance_root) {
  const std::vector<Eigen::Index> hysteresis = hysteresis_unknowns();
  signs_.mean = std::move(mean);
  for (std::size_t j = 0; j < 3; ++j) {
    const Eigen::Index at = hysteresis[j];
    const double size2 = std::max(std::pow(unknowns_[static_cast<std::size_t>(at)].prior_sd, 2),
                                  std::pow(value_(at), 2) + covariance_root.row(at).squaredNorm());
    const auto output = static_cast<Eigen::Index>(j);
    for (std::size_t n = 0; n < readings_.size(); ++n)
      signs_.variance[n](output) = size2 * (1.0 - std::pow(signs_.mean[n](output), 2));
  }
}

ArrivalSigns::Responses EffectModel::responses_at(const Eigen::VectorXd& value) const {
  return [this, &value, rows = rows_of(value)](const StagePose& pose) -> Eigen::Vector3d {
    return rows * gravity_alone(pose, inputs_on_the_way(pose, value));
  };
}

StageInputs EffectModel::inputs_on_the_way(const StagePose& pose, const Eigen::VectorXd& value) const {
  StageInputs inputs = StageInputs::Zero();
  for (std::size_t k = 0; k < layout_.stage.size(); ++k) {
    const StageShare share = layout_.stage[k].effect->share(pose, layout_.stage[k].index);
    const double p = value(layout_.first_stage() + static_cast<Eigen::Index>(k));
    inputs(share.input) += share.value * p;
    inputs(share.second_input) += share.second_value * p;
  }
  return inputs;
}

EffectModel::ResponsesAt EffectModel::responses_by_unknowns(const StagePose& pose) const {
  const GravityAt gravity = gravity_at(pose, inputs_on_the_way(pose, value_));
  const Eigen::Matrix<double, 3, kStageInputs> by = rows() * gravity.by_input;
  ResponsesAt out{gravity.g, Eigen::Matrix3Xd::Zero(3, static_cast<Eigen::Index>(layout_.stage.size())),
                  by.col(moving_angle_input(pose.experiment))};
  for (std::size_t k = 0; k < layout_.stage.size(); ++k) {
    const StageShare share = layout_.stage[k].effect->share(pose, layout_.stage[k].index);
    out.by_stage.col(static_cast<Eigen::Index>(k)) =
        by.col(share.input) * share.value + by.col(share.second_input) * share.second_value;
  }
  return out;
}

void EffectModel::take_uncertainties_of_arrival(const Eigen::MatrixXd& covariance_root) {
  const double step = step_prior(options_.sizes);
  double stage = 2.0 * step * step;
  for (const EffectLayout::StageUnknown& of_stage : layout_.stage)
    if (!of_stage.effect->in_motion) stage += std::pow(of_stage.effect->prior(options_.sizes), 2);
  constexpr double kFar = 30.0;
  // A change of output j depends on its three s and on the stage: of their covariance the root is kept.
  const auto unknowns = static_cast<Eigen::Index>(layout_.stage.size());
  std::array<Eigen::MatrixXd, 3> covariance;
  for (int j = 0; j < 3; ++j) {
    Eigen::MatrixXd root(3 + unknowns, covariance_root.cols());
    root << covariance_root.middleRows<3>(Eigen::Index{layout_.own_count()} * j),
        covariance_root.middleRows(layout_.first_stage(), unknowns);
    covariance[static_cast<std::size_t>(j)] = covariance_of_root(root);
  }
  // The outputs ask for the same poses one after another.
  std::array<std::pair<const StagePose*, ResponsesAt>, 2> latest{};
  std::size_t filled = 0;
  const auto at = [&](const StagePose& pose) -> const ResponsesAt& {
    for (const auto& [known, response] : latest)
      if (known == &pose) return response;
    auto& [known, response] = latest[filled++ % 2];
    known = &pose;
    response = responses_by_unknowns(pose);
    return response;
  };
  const auto uncertainty = [&](const ResponseChange& change, int output) {
    Eigen::VectorXd by(3 + unknowns);
    double variance = 0.0;
    by.setZero();
    for (const auto& [pose, weight] : {std::pair{&change.to, 1.0}, {&change.from, -1.0}}) {
      const ResponsesAt& response = at(*pose);
      by.head<3>() += weight * response.g;
      by.tail(unknowns) += weight * response.by_stage.row(output).transpose();
      variance += step * step * std::pow(response.by_step(output), 2);
    }
    variance += by.dot(product_with_vector(covariance[static_cast<std::size_t>(output)], by));
    return std::sqrt(std::max(0.0, variance));
  };
  const ArrivalSigns::Responses responses = responses_at(value_);
  arrival_signs_.find(responses);
  arrival_signs_.take_uncertainties(responses, uncertainty, kFar * std::sqrt(stage));
}

bool EffectModel::take_signs(const Eigen::MatrixXd& covariance_root) {
  constexpr double kSame = 1e-3;
  const std::vector<Eigen::Index> hysteresis = hysteresis_unknowns();
  if (options_.signs || hysteresis.empty()) return false;
  take_uncertainties_of_arrival(covariance_root);
  if (in_motion()) {
    Eigen::VectorXd variance = times_upper(changes_by_unknowns(), covariance_root).rowwise().squaredNorm();
    for (std::size_t n = 0; n < readings_.size(); ++n) {
      const auto [from, to] = change_of(n);
      if (from == to) continue;
      variance.segment<3>(3 * static_cast<Eigen::Index>(n)) +=
          step_sd_ * step_sd_ * (by_step_[from].cwiseAbs2() + by_step_[to].cwiseAbs2());
    }
    variance += bends_at(value_, step_).cwiseAbs2() / 3.0;
    u_change_ = variance.cwiseSqrt();
  }
  std::vector<Eigen::Vector3d> mean = mean_signs_at(value_, step_);
  double largest = 0.0;
  for (std::size_t n = 0; n < mean.size(); ++n)
    largest = std::max(largest, (mean[n] - signs_.mean[n]).cwiseAbs().maxCoeff());
  if (largest < kSame) return false;
  use_signs(std::move(mean), covariance_root);
  evaluate();
  return true;
}

std::vector<Eigen::Vector3d> EffectModel::mean_signs_at(const Eigen::VectorXd& value,
                                                        const std::vector<double>& steps) const {
  std::vector<Eigen::Vector3d> out = arrival_signs_.mean(responses_at(value));
  if (!in_motion()) return out;
  const Eigen::VectorXd change = changes_at(value, steps);
  for (std::size_t n = 0; n < readings_.size(); ++n) {
    if (readings_[n].sweep < 0) continue;
    const Eigen::Index row = 3 * static_cast<Eigen::Index>(n);
    if (u_change_.size() == 0) {
      out[n] = signs_of_change(Eigen::Vector3d::Zero(), change.segment<3>(row));
      continue;
    }
    for (Eigen::Index j = 0; j < 3; ++j)
      out[n](j) = change(row + j) == 0.0
                      ? 0.0
                      : std::erf(change(row + j) / (std::numbers::sqrt2 * u_change_(row + j)));
  }
  return out;
}

Eigen::VectorXd EffectModel::changes_at(const Eigen::VectorXd& value,
                                        const std::vector<double>& steps) const {
  Eigen::VectorXd out = Eigen::VectorXd::Zero(residual_.size());
  const Eigen::Matrix3Xd y = linear_responses_at(value, steps);
  for (std::size_t n = 0; n < readings_.size(); ++n) {
    const auto [from, to] = change_of(n);
    out.segment<3>(3 * static_cast<Eigen::Index>(n)) =
        y.col(static_cast<Eigen::Index>(to)) - y.col(static_cast<Eigen::Index>(from));
  }
  return out;
}

std::pair<std::size_t, std::size_t> EffectModel::change_of(std::size_t n) const {
  const auto is_of_sweep = [&](std::size_t other) {
    return other < readings_.size() && readings_[other].sweep == readings_[n].sweep;
  };
  if (readings_[n].sweep < 0) return {n, n};
  return {n > 0 && is_of_sweep(n - 1) ? n - 1 : n, is_of_sweep(n + 1) ? n + 1 : n};
}

Eigen::Matrix3Xd EffectModel::linear_responses_at(const Eigen::VectorXd& value,
                                                  const std::vector<double>& steps) const {
  Eigen::Matrix3Xd out(3, static_cast<Eigen::Index>(readings_.size()));
  const Eigen::Matrix3d at_value = rows_of(value);
  for (std::size_t n = 0; n < readings_.size(); ++n)
    out.col(static_cast<Eigen::Index>(n)) = at_value * gravity_alone(poses_[n], inputs_at(n, value, steps));
  return out;
}

Eigen::VectorXd EffectModel::bends_at(const Eigen::VectorXd& value, const std::vector<double>& steps) const {
  Eigen::VectorXd out = Eigen::VectorXd::Zero(residual_.size());
  if (!in_motion()) return out;
  const Eigen::Matrix3Xd y = linear_responses_at(value, steps);
  for (std::size_t n = 0; n < readings_.size(); ++n) {
    const auto [from, to] = change_of(n);
    if (to != from + 2) continue;
    const auto at = static_cast<Eigen::Index>(n);
    out.segment<3>(3 * at) = y.col(at + 1) - 2.0 * y.col(at) + y.col(at - 1);
  }
  return out;
}

ReadingRows EffectModel::changes_by_unknowns() const {
  ReadingRows out = ReadingRows::Zero(residual_.size(), layout_.count());
  const Eigen::Index rest = layout_.count() - layout_.first_stage();
  for (Eigen::Index row = 0; row < out.rows(); ++row) {
    const Eigen::Index j = row % 3;
    const Eigen::Index first = layout_.own_count() * j;
    const auto [from, to] = change_of(static_cast<std::size_t>(row / 3));
    const auto difference = jacobian_.row(3 * static_cast<Eigen::Index>(to) + j) -
                            jacobian_.row(3 * static_cast<Eigen::Index>(from) + j);
    out.row(row).segment<3>(first) = difference.segment<3>(first);
    out.row(row).tail(rest) = difference.tail(rest);
  }
  return out;
}

std::vector<Eigen::Index> EffectModel::hysteresis_unknowns() const {
  std::vector<Eigen::Index> out;
  for (std::size_t i = 0; i < unknowns_.size(); ++i)
    if (unknowns_[i].effect == "hysteresis") out.push_back(static_cast<Eigen::Index>(i));
  return out;
}

Eigen::Matrix3d EffectModel::rows_of(const Eigen::VectorXd& value) const {
  return rows_of_line(layout_, value);
}

StageInputs EffectModel::inputs_at(std::size_t n, const Eigen::VectorXd& value,
                                   const std::vector<double>& steps) const {
  StageInputs inputs = StageInputs::Zero();
  const auto last = input_terms_.begin() + static_cast<std::ptrdiff_t>(first_term_[n + 1]);
  for (auto term = input_terms_.begin() + static_cast<std::ptrdiff_t>(first_term_[n]); term != last;) {
    const int input = term->input;
    double sum = 0.0;
    for (; term != last && term->input == input; ++term)
      sum += term->value * value(layout_.first_stage() + term->unknown);
    inputs(input) = sum;
  }
  if (axes_distance_ >= 0) {
    const StageShare share =
        layout_.stage[static_cast<std::size_t>(axes_distance_)].effect->share(pose_at(n, value), 0);
    const double distance = value(layout_.first_stage() + axes_distance_);
    inputs(share.input) += share.value * distance;
    inputs(share.second_input) += share.second_value * distance;
  }
  const int map = map_of(n);
  inputs(moving_angle_input(readings_[n].experiment)) +=
      map >= 0 ? value(layout_.first_map() + map) : steps[n] * readings_[n].step_factor;
  if (const int sweep = readings_[n].sweep; sweep >= 0) {
    double error = 0.0;
    for (int i = 0; i < kSweepUnknowns; ++i)
      error += sweep_shares_[n].value[static_cast<std::size_t>(i)] *
               value(layout_.first_sweep() + kSweepUnknowns * sweep + i);
    inputs(moving_angle_input(readings_[n].experiment)) += error;
  }
  return inputs;
}

StagePose EffectModel::pose_at(std::size_t n, const Eigen::VectorXd& value) const {
  StagePose pose = poses_[n];
  if (readings_[n].sweep < 0) return pose;
  const auto errors =
      value.segment<kSweepUnknowns>(layout_.first_sweep() + kSweepUnknowns * readings_[n].sweep);
  const SweepShares& shares = sweep_shares_[n];
  const double rate = readings_[n].rate_radps;
  using Shares = Eigen::Map<const Eigen::Matrix<double, kSweepUnknowns, 1>>;
  pose.rate_radps += rate * Shares(shares.slope.data()).dot(errors);
  pose.acceleration_radps2 += rate * rate * Shares(shares.curvature.data()).dot(errors);
  return pose;
}

EffectModel::ByMotion EffectModel::by_motion(const StagePose& pose, const Eigen::Matrix3d& rows) const {
  const Eigen::Vector3d axis = pose.axis_in_platter();
  Eigen::Vector3d common = Eigen::Vector3d::Zero();
  if (axes_distance_ >= 0 && pose.about_x())
    common =
        value_(layout_.first_stage() + axes_distance_) * Eigen::Vector3d(pose.z.sin[1], pose.z.cos[1], 0.0);
  std::array<Eigen::Vector3d, 3> places{common, common, common};
  for (std::size_t i = 0; i < layout_.own.size(); ++i) {
    if (layout_.own[i].effect->key != "position_mm") continue;
    for (int j = 0; j < 3; ++j)
      places[static_cast<std::size_t>(j)](layout_.own[i].index) +=
          value_(layout_.own_count() * j + EffectLayout::kOwnFixed + static_cast<int>(i));
  }
  ByMotion by;
  for (int j = 0; j < 3; ++j) {
    const Eigen::Vector3d& place = places[static_cast<std::size_t>(j)];
    by.rate(j) = -2.0 * pose.rate_radps * rows.row(j).dot(place - axis * axis.dot(place)) / kStandardGravity;
    by.acceleration(j) = rows.row(j).dot(axis.cross(place)) / kStandardGravity;
  }
  return by;
}

std::vector<Eigen::Vector3d> EffectModel::came_from_at(const Eigen::VectorXd& value,
                                                       const std::vector<double>& steps,
                                                       SignRule rule) const {
  std::vector<Eigen::Vector3d> out = arrival_signs_.of_one_item(responses_at(value), rule);
  if (!in_motion()) return out;
  const Eigen::VectorXd change = changes_at(value, steps);
  for (std::size_t n = 0; n < readings_.size(); ++n)
    if (readings_[n].sweep >= 0)
      out[n] = signs_of_change(Eigen::Vector3d::Zero(), change.segment<3>(3 * static_cast<Eigen::Index>(n)));
  return out;
}

Eigen::VectorXd EffectModel::readings_at(const Eigen::VectorXd& value, const std::vector<double>& steps,
                                         const std::vector<Eigen::Vector3d>& came_from) const {
  Eigen::VectorXd out(3 * static_cast<Eigen::Index>(readings_.size()));
  const Eigen::Matrix3d at_value = rows_of(value);
  for (std::size_t n = 0; n < readings_.size(); ++n) {
    const StageInputs inputs = inputs_at(n, value, steps);
    GravityAt gravity;
    if (readings_[n].sweep >= 0) {
      gravity = gravity_at(poses_[n], inputs);
    } else {
      gravity.g = gravity_alone(poses_[n], inputs);
    }
    ItemPoint point = point_at(n, pose_at(n, value), at_value, gravity, inputs);
    point.came_from = came_from[n];
    const Eigen::Vector3d y = point.y;
    if (point.rate_radps != 0.0) point = bent_point(placed_point(point, value), value);
    for (int j = 0; j < 3; ++j) {
      const int first = layout_.own_count() * j;
      const double gain = half_gain(point.t, j, value), own = point.y(j);
      double reading = y(j) + value(first + 3);
      for (std::size_t i = 0; i < layout_.own.size(); ++i) {
        const double of_effect = bends_[i] != 0 ? gain : 1.0;
        point.y(j) = of_effect * own;
        reading += of_effect * layout_.own[i].effect->share(point, j, layout_.own[i].index).value *
                   value(first + EffectLayout::kOwnFixed + static_cast<int>(i));
      }
      point.y(j) = own;
      out(3 * static_cast<Eigen::Index>(n) + j) = reading;
    }
  }
  return out;
}

EffectModel::At EffectModel::evaluate_at(std::size_t n, const Eigen::Matrix3d& rows) {
  const auto stage_count = static_cast<int>(layout_.stage.size());
  const StageShare* shares = shares_.data() + n * layout_.stage.size();
  const int moving = moving_angle_input(readings_[n].experiment);
  const StageInputs inputs = inputs_at(n);
  const GravityAt gravity = gravity_at(poses_[n], inputs);
  const StagePose pose = pose_at(n, value_);
  const ItemPoint point = point_at(n, pose, rows, gravity, inputs);
  const ByMotion by_motion = readings_[n].sweep >= 0 ? this->by_motion(pose, rows) : ByMotion{};
  const Eigen::Matrix<double, 3, kStageInputs> by_input = rows * gravity.by_input;

  ItemPoint bent = bent_point(placed_point(point, value_), value_);
  At out;
  for (int j = 0; j < 3; ++j) {
    double* row = jacobian_.row(static_cast<Eigen::Index>(3 * n) + j).data();
    std::fill_n(row, layout_.count(), 0.0);
    const int first = layout_.own_count() * j;
    double reading = point.y(j) + value_(first + 3);
    Eigen::Vector3d slope = Eigen::Vector3d::Unit(j);  // by the linear responses of u, v, w
    const double gain = half_gain(point.t, j, value_), own = bent.y(j);
    double by_gain = 0.0;
    for (std::size_t i = 0; i < layout_.own.size(); ++i) {
      const bool bends = bends_[i] != 0;
      const double of_effect = bends ? gain : 1.0;
      bent.y(j) = of_effect * own;
      const ItemShare share = layout_.own[i].effect->share(bent, j, layout_.own[i].index);
      const int column = first + EffectLayout::kOwnFixed + static_cast<int>(i);
      const double unknown = of_effect * value_(column);
      reading += share.value * unknown;
      if (bends) by_gain += (share.value + share.by_y * bent.y(j)) * value_(column);
      slope(j) += of_effect * share.by_y * unknown;
      slope((j + 1) % 3) += share.by_next * unknown;
      slope((j + 2) % 3) += share.by_last * unknown;
      row[column] = of_effect * share.value;
    }
    bent.y(j) = own;
    if (sensitivity_drift_ >= 0)
      row[first + EffectLayout::kOwnFixed + sensitivity_drift_] += 0.5 * point.t * by_gain;
    const Eigen::Matrix<double, 1, kStageInputs> by = slope.transpose() * by_input;
    out.reading(j) = reading;
    out.by_step(j) = by(moving);
    for (int m = 0; m < 3; ++m) {
      for (int k = 0; k < 3; ++k) row[layout_.own_count() * m + k] = slope(m) * gravity.g(k);
    }
    row[first + 3] = 1.0;
    double* of_stage = row + layout_.first_stage();
    for (int k = 0; k < stage_count; ++k) {
      of_stage[k] =
          by(shares[k].input) * shares[k].value + by(shares[k].second_input) * shares[k].second_value;
    }
    if (const int map = map_of(n); map >= 0) row[layout_.first_map() + map] = out.by_step(j);
    if (const int sweep = readings_[n].sweep; sweep >= 0) {
      double* of_sweep = row + layout_.first_sweep() + std::ptrdiff_t{kSweepUnknowns} * sweep;
      const SweepShares& sweep_shares = sweep_shares_[n];
      const double by_slope = by_motion.rate(j) * readings_[n].rate_radps;
      const double by_curvature = by_motion.acceleration(j) * std::pow(readings_[n].rate_radps, 2);
      for (std::size_t i = 0; i < kSweepUnknowns; ++i)
        of_sweep[i] = out.by_step(j) * sweep_shares.value[i] + by_slope * sweep_shares.slope[i] +
                      by_curvature * sweep_shares.curvature[i];
    }
  }
  return out;
}

/// Sums up what the effects that bend a response add to the linear response of an output.
double EffectModel::bend_at(const ItemPoint& point, int output, const Eigen::VectorXd& value) const {
  const int first = layout_.own_count() * output + EffectLayout::kOwnFixed;
  double sum = 0.0;
  for (const std::size_t i : bending_) {
    const EffectLayout::OwnUnknown& own = layout_.own[i];
    sum += own.effect->share(point, output, own.index).value * value(first + static_cast<int>(i));
  }
  return sum;
}

/// The point with the acceleration of each output's own place in its y: that is what an output bends with,
/// also where it bends with its neighbours.
ItemPoint EffectModel::placed_point(const ItemPoint& point, const Eigen::VectorXd& value) const {
  ItemPoint out = point;
  if (point.rate_radps == 0.0) return out;
  for (std::size_t i = 0; i < layout_.own.size(); ++i) {
    const EffectLayout::OwnUnknown& own = layout_.own[i];
    if (own.effect->key != "position_mm") continue;
    for (int j = 0; j < 3; ++j)
      out.y(j) += own.effect->share(point, j, own.index).value *
                  value(layout_.own_count() * j + EffectLayout::kOwnFixed + static_cast<int>(i));
  }
  return out;
}

/// The swings of the outputs with what their bends add. A filter takes the same share of all orders:
/// account_for_motion() has taken back what it does to the higher ones beyond that.
/// @param point  a placed_point()
ItemPoint EffectModel::bent_point(const ItemPoint& point, const Eigen::VectorXd& value) const {
  ItemPoint out = point;
  if (point.rate_radps == 0.0) return out;
  // The mean over the turn from equal steps: exact for powers of y below their number.
  constexpr double kHalf = 0.5 * std::numbers::sqrt2;
  constexpr std::array<std::array<double, 2>, 8> kCosAndSin{{{1.0, 0.0},
                                                             {kHalf, kHalf},
                                                             {0.0, 1.0},
                                                             {-kHalf, kHalf},
                                                             {-1.0, 0.0},
                                                             {-kHalf, -kHalf},
                                                             {0.0, -1.0},
                                                             {kHalf, -kHalf}}};
  ItemPoint at = point;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& [cos, sin] : kCosAndSin) {
    at.y = point.y + (cos - 1.0) * point.swing + sin * point.by_angle;
    for (int j = 0; j < 3; ++j) mean(j) += bend_at(at, j, value) / kCosAndSin.size();
  }
  for (int j = 0; j < 3; ++j) out.swing(j) += bend_at(point, j, value) - mean(j);
  return out;
}

/// The item at a reading, with the signs of this point.
ItemPoint EffectModel::point_at(std::size_t n, const StagePose& pose, const Eigen::Matrix3d& rows,
                                const GravityAt& gravity, const StageInputs& inputs) const {
  ItemPoint point{readings_[n].t, rows * gravity.g, signs_.mean[n]};
  if (readings_[n].sweep < 0) return point;
  point.turn(pose, rows, gravity);
  // The acceleration of what turns with the platter is the same all around the circle.
  const Eigen::Vector3d axis = pose.axis_in_platter();
  const Eigen::Vector3d force = inputs.segment<3>(kInputForceX);
  point.swing -= rows * (force - axis * axis.dot(force));
  return point;
}

void EffectModel::evaluate() {
  const Eigen::Matrix3d at_value = rows();
  for (std::size_t n = 0; n < readings_.size(); ++n) {
    const At model = evaluate_at(n, at_value);
    by_step_[n] = model.by_step * readings_[n].step_factor;
    residual_.segment<3>(3 * static_cast<Eigen::Index>(n)) =
        readings_[n].value.cwiseQuotient(unit_) - model.reading + by_step_[n] * step_[n];
  }
}

void EffectModel::move_to(const Eigen::VectorXd& value, std::vector<double> steps) {
  value_ = value;
  step_ = std::move(steps);
  evaluate();
}

void EffectModel::move_to(const EffectModel& other, std::vector<double> steps) {
  usual_u_ = usual_u_.cwiseProduct(unit_).cwiseQuotient(other.unit_);
  unit_ = other.unit_;
  Eigen::VectorXd value = Eigen::VectorXd::Zero(layout_.count());
  // Both list their unknowns in the order of the table.
  for (std::size_t i = 0, k = 0; i < unknowns_.size() && k < other.unknowns_.size(); ++i) {
    if (unknowns_[i].name == other.unknowns_[k].name)
      value(static_cast<Eigen::Index>(i)) = other.value_(static_cast<Eigen::Index>(k++));
  }
  move_to(value, std::move(steps));
}

bool EffectModel::is_plausible() const {
  const Eigen::Index axes = std::min<Eigen::Index>(3, static_cast<Eigen::Index>(layout_.stage.size()));
  return value_.allFinite() &&
         (axes == 0 || value_.segment(layout_.first_stage(), axes).cwiseAbs().maxCoeff() < kMostAskew);
}

Eigen::VectorXd EffectModel::misfit() const {
  Eigen::VectorXd out = residual_;
  for (std::size_t n = 0; n < readings_.size(); ++n)
    out.segment<3>(3 * static_cast<Eigen::Index>(n)) -= by_step_[n] * step_[n];
  return out;
}

std::vector<NoiseAtAngle> EffectModel::noise_at_angles(const Eigen::Vector3d& white) const {
  std::vector<NoiseAtAngle> out = stated_noise_at_angles(white);
  for (std::size_t n = 0; n < out.size(); ++n) out[n].white += signs_.variance[n];
  return out;
}

std::vector<NoiseAtAngle> EffectModel::stated_noise_at_angles(const Eigen::Vector3d& white) const {
  std::vector<NoiseAtAngle> out(readings_.size());
  const double intervals = static_cast<double>(std::max<std::size_t>(readings_.size(), 2) - 1);
  for (std::size_t n = 0; n < readings_.size(); ++n) {
    out[n].white = readings_[n].u.cwiseQuotient(unit_).cwiseProduct(white).cwiseAbs2();
    out[n].by_step = layout_.maps > 0 ? Eigen::Vector3d::Zero() : by_step_[n];
    if (n > 0) out[n].distance = std::max(0.0, (readings_[n].t - readings_[n - 1].t) * intervals);
  }
  return out;
}

NoiseProcess EffectModel::process_of(double tau, double rho) const {
  return {tau * usual_u_, rho};
}

Eigen::Vector3d EffectModel::least_white() const {
  return kSmallestRelativeNoise * unit_.cwiseQuotient(readings_.front().u);
}

ReadingRows EffectModel::left_out_columns(std::vector<EffectUnknown>& unknowns) const {
  std::vector<EffectColumn> columns;
  for (const ItemEffect& effect : item_effects()) {
    if (effect.prior(options_.sizes) > 0.0 || (effect.in_motion && !in_motion())) continue;
    for (int j = 0; j < 3; ++j) {
      for (int i = 0; i < effect.count; ++i) {
        columns.push_back({nullptr, &effect, i, j});
        unknowns.push_back({std::string(effect.name), "", std::string(effect.key), j, 0.0, 0.0});
      }
    }
  }
  for (const StageEffect& effect : stage_effects()) {
    if (!is_in_run(effect)) continue;
    const auto* of_effect = measured(effect.name);
    if (effect.prior(options_.sizes) > 0.0 || (of_effect != nullptr && *of_effect)) continue;
    for (int i = 0; i < effect.count; ++i) {
      columns.push_back({&effect, nullptr, i, -1});
      unknowns.push_back({std::string(effect.name), "", std::string(effect.key), -1, 0.0, 0.0});
    }
  }
  ReadingRows out = ReadingRows::Zero(residual_.size(), static_cast<Eigen::Index>(columns.size()));
  const Eigen::Matrix3d at_value = rows();
  for (std::size_t n = 0; n < readings_.size() && !columns.empty(); ++n) {
    const StageInputs inputs = inputs_at(n);
    const GravityAt gravity = gravity_at(poses_[n], inputs);
    const Eigen::Matrix<double, 3, kStageInputs> by_input = at_value * gravity.by_input;
    const ItemPoint point = point_at(n, pose_at(n, value_), at_value, gravity, inputs);
    auto three = out.middleRows<3>(3 * static_cast<Eigen::Index>(n));
    for (std::size_t c = 0; c < columns.size(); ++c)
      three.col(static_cast<Eigen::Index>(c)) =
          columns[c].at(poses_[n], point, by_input, Eigen::Vector3d::Ones());
  }
  return out;
}

}  // namespace abcal
