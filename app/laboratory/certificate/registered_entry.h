#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "app/formats/xml_query.h"

namespace abcal {

/// The entry of a register's audit that gave a certificate its number. Named on the certificate, it is
/// evidence outside the register of this entry and of all before it.
struct RegisteredEntry {
  std::string register_identity;  ///< 32 hexadecimal digits.
  std::int64_t entry = 0;         ///< From 1.
  std::string sha256;             ///< Hash of the audit up to this entry, 64 hexadecimal digits.

  /// The first 32 digits, for paper.
  std::string digits_on_paper() const { return sha256.substr(0, 32); }
};

/// As the XML has it, in each language: "register IDENTITY, entry 17, SHA-256 HASH".
std::string reference_of(const RegisteredEntry& registered);

/// The entry that a certificate names; nothing if it names none.
/// @throws std::invalid_argument  if its statement abc_register does not have the form of reference_of()
std::optional<RegisteredEntry> registered_entry_of(const XmlQuery& certificate);

}  // namespace abcal
