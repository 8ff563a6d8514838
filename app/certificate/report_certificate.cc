#include "app/certificate/report_certificate.h"

#include <fmt/format.h>

#include <algorithm>

#include "app/certificate/issue.h"

namespace abcal {
namespace {

void require_consistent(const ReportData& data) {
  std::vector<Problem> problems;
  for (const IntegrityCheck& check : data.integrity)
    if (!check.good) problems.push_back({check.what, check.found, "consistent with what was stored"});
  if (!problems.empty()) throw CertificateRefused(data.path.string(), std::move(problems));
}

/// The page of a certificate must not show a calibration that its XML does not contain.
void require_issued_with(const IssuedCertificate& issued, const ReportData& as_found) {
  if (as_found.sha256 && issued.xml.find(*as_found.sha256) != std::string::npos) return;
  throw CertificateRefused(
      issued.number,
      {{"--as-found", as_found.path.string() + ", whose results are not part of this certificate",
        "the as-found run of the certificate"}});
}

bool has_as_found(const IssuedCertificate& issued) {
  return issued.xml.find("<dcc:status>beforeAdjustment<") != std::string::npos;
}

/// The certificate as it was issued, made again from the data kept with it.
Certificate restored(const IssuedCertificate& issued, const ReportData& data,
                     std::optional<ReportData> as_found) {
  CertificateRequest request;
  request.laboratory =
      parse_laboratory_file(issued.laboratory_toml, "as kept with certificate " + issued.number);
  request.run = data;
  const bool only_as_left = !as_found && has_as_found(issued);
  request.as_found = std::move(as_found);
  IssueFacts& facts = request.issue.emplace();
  facts.number = issued.number;
  facts.approved_by = issued.approved_by;
  facts.date = parse_date(issued.date).value_or(Date{});
  facts.training = issued.xml.find("refType=\"abc_training\"") != std::string::npos;
  if (!issued.replaces.empty()) facts.replaces = Replacement{issued.replaces, issued.reason, {}};
  request.draft = true;  // It is issued already: new findings are reservations and refuse nothing.
  Certificate certificate = make_certificate(std::move(request));
  if (only_as_left)
    certificate.reservations.emplace_back(
        "Incomplete: the certificate also contains the calibration before adjustment; --as-found RUN shows "
        "it");
  if (issued.program_version != certificate.program_version) {
    certificate.reservations.push_back(
        fmt::format("Recomputed: the certificate was issued by abcal {}; the numbers on this page were "
                    "computed by abcal {}",
                    issued.program_version, certificate.program_version));
  }
  return certificate;
}

}  // namespace

std::optional<DccSchema> schema_of(const CertificateFiles& files) {
  if (files.schemas.empty()) return std::nullopt;
  return DccSchema(files.schemas);
}

ReportedCertificate certificate_for_report(const ReportData& data, const CertificateFiles& files, bool draft,
                                           Clock::UtcTime now) {
  std::optional<ReportData> as_found;
  if (!files.as_found.empty()) as_found = gather_report(files.as_found, now);
  if (data.run && !draft) {
    if (const auto issued = current_certificate(data.path)) {
      require_consistent(data);
      if (as_found) require_issued_with(*issued, *as_found);
      ReportedCertificate reported{restored(*issued, data, std::move(as_found)), issued->xml, {}};
      if (!files.schemas.empty()) {
        std::vector<Problem> problems;
        for (const DccProblem& problem :
             DccSchema(files.schemas).check(parse_xml(issued->xml, issued->number)))
          problems.push_back({problem.where, problem.what, "the schema of DCC 3.3.0"});
        if (!problems.empty()) throw CertificateRefused(data.path.string(), std::move(problems));
      }
      return reported;
    }
  }
  if (files.laboratory.empty())
    throw std::invalid_argument(
        "a certificate needs --laboratory LAB.toml (docs/examples/laboratory.toml is one)");
  const std::optional<DccSchema> schema = schema_of(files);
  CertificateRequest request;
  request.laboratory = read_laboratory_file(files.laboratory);
  request.run = data;
  request.as_found = std::move(as_found);
  request.draft = draft;
  Certificate certificate = make_certificate(std::move(request));
  std::string xml = checked_xml(certificate, schema ? &*schema : nullptr);
  return {std::move(certificate), std::move(xml), schema ? "" : kNotValidated};
}

}  // namespace abcal
