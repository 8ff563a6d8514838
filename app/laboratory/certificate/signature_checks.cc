#include "app/laboratory/certificate/signature_checks.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "app/document/weasyprint.h"
#include "app/formats/xml_query.h"
#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/sign.h"
#include "app/laboratory/certificate/signing_certificate.h"
#include "app/system/read_file.h"
#include "drivers/text/message.h"
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

const std::string kSigned = "ds:Signature/ds:SignedInfo/ds:Reference";
const std::string kProperties = "ds:Signature/ds:Object/xades:QualifyingProperties/xades:SignedProperties";
const std::string kOfSignature = kProperties + "/xades:SignedSignatureProperties/";
constexpr const char* kEnveloped = "http://www.w3.org/2000/09/xmldsig#enveloped-signature";
constexpr const char* kExclusive = "http://www.w3.org/2001/10/xml-exc-c14n#";

/// Whether a reference points to this with these transforms, by SHA-256.
bool refers(const XmlQuery& query, const std::string& reference, const std::string& to,
            const std::vector<std::string>& transforms) {
  return query.texts(reference + "/@URI") == std::vector<std::string>{to} &&
         query.texts(reference + "/ds:Transforms/ds:Transform/@Algorithm") == transforms &&
         query.text(reference + "/ds:DigestMethod/@Algorithm") == kSha256Algorithm;
}

/// Whether the properties of XAdES-BES are those that the signature signs, and name this certificate. An
/// element that is there twice could be signed in one place and read in another.
bool names_certificate(const XmlQuery& query, const std::string& certificate_pem) {
  const std::string id = query.text(kProperties + "/@Id"),
                    cert = kOfSignature + "xades:SigningCertificateV2/xades:Cert";
  return query.nodes("//xades:QualifyingProperties").size() == 1 &&
         query.nodes("//xades:SignedProperties").size() == 1 &&
         query.nodes("//ds:X509Certificate").size() == 1 && !id.empty() &&
         id.find('\'') == std::string::npos && query.nodes("//@Id[. = '" + id + "']").size() == 1 &&
         query.text(kSigned + "[2]/@Type") == kSignedPropertiesType &&
         refers(query, kSigned + "[2]", "#" + id, {kExclusive}) &&
         query.text("ds:Signature/ds:Object/xades:QualifyingProperties/@Target") ==
             "#" + query.text("ds:Signature/@Id") &&
         query.nodes(cert).size() == 1 &&
         query.text(cert + "/xades:CertDigest/ds:DigestMethod/@Algorithm") == kSha256Algorithm &&
         query.text(cert + "/xades:CertDigest/ds:DigestValue") == digest_of_certificate(certificate_pem);
}

/// The form of a signature that verifies.
struct SignatureForm {
  bool signs_all = false;  ///< It covers the whole document except itself: the rest cannot be exchanged.
  bool is_xades = false;   ///< It is to have the properties of XAdES-BES; earlier versions signed without.
  bool names_certificate = false;  ///< These are signed and name the certificate of the signature.
  std::string signing_time;        ///< As the signer states it.

  /// Why it is not accepted; empty: it is.
  std::string why_not() const {
    if (!signs_all)
      return "it is of another kind; required: of the whole certificate, enveloped, SHA-256, exclusive "
             "canonicalisation";
    if (is_xades && !names_certificate)
      return "its certificate is not the one that was signed (XAdES, SigningCertificateV2): it was exchanged";
    return {};
  }
  std::string words() const {
    return is_xades ? fmt::format("XAdES-BES, signed on {} by the signer's clock", signing_time)
                    : "XML-DSig without XAdES";
  }
};

SignatureForm form_of(const std::string& signed_xml, const std::string& certificate_pem) {
  const XmlDocument document = parse_xml(signed_xml, "certificate");
  const XmlQuery query(document.get());
  SignatureForm form;
  const std::size_t references = query.nodes("//ds:Reference").size();
  form.is_xades = references > 1 || query.any("//xades:*");
  form.signs_all = query.nodes("//ds:Signature").size() == 1 && references == (form.is_xades ? 2U : 1U) &&
                   query.nodes(kSigned).size() == references &&
                   refers(query, kSigned + "[1]", "", {kEnveloped, kExclusive});
  if (!form.is_xades) return form;
  form.names_certificate = names_certificate(query, certificate_pem);
  form.signing_time = query.text(kOfSignature + "xades:SigningTime");
  return form;
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
    const SignatureForm form = form_of(one.xml, pem);
    std::string why_not = why_signature_fails(one.xml, pem);
    if (why_not.empty()) why_not = form.why_not();
    checks.push_back(why_not.empty() ? judged(what, pem, one.approved_by, keys)
                                     : IntegrityCheck{what, false, why_not});
    if (why_not.empty()) checks.back().found += "; " + form.words();
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
    throw Telling<std::invalid_argument>(
        Message("the file is not the certificate that was to be signed; required: that file, unchanged, with "
                "a signature (abcal lab sign)"));
  const std::string pem = certificate_in(signed_xml);
  if (pem.empty())
    throw Telling<std::invalid_argument>(
        Message("the file has no signature with an X.509 certificate; required: that of the approver (abcal "
                "lab sign)"));
  const SignatureForm form = form_of(signed_xml, pem);
  if (!form.signs_all)
    throw Telling<std::invalid_argument>(
        Message("the signature is of another kind; required: of the whole certificate, enveloped, SHA-256, "
                "exclusive canonicalisation (abcal lab sign)"));
  if (const std::string why_not = form.why_not(); !why_not.empty())
    throw std::invalid_argument("the signature: " + why_not);
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
  const std::string what = signature_path_of(pdf).filename().string();
  if (!std::filesystem::exists(signature_path_of(pdf))) {
    checks.push_back(
        {what, false,
         "is not there: nobody signed the pages, so that nothing says that they show the XML "
         "inside; make them again from it (abcal report --pdf), or sign them (abcal issue --sign)"});
    return checks;
  }
  const DetachedSignature signature = check_detached(read_file(pdf), read_file(signature_path_of(pdf)));
  checks.push_back(signature.good ? judged(what, signature.certificate_pem, current.approved_by, keys)
                                  : IntegrityCheck{what, false, signature.why_not});
  return checks;
}

}  // namespace abcal
