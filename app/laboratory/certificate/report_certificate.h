#pragma once

#include <optional>
#include <string>
#include <vector>

#include "app/laboratory/certificate/certificate.h"
#include "app/laboratory/certificate/schema_check.h"
#include "app/results/analysis/report_data.h"

namespace abcal {

/// Files from which a certificate is made; empty: none.
struct CertificateFiles {
  std::string laboratory;  ///< Laboratory file.
  std::string as_found;    ///< Run of the item before it was adjusted; with several items, that of the same
                           ///< item.
  std::vector<std::string> temperature;  ///< Runs of the points of a series over temperature.
  std::string schemas;                   ///< Folder with schemas to be used instead of the program's.
  std::string language;                  ///< Instead of the laboratory file's.
};

/// The schemas that every certificate is checked with: those of the files, or else those of the program.
/// @throws std::invalid_argument as DccSchema
DccSchema schema_of(const CertificateFiles& files);

/// Reads another run of an item. If it has several items, takes the one with the maker, model and serial
/// number of `of`.
/// @param option  command-line option that names the run, for messages
/// @throws as gather_report(); std::invalid_argument if none of several is this item
ReportData gather_same_item(const char* option, const std::filesystem::path& path, const ReportData& of,
                            Clock::UtcTime now);

/// Reads the runs of an item in a series over temperature. @throws as gather_same_item()
std::vector<ReportData> gather_series(const std::vector<std::string>& paths, const ReportData& of,
                                      Clock::UtcTime now);

/// Reads the runs of a measurement, for the item that it is of; none, if it is one run.
std::vector<ReportData> gather_runs(const ReportData& data, Clock::UtcTime now);
/// Reads those of both results of a certificate.
void gather_runs(CertificateRequest& request, Clock::UtcTime now);

/// The XML of a run's certificate: of the one that was issued, byte for byte, or else of a draft from the
/// laboratory file.
/// @param data   the run; it is copied into the certificate
/// @param draft  make a draft in spite of any problem of the run
/// @param now    for as-found data
/// @throws LaboratoryFileError, CertificateRefused, RunFileError, std::invalid_argument (no laboratory file)
std::string certificate_for_report(const ReportData& data, const CertificateFiles& files, bool draft,
                                   Clock::UtcTime now);

}  // namespace abcal
