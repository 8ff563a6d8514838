#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <stop_token>
#include <string>
#include <vector>

#include "protocol/estimators/joint/analyse_joint.h"

namespace abcal {

/// Distributions of the simulated runs of a study (docs/theory/joint_estimator.md). Responses are in units of
/// 1 per g_loc; `scale` multiplies them afterwards.
struct JointStudyOptions {
  int trials = 2000;
  std::uint64_t seed = 1;
  double noise = 1e-5;           ///< Standard deviation of each reading.
  double k = 1e-3;               ///< Standard deviation of k2, k3; 0: linear accelerometers.
  double drift = 2e-5;           ///< Standard deviation of the drift over the run; 0: none.
  double scale = 1.0;            ///< Response units per R, e.g. 4096 LSB.
  int steps = 72;                ///< N
  double diagonal_sd = 0.1;      ///< s_ux, s_vy, s_wz ~ N(1, this).
  double off_diagonal_sd = 0.1;  ///< The other elements of s and O ~ N(0, this).
  Tolerances tolerances;         ///< Sizes of the errors drawn and of the priors.
  JointOptions joint;            ///< Options of the estimator.
  int threads = 1;               ///< The result does not depend on it.
  std::stop_token stop = {};     ///< Tested between trials; the study then has the trials made so far.
  /// Called now and then, by one thread at a time, with the trials made and planned.
  std::function<void(int, int)> progress = {};
};

/// One output over all trials.
struct JointStudyOutput {
  std::string name;       ///< "s_ux" ... "O_w", "|s_u|", "phi_uv", "k2_u", "zx", ...
  int trials = 0;         ///< Trials in which it was an unknown of the fit.
  double coverage = 0.0;  ///< Share of trials with the truth inside +-1.96 posterior uncertainties.
  double rms_error = 0.0;
  double rms_uncertainty = 0.0;  ///< Root mean square of the posterior one.
  double abc_rms_error = 0.0;    ///< That of plain ABC on the same runs; NaN where ABC has no such output.
  double ratio() const { return rms_error / rms_uncertainty; }
};

struct JointStudy {
  JointStudyOptions options;
  int trials = 0;  ///< Trials made; fewer than planned if interrupted.
  bool interrupted = false;
  int failed = 0;                  ///< Trials whose fit did not converge; not counted in the members below.
  int nonlinearity_fitted = 0;     ///< Trials in which k2, k3 were unknowns.
  int not_usable_or_doubtful = 0;  ///< Trials with a verdict other than usable.
  double mean_chi2_per_dof = 0.0;
  double mean_iterations = 0.0;
  /// s (9), O (3), intrinsic sensitivity (3), intrinsic angle (3, degree): the 18 outputs; then k2 (3), k3
  /// (3), Zx, Zy, Xz, d2, d3, F_X, F_Z (degree), b (3), and "f" (all step errors together, degree).
  std::vector<JointStudyOutput> outputs;

  /// @throws std::out_of_range for an unknown name.
  const JointStudyOutput& output(const std::string& name) const;
};

/// Analyses simulated runs by the joint estimator and by plain ABC. Trial k draws from its own counter-based
/// stream (Philox, key = seed, counter = trial), and the trials are summed in their order, so the result is
/// the same for any number of threads.
/// @throws std::invalid_argument trials < 1, threads < 1, steps < 5, a negative or not finite size
JointStudy run_joint_study(const JointStudyOptions& options);

}  // namespace abcal
