#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "app/laboratory/register/register.h"
#include "protocol/record/attestation.h"
#include "protocol/record/verify_run.h"

namespace abcal {

/// Integrity of a closed run and of its certificates, and the evidence for it.
struct RunEvidence {
  std::vector<IntegrityCheck> checks;
  bool is_signed = false;     ///< A trusted key has signed the end of the run.
  bool is_stamped = false;    ///< A trusted authority has stamped its time.
  bool is_witnessed = false;  ///< A trusted key has signed each angle while the run was measured.
  bool is_simulated = false;  ///< Its witness has signed that its time is simulated.
  std::string witness;        ///< Owner of the key of the witness; empty: none is trusted.
  std::size_t angles = 0;     ///< Number of angles of a run with a witness.
  std::string witness_words;  ///< Which angles are witnessed, in words.
  std::string words;          ///< One sentence: the facts that are attested, and those that are not.

  bool is_good() const;
};

/// Name of the check that fails for a run without the witness that a register requires.
inline constexpr const char* kWitnessRequired = "witness required";

/// Why a run does not have the witness that a register requires; empty if it has one, or if the register
/// holds no key of a bench. A training register accepts a run whose witness states that its time is
/// simulated.
std::string missing_witness(const RunEvidence& evidence, lab::Register& opened);

/// The keys of the benches of a register.
std::vector<TrustedKey> bench_keys(lab::Register& opened);

/// Judges a run: `abcal verify` shows the result, and no certificate is issued for a run that is not good.
/// @param opened  null: no register, whose certificates and audit are then not compared
/// @throws RunFileError, lab::RegisterError, ProgramMissing, RunInterrupted
RunEvidence judge_run(const std::filesystem::path& run, const Trust& trust, lab::Register* opened);

/// Judges a measurement: its files, each of its runs as judge_run() does, and its stored analyses. It is
/// signed, stamped or witnessed if each run is.
RunEvidence judge_measurement(const std::filesystem::path& measurement, const Trust& trust,
                              lab::Register* opened);

}  // namespace abcal
