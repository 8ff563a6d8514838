#pragma once

#include <Eigen/Core>
#include <array>
#include <limits>
#include <optional>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/quantities/output_names.h"
#include "protocol/record/run_record.h"

namespace abcal {

/// The nine properties that do not depend on mounting, in the order of Covariance9. NaN: not given.
using IntrinsicValues = Eigen::Matrix<double, 9, 1>;

/// One of the nine properties of a result. @param i  0..8, in the order of Covariance9
const Quantity& intrinsic_property(const CalibrationResult& result, Eigen::Index i);

IntrinsicValues intrinsic_values(const CalibrationResult& result);

/// One property in two results (ISO 13528; ISO/IEC 17043).
struct PropertyDifference {
  double difference = std::numeric_limits<double>::quiet_NaN();            ///< Second minus first.
  double standard_uncertainty = std::numeric_limits<double>::quiet_NaN();  ///< That of the difference.
  double zeta = std::numeric_limits<double>::quiet_NaN();  ///< difference / u; |zeta| <= 2 agrees.
  /// difference / U with U = 2 u; |E_n| <= 1 agrees. Both results' uncertainties are taken at k = 2, so that
  /// E_n is zeta / 2.
  double e_n = std::numeric_limits<double>::quiet_NaN();
};

/// Results disagree if differences as large have a smaller probability than this: that of one |E_n| above 1
/// by chance (both uncertainties normal, k = 2).
inline constexpr double kAgreementLevel = 0.0455;

struct IntrinsicComparison {
  std::array<PropertyDifference, 9> properties;  ///< NaN where either result does not give the property.
  std::optional<double> chi2;                    ///< All differences together, with their covariances.
  int degrees_of_freedom = 0;                    ///< Properties compared.
  std::optional<double> chi2_probability;        ///< P(chi2 >= found) if the two agree.
  double largest_e_n = 0.0;                      ///< Largest |E_n|.
  /// Probability of differences as large or larger, all properties together, if the two agree:
  /// chi2_probability; where the covariances allow no chi2, that of the largest |E_n| among this number of
  /// them (Bonferroni, at most 1). The verdict follows it, and no single E_n.
  double joint_probability = 0.0;

  bool agrees() const { return degrees_of_freedom > 0 && joint_probability >= kAgreementLevel; }
  /// How many of the compared properties have an |E_n| above 1 by chance, on average.
  double expected_beyond() const { return kAgreementLevel * degrees_of_freedom; }
};

/// @param covariance_1, covariance_2  rows and columns of a property that is not given are not read
/// @param shared  covariance between the two results (1 in rows, 2 in columns) where they have errors in
///                common; zero if they are independent
/// @throws std::invalid_argument an uncertainty of a given property that is not above 0, or a shared part
///         that leaves no uncertainty of a difference
IntrinsicComparison compare_intrinsic(const IntrinsicValues& first, const Covariance9& covariance_1,
                                      const IntrinsicValues& second, const Covariance9& covariance_2,
                                      const Covariance9& shared = Covariance9::Zero());

/// The numbers of analyse_abc(): its line response, or those of the paper's own formula (PublishedResult).
enum class AbcFormula { kLineResponse, kPublished };

/// Covariance between the twelve outputs of analyse_abc() of two records measured on the same stage: its
/// alignment, zeros and initial turns are taken to be the same both times, and its step errors if both runs
/// have the same angles (record 1 in rows, 2 in columns; each in its own units). Effects of the item, such as
/// drift, are independent.
/// @param formula  kPublished: of PublishedResult, to whose uncertainty fewer effects belong
/// @throws std::invalid_argument as type_b_effects()
Covariance12 shared_type_b(const RunRecord& first, const RunRecord& second,
                           AbcFormula formula = AbcFormula::kLineResponse);

/// Covariance of the nine elements of a sensitivity matrix, row by row.
using MatrixCovariance = Eigen::Matrix<double, 9, 9>;

/// How an accelerometer was turned from one mounting to the next, and what remains of the difference of its
/// two sensitivity matrices.
struct RotationBetween {
  /// T: turns the axes as mounted first into the axes as mounted second, s_2 = T s_1; the rotation that makes
  /// S_2 T most like S_1 (least squares of the elements; Kabsch).
  Eigen::Matrix3d rotation = kUnknown;
  double angle_deg = std::numeric_limits<double>::quiet_NaN();  ///< 0..180
  double angle_standard_uncertainty_deg = std::numeric_limits<double>::quiet_NaN();
  /// Unit vector, right-hand rule. Absent where the angle does not exceed its expanded uncertainty (k = 2):
  /// no axis is known then.
  std::optional<Eigen::Vector3d> axis;
  /// The largest over the directions in which the axis may tilt.
  double axis_standard_uncertainty_deg = std::numeric_limits<double>::quiet_NaN();
  Eigen::Matrix3d residual = kUnknown;  ///< S_2 T - S_1
  Eigen::Matrix3d residual_standard_uncertainty = kUnknown;
  /// The axes u, v, w have the same handedness in both. If not, an axis is reversed or two are swapped, which
  /// lengths and angles between axes need not show; no rotation exists, and all numbers here are NaN.
  bool same_handedness = false;

  inline static const Eigen::Matrix3d kUnknown =
      Eigen::Matrix3d::Constant(std::numeric_limits<double>::quiet_NaN());
};

/// Uncertainties are propagated through the rotation to first order.
/// @param shared  covariance between the elements of the two matrices (1 in rows, 2 in columns)
/// @throws std::invalid_argument a matrix that is not finite or not of full rank
RotationBetween rotation_between(const Eigen::Matrix3d& first, const MatrixCovariance& covariance_1,
                                 const Eigen::Matrix3d& second, const MatrixCovariance& covariance_2,
                                 const MatrixCovariance& shared = MatrixCovariance::Zero());

}  // namespace abcal
