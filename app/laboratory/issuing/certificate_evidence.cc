#include "app/laboratory/issuing/certificate_evidence.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>

#include "app/formats/xml_query.h"
#include "app/laboratory/certificate/signature_checks.h"
#include "app/laboratory/issuing/evidence_files.h"

namespace abcal {
namespace {

/// The check of its signature. An approver is the main signer of the certificate. One without a signature is
/// judged by the register alone; without both, nothing shows that the laboratory issued it.
void add_signature(const std::string& number, const std::string& xml, lab::Register* opened,
                   std::vector<IntegrityCheck>& checks) {
  IssuedCertificate issued;
  issued.number = number;
  issued.xml = xml;
  const XmlDocument document = parse_xml(xml, number);
  const XmlQuery query(document.get());
  issued.approved_by = query.text(
      "dcc:administrativeData/dcc:respPersons/dcc:respPerson[dcc:mainSigner='true']/"
      "dcc:person/dcc:name/dcc:content");
  std::vector<PersonKey> keys;
  if (opened != nullptr)
    for (const lab::SigningKey& key : opened->keys())
      if (key.kind == "person") keys.push_back({key.fingerprint, key.owner});
  std::vector<IntegrityCheck> found = check_certificate_signatures({issued}, keys);
  if (found.empty()) {
    IntegrityCheck unsigned_one{"signature of certificate " + number, opened != nullptr, "it is not signed"};
    if (query.any("//ds:Signature"))
      unsigned_one = {unsigned_one.what, false, "it has no X.509 certificate, so that it cannot be verified"};
    else if (opened == nullptr)
      unsigned_one.found += ", and no register is given: nothing shows that the laboratory issued this file";
    found.push_back(unsigned_one);
  }
  std::ranges::move(found, std::back_inserter(checks));
}

}  // namespace

bool CertificateEvidence::is_good() const {
  return std::ranges::all_of(checks, &IntegrityCheck::good);
}

CertificateEvidence judge_certificate(const std::string& name, const std::string& xml,
                                      lab::Register* opened) {
  const lab::RegisterEvidence evidence = evidence_of_certificate(name, xml);
  CertificateEvidence result;
  result.number = evidence.certificate->number;
  add_signature(result.number, xml, opened, result.checks);
  if (opened == nullptr) {
    result.words = fmt::format(
        "Whether certificate {} was amended or withdrawn is known to the laboratory's register only "
        "(--register).",
        result.number);
    return result;
  }
  for (const lab::RegisterFinding& finding : opened->compare_with(evidence))
    result.checks.push_back({"register against " + finding.what, finding.good, finding.found});
  const auto status = opened->status_of(result.number);
  result.status = status ? std::string(status->word()) : "not known";
  const std::string words =
      status ? status->words().english() : std::string("the register did not give this number");
  result.checks.push_back({"status of certificate " + result.number, status && status->holds(), words});
  result.words = result.is_good()
                     ? fmt::format("Certificate {} is as the laboratory issued it, and holds.", result.number)
                     : fmt::format("Do not rely on certificate {}.", result.number);
  return result;
}

}  // namespace abcal
