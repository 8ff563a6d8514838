#include "protocol/estimators/shared/voltmeter.h"

#include <cmath>
#include <cstddef>
#include <string_view>

namespace abcal {
namespace {

/// Beginning of a source from the register (`{ from = "RECORD" }`); free text names no single instrument.
constexpr std::string_view kOfRegister = "calibration ";

void add_type_b(Quantity& quantity, double variance) {
  const double before = quantity.standard_uncertainty;
  quantity.type_b = std::sqrt(quantity.type_b.value_or(0.0) * quantity.type_b.value_or(0.0) + variance);
  if (!std::isfinite(before)) return;
  quantity.standard_uncertainty = std::sqrt(before * before + variance);
  if (before > 0.0) quantity.degrees_of_freedom *= std::pow(quantity.standard_uncertainty / before, 4);
}

/// Covariance of |s_j| and O_j, in the order of Covariance9: the angles between outputs do not change.
Covariance9 intrinsic_share(const CalibrationResult& result, const EffectSizes& sizes) {
  Eigen::Matrix<double, 9, 1> by_gain = Eigen::Matrix<double, 9, 1>::Zero();
  Eigen::Matrix<double, 9, 1> by_offset = Eigen::Matrix<double, 9, 1>::Zero();
  for (Eigen::Index j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    by_gain(j) = sizes.voltmeter_gain * result.intrinsic_sensitivity[at].value;
    by_gain(6 + j) = sizes.voltmeter_gain * result.offset[at].value;
    by_offset(6 + j) = sizes.voltmeter_offset * result.intrinsic_sensitivity[at].value;
  }
  return by_gain * by_gain.transpose() + Covariance9(by_offset.cwiseAbs2().asDiagonal());
}

template <class Matrix>
void add_where_present(std::optional<Matrix>& covariance, const Matrix& share) {
  if (covariance) *covariance += share;
}

void add_to_model_equation(const CalibrationResult& result, const EffectSizes& sizes,
                           ModelEquation& equation) {
  for (std::size_t j = 0; j < 3; ++j) {
    Eigen::Vector4d k;
    for (std::size_t order = 0; order < 4; ++order)
      k(static_cast<Eigen::Index>(order)) = equation.k[j][order].value;
    // An order that was not fitted is not known.
    const Eigen::Vector4d change = sizes.voltmeter_gain * k.array().isFinite().select(k, 0.0);
    Eigen::Matrix4d share = change * change.transpose();
    share(0, 0) += std::pow(sizes.voltmeter_offset * result.intrinsic_sensitivity[j].value, 2);
    equation.covariance[j] += share;
    for (std::size_t order = 0; order < 4; ++order) {
      const auto at = static_cast<Eigen::Index>(order);
      if (std::isfinite(k(at))) add_type_b(equation.k[j][order], share(at, at));
    }
  }
}

}  // namespace

Eigen::Matrix<double, 12, 1> effect_of_gain(const Eigen::Matrix3d& s, const Eigen::Vector3d& o,
                                            const EffectSizes& sizes) {
  Eigen::Matrix<double, 12, 1> by_gain;
  by_gain << s.row(0).transpose(), s.row(1).transpose(), s.row(2).transpose(), o;
  return sizes.voltmeter_gain * by_gain;
}

bool share_voltmeter(const EffectSizes& a, const EffectSizes& b) {
  if (!(a.voltmeter_gain > 0.0) || !(b.voltmeter_gain > 0.0)) return false;
  const auto of_a = a.sources.find("voltmeter_gain"), of_b = b.sources.find("voltmeter_gain");
  return of_a != a.sources.end() && of_b != b.sources.end() && of_a->second == of_b->second &&
         of_a->second.starts_with(kOfRegister);
}

VoltmeterShare voltmeter_share(const Eigen::Matrix3d& s, const Eigen::Vector3d& o, const EffectSizes& sizes) {
  const Eigen::Matrix<double, 12, 1> by_gain = effect_of_gain(s, o, sizes);
  VoltmeterShare share;
  share.gain = by_gain * by_gain.transpose();
  share.offset.diagonal().tail<3>() = (sizes.voltmeter_offset * s.rowwise().norm()).cwiseAbs2();
  return share;
}

void add_shared_voltmeters(std::span<const ReadItem> items, Eigen::MatrixXd& covariance) {
  if (items.size() < 2) return;
  const auto effect = [](const ReadItem& item) {
    return effect_of_gain(item.result->sensitivity_values(), item.result->offset_values(), *item.sizes);
  };
  for (std::size_t i = 0; i < items.size(); ++i)
    for (std::size_t k = 0; k < items.size(); ++k)
      if (share_voltmeter(*items[i].sizes, *items[k].sizes))
        covariance.block<12, 12>(12 * static_cast<Eigen::Index>(i), 12 * static_cast<Eigen::Index>(k)) +=
            effect(items[i]) * effect(items[k]).transpose();
}

bool states_voltmeter(const EffectSizes& sizes) {
  return sizes.voltmeter_gain > 0.0 || sizes.voltmeter_offset > 0.0;
}

void add_voltmeter(const EffectSizes& sizes, CalibrationResult& result) {
  if (!states_voltmeter(sizes) || !std::isfinite(result.intrinsic_sensitivity[0].value)) return;
  const Covariance9 intrinsic = intrinsic_share(result, sizes);
  if (result.sensitivity_matrix) {
    const VoltmeterShare share = voltmeter_share(result.sensitivity_values(), result.offset_values(), sizes);
    const Covariance12 both = share.gain + share.offset;
    for (Eigen::Index j = 0; j < 3; ++j) {
      for (Eigen::Index k = 0; k < 3; ++k) {
        add_type_b((*result.sensitivity_matrix)[static_cast<std::size_t>(j)][static_cast<std::size_t>(k)],
                   both(3 * j + k, 3 * j + k));
      }
    }
    add_where_present(result.covariance, both);
    add_where_present(result.covariance_type_b, both);
  }
  for (Eigen::Index j = 0; j < 3; ++j) {
    const auto at = static_cast<std::size_t>(j);
    add_type_b(result.intrinsic_sensitivity[at], intrinsic(j, j));
    add_type_b(result.offset[at], intrinsic(6 + j, 6 + j));
  }
  add_where_present(result.covariance_intrinsic, intrinsic);
  add_where_present(result.covariance_intrinsic_type_b, intrinsic);
  if (result.model_equation) add_to_model_equation(result, sizes, *result.model_equation);
}

}  // namespace abcal
