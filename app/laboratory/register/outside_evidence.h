#pragma once

#include <optional>
#include <string>
#include <vector>

#include "app/laboratory/register/records.h"

namespace abcal::lab {

/// A certificate as it left the laboratory.
struct NamedCertificate {
  std::string number, run_sha256;
  std::string xml_sha256;  ///< Hash of its bytes, signature included.
};

/// Evidence outside the database of a register. It is independent of later changes of the database.
struct RegisterEvidence {
  std::string name;               ///< The file and the entry in it, for messages.
  std::string register_identity;  ///< Empty: not stated (a certificate of a version before 1.1).
  /// Head that it names. On paper the SHA-256 is cut to its first digits.
  std::optional<AuditHead> head;
  std::optional<NamedCertificate> certificate;  ///< Only for a certificate.
  std::vector<AuditEntry> audit;                ///< Only for a backup: all entries up to the head.
};

/// The evidence of a backup (`abcal lab backup`).
/// @throws RegisterError if the text is not a backup, or its own audit is not whole
RegisterEvidence evidence_of_backup(const std::string& name, const std::string& text);

}  // namespace abcal::lab
