#include "app/commands/simulate_calibration.h"

#include <nlohmann/json.hpp>

#include "app/commands/study_bar.h"
#include "app/studies/calibration/rank_figures.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"

namespace abcal {

int simulate_calibration(const CalibrationOptions& options, bool json, const std::string& figures) {
  const CalibrationStudy study = with_bar(options, run_calibration_study);
  if (json) {
    print_result("{}\n", calibration_json(study).dump(2));
  } else {
    print_result("{}", calibration_text(study));
  }
  if (!figures.empty())
    for (const std::filesystem::path& path : write_rank_figures(study, figures))
      print_log("wrote {}\n", path.string());
  if (study.interrupted) return kExitInterrupted;
  return study.passed() ? kExitDone : kExitFailed;
}

int simulate_power(const CalibrationOptions& options, bool json) {
  const PowerStudy study = with_bar(options, run_power_study);
  if (json) {
    print_result("{}\n", power_json(study).dump(2));
  } else {
    print_result("{}", power_text(study));
  }
  return study.interrupted ? kExitInterrupted : kExitDone;
}

}  // namespace abcal
