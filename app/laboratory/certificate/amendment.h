#pragma once

#include <string>
#include <vector>

namespace abcal {

/// Kinds of amendment, by what they may change.
enum class AmendmentKind {
  kAdministrative,  ///< Customer, laboratory, persons, order; no result and nothing of the item.
  kTechnical,       ///< Anything; every change is listed.
};
/// @throws std::invalid_argument  for another word than "administrative" and "technical"
AmendmentKind amendment_kind_from(const std::string& word);

/// One thing that a certificate says, as its XML has it: a value with unit, U and k, a verdict, a text.
struct CertificateStatement {
  std::string key;   ///< Its place in the XML: the same in another certificate.
  std::string name;  ///< For people: "Sensitivity matrix, row of accelerometer u, s_ux".
  std::string text;  ///< "0.10021 \volt\per...; U = 0.00012; k = 2".
  bool administrative = false;
  bool in_language = false;  ///< A text in the language of the certificate, no name and no number.
  /// The quantity of a number of the results, which several places state in several units: "s_ux". Empty:
  /// none.
  std::string quantity = {};
};

/// Everything that a certificate says, in its order. What differs in every certificate (number, date of
/// issue, entry of the register, the amendment itself, signature) is left out.
/// @throws std::runtime_error  no XML, or no certificate
std::vector<CertificateStatement> statements_in(const std::string& xml, const std::string& source);

/// A statement that differs between two certificates.
struct ChangedStatement {
  std::string name;
  std::string before, after;  ///< Empty: not stated.
  bool administrative = false;

  /// "NAME: BEFORE → AFTER", with long texts cut.
  std::string words() const;
};

/// Every statement of a certificate that differs from those of the certificate that it replaces. Between
/// languages, only what is in no language is compared. A quantity that differs in several places, as one
/// whose uncertainty was raised does in each of its units and in the budget, is one statement.
std::vector<ChangedStatement> changed_statements(const std::string& replaced_xml, const std::string& xml);

}  // namespace abcal
