#pragma once

#include <optional>
#include <string>

#include "app/certificate/certificate.h"
#include "app/certificate/schema_check.h"
#include "app/results/report_data.h"

namespace abcal {

/// Files from which a certificate is made; empty: none.
struct CertificateFiles {
  std::string laboratory;  ///< Laboratory file.
  std::string as_found;    ///< Run of the item before it was adjusted.
  std::string schemas;     ///< Folder with the schemas of the certificate.
};

/// The note where no schemas are given.
inline constexpr const char* kNotValidated =
    "the certificate follows the business rules; --schemas DIR validates it as well";

/// The schemas of the files, if there are any. @throws std::invalid_argument as DccSchema
std::optional<DccSchema> schema_of(const CertificateFiles& files);

/// A certificate for a report of a run: its content and its XML.
struct ReportedCertificate {
  Certificate certificate;
  std::string xml;   ///< As issued, byte for byte; for a draft, made now.
  std::string note;  ///< What was not checked; empty: nothing.
};

/// The certificate of a run: the one that was issued, or else a draft from the laboratory file.
/// @param data   the run; it is copied into the certificate
/// @param draft  make a draft in spite of any problem of the run
/// @param now    for as-found data
/// @throws LaboratoryFileError, CertificateRefused, RunFileError, std::invalid_argument (no laboratory file)
ReportedCertificate certificate_for_report(const ReportData& data, const CertificateFiles& files, bool draft,
                                           Clock::UtcTime now);

}  // namespace abcal
