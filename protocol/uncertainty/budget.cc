#include "protocol/uncertainty/budget.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <span>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "protocol/estimators/checks/check_poses.h"
#include "protocol/estimators/circle/abc_estimator.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/estimators/shared/voltmeter.h"
#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"
#include "protocol/model/effects.h"
#include "protocol/plan/backlash.h"
#include "protocol/record/stage_record.h"

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

/// Sources of uncertainty that no budget of this program covers.
std::vector<Message> sources_without_a_line(const RunRecord& record, bool resolution_given) {
  static constexpr std::array<Term, 7> kOfEvery{"nutation of the stage's axes beyond its stated wobble",
                                                "stress-induced distortion of the stage",
                                                "temperature and remounting of the accelerometer",
                                                "torque of the mounting screws and pull of the cable",
                                                "self-heating that changes with the orientation",
                                                "magnetic fields",
                                                "vibration rectification"};
  constexpr std::ptrdiff_t kOfTheStage = 2;  // The first of them.
  std::vector<Message> out(kOfEvery.begin() + (has_angles(record) ? 0 : kOfTheStage), kOfEvery.end());
  if (record.g_loc_known && !(record.g_loc.expanded_uncertainty_mps2 > 0.0))
    out.push_back(Message("local gravity in sensitivities per m/s2 (its uncertainty is not given)"));
  if (record.g_loc_known)
    out.push_back(
        Message("height of the item above the point of g_loc (3.1e-07 of g_loc per metre) and its tide "
                "(1.5e-07), in sensitivities per m/s2"));
  for (const EffectSizeKey& size : effect_size_keys()) {
    if (size.get(record.tolerances) > 0.0) continue;
    // A table without angles leaves out the effects of the item that it does not state.
    const bool is_left_out =
        !has_angles(record) && std::ranges::any_of(item_effects(), [&](const ItemEffect& effect) {
          return effect.key == size.key && !effect.in_motion;
        });
    if (is_left_out) out.push_back(Message("{effect} ({key} not given)", size.words, size.key));
    if (!is_left_out && !size.uncovered.empty() && (has_angles(record) || size.section == "item_uncertainty"))
      out.push_back(Message("{effect} ({key} not given)", size.uncovered, size.key));
  }
  if (!resolution_given) out.push_back(Message("resolution of the accelerometer's output (not given)"));
  if (backlash_is_left(record)) out.push_back(kBacklashNotCovered);
  return out;
}

/// g_loc: it contributes to sensitivities per m/s2 and per standard g, not to those per g_loc.
void add_gravity_to(const RunRecord& record, const CalibrationResult& result, Budget& budget) {
  if (!record.g_loc_known || !(record.g_loc.coverage_factor > 0.0)) {
    budget.notes.emplace_back("g_loc is not known: results are per g_loc.");
    return;
  }
  // An uncertainty that is not given is named as not covered.
  if (!(record.g_loc.expanded_uncertainty_mps2 > 0.0)) return;
  const double g = record.g_loc.value_mps2;
  BudgetLine line;
  line.input = Message("{symbol}", "g_loc");
  line.is_local_gravity = true;
  line.value = std::to_string(g);
  line.unit = "m/s2";
  line.distribution = to_string(Shape::kNormal);
  line.standard_uncertainty = record.g_loc.expanded_uncertainty_mps2 / record.g_loc.coverage_factor;
  line.source = record.g_loc.source;
  const std::vector<Quantity> quantities = quantities_of_outputs(result);
  line.contribution_per_mps2.setZero();
  for (int k = 0; k < kStudyOutputs; ++k) {
    if (is_sensitivity(k))
      line.contribution_per_mps2(k) =
          std::abs(quantities[static_cast<std::size_t>(k)].value) / g * line.standard_uncertainty / g;
  }
  budget.notes.emplace_back(
      "g_loc contributes nothing to results per g_loc, to angles and to offsets. Sensitivities per m/s2 and "
      "per standard g carry its relative standard uncertainty, all of them the same error.");
  budget.lines.push_back(std::move(line));
}

/// Fills the contributions per m/s2 and both combined uncertainties.
void combine(const RunRecord& record, Budget& budget) {
  const bool known = record.g_loc_known && record.g_loc.coverage_factor > 0.0;
  OutputVector per_g_loc = OutputVector::Zero(), per_mps2 = OutputVector::Zero();
  for (BudgetLine& line : budget.lines) {
    if (known && !line.is_local_gravity) {
      line.contribution_per_mps2 = line.contribution;
      for (int k = 0; k < kStudyOutputs; ++k)
        if (is_sensitivity(k)) line.contribution_per_mps2(k) /= record.g_loc.value_mps2;
    }
    per_g_loc += line.contribution.cwiseAbs2();
    per_mps2 += line.contribution_per_mps2.cwiseAbs2();
  }
  budget.combined = per_g_loc.cwiseSqrt();
  budget.combined_per_mps2 = per_mps2.cwiseSqrt();
}

/// Names key, source and distribution of a stated size.
void describe_size(const EffectSizes& sizes, std::string_view key, BudgetLine& line) {
  line.key = key;
  line.distribution = to_string(sizes.shape_of(key));
  const auto source = sizes.sources.find(key);
  line.source = source == sizes.sources.end() ? "default" : source->second;
}

/// The degrees of freedom of a result are those of its readings alone: stated values have infinitely many.
void set_degrees(const CalibrationResult& result, BudgetLine& readings) {
  const std::vector<Quantity> quantities = quantities_of_outputs(result);
  for (int k = 0; k < kStudyOutputs; ++k) {
    const Quantity& quantity = quantities[static_cast<std::size_t>(k)];
    if (std::isfinite(quantity.degrees_of_freedom) && quantity.standard_uncertainty > 0.0)
      readings.degrees_of_freedom(k) =
          quantity.degrees_of_freedom * std::pow(readings.contribution(k) / quantity.standard_uncertainty, 4);
  }
}

OutputVector contributions(const OutputJacobian& jacobian, const Covariance12& covariance) {
  return carried_covariance(jacobian, covariance).diagonal().cwiseMax(0.0).cwiseSqrt();
}

/// Adds the contributions of the voltmeter, on which the angles give no information.
/// @return their covariance, of s row by row and O
Covariance12 add_voltmeter_to(const RunRecord& record, const CalibrationResult& result,
                              const OutputJacobian& jacobian, Budget& budget) {
  const EffectSizes& sizes = record.tolerances;
  const VoltmeterShare share = voltmeter_share(result.sensitivity_values(), result.offset_values(), sizes);
  const auto add = [&](Term input, const char* key, double size, const char* unit,
                       const Covariance12& covariance) {
    if (!(size > 0.0)) return;
    BudgetLine line;
    line.input = input;
    line.value = "0";
    line.unit = unit;
    describe_size(sizes, key, line);
    line.standard_uncertainty = size;
    line.contribution = contributions(jacobian, covariance);
    line.sensitivity = line.contribution / size;
    budget.lines.push_back(std::move(line));
  };
  add("gain of the voltmeter", "voltmeter_gain", sizes.voltmeter_gain, "1", share.gain);
  add("offset of the voltmeter", "voltmeter_offset", sizes.voltmeter_offset, "of S", share.offset);
  return share.gain + share.offset;
}

/// The scatter of the readings; without the one standard uncertainty that all of them might have.
BudgetLine readings_line(Message input, const RunRecord& record, const CalibrationResult& result,
                         const OutputVector& contribution) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  BudgetLine line;
  line.input = std::move(input);
  line.value = "measured";
  line.unit = record.response_unit;
  line.distribution = "normal";
  line.type_a = true;
  line.standard_uncertainty = kNone;
  line.contribution = contribution;
  line.sensitivity = OutputVector::Constant(kNone);
  line.source = kThisRun;
  set_degrees(result, line);
  return line;
}

/// Unit in which a budget shows the size of a joint fit's effect, and the size of this unit.
std::pair<std::string, double> shown_size(const EffectShare& share) {
  constexpr double kDegree = std::numbers::pi / 180.0;
  if (share.key == "wobble_urad") return {"urad", 1e-6};
  if (share.key == "alignment_deg" || share.key.empty()) return {"1", 1.0};
  if (share.key.ends_with("_deg")) return {"degree", kDegree};
  return {"of S", 1.0};
}

/// Adds a note on changes during the run that the check poses found, or could have missed. The drifts of the
/// stated sizes have lines of their own: the check poses contribute nothing, and have no line.
void add_check_poses_to(const RunRecord& record, Budget& budget) {
  const std::optional<CheckPoseStudy> study = compared_check_poses(record);
  if (!study) {
    budget.notes.emplace_back(
        "No check poses were compared: a change of the sensitivity late in experiment 3 would pass unseen.");
    return;
  }
  const auto change_of = [](const char* of, const std::array<PoseTrend, 3>& trends) {
    const auto largest = [&](double PoseTrend::*member) {
      double found = 0.0;
      for (const PoseTrend& trend : trends) found = std::max(found, std::abs(trend.*member));
      return found;
    };
    return fmt::format("{} {:.1e} (u = {:.1e}; between two visits {:.1e} is found)", of,
                       largest(&PoseTrend::change), largest(&PoseTrend::standard_uncertainty),
                       largest(&PoseTrend::smallest_found));
  };
  budget.notes.push_back(fmt::format(
      "Check poses, of S, the largest of u, v, w, from the first visit to the last: change of a {}, of an "
      "{}. "
      "{} The stated drifts are in the lines of the drifts, and the check poses contribute nothing besides{}",
      change_of("gain", study->gain), change_of("offset", study->offset),
      study->found.empty() ? "No change was found." : "A CHANGE WAS FOUND (see the verdict).",
      study->found.empty() ? "." : "; what was found is not covered."));
}

/// The budget of a joint fit: the priors of each effect, and the readings with their noise process. The lines
/// of effects already take into account that the readings determine them in part.
Budget joint_budget(const RunRecord& record, const CalibrationResult& result) {
  Budget budget;
  const OutputJacobian jacobian = jacobian_of(result.sensitivity_values());
  Covariance12 readings = *result.covariance;
  for (const EffectShare& share : result.joint->shares) {
    const auto [unit, size] = shown_size(share);
    BudgetLine line;
    line.input = effect_words(share.effect);
    line.key = share.key;
    if (share.unknowns > 1) line.input = Message("{input}, {unknowns} unknowns", line.input, share.unknowns);
    line.value = "estimated";
    line.unit = unit;
    describe_size(record.tolerances, share.key, line);
    if (is_measured(record.measured_alignment, share.effect)) {
      line.source = "measured";
      line.distribution = to_string(Shape::kNormal);
    }
    // No key of the bench file states what the record does.
    if (result.stage_record && share.key.empty()) line.source = kStageRecordSource;
    line.standard_uncertainty = share.prior_sd / size;
    line.contribution = contributions(jacobian, share.covariance);
    line.sensitivity = line.contribution / line.standard_uncertainty;
    readings -= share.covariance;
    budget.lines.push_back(std::move(line));
  }
  readings -= add_voltmeter_to(record, result, jacobian, budget);
  budget.lines.push_back(readings_line(Message("readings (noise, and its process from angle to angle)"),
                                       record, result, contributions(jacobian, readings)));
  add_check_poses_to(record, budget);
  add_gravity_to(record, result, budget);
  combine(record, budget);
  budget.covariance = carried_covariance(jacobian, *result.covariance);
  budget.not_covered = sources_without_a_line(record, false);
  return budget;
}

using Variances9 = Eigen::Matrix<double, 9, 1>;

/// Variances of the matrix of a norm fit, row by row; NaN where it has no matrix.
Variances9 variances_of_matrix(const std::optional<Covariance12>& covariance) {
  if (!covariance) return Variances9::Constant(std::numeric_limits<double>::quiet_NaN());
  return covariance->diagonal().head<9>();
}

/// From variances of s_u, s_v, s_w, phi_uv, phi_vw, phi_wu, O_u, O_v, O_w, and of the matrix row by row.
OutputVector norm_contributions(const Variances9& variance, const Variances9& of_matrix) {
  OutputVector out;
  out.head<9>() = of_matrix.unaryExpr([](double v) { return v < 0.0 ? 0.0 : std::sqrt(v); });
  const Eigen::Matrix<double, 9, 1> u = variance.cwiseMax(0.0).cwiseSqrt();
  out.segment<3>(kFirstIntrinsicSensitivity) = u.head<3>();
  out.segment<3>(kFirstIntrinsicAngle) = u.segment<3>(3);
  out.segment<3>(kFirstOffset) = u.tail<3>();
  return out;
}

/// The budget of a norm fit: the stated sizes of each effect, the voltmeter, and the poses.
Budget norm_budget(const RunRecord& record, const CalibrationResult& result) {
  Budget budget;
  Variances9 voltmeter = (*result.covariance_intrinsic - *result.covariance_intrinsic_type_a).diagonal();
  Variances9 of_matrix =
      variances_of_matrix(result.covariance) - variances_of_matrix(result.covariance_type_a);
  const auto add = [&](Message input, std::string_view key, double size, const Variances9& variance,
                       const Variances9& variance_of_matrix) {
    BudgetLine line;
    line.input = std::move(input);
    line.value = "estimated";
    line.unit = key.ends_with("_deg") ? "degree" : "of S";
    describe_size(record.tolerances, key, line);
    line.standard_uncertainty = size;
    line.contribution = norm_contributions(variance, variance_of_matrix);
    line.sensitivity = line.contribution / size;
    budget.lines.push_back(std::move(line));
  };
  for (const NormEffectShare& share : result.norm->shares) {
    voltmeter -= share.variance;
    of_matrix -= share.of_matrix;
    if (share.key == kPoseUncertaintyKey) {
      add(Message("stated directions of the poses"), share.key, record.u_up->deg(), share.variance,
          share.of_matrix);
      budget.lines.back().source = "stated";
    }
    for (const EffectSizeKey& size : effect_size_keys())
      if (size.key == share.key)
        add(share.key == "orthogonality_deg" ? Message(size.words) : effect_words(share.effect), share.key,
            size.get(record.tolerances), share.variance, share.of_matrix);
  }
  const double size = std::hypot(record.tolerances.voltmeter_gain, record.tolerances.voltmeter_offset);
  if (size > 0.0)
    add(Message("gain and offset of the voltmeter"), "voltmeter_gain", size, voltmeter, of_matrix);
  budget.lines.push_back(readings_line(Message("readings of the poses"), record, result,
                                       norm_contributions(result.covariance_intrinsic_type_a->diagonal(),
                                                          variances_of_matrix(result.covariance_type_a))));
  add_gravity_to(record, result, budget);
  combine(record, budget);
  budget.not_covered = sources_without_a_line(record, false);
  return budget;
}

class BudgetMaker {
 public:
  BudgetMaker(const RunRecord& record, const CalibrationResult& result)
      : record_(record),
        result_(result),
        design_(AbcDesign::of_record(record)),
        jacobian_(jacobian_of(result.sensitivity_values())) {
    std::array<Eigen::Index, 3> next{};
    for (const DwellRecord& dwell : record.dwells) {
      if (dwell.closing) continue;
      dwells_.push_back(&dwell);
      shares_.push_back(
          design_.share(dwell.experiment, next[static_cast<std::size_t>(dwell.experiment - 1)]++));
    }
  }

  Budget make(std::optional<double> resolution) {
    add_effects();
    budget_.other_covariance += add_voltmeter_to(record_, result_, jacobian_, budget_);
    add_readings();
    if (resolution) add_resolution(*resolution);
    add_check_poses_to(record_, budget_);
    add_gravity_to(record_, result_, budget_);
    combine(record_, budget_);
    split_correction();
    budget_.covariance = budget_.type_b_covariance + carried_covariance(jacobian_, budget_.other_covariance);
    budget_.not_covered = sources_without_a_line(record_, resolution.has_value());
    return budget_;
  }

 private:
  // One line for each kind of effect: error of the ABC result relative to the measurand, as in the result.
  void add_effects() {
    std::map<std::string, BudgetLine> groups;
    std::map<std::string, int> members;
    std::vector<std::string> order;
    for (const OutputEffect& input : type_b_effects(record_)) {
      if (!groups.contains(input.group)) order.push_back(input.group);
      BudgetLine& line = groups[input.group];
      ++members[input.group];
      const OutputVector contribution = jacobian_ * input.change;
      const OutputVector sensitivity = contribution / input.standard_uncertainty;
      line.unit = input.unit;
      line.input = effect_words(input.group);
      describe_size(record_.tolerances, input.key, line);
      line.standard_uncertainty = std::max(line.standard_uncertainty, input.standard_uncertainty);
      line.sensitivity += sensitivity.cwiseAbs2();
      line.contribution += contribution.cwiseAbs2();
      // Monte Carlo draws the inputs of the published protocol; all others are added as normal.
      if (in_published_protocol(input.key)) {
        budget_.type_b_covariance += contribution * contribution.transpose();
        const Eigen::Matrix<double, 12, 1> corrected = input.change - input.published_change;
        published_ += input.published_change * input.published_change.transpose();
        corrected_with_published_ += corrected * input.published_change.transpose();
        corrected_ += corrected * corrected.transpose();
      } else {
        budget_.other_covariance += input.change * input.change.transpose();
      }
      signed_[input.group] = sensitivity;
    }
    for (const std::string& group : order) {
      BudgetLine& line = groups[group];
      line.value = "0";
      // One input alone keeps the sign of its sensitivity.
      line.sensitivity = members[group] == 1 ? signed_[group] : OutputVector(line.sensitivity.cwiseSqrt());
      line.contribution = line.contribution.cwiseSqrt();
      if (group.starts_with("f_")) line.input = Message("{group}(n), {angles} angles", group, members[group]);
      if (group == "drift") line.input = Message("drift over the run, u v w");
      budget_.lines.push_back(line);
    }
  }

  // The correction of the drawn inputs is linear in them, and so are the published errors: regression of one
  // on the other leaves a rest that is independent of them.
  void split_correction() {
    constexpr double kRoundOff = 1e-12;
    const SymmetricEigen eigen = symmetric_eigen(published_);
    const double least = kRoundOff * eigen.values.cwiseAbs().maxCoeff();
    const Eigen::VectorXd inverse =
        eigen.values.unaryExpr([&](double value) { return value > least ? 1.0 / value : 0.0; });
    const Eigen::MatrixXd along = product(corrected_with_published_, eigen.vectors);
    budget_.by_correction = product_transposed(scaled_columns(along, inverse), eigen.vectors);
    budget_.added_covariance = budget_.other_covariance + corrected_ -
                               product_transposed(budget_.by_correction, corrected_with_published_);
  }

  void add_readings() {
    if (!result_.covariance_type_a) {
      budget_.notes.emplace_back("The readings carry no uncertainty and leave no residual: no type A line.");
      return;
    }
    const Covariance12& covariance = *result_.covariance_type_a;
    BudgetLine line = readings_line(Message("readings (noise, fit residual)"), record_, result_,
                                    contributions(jacobian_, covariance));
    // The typical standard uncertainty of a reading; each reading has its own.
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
    if (line.standard_uncertainty > 0.0) line.sensitivity = line.contribution / line.standard_uncertainty;
    budget_.other_covariance += covariance;
    budget_.lines.push_back(line);
  }

  // A rounding error of its own in every reading.
  void add_resolution(double step) {
    if (!(step > 0.0 && std::isfinite(step))) {
      throw std::invalid_argument("resolution = " + std::to_string(step) + ", it must be above 0");
    }
    BudgetLine line;
    line.input = Message("resolution of the output");
    line.value = "0";
    line.unit = record_.response_unit;
    line.distribution = to_string(Shape::kRectangular);
    line.source = "stated";
    line.standard_uncertainty = step / std::sqrt(12.0);
    Covariance12 unit = Covariance12::Zero();
    for (const Eigen::Vector4d& share : shares_) {
      for (Eigen::Index j = 0; j < 3; ++j) {
        for (Eigen::Index a = 0; a < 4; ++a) {
          for (Eigen::Index b = 0; b < 4; ++b) unit(position(j, a), position(j, b)) += share(a) * share(b);
        }
      }
    }
    line.sensitivity = contributions(jacobian_, unit);
    line.contribution = line.sensitivity * line.standard_uncertainty;
    budget_.other_covariance += unit * (line.standard_uncertainty * line.standard_uncertainty);
    budget_.lines.push_back(line);
  }

  const RunRecord& record_;
  const CalibrationResult& result_;
  AbcDesign design_;
  OutputJacobian jacobian_;
  std::vector<const DwellRecord*> dwells_;
  std::vector<Eigen::Vector4d> shares_;
  std::map<std::string, OutputVector> signed_;
  /// Covariances due to the drawn inputs, to first order: by the published equations, by the correction for
  /// k2 and k3, and between both.
  Covariance12 published_ = Covariance12::Zero();
  Covariance12 corrected_ = Covariance12::Zero();
  Covariance12 corrected_with_published_ = Covariance12::Zero();
  Budget budget_;
};

}  // namespace

double Budget::share(const BudgetLine& line, int output) const {
  const double u = combined(output);
  return u > 0.0 ? line.contribution(output) * line.contribution(output) / (u * u) : 0.0;
}

double Budget::share_per_mps2(const BudgetLine& line, int output) const {
  const double u = combined_per_mps2(output);
  if (!(u > 0.0)) return u == 0.0 ? 0.0 : std::numeric_limits<double>::quiet_NaN();
  return std::pow(line.contribution_per_mps2(output) / u, 2);
}

Budget make_budget(const RunRecord& record, const CalibrationResult& result,
                   std::optional<double> resolution) {
  const bool has_numbers = result.sensitivity_matrix ? result.sensitivity_values().allFinite()
                                                     : result.norm && result.covariance_intrinsic_type_a;
  if (!has_numbers || !result.offset_values().allFinite())
    throw std::invalid_argument(record.source + ": no result, so no budget: " + result.why.english());
  if (result.norm) return norm_budget(record, result);
  if (result.joint) return joint_budget(record, result);
  return BudgetMaker(record, result).make(resolution);
}

}  // namespace abcal
