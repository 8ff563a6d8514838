#pragma once

#include <string>
#include <vector>

#include "app/laboratory/register/outside_evidence.h"

namespace abcal {

/// The register that gave a certificate its number, as the certificate names it.
/// @param name  where it is from, for messages
/// @throws std::invalid_argument  XML that is not a certificate of abcal, a draft, or its statement
/// abc_register is damaged; std::runtime_error (no XML)
lab::RegisterEvidence evidence_of_certificate(const std::string& name, const std::string& xml);

/// Evidence outside a register that names entries of it: a backup (JSON), a certificate (XML), a run or its
/// RUN.results (all certificates in it), or the line of a printed certificate as "ENTRY:DIGITS".
/// @throws std::invalid_argument  if it is another file, or has nothing that a register knows;
/// lab::RegisterError (a backup that is not whole), std::runtime_error (no XML), RunFileError
std::vector<lab::RegisterEvidence> read_evidence(const std::string& file);

}  // namespace abcal
