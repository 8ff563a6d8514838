#pragma once

#include <string>
#include <vector>

#include "app/laboratory/register/register.h"
#include "protocol/record/verify_run.h"

namespace abcal {

/// Findings about a certificate that is there as a file alone, without its run.
struct CertificateEvidence {
  std::string number;
  std::string status;  ///< "valid", "amended", "withdrawn", "not issued", "not known"; empty: no register.
  std::vector<IntegrityCheck> checks;
  std::string words;  ///< One sentence.

  bool is_good() const;
};

/// Checks the signature of a certificate, whether the register issued exactly this file, and whether it still
/// holds. One that was amended or withdrawn, or rests on a record that was withdrawn, is not good.
/// @param opened  null: no register, so that its status is not known
/// @throws std::invalid_argument (no certificate of abcal, a draft), std::runtime_error (no XML),
/// lab::RegisterError, ProgramMissing, RunInterrupted
CertificateEvidence judge_certificate(const std::string& name, const std::string& xml, lab::Register* opened);

}  // namespace abcal
