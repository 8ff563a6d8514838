#include "app/laboratory/certificate/signature_checks.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "app/ground/document/weasyprint.h"
#include "app/ground/system/read_file.h"
#include "app/ground/xml/xml_query.h"
#include "app/ground/xml/xml_tree.h"
#include "app/laboratory/certificate/sign.h"
#include "app/laboratory/certificate/signing_certificate.h"
#include "protocol/record/signature.h"

namespace abcal {
namespace {

/// The certificate that an XML signature carries, as PEM; empty: the XML is not signed.
std::string certificate_in(const std::string& xml) {
  const XmlDocument document = parse_xml(xml, "certificate");
  std::string base64;
  for (const std::string& word : XmlQuery(document.get()).words("ds:Signature//ds:X509Certificate"))
    base64 += word;
  if (base64.empty()) return {};
  constexpr std::size_t kLine = 64;
  std::string pem = "-----BEGIN CERTIFICATE-----\n";
  for (std::size_t at = 0; at < base64.size(); at += kLine) pem += base64.substr(at, kLine) + "\n";
  return pem + "-----END CERTIFICATE-----\n";
}

/// Whether exactly one signature exists and covers the whole document except itself. A signature of a part
/// would allow the rest to be exchanged.
bool signs_all(const std::string& signed_xml) {
  const XmlDocument document = parse_xml(signed_xml, "certificate");
  const XmlQuery query(document.get());
  const std::string reference = "ds:Signature/ds:SignedInfo/ds:Reference";
  const std::vector<std::string> transforms{"http://www.w3.org/2000/09/xmldsig#enveloped-signature",
                                            "http://www.w3.org/2001/10/xml-exc-c14n#"};
  return query.nodes("//ds:Signature").size() == 1 && query.nodes("//ds:Reference").size() == 1 &&
         query.texts(reference + "/@URI") == std::vector<std::string>{""} &&
         query.texts(reference + "/ds:Transforms/ds:Transform/@Algorithm") == transforms &&
         query.text(reference + "/ds:DigestMethod/@Algorithm") == "http://www.w3.org/2001/04/xmlenc#sha256";
}

/// Identifies the owner of a signature's key; bad if the approver's keys are known and it is none of them.
IntegrityCheck judged(const std::string& what, const std::string& certificate_pem,
                      const std::string& approver, const std::vector<PersonKey>& keys) {
  const CertificateSubject subject = subject_of(certificate_pem);
  const std::string fingerprint = fingerprint_of(subject.public_pem);
  const auto known = std::find_if(keys.begin(), keys.end(),
                                  [&](const PersonKey& key) { return key.fingerprint == fingerprint; });
  if (known != keys.end())
    return {what, known->owner == approver,
            fmt::format("verifies by a key of {}{}", known->owner,
                        known->owner == approver ? "" : ", but " + approver + " approved")};
  const bool has_keys =
      std::any_of(keys.begin(), keys.end(), [&](const PersonKey& key) { return key.owner == approver; });
  return {what, !has_keys,
          fmt::format("verifies by the key of \"{}\", {}", subject.name,
                      has_keys ? "which is none of " + approver + "'s" : "which no register names")};
}

}  // namespace

std::vector<IntegrityCheck> check_certificate_signatures(const std::vector<IssuedCertificate>& certificates,
                                                         const std::vector<PersonKey>& keys) {
  std::vector<IntegrityCheck> checks;
  for (const IssuedCertificate& one : certificates) {
    const std::string what = "signature of certificate " + one.number;
    const std::string pem = certificate_in(one.xml);
    if (pem.empty()) continue;
    const std::string why_not = why_signature_fails(one.xml, pem);
    checks.push_back(why_not.empty() ? judged(what, pem, one.approved_by, keys)
                                     : IntegrityCheck{what, false, why_not});
  }
  return checks;
}

std::string certificate_of_signature(const std::string& xml, const std::string& signed_xml) {
  const std::string_view before = std::string_view(xml).substr(0, xml.rfind("</"));
  const auto parts = [](const std::string& text) {
    const XmlDocument document = parse_xml(text, "certificate");
    return XmlQuery(document.get()).nodes("/*/*").size();
  };
  // Only the signature may be added: anything else that the approver adds and signs was never shown to
  // anybody.
  if (!std::string_view(signed_xml).starts_with(before) || parts(signed_xml) > parts(xml) + 1)
    throw std::invalid_argument(
        "the file is not the certificate that was to be signed; required: that file, unchanged, with a "
        "signature (abcal lab sign)");
  const std::string pem = certificate_in(signed_xml);
  if (pem.empty())
    throw std::invalid_argument(
        "the file has no signature with an X.509 certificate; required: that of the approver (abcal lab "
        "sign)");
  if (!signs_all(signed_xml))
    throw std::invalid_argument(
        "the signature is of another kind; required: of the whole certificate, enveloped, SHA-256, exclusive "
        "canonicalisation (abcal lab sign)");
  if (const std::string why_not = why_signature_fails(signed_xml, pem); !why_not.empty())
    throw std::invalid_argument("the signature: " + why_not);
  return pem;
}

std::filesystem::path signature_path_of(const std::filesystem::path& file) {
  return file.string() + ".p7s";
}

std::vector<IntegrityCheck> check_printed_certificate(const std::filesystem::path& pdf,
                                                      const std::vector<IssuedCertificate>& certificates,
                                                      const std::vector<PersonKey>& keys) {
  std::vector<IntegrityCheck> checks;
  const std::string name = pdf.filename().string();
  if (certificates.empty()) return {{name, false, "no certificate has been issued for this run"}};
  // Each of several items has a current certificate.
  const std::string attached = attachment_of_pdf(pdf);
  const IssuedCertificate* found = &certificates.back();
  for (const IssuedCertificate& one : certificates) {
    const bool is_replaced = std::any_of(
        certificates.begin(), certificates.end(),
        [&](const IssuedCertificate& other) { return !one.number.empty() && other.replaces == one.number; });
    if (!is_replaced && one.xml == attached) found = &one;
  }
  const IssuedCertificate& current = *found;
  const bool is_same = attached == current.xml;
  checks.push_back({name + ", XML inside", is_same,
                    is_same ? "is certificate " + current.number : "is not certificate " + current.number});
  const DetachedSignature signature = check_detached(read_file(pdf), read_file(signature_path_of(pdf)));
  const std::string what = signature_path_of(pdf).filename().string();
  checks.push_back(signature.good ? judged(what, signature.certificate_pem, current.approved_by, keys)
                                  : IntegrityCheck{what, false, signature.why_not});
  return checks;
}

}  // namespace abcal
