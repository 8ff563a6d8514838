#include "protocol/estimators/joint/planned_fit.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <set>
#include <utility>

#include "protocol/estimators/joint/item_fit.h"
#include "protocol/estimators/joint/line_response.h"
#include "protocol/estimators/joint/noise_search.h"
#include "protocol/estimators/measurement/measurement_fit.h"
#include "protocol/estimators/shared/noise_process.h"
#include "protocol/estimators/shared/normal_matrix.h"
#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/linear/products.h"
#include "protocol/record/stage_record.h"

namespace abcal {
namespace {

/// J C J' of a line response from the normal matrix of the unknowns.
Covariance12 line_covariance(const NormalMatrix& normal, const Rows12& rows) {
  if (!normal.solvable())
    throw UnusableData("planned fit: the readings do not determine the sensitivity matrix");
  const Covariance12 covariance = product(rows, normal.solve_columns(rows.transpose()));
  return 0.5 * (covariance + covariance.transpose());
}

/// The angles of the fine map that a run visits, in ascending order.
std::vector<AxisAngle> angles_of(const CollectedReadings& data) {
  std::set<AxisAngle> angles;
  for (const DwellRecord* dwell : data.dwells) angles.insert(visited_angle(dwell->experiment, dwell->alpha));
  return {angles.begin(), angles.end()};
}

/// Derivatives of the readings by the fine map at these angles (3 N x angles).
ReadingRows derivatives_by_map(const EffectModel& model, const CollectedReadings& data,
                               const std::vector<AxisAngle>& angles) {
  const auto readings = static_cast<Eigen::Index>(model.angles());
  ReadingRows out = ReadingRows::Zero(3 * readings, static_cast<Eigen::Index>(angles.size()));
  for (Eigen::Index n = 0; n < readings && !angles.empty(); ++n) {
    const auto at = static_cast<std::size_t>(n);
    const auto place =
        std::ranges::lower_bound(angles, visited_angle(data.dwells[at]->experiment, data.dwells[at]->alpha));
    out.block<3, 1>(3 * n, place - angles.begin()) = model.by_own_step(at);
  }
  return out;
}

/// The priors of the fine map at some angles and of the unknowns of a model, where a record knows the stage.
class PriorWithRecord {
 public:
  PriorWithRecord(const EffectModel& model, const StageRecordInUse& use, std::vector<AxisAngle> angles)
      : model_(model),
        record_(*use.record),
        state_(state_after(record_, use.age_months)),
        angles_(std::move(angles)),
        maps_(static_cast<Eigen::Index>(angles_.size())) {}

  /// The inverse of their covariance; zero where there is no prior.
  Eigen::MatrixXd weight() const {
    const Eigen::Index count = maps_ + model_.layout().count();
    Eigen::MatrixXd out = Eigen::MatrixXd::Zero(count, count);
    std::vector<Known> known;
    for (Eigen::Index i = 0; i < count; ++i) {
      if (const Eigen::Index place = place_of(i); place >= 0) {
        known.push_back({i, place});
      } else if (const double variance = stated_variance(i); std::isfinite(variance)) {
        out(i, i) = 1.0 / (variance + not_repeated(i));
      }
    }
    const auto size = static_cast<Eigen::Index>(known.size());
    Eigen::MatrixXd covariance(size, size);
    for (Eigen::Index a = 0; a < size; ++a) {
      for (Eigen::Index b = 0; b < size; ++b)
        covariance(a, b) = state_.covariance(at(known, a).in_record, at(known, b).in_record);
      covariance(a, a) += not_repeated(at(known, a).unknown);
    }
    const Eigen::MatrixXd inverse =
        NormalMatrix(covariance).solve_columns(Eigen::MatrixXd::Identity(size, size));
    for (Eigen::Index a = 0; a < size; ++a)
      for (Eigen::Index b = 0; b < size; ++b) out(at(known, a).unknown, at(known, b).unknown) = inverse(a, b);
    return out;
  }

 private:
  struct Known {
    Eigen::Index unknown, in_record;
  };
  static const Known& at(const std::vector<Known>& known, Eigen::Index i) {
    return known[static_cast<std::size_t>(i)];
  }
  const EffectUnknown& unknown(Eigen::Index i) const {
    return model_.unknowns()[static_cast<std::size_t>(i - maps_)];
  }
  double repeatability(RepeatPart part) const {
    return record_.repeatabilities[static_cast<std::size_t>(part)].rms;
  }
  Eigen::Index place_of(Eigen::Index i) const {
    if (i < maps_) return state_.place_of(angles_[static_cast<std::size_t>(i)]);
    return unknown(i).output < 0 ? state_.place_of(unknown(i).name) : -1;
  }
  /// As in a series of runs: a new angle has what is left of the stated size, that of zero any.
  double stated_variance(Eigen::Index i) const {
    if (i >= maps_) return std::pow(unknown(i).prior_sd, 2);
    return variance_of_new_map(angles_[static_cast<std::size_t>(i)], step_prior(model_.options().sizes),
                               repeatability(RepeatPart::kStep));
  }
  /// Variance of the part that the stage does not repeat, beside that of a step.
  double not_repeated(Eigen::Index i) const {
    const int part = i < maps_ ? -1 : repeat_part_of(unknown(i).name);
    return part < 0 ? 0.0 : std::pow(repeatability(static_cast<RepeatPart>(part)), 2);
  }

  const EffectModel& model_;
  const StageRecord& record_;
  StageState state_;
  std::vector<AxisAngle> angles_;
  Eigen::Index maps_;
};

}  // namespace

PlannedFit::PlannedFit(const RunRecord& record, const JointOptions& options)
    : data_(collect_readings(record, options.one_map_per_axis)),
      model_(data_.readings, fit_options(data_, record.tolerances, options)) {
  if (!record.stage_record.record) return;
  // The mean over a step of a sweep is another quantity than the fine map at the angle.
  const double step = step_prior(record.tolerances);
  const bool has_map = data_.sweeps.empty() && step > 0.0;
  const std::vector<AxisAngle> angles = has_map ? angles_of(data_) : std::vector<AxisAngle>{};
  const Repeatabilities& repeatabilities = record.stage_record.record->repeatabilities;
  stage_ = KnownStage{
      .by_map = derivatives_by_map(model_, data_, angles),
      .prior = PriorWithRecord(model_, record.stage_record, angles).weight(),
      .step_sd = has_map ? repeatabilities[static_cast<std::size_t>(RepeatPart::kStep)].rms : step};
}

Covariance12 PlannedFit::covariance_with_record(const Eigen::Vector3d& white) const {
  const Eigen::Index maps = stage_->by_map.cols();
  ReadingRows rows(model_.jacobian().rows(), stage_->prior.cols());
  rows << stage_->by_map, model_.jacobian();
  std::vector<NoiseAtAngle> noise = model_.noise_at_angles(white);
  for (std::size_t n = 0; n < noise.size(); ++n) noise[n].by_step /= model_.step_factor(n);
  NoiseWhitener(noise, stage_->step_sd, NoiseProcess{}).whiten(rows);
  Rows12 line = Rows12::Zero(12, rows.cols());
  line.rightCols(line.cols() - maps) = model_.line_rows();
  return line_covariance(NormalMatrix(products_of_columns(rows) + stage_->prior), line);
}

Covariance12 PlannedFit::covariance_line(double readings) {
  const AssumedNoise noise{.tau = 0.0,
                           .rho = 1.0,
                           .white = Eigen::Vector3d::Constant(1.0 / std::sqrt(readings)),
                           .step_sd = model_.step_sd()};
  // The signs of the hysteresis are those of a fit with this noise: they depend on what it knows.
  constexpr int kMostSigns = 5;
  AtNoise at = solve_at(model_, noise);
  for (int pass = 0; pass < kMostSigns && at.normal.solvable(); ++pass) {
    if (!model_.take_signs(at.normal.covariance_root())) break;
    at = solve_at(model_, noise);
  }
  const Covariance12 covariance =
      stage_ ? covariance_with_record(noise.white) : line_covariance(at.normal, model_.line_rows());
  const Vector12 units = units_of_line(model_.unit());
  return units.asDiagonal() * covariance * units.asDiagonal();
}

Vector12 PlannedFit::line() const {
  return model_.line_values().cwiseProduct(units_of_line(model_.unit()));
}

}  // namespace abcal
