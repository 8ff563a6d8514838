#pragma once

#include <CLI/CLI.hpp>
#include <optional>
#include <string>

#include "app/certificate/certificate.h"
#include "app/certificate/schema_check.h"
#include "app/report/report_data.h"

namespace abcal {

/// Options of commands that make a certificate.
struct CertificateOptions {
  std::string laboratory;  ///< Laboratory file.
  std::string as_found;    ///< Run of the item before it was adjusted.
  std::string schemas;     ///< Folder with the schemas of the certificate.
};

/// Adds --laboratory, --as-found and --schemas.
void add_certificate_options(CLI::App& command, CertificateOptions& options);

/// The schemas, where they are asked for; else a word on standard error that nothing was checked against
/// them.
std::optional<DccSchema> schema_for(const CertificateOptions& options);

/// A certificate for a report of a run: its content and its XML.
struct ReportedCertificate {
  Certificate certificate;
  std::string xml;  ///< As it was issued, byte for byte; of a draft, made now.
};

/// The certificate of a run: the one that was issued, or else a draft from the laboratory file.
/// @param data   the run; it is copied into the certificate
/// @param draft  make a draft whatever speaks against the run
/// @param now    for as-found data
/// @throws LaboratoryFileError, CertificateRefused, RunFileError, std::invalid_argument (no laboratory file)
ReportedCertificate certificate_for_report(const ReportData& data, const CertificateOptions& options,
                                           bool draft, Clock::UtcTime now);

}  // namespace abcal
