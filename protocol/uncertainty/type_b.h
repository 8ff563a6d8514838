#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "protocol/model/alignment.h"
#include "protocol/plan/tolerances.h"
#include "protocol/uncertainty/abc_design.h"
#include "protocol/uncertainty/monte_carlo.h"
#include "protocol/uncertainty/study_output.h"

namespace abcal {

/// An accelerometer under test: the platter's matrix before the tilt with Z (docs/theory/model.md).
struct AccelerometerUnderTest {
  Eigen::Matrix3d sensitivity_matrix = Eigen::Matrix3d::Identity();  ///< R/g_loc
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();                  ///< R
};

/// The accelerometer of the paper's Table 2.
AccelerometerUnderTest table_2_accelerometer();

/// How the step errors are drawn.
enum class StepErrorModel {
  kIndependent,  ///< Each f_i(n) ~ N(0, step) (the paper's Set ABC1).
  kHarmonic,  ///< f_i(n) = sum over m = 1..N/2 of D_m sin(m alpha) + E_m cos(m alpha), D, E ~ N(0, step) (Eq.
              ///< 14).
};

/// A type B study: the quantities drawn for every trial.
struct TypeBStudy {
  AbcDesign design = AbcDesign::uniform();
  AccelerometerUnderTest accelerometer;
  /// Above 0: a new accelerometer every trial, every element of s and O drawn with this standard deviation
  /// around `accelerometer` (the paper: 0.1 around the ideal one).
  double accelerometer_spread = 0.0;
  Tolerances tolerances;  ///< drift is not drawn.
  StepErrorModel step_errors = StepErrorModel::kIndependent;
  /// Draws each independent step error: the reference. Else those of an experiment act through their six sums
  /// in the fit, which are drawn, where their tolerance is at most kMostSummedDegrees.
  bool each_step = false;
  std::uint64_t seed = 1;
};

/// Above it (degrees) the cosines of step errors vary by more than 0.15 % of what their sines do.
inline constexpr double kMostSummedDegrees = 0.1;

/// @throws std::invalid_argument for a tolerance that is negative, not finite, or above 4 degrees (step
/// errors of the harmonic model: 0.5 degrees)
void check_tolerances(const Tolerances& tolerances,
                      StepErrorModel step_errors = StepErrorModel::kIndependent);

/// The paper's tolerances: 0.008 degrees for alignment and step; the initial turns and the mean step errors
/// exact.
Tolerances paper_tolerances();

/// Readings (R) of the three experiments with the errors of the calibration system, by the plain forward
/// model of protocol/model: [i - 1] is N x 3, columns u, v, w. The accelerometer tilts with Z.
std::array<Eigen::MatrixX3d, 3> simulated_readings(const AbcDesign& design,
                                                   const AccelerometerUnderTest& accelerometer,
                                                   const AcsErrors& errors);

/// The ABC analysis of such readings (docs/theory/abc_protocol.md).
StudyOutput abc_analysis(const AbcDesign& design, const std::array<Eigen::MatrixX3d, 3>& readings);

/// The true values of the analysis' outputs: those of the tilted matrix at rest.
StudyOutput true_outputs(const AccelerometerUnderTest& accelerometer, const Alignment& alignment);

/// Errors of one simulated calibration: analysis of the simulated readings minus truth. Plain version of
/// TypeBSampler.
StudyOutput abc_errors(const AbcDesign& design, const AccelerometerUnderTest& accelerometer,
                       const AcsErrors& errors);

/// The inputs of one trial of a study as TypeBSampler draws them with `each_step`, one by one, for checks and
/// for examples.
struct TypeBDraw {
  AccelerometerUnderTest accelerometer;
  AcsErrors errors;
};
TypeBDraw type_b_draw(const TypeBStudy& study, std::uint64_t trial);

/// Makes blocks of trials of a study: a whole simulated calibration each, in about a microsecond. Vector code
/// chosen at run time (Highway); one trial per lane and no fused operations, so every processor gives the
/// same bits.
class TypeBSampler {
 public:
  /// @throws std::invalid_argument for a tolerance that is negative, not finite, or above 4 degrees (0.5
  /// degrees for the harmonic model), and for an accelerometer that is not finite or has a row of zeros.
  explicit TypeBSampler(TypeBStudy study);

  /// A TrialBlock: errors (estimate minus truth) of the 18 outputs; angles in degrees.
  void operator()(std::uint64_t first, std::size_t count, double* out) const;

  const TypeBStudy& study() const { return study_; }

  /// Layout shared with the vector code.
  struct Plan {
    std::array<std::uint32_t, 3> angles{};
    // Each experiment: sin alpha, cos alpha, w_A, w_B, w_C of angle n, one after the other.
    std::array<std::vector<double>, 3> table;
    // Each experiment: A, B, C of cos alpha and of sin alpha, without step errors.
    std::array<std::array<double, 6>, 3> nominal{};
    // Harmonic model: sin m alpha(n), cos m alpha(n) for m = 1..N/2, angle by angle.
    std::array<std::vector<double>, 3> spectrum;
    std::array<double, 12> accelerometer{};  // s row by row, O
    /// Each experiment: R of the covariance R R' of the sums of w_A, w_B, w_C times cos alpha sin f, then
    /// times sin alpha sin f, row by row; the mean of cos f. Used if by_sums.
    std::array<std::array<double, 36>, 3> sum_root{};
    double mean_cosine = 1.0;
    bool by_sums = false;
    double spread = 0.0;
    double alignment = 0.0, step = 0.0, turn = 0.0, zero = 0.0;  // 1, rad
    bool harmonic = false;
    std::uint64_t seed = 1;
  };

 private:
  TypeBStudy study_;
  Plan plan_;
};

/// Runs a type B study.
MonteCarloResult run_type_b(const TypeBStudy& study, const MonteCarloOptions& options);

/// Name of the vector instruction set that the sampler uses on this machine ("AVX2", ...).
const char* vector_target();

}  // namespace abcal
