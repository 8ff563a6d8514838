#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "app/laboratory/certificate/certificate.h"
#include "app/laboratory/certificate/schema_check.h"
#include "app/laboratory/certificate/sign.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// The XML of a certificate, checked by the business rules and by the schema.
/// @param schema  null: checked by the rules only, for tests
/// @throws CertificateRefused  with every violation: nothing is written then
std::string checked_xml(const Certificate& certificate, const DccSchema* schema);

/// The objections of the business rules and of the schema to a document.
std::vector<Problem> problems_of_xml(const XmlDocument& document, const DccSchema* schema);

/// A certificate whose XML is made and checked, but not yet stored.
struct PreparedCertificate {
  IssuedCertificate issued;  ///< Without a signature, and without the time of issue.
  std::filesystem::path run;
  std::string run_sha256;
};

/// @throws as checked_xml(), std::logic_error for a draft
PreparedCertificate prepare_certificate(const Certificate& certificate, const DccSchema* schema);

/// Keeps a certificate in RUN.results as issue_certificate() does.
/// @param signed_xml  its XML with a signature; empty: it is not signed
/// @throws as issue_certificate()
IssuedCertificate keep_certificate(PreparedCertificate prepared, std::string signed_xml,
                                   const DccSchema* schema, const std::string& utc);

/// Issues a certificate: its XML, signed if a key is given, is kept in RUN.results, where it can be neither
/// changed nor removed unnoticed. From then on every report of the run carries it unchanged.
/// @param certificate  with its issue facts
/// @throws CertificateRefused, RunFileError (number given already, run replaced already),
/// std::invalid_argument
///         (key)
IssuedCertificate issue_certificate(const Certificate& certificate, const DccSchema* schema,
                                    const std::optional<SigningKey>& key, const std::string& utc);

/// The certificate that holds for an item of a run (from 1): the last that was issued.
std::optional<IssuedCertificate> current_certificate(const std::filesystem::path& run, int item);

}  // namespace abcal
