#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "protocol/record/results_file.h"
#include "protocol/record/verify_run.h"

namespace abcal {

/// A key that is known to be a person's: its fingerprint, and whose it is.
struct PersonKey {
  std::string fingerprint, owner;
};

/// Checks the signatures of a run's certificates: one check for each signed certificate. Good: it verifies,
/// and if keys of the approver are known, it was made by one of these.
/// @throws ProgramMissing, RunInterrupted
std::vector<IntegrityCheck> check_certificate_signatures(const std::vector<IssuedCertificate>& certificates,
                                                         const std::vector<PersonKey>& keys);

/// The X.509 certificate (PEM) of a signature that was made elsewhere: `signed_xml` is `xml`, byte for byte,
/// with a signature of the whole document at its end that verifies with this certificate. The caller must
/// identify its owner.
/// @throws std::invalid_argument  if it is anything else; ProgramMissing, RunInterrupted
std::string certificate_of_signature(const std::string& xml, const std::string& signed_xml);

/// A printed certificate against the run's: its detached signature (FILE.p7s) verifies by a key as above, and
/// the XML inside is that of the current certificate.
/// @throws ProgramMissing, RunInterrupted, std::invalid_argument (the files cannot be read)
std::vector<IntegrityCheck> check_printed_certificate(const std::filesystem::path& pdf,
                                                      const std::vector<IssuedCertificate>& certificates,
                                                      const std::vector<PersonKey>& keys);

/// Path of the detached signature of a file.
std::filesystem::path signature_path_of(const std::filesystem::path& file);

}  // namespace abcal
