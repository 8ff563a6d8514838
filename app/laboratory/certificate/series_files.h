#pragma once

#include <filesystem>
#include <vector>

#include "protocol/record/results_file.h"
#include "protocol/record/verify_run.h"

namespace abcal {

/// The run files of the series over temperature that certificates name, in the folder of their run: one check
/// each. Good: its SHA-256 is that of the certificate, or it is not in this folder, which the check states.
std::vector<IntegrityCheck> check_series_files(const std::vector<IssuedCertificate>& certificates,
                                               const std::filesystem::path& folder);

}  // namespace abcal
