#include "app/laboratory/certificate/issue_certificate.h"

#include <utility>

#include "app/laboratory/certificate/business_rules.h"
#include "app/laboratory/certificate/dcc_xml.h"
#include "app/laboratory/certificate/dsi_list.h"

namespace abcal {
namespace {

void add(std::vector<Problem>& problems, const std::vector<DccProblem>& found, const std::string& required) {
  for (const DccProblem& problem : found) problems.push_back({problem.where, problem.what, required});
}

}  // namespace

std::vector<Problem> problems_of_xml(const XmlDocument& document, const DccSchema* schema) {
  std::vector<Problem> problems;
  add(problems, check_business_rules(document), "the business rules of the DCC");
  if (schema != nullptr) add(problems, schema->check(document), "the schema of DCC 3.3.0");
  return problems;
}

std::string checked_xml(const Certificate& certificate, const DccSchema* schema) {
  const std::string source = certificate.run.data.path.string();
  XmlDocument document;
  try {
    document = dcc_document(certificate);
  } catch (const NumberNotFinite& error) {
    throw CertificateRefused(source, {{"results", error.what(), "finite numbers"}});
  }
  std::vector<Problem> problems = problems_of_xml(document, schema);
  if (!problems.empty()) throw CertificateRefused(source, std::move(problems));
  return xml_text(document);
}

PreparedCertificate prepare_certificate(const Certificate& certificate, const DccSchema* schema) {
  if (!certificate.issue) throw std::logic_error("a draft is not issued");
  const IssueFacts& facts = *certificate.issue;
  PreparedCertificate prepared;
  IssuedCertificate& issued = prepared.issued;
  issued.number = facts.number;
  issued.measured_by = certificate.measured_by();
  issued.approved_by = facts.approved_by;
  issued.date = format_date(facts.date);
  if (facts.replaces) {
    issued.replaces = facts.replaces->number;
    issued.reason = facts.replaces->reason;
  }
  issued.program_version = certificate.program_version;
  issued.laboratory_toml = certificate.laboratory.text;
  issued.xml = checked_xml(certificate, schema);
  const ReportData& data = certificate.run.data;
  issued.item = data.run.value().named_item();
  prepared.run = data.path;
  prepared.run_sha256 = data.sha256.value();
  return prepared;
}

IssuedCertificate keep_certificate(PreparedCertificate prepared, std::string signed_xml,
                                   const DccSchema* schema, const std::string& utc) {
  IssuedCertificate& issued = prepared.issued;
  if (!signed_xml.empty()) {
    // The signature is part of the document, and of its schema.
    if (schema != nullptr) {
      std::vector<Problem> problems;
      add(problems, schema->check(parse_xml(signed_xml, issued.number)), "the schema of DCC 3.3.0");
      if (!problems.empty()) throw CertificateRefused(prepared.run.string(), std::move(problems));
    }
    issued.xml = std::move(signed_xml);
  }
  issued.utc = utc;
  ResultsFile(prepared.run, prepared.run_sha256).add_certificate(issued);
  return std::move(prepared.issued);
}

IssuedCertificate issue_certificate(const Certificate& certificate, const DccSchema* schema,
                                    const std::optional<SigningKey>& key, const std::string& utc) {
  PreparedCertificate prepared = prepare_certificate(certificate, schema);
  std::string signed_xml = key ? sign_xml(prepared.issued.xml, *key, utc) : std::string();
  return keep_certificate(std::move(prepared), std::move(signed_xml), schema, utc);
}

std::optional<IssuedCertificate> current_certificate(const std::filesystem::path& run, int item) {
  std::vector<IssuedCertificate> issued = ResultsFile::certificates(run, item);
  if (issued.empty()) return std::nullopt;
  return std::move(issued.back());
}

}  // namespace abcal
