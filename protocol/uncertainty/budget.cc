#include "protocol/uncertainty/budget.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <span>
#include <stdexcept>

#include "protocol/analysis/first_order.h"
#include "protocol/analysis/intrinsic_properties.h"
#include "protocol/analysis/run_time.h"

namespace abcal {

namespace {

using OutputJacobian = Eigen::Matrix<double, kStudyOutputs, 12>;

// The 18 outputs from errors of the 12 (s row by row, O), to first order.
OutputJacobian jacobian_of(const Eigen::Matrix3d& s) {
  const Eigen::Matrix<double, 9, 12> intrinsic = intrinsic_jacobian(s);  // s, phi, O
  OutputJacobian jacobian = OutputJacobian::Zero();
  jacobian.topRows<12>().setIdentity();
  jacobian.middleRows<3>(kFirstIntrinsicSensitivity) = intrinsic.topRows<3>();
  jacobian.middleRows<3>(kFirstIntrinsicAngle) = intrinsic.middleRows<3>(3);
  return jacobian;
}

// Position of accelerometer j's (s_jx, s_jy, s_jz, O_j) among the 12.
Eigen::Index position(Eigen::Index j, Eigen::Index component) {
  return component < 3 ? 3 * j + component : 9 + j;
}

class BudgetMaker {
 public:
  BudgetMaker(const RunRecord& record, const CalibrationResult& result)
      : record_(record),
        result_(result),
        design_(AbcDesign::of_record(record)),
        jacobian_(jacobian_of(result.sensitivity_values())) {
    const std::vector<double> all_times = run_time_fractions(record);
    std::array<Eigen::Index, 3> next{};
    for (std::size_t i = 0; i < record.dwells.size(); ++i) {
      const DwellRecord& dwell = record.dwells[i];
      if (dwell.closing) continue;
      dwells_.push_back(&dwell);
      times_.push_back(all_times[i]);
      shares_.push_back(
          design_.share(dwell.experiment, next[static_cast<std::size_t>(dwell.experiment - 1)]++));
    }
  }

  Budget make(std::optional<double> resolution) {
    add_stage();
    add_readings();
    if (resolution) add_resolution(*resolution);
    add_nonlinearity();
    add_gravity();
    budget_.covariance =
        budget_.type_b_covariance + jacobian_ * budget_.other_covariance * jacobian_.transpose();
    OutputVector variance = OutputVector::Zero();
    for (const BudgetLine& line : budget_.lines) variance += line.contribution.cwiseAbs2();
    budget_.combined = variance.cwiseSqrt();
    budget_.not_covered = {"nutation of the stage's axes", "stress-induced distortion of the stage",
                           "temperature, hysteresis and remounting of the accelerometer"};
    if (!resolution) budget_.not_covered.emplace_back("resolution of the accelerometer's output (not given)");
    return budget_;
  }

 private:
  // Errors of the 12 outputs for a unit of an input.
  Eigen::Matrix<double, 12, 1> through_the_fit(const InputEffect& input) const {
    Eigen::Matrix<double, 12, 1> errors = Eigen::Matrix<double, 12, 1>::Zero();
    for (std::size_t i = 0; i < input.effect.size(); ++i) {
      const Eigen::Vector4d& share = shares_[input.first_reading + i];
      for (Eigen::Index j = 0; j < 3; ++j) {
        for (Eigen::Index c = 0; c < 4; ++c) errors(position(j, c)) += share(c) * input.effect[i](j);
      }
    }
    return errors;
  }

  void add_stage() {
    AccelerometerModel accelerometer;
    accelerometer.sensitivity_matrix = result_.sensitivity_values();
    accelerometer.offset = result_.offset_values();
    // Step errors and drift are many inputs of one kind: one line for each experiment, one for the drift.
    std::map<std::string, BudgetLine> groups;
    std::map<std::string, int> members;
    std::vector<std::string> order;
    for (const InputEffect& input :
         first_order_effects(dwells_, times_, accelerometer, record_.tolerances, record_.response_unit)) {
      const bool step = input.name.starts_with("f_");
      const bool drift = input.name.starts_with("drift");
      const std::string group = step ? input.name.substr(0, 3) : drift ? "drift" : input.name;
      if (!groups.contains(group)) order.push_back(group);
      BudgetLine& line = groups[group];
      ++members[group];
      const Eigen::Matrix<double, 12, 1> errors = through_the_fit(input);
      const OutputVector sensitivity = jacobian_ * errors;
      line.unit = input.unit;
      line.standard_uncertainty = std::max(line.standard_uncertainty, input.standard_uncertainty);
      line.sensitivity += sensitivity.cwiseAbs2();
      const OutputVector contribution = sensitivity * input.standard_uncertainty;
      line.contribution += contribution.cwiseAbs2();
      if (drift) {
        const Eigen::Matrix<double, 12, 1> scaled = errors * input.standard_uncertainty;
        budget_.other_covariance += scaled * scaled.transpose();
      } else {
        budget_.type_b_covariance += contribution * contribution.transpose();
      }
      if (members[group] == 1) line.input = input.name;
      // One input alone keeps the sign of its sensitivity.
      if (!step && !drift) signed_[group] = sensitivity;
    }
    for (const std::string& group : order) {
      BudgetLine& line = groups[group];
      line.value = "0";
      line.distribution = "normal";
      line.sensitivity =
          signed_.contains(group) ? signed_[group] : OutputVector(line.sensitivity.cwiseSqrt());
      line.contribution = line.contribution.cwiseSqrt();
      if (group.starts_with("f_")) line.input = group + "(n), " + std::to_string(members[group]) + " angles";
      if (group == "drift") line.input = "drift over the run, u v w";
      budget_.lines.push_back(line);
    }
  }

  void add_readings() {
    if (!result_.covariance_type_a) {
      budget_.notes.emplace_back("The readings carry no uncertainty and leave no residual: no type A line.");
      return;
    }
    const Covariance12& covariance = *result_.covariance_type_a;
    BudgetLine line;
    line.input = "readings (noise, fit residual)";
    line.value = "measured";
    line.unit = record_.response_unit;
    line.distribution = "normal";
    line.type_a = true;
    // The typical standard uncertainty of a reading; each has its own.
    double sum = 0.0;
    for (const DwellRecord* dwell : dwells_) sum += dwell->u_mean ? dwell->u_mean->squaredNorm() / 3.0 : 0.0;
    line.standard_uncertainty = sum > 0.0 ? std::sqrt(sum / static_cast<double>(dwells_.size()))
                                          : std::numeric_limits<double>::quiet_NaN();
    if (sum == 0.0) {
      double residual = 0.0;
      for (const FitDiagnostic& fit : result_.diagnostics.fits)
        residual += fit.residual_rms * fit.residual_rms;
      if (!result_.diagnostics.fits.empty()) {
        line.standard_uncertainty =
            std::sqrt(residual / static_cast<double>(result_.diagnostics.fits.size()));
      }
    }
    line.contribution = (jacobian_ * covariance * jacobian_.transpose()).diagonal().cwiseMax(0.0).cwiseSqrt();
    line.sensitivity = line.standard_uncertainty > 0.0
                           ? OutputVector(line.contribution / line.standard_uncertainty)
                           : OutputVector(OutputVector::Constant(std::numeric_limits<double>::quiet_NaN()));
    budget_.other_covariance += covariance;
    budget_.lines.push_back(line);
  }

  // A rounding error of its own in every reading.
  void add_resolution(double step) {
    if (!(step > 0.0 && std::isfinite(step))) {
      throw std::invalid_argument("resolution = " + std::to_string(step) + ", it must be above 0");
    }
    BudgetLine line;
    line.input = "resolution of the output";
    line.value = "0";
    line.unit = record_.response_unit;
    line.distribution = "rectangular";
    line.standard_uncertainty = step / std::sqrt(12.0);
    Covariance12 unit = Covariance12::Zero();
    for (const Eigen::Vector4d& share : shares_) {
      for (Eigen::Index j = 0; j < 3; ++j) {
        for (Eigen::Index a = 0; a < 4; ++a) {
          for (Eigen::Index b = 0; b < 4; ++b) unit(position(j, a), position(j, b)) += share(a) * share(b);
        }
      }
    }
    line.sensitivity = (jacobian_ * unit * jacobian_.transpose()).diagonal().cwiseMax(0.0).cwiseSqrt();
    line.contribution = line.sensitivity * line.standard_uncertainty;
    budget_.other_covariance += unit * (line.standard_uncertainty * line.standard_uncertainty);
    budget_.lines.push_back(line);
  }

  // What harmonics 2 and 3 show beyond their own uncertainty. A term K2 a^2 makes a second harmonic of K2/2
  // and an offset error of K2/3; a term K3 a^3 a third harmonic of K3/4 and a sensitivity error of 3 K3/4
  // (metrology.md 1.2).
  void add_nonlinearity() {
    std::array<double, 3> second{}, third{};
    std::array<int, 3> fits{};
    for (const FitDiagnostic& fit : result_.diagnostics.fits) {
      if (fit.harmonics.empty()) continue;
      const auto j = static_cast<std::size_t>(fit.accelerometer);
      ++fits[j];
      for (const Harmonic& harmonic : fit.harmonics) {
        if (harmonic.order != 2 && harmonic.order != 3) continue;
        double excess = 0.0;
        for (const Quantity* q : {&harmonic.sin_amplitude, &harmonic.cos_amplitude}) {
          const double u = std::isfinite(q->standard_uncertainty) ? q->standard_uncertainty : 0.0;
          excess += q->value * q->value - u * u;
        }
        (harmonic.order == 2 ? second : third)[j] += std::max(0.0, excess);
      }
    }
    if (*std::min_element(fits.begin(), fits.end()) == 0) {
      budget_.not_covered.emplace_back(
          "non-linearity of the accelerometer (too few angles for five harmonics)");
      return;
    }
    BudgetLine line;
    line.input = "non-linearity (harmonics 2, 3)";
    line.value = "0";
    line.unit = record_.response_unit;
    line.distribution = "rectangular";
    const Eigen::Matrix3d s = result_.sensitivity_values();
    for (Eigen::Index j = 0; j < 3; ++j) {
      const auto index = static_cast<std::size_t>(j);
      const double h2 = std::sqrt(second[index] / fits[index]), h3 = std::sqrt(third[index] / fits[index]);
      line.standard_uncertainty =
          std::max({line.standard_uncertainty, h2 / std::sqrt(3.0), h3 / std::sqrt(3.0)});
      Eigen::Matrix<double, 12, 1> errors = Eigen::Matrix<double, 12, 1>::Zero();
      // Along the axis of maximum sensitivity, where the accelerometer sees the whole of gravity.
      errors.segment<3>(3 * j) = s.row(j).transpose().normalized() * (3.0 * h3 / std::sqrt(3.0));
      Eigen::Matrix<double, 12, 1> offset = Eigen::Matrix<double, 12, 1>::Zero();
      offset(9 + j) = 2.0 / 3.0 * h2 / std::sqrt(3.0);
      line.contribution += (jacobian_ * errors).cwiseAbs2() + (jacobian_ * offset).cwiseAbs2();
      budget_.other_covariance += errors * errors.transpose() + offset * offset.transpose();
    }
    line.contribution = line.contribution.cwiseSqrt();
    line.sensitivity = line.standard_uncertainty > 0.0
                           ? OutputVector(line.contribution / line.standard_uncertainty)
                           : OutputVector(OutputVector::Zero());
    budget_.lines.push_back(line);
  }

  void add_gravity() {
    BudgetLine line;
    line.input = "g_loc";
    line.unit = "m/s2";
    line.distribution = "normal";
    if (record_.g_loc_known && record_.g_loc.coverage_factor > 0.0) {
      line.value = std::to_string(record_.g_loc.value_mps2);
      line.standard_uncertainty = record_.g_loc.expanded_uncertainty_mps2 / record_.g_loc.coverage_factor;
      budget_.notes.push_back(
          "Results are per g_loc, so g_loc contributes nothing here; sensitivities per m/s2 carry "
          "its relative standard uncertainty besides, angles and offsets do not.");
    } else {
      line.value = "not known";
      line.standard_uncertainty = std::numeric_limits<double>::quiet_NaN();
      budget_.notes.emplace_back("g_loc is not known: results are per g_loc.");
    }
    budget_.lines.push_back(line);
  }

  const RunRecord& record_;
  const CalibrationResult& result_;
  AbcDesign design_;
  OutputJacobian jacobian_;
  std::vector<const DwellRecord*> dwells_;
  std::vector<double> times_;
  std::vector<Eigen::Vector4d> shares_;
  std::map<std::string, OutputVector> signed_;
  Budget budget_;
};

}  // namespace

double Budget::share(const BudgetLine& line, int output) const {
  const double u = combined(output);
  return u > 0.0 ? line.contribution(output) * line.contribution(output) / (u * u) : 0.0;
}

Budget make_budget(const RunRecord& record, const CalibrationResult& result,
                   std::optional<double> resolution) {
  if (!result.sensitivity_matrix || !result.sensitivity_values().allFinite() ||
      !result.offset_values().allFinite()) {
    throw std::invalid_argument(record.source + ": no result, so no budget: " + result.why);
  }
  return BudgetMaker(record, result).make(resolution);
}

}  // namespace abcal
