#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_operator.h"

namespace abcal {

/// The register's answer before a run begins. Nothing is asked while the run measures: losing the register
/// neither stops nor delays it.
struct RegisteredStart {
  RunOperator who;
  std::string calibrations_json;  ///< Calibrations of equipment in use that hold today; empty: no register.
};

/// A complete run.
struct EndedRun {
  const std::filesystem::path& path;
  const std::string& sha256;  ///< SHA-256 of the closed file; empty: it is closed later.
  const StoredRun& stored;
};

/// The questions that a run asks of the laboratory's register. The register's side is laboratory_link() of
/// app/laboratory; a run that has no link states the operator of its bench file and has no check standards.
struct LaboratoryLink {
  /// Called before the first move; see find_operator().
  std::function<RegisteredStart(const std::string& stated, Clock::UtcTime now, const std::string& login)>
      find_operator;
  /// Called with every complete run; see check_run_notices().
  std::function<std::vector<std::string>(const EndedRun& run, const std::string& login)> check_run_notices;
};

}  // namespace abcal
