#pragma once

#include "protocol/estimators/joint/joint_study.h"

namespace abcal {

/// `abcal simulate joint`: many simulated runs through the joint estimator and through plain ABC; coverage,
/// errors and stated uncertainties of every output, as text or JSON (schema abcal.joint_study/1). Returns the
/// exit code.
int simulate_joint(const JointStudyOptions& options, bool json);

}  // namespace abcal
