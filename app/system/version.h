#pragma once

namespace abcal {

/// "1.2.0 (1a2b3c4)": version and commit, as written into every run and report.
const char* program_version();

}  // namespace abcal
