#pragma once

#include <Eigen/Core>
#include <array>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/text/message.h"

namespace abcal {

/// A value with its uncertainty and unit. NaN: not determined; a report prints no number for it. An absent
/// part of the uncertainty was not evaluated, which is not the same as zero.
struct Quantity {
  double value = std::numeric_limits<double>::quiet_NaN();
  /// type_a and type_b (those that are present) combined. NaN: none was evaluated.
  double standard_uncertainty = std::numeric_limits<double>::quiet_NaN();
  std::optional<double> type_a;  ///< From the scatter of the readings.
  std::optional<double> type_b;  ///< From other knowledge of stage and instrument, to first order.
  std::string unit;
  /// Effective degrees of freedom of standard_uncertainty; infinite where it rests on stated values.
  double degrees_of_freedom = std::numeric_limits<double>::infinity();
};

/// The probability with which U = k u covers, wherever one is stated: that of two standard uncertainties of a
/// normal distribution, 95.45 %.
inline constexpr double kCoverageProbability = 0.9544997361036416;

/// k for a coverage probability: Student's t for the quantity's degrees of freedom; for 95.45 % it is 2 where
/// they are infinite. NaN below one degree of freedom.
double coverage_factor(const Quantity& quantity, double probability = kCoverageProbability);

/// Whether the numbers may be used. Starts pessimistic.
enum class Verdict {
  kNotUsable,  ///< No result: nothing may be read from the numbers.
  kDoubtful,   ///< Solved, but something contradicts the model or the stated uncertainty.
  kUsable,
};

/// "not_usable", "doubtful", "usable".
std::string_view to_string(Verdict verdict);

/// Order of the twelve outputs: s row by row (s_ux, s_uy, s_uz, s_vx, ... s_wz), then O_u, O_v, O_w.
using Covariance12 = Eigen::Matrix<double, 12, 12>;
/// Order of the nine outputs that do not depend on mounting: s_u, s_v, s_w, phi_uv, phi_vw, phi_wu, O_u, O_v,
/// O_w.
using Covariance9 = Eigen::Matrix<double, 9, 9>;

/// One harmonic of the five-harmonic fit: sin_amplitude sin(order alpha) + cos_amplitude cos(order alpha).
/// Order 0 has only cos_amplitude (the constant).
struct Harmonic {
  int order = 0;
  Quantity sin_amplitude;
  Quantity cos_amplitude;
};

/// One experiment seen by one accelerometer.
struct FitDiagnostic {
  int experiment = 0;               ///< 1, 2, 3
  int accelerometer = 0;            ///< 0, 1, 2 = u, v, w
  Quantity sine, cosine, constant;  ///< A, B, C of the one-harmonic fit (R).
  int angles = 0;                   ///< Readings in the fit.
  int degrees_of_freedom = 0;
  double residual_rms = std::numeric_limits<double>::quiet_NaN();  ///< sqrt(sum of squares / angles), R.
  std::optional<double> chi2;       ///< Absent where the readings carry no uncertainty.
  std::vector<Harmonic> harmonics;  ///< Orders 0..5; empty where the angles cannot determine them.
  double harmonics_residual_rms = std::numeric_limits<double>::quiet_NaN();  ///< R, of the five-harmonic fit.
};

/// One of the 15 combinations that vanish for a perfect stage (A1+B3, A2-A3, B1-B2, C1-C2, C2-C3).
struct Closure {
  std::string name;
  int accelerometer = 0;  ///< 0, 1, 2 = u, v, w
  Quantity value;         ///< R; its uncertainty covers readings (A) and tolerances (B).
};

/// Reading at the closing angle (360 degrees) minus reading at 0 degrees.
struct ClosingDifference {
  int experiment = 0;
  int accelerometer = 0;
  Quantity value;  ///< R
};

/// Dwells that carry one flag.
struct FlagCount {
  std::string flag;  ///< In the words of describe_flags().
  int dwells = 0;
};

/// One test of a run, so that a wrong number is not taken for a right one (docs/measurement.md, "Checks").
struct Check {
  std::string name;  ///< "mounting slip", "full scale", ...
  double found = std::numeric_limits<double>::quiet_NaN();
  double limit = std::numeric_limits<double>::quiet_NaN();  ///< Limit of |found|.
  std::string unit;
  bool passed = true;
  Message words;  ///< The error, its place and its possible causes; empty where it passed.
};

struct Diagnostics {
  std::vector<FitDiagnostic> fits;  ///< 9: experiment by experiment, u v w in each. (norm: empty)
  std::vector<Closure> closures;    ///< 15: u v w for each of the five names. (norm: empty)
  std::vector<ClosingDifference> closing_differences;  ///< Empty where no closing angle was measured.
  std::optional<double> chi2;  ///< From the estimator's own fit; absent without u of the readings.
  int degrees_of_freedom = 0;
  std::optional<double> chi2_probability;  ///< P(chi2 >= found) if the model is right.
  /// P(chi2 <= found) if the model is right and its sizes are the stated ones; where chi2_probability is.
  std::optional<double> low_chi2_probability;
  /// How many times too large the stated sizes are over all, sqrt(degrees of freedom / chi2), where chi2 is
  /// so far below its degrees of freedom that this is said. No uncertainty is made smaller by it.
  std::optional<double> sizes_too_large;
  double reciprocal_condition = 0.0;  ///< Smallest of the (column-scaled) designs of its fits, 0..1.
  int rank = 0;                       ///< Smallest rank of its fits (abc: 3 is full).
  int angles_used = 0;                ///< Dwells in the fit.
  int angles_flagged = 0;
  std::vector<FlagCount> flags;
  std::vector<Check> checks;
  std::vector<Message> notes;  ///< Sentences that a reader should see with the verdict.
};

/// The model equation at zero (IEEE 1293): output j at a specific force a (g_loc) along its own axis is
/// K0 + K1 a + K2 a^2 + K3 a^3. It is not the measurand of the result, which is the line response.
struct ModelEquation {
  std::array<std::array<Quantity, 4>, 3> k;   ///< [output][order]: R, R/g_loc, R/g_loc^2, R/g_loc^3
  std::array<Eigen::Matrix4d, 3> covariance;  ///< Covariance of K0 to K3 of each output.
};

/// An effect that was estimated, and whether its size agrees with the stated one.
struct EffectTest {
  Message name;                ///< "wobble of X", "hysteresis of u"
  std::string key;             ///< Key of its size in the bench file.
  double times_stated = 0.0;   ///< Root mean square of its unknowns over their stated standard uncertainty.
  double chi2 = 0.0;           ///< Estimate against the prediction of the stated size.
  int degrees_of_freedom = 0;  ///< 0: the run does not determine this effect.
  double probability = 1.0;
  bool passed = true;
  bool stated_zero = false;  ///< Left out of the fit: the test is made on the residuals.
  /// The test is whether the readings, in which a noise process was found, are more probable with a size
  /// `times_stated` times as large and less noise. `probability` is then a bound, and there is no chi2.
  bool instead_of_noise = false;
};

/// Contribution of the priors of one effect to the uncertainty of the line response.
struct EffectShare {
  std::string effect;  ///< "wobble of X", "drift", "f_1" (step errors without memory of experiment 1)
  std::string key;     ///< Key of its size in the bench file.
  int unknowns = 0;
  double prior_sd = 0.0;  ///< Prior of one unknown: radian, 1, or relative to S_j.
  Covariance12 covariance = Covariance12::Zero();
};

/// The joint fit against the norm fit of the same readings. No error of the stage affects the norm fit; the
/// nine intrinsic outputs, which both fits give, therefore differ by no more than the effects of the model
/// explain, unless the stage has errors that the model does not have (Hausman's test).
struct NormAgreement {
  bool done = false;  ///< False: the readings alone do not determine the nine outputs (`why_not`).
  Message why_not;
  double statistic = 0.0;  ///< chi2, or F times its degrees of freedom where the noise was estimated.
  int degrees_of_freedom = 0;
  double probability = 1.0;
  double norm_probability = 1.0;  ///< From the norm fit's own chi2, for readings with white noise only.
  /// Sum of the products of successive residuals of the norm fit, less the part caused by the fit itself, in
  /// standard deviations for white noise.
  double norm_autocorrelation = 0.0;
  /// Norm minus joint, and its standard uncertainty if the model is right: s_u, s_v, s_w (R/g_loc), phi_uv,
  /// phi_vw, phi_wu (degree), O_u, O_v, O_w (R).
  Eigen::Matrix<double, 9, 1> difference = Eigen::Matrix<double, 9, 1>::Zero();
  Eigen::Matrix<double, 9, 1> standard_uncertainty = Eigen::Matrix<double, 9, 1>::Zero();
};

/// The response at one rate of a run at a constant rate, relative to rest.
struct RateResponse {
  double rate_deg_per_s = 0.0;
  double frequency_hz = 0.0;          ///< That of gravity at this rate.
  std::array<Quantity, 3> amplitude;  ///< For u, v, w; 1 at rest.
  Quantity phase;                     ///< degree, beyond that of a pure delay; above 0: leading.
};

/// Results that a run at a constant rate gives beside the response at rest (docs/constant_rate.md).
struct MotionResult {
  std::vector<RateResponse> responses;  ///< By rising rate.
  /// Apparent position of each output's element along x, y, z of the platter (mm): from the Z axis, along Z
  /// from the X axis. It absorbs a sensitivity to the square of the rate.
  std::array<std::array<Quantity, 3>, 3> position;
  std::array<Quantity, 2> delay;             ///< That of the item behind the encoders of X and Z (s).
  std::array<Quantity, 3> delay_difference;  ///< For each output, beyond that (s).
  std::array<Quantity, 3> rate_offset;       ///< R at 60 degrees/s.
  Quantity axes_distance;                    ///< mm
};

/// Results that only the joint estimator gives (docs/joint_estimator.md).
struct JointResult {
  std::array<Quantity, 3> alignment;           ///< Zx, Zy, Xz (1)
  std::array<Quantity, 2> initial_turn_error;  ///< d2, d3 (degree)
  /// Errors of the turns to the second face before experiments 1, 2, 3 (degree); only in a run of two faces.
  std::optional<std::array<Quantity, 3>> turn_error_face_2;
  std::array<Quantity, 2> mean_step_error;  ///< F_X, F_Z (degree)
  std::array<std::vector<Quantity>, 3>
      step_error;                    ///< f_i(n) (degree): [i - 1][n - 1]; NaN where not measured.
  std::array<Quantity, 3> drift;     ///< b_j (R over the run)
  std::array<Quantity, 3> k2;        ///< 1/R; unit empty and value NaN where left out of the fit
  std::array<Quantity, 3> k3;        ///< 1/R^2
  bool nonlinearity_fitted = false;  ///< k2 and k3 were unknowns of the fit.
  int iterations = 0;
  std::vector<EffectTest> effects;  ///< Every effect that was an unknown, and those stated as zero.
  /// The stated sizes that the run contradicts, in words. Every result that rests on them is doubtful.
  std::vector<Message> contradicted_sizes;
  std::vector<EffectShare> shares;  ///< Contributions to covariance_type_b.
  /// Noise from angle to angle: probability of a process in addition to the white part (prior: 1/2), its
  /// standard deviation in units of the readings' u, its correlation length in angles.
  double process_probability = 0.0;
  double process_tau = 0.0;
  double process_rho = 0.0;
  NormAgreement norm_against_joint;
  std::optional<MotionResult> motion;    ///< Only of a run at a constant rate.
  std::array<Quantity, 3> drift_at_end;  ///< Offset at the end of the run minus its mean over the run (R).
};

/// The ABC result by the paper's own formula (Geist & Gaitan 2021, Eqs. 5 to 10), without the correction for
/// k2 and k3: the number that another laboratory's ABC result is compared with. It is not the line response:
/// a non-linearity enters it as three circles see it. type_a: the readings; type_b: alignment, turns, zeros
/// and step errors of the stage, to first order, as in the paper. No other effect is in its uncertainty.
struct PublishedResult {
  std::array<std::array<Quantity, 3>, 3> sensitivity_matrix;  ///< As in CalibrationResult.
  std::array<Quantity, 3> offset;
  std::array<Quantity, 3> intrinsic_sensitivity;
  std::array<Quantity, 3> intrinsic_angle;
  Covariance12 covariance = Covariance12::Zero();          ///< Type A, where it is known, and type B.
  Covariance9 covariance_intrinsic = Covariance9::Zero();  ///< Likewise; phi in degrees.
};

/// A line response: rows u v w of the sensitivity matrix, and the offset.
struct LineResult {
  std::array<std::array<Quantity, 3>, 3> sensitivity_matrix;  ///< As in CalibrationResult.
  std::array<Quantity, 3> offset;
};

/// The ABC result of each of two faces, from its own angles (docs/measurement.md, "Two faces").
struct FaceResults {
  std::array<LineResult, 2> face;
  LineResult difference;  ///< Face 1 minus face 2; zero for a perfect stage.
};

/// The record of the stage that a joint result rests on, and its test by the run.
struct StageRecordUse {
  std::string stage;        ///< "Newport XPS-D, serial number 17"
  std::string learned_utc;  ///< Time of its last learning.
  int runs = 0;             ///< That taught it.
  double age_months = 0.0;  ///< At the time of the run.
  double validity_months = 0.0;
  std::string sha256;             ///< Hash of its file.
  std::vector<EffectTest> tests;  ///< Part by part.
  bool agrees = true;
};

/// How far one result is from another: of the nine outputs that do not depend on the mounting, the one that
/// differs most.
struct Apart {
  std::string estimator;  ///< The estimator of the one result.
  double in_u = 0.0;      ///< In the root of the sum of both squared standard uncertainties.
  std::string output;     ///< "O_v"
};

/// One run of a series of mountings (docs/theory/series.md).
struct SeriesMember {
  std::string source;                      ///< File of the run.
  Message mounting;                        ///< "as in the first run", "turned by 90 degrees about X".
  std::array<double, 3> small_turn_deg{};  ///< Further turn about x, y, z of the platter.
  Verdict verdict = Verdict::kNotUsable;   ///< Verdict on the run alone.
  std::vector<Apart> alone;                ///< Results of this run alone, against that of all runs.
};

/// Variances that the stated size of one effect adds to s_u, s_v, s_w, phi_uv, phi_vw, phi_wu, O_u, O_v, O_w.
struct NormEffectShare {
  std::string effect;  ///< "k3", "the angles between the axes"
  std::string key;     ///< Key of its size in the bench file.
  Eigen::Matrix<double, 9, 1> variance =
      Eigen::Matrix<double, 9, 1>::Zero();  ///< Squares of R/g_loc, degree, R.
  /// Variances that it adds to the matrix, row by row; NaN where the result has no matrix.
  Eigen::Matrix<double, 9, 1> of_matrix =
      Eigen::Matrix<double, 9, 1>::Constant(std::numeric_limits<double>::quiet_NaN());
};

/// Key of the stated standard uncertainty of the directions of poses.
inline constexpr std::string_view kPoseUncertaintyKey = "pose_uncertainty_deg";

/// Results that only the norm estimator gives.
struct NormResult {
  int poses = 0;  ///< Poses used.
  int poses_left_out = 0;
  /// The poses left out: their number among the poses given (from 1), and |a|/g_loc - 1.
  std::vector<std::pair<int, double>> left_out;
  double norm_rms = std::numeric_limits<double>::quiet_NaN();  ///< rms of |a|/g_loc - 1.
  /// rms of the stated directions about an axis across them; absent: none are stated.
  std::optional<double> direction_rms_deg{};
  double sphere_coverage = 0.0;         ///< 0..1: how well the poses cover the sphere.
  Message coverage_words;               ///< The largest gap in the coverage, in words; empty if small.
  std::vector<NormEffectShare> shares;  ///< The part of the variances that is of type B.
};

/// The result of one estimator on one run. The default is not usable.
struct CalibrationResult {
  std::string estimator;  ///< "abc", "joint", "norm"
  Verdict verdict = Verdict::kNotUsable;
  Message why{"not analysed"};  ///< One sentence: the reason for the verdict.
  std::string source;           ///< The record it came from.
  std::string response_unit = "R";
  Quantity g_loc;  ///< m/s2; NaN: not known, sensitivities are per g_loc.
  std::string g_loc_source;

  /// R/g_loc, rows u v w, columns x y z of the LGCS at the default orientation; for norm of the mount. Absent
  /// where the directions of its poses are not stated.
  std::optional<std::array<std::array<Quantity, 3>, 3>> sensitivity_matrix;
  std::array<Quantity, 3> offset;                 ///< R
  std::array<Quantity, 3> intrinsic_sensitivity;  ///< R/g_loc
  std::array<Quantity, 3> intrinsic_angle;        ///< uv, vw, wu (degree)

  std::optional<Covariance12> covariance;  ///< Combined (A and B), R^2 (s in R/g_loc).
  std::optional<Covariance12> covariance_type_a;
  std::optional<Covariance12> covariance_type_b;
  std::optional<Covariance9> covariance_intrinsic;  ///< Combined; phi in degrees.
  std::optional<Covariance9> covariance_intrinsic_type_a;
  std::optional<Covariance9> covariance_intrinsic_type_b;

  /// Effects in the uncertainties whose size is a default that nobody stated.
  std::vector<Term> unstated_effects;
  Diagnostics diagnostics;
  std::optional<ModelEquation> model_equation;
  std::optional<JointResult> joint;
  std::optional<NormResult> norm;
  std::optional<PublishedResult> published;    ///< Only of the ABC estimator.
  std::optional<FaceResults> faces;            ///< Only of the ABC estimator, for a run of two faces.
  std::optional<StageRecordUse> stage_record;  ///< Only of the joint estimator, with a record of the stage.
  std::vector<SeriesMember> series;            ///< Runs of one fit; empty: this is the result of one run.

  /// The values of sensitivity_matrix as numbers; NaN where there is none.
  Eigen::Matrix3d sensitivity_values() const;
  Eigen::Vector3d offset_values() const;
};

}  // namespace abcal
