#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "protocol/record/attestation.h"
#include "protocol/record/verify_run.h"

namespace abcal {

/// The statements of the witness about a run (docs/witness.md), compared with the run.
struct WitnessCheck {
  /// Statements that contradict the run or that no trusted key has signed; one good check where there are
  /// none. None where the run has no statements.
  std::vector<IntegrityCheck> checks;
  /// A trusted key has signed the beginning, every angle in order at a plausible time, and the end.
  bool is_witnessed = false;
  bool is_signed = false;     ///< A trusted key has signed the end of the run; nothing contradicts it.
  bool is_simulated = false;  ///< The run was begun as one with simulated time.
  std::string signer;         ///< Owner of the key of the statements; empty: none is trusted.
  std::size_t angles = 0;     ///< Number of angles of the run.
  std::string words;          ///< One sentence: which angles are witnessed and which are not.
};

/// Least time between the signatures of two angles, as a part of the time that their readings take.
inline constexpr double kLeastWitnessedTime = 0.8;

/// Compares the statements of the witness about a run with its links.
/// @param trust  keys of benches; none: the signatures are not checked, and nothing is witnessed
/// @throws RunFileError if the file is not a run file
WitnessCheck check_witness(const std::filesystem::path& run, const Trust& trust);

}  // namespace abcal
