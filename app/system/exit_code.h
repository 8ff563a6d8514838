#pragma once

namespace abcal {

/// Exit codes of the program (a contract, docs/architecture.md).
enum ExitCode : int {
  kExitDone = 0,
  kExitFailed = 1,      ///< The measurement or analysis failed.
  kExitUsage = 2,       ///< Usage or bench file.
  kExitInstrument = 3,  ///< An instrument failed.
  kExitInterrupted = 130,
};

}  // namespace abcal
