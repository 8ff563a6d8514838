#include "app/commands/simulate_joint.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "app/commands/study_bar.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"

namespace abcal {

int simulate_joint(const JointStudyOptions& options, bool json) {
  const JointStudy study = with_bar(options, run_joint_study);
  if (study.interrupted) {
    print_log("interrupted: the first {} of {} runs\n", study.trials, options.trials);
  }
  const int exit_code = study.interrupted ? kExitInterrupted : kExitDone;
  const auto number = [](double value) {
    return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json(nullptr);
  };
  if (json) {
    nlohmann::ordered_json output{{"schema", "abcal.joint_study/1"},
                                  {"set", "joint"},
                                  {"trials", study.trials},
                                  {"interrupted", study.interrupted},
                                  {"seed", options.seed},
                                  {"noise", options.noise},
                                  {"k", options.k},
                                  {"drift", options.drift},
                                  {"response_scale", options.scale},
                                  {"steps", options.steps},
                                  {"mean_step_unknowns", options.joint.mean_step},
                                  {"failed", study.failed},
                                  {"nonlinearity_fitted", study.nonlinearity_fitted},
                                  {"not_usable_or_doubtful", study.not_usable_or_doubtful},
                                  {"mean_chi2_per_dof", number(study.mean_chi2_per_dof)},
                                  {"mean_iterations", number(study.mean_iterations)}};
    output["outputs"] = nlohmann::ordered_json::array();
    for (const JointStudyOutput& o : study.outputs) {
      output["outputs"].push_back({{"name", o.name},
                                   {"trials", o.trials},
                                   {"coverage", number(o.coverage)},
                                   {"rms_error", number(o.rms_error)},
                                   {"rms_uncertainty", number(o.rms_uncertainty)},
                                   {"ratio", number(o.ratio())},
                                   {"abc_rms_error", number(o.abc_rms_error)}});
    }
    print_result("{}\n", output.dump(2));
    return exit_code;
  }
  print_result("Joint estimator: {} simulated runs of 3 x {} angles, seed {}\n", study.trials, options.steps,
               options.seed);
  print_result(
      "reading noise {:g} R, k2 and k3 {:g}, drift {:g} R, response times {:g}; angles from their standard "
      "uncertainties{}\n\n",
      options.noise, options.k, options.drift, options.scale,
      options.joint.mean_step ? "" : "; the fit omits the mean step errors");
  print_result("{:<8} {:>9} {:>12} {:>16} {:>7} {:>16}\n", "output", "coverage", "rms error",
               "rms uncertainty", "ratio", "plain ABC rms");
  for (const JointStudyOutput& o : study.outputs) {
    if (o.trials == 0) continue;
    print_result("{:<8} {:>9.3f} {:>12.3e} {:>16.3e} {:>7.3f} {:>16}\n", o.name, o.coverage, o.rms_error,
                 o.rms_uncertainty, o.ratio(),
                 std::isfinite(o.abc_rms_error) ? fmt::format("{:.3e}", o.abc_rms_error) : "-");
  }
  print_result(
      "\nmean chi2/dof {:.4f}; {} fits did not converge; non-linearity fitted in {}; {} verdicts other than "
      "usable\n",
      study.mean_chi2_per_dof, study.failed, study.nonlinearity_fitted, study.not_usable_or_doubtful);
  print_result(
      "coverage: share of runs with the truth inside +-1.96 standard uncertainties (nominal 0.95)\n");
  return exit_code;
}

}  // namespace abcal
