#include "app/laboratory/certificate/xml_signature.h"

#include <xmlsec/crypto.h>
#include <xmlsec/errors.h>
#include <xmlsec/keyinfo.h>
#include <xmlsec/templates.h>
#include <xmlsec/xmldsig.h>
#include <xmlsec/xmlsec.h>
#include <xmlsec/xmltree.h>

#include <memory>
#include <stdexcept>

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/signing_certificate.h"
#include "app/system/read_file.h"

namespace abcal {
namespace {

/// XML Security is set up once for the program.
void start_xmlsec() {
  static const bool kStarted = [] {
    xmlSecErrorsDefaultCallbackEnableOutput(0);  // Our exceptions report the errors.
    return xmlSecInit() >= 0 && xmlSecCryptoAppInit(nullptr) >= 0 && xmlSecCryptoInit() >= 0;
  }();
  if (!kStarted) throw std::runtime_error("the library for XML signatures cannot be started");
}

struct FreeKey {
  void operator()(xmlSecKey* key) const { xmlSecKeyDestroy(key); }
};
using Key = std::unique_ptr<xmlSecKey, FreeKey>;

struct FreeContext {
  void operator()(xmlSecDSigCtx* context) const { xmlSecDSigCtxDestroy(context); }
};
using Context = std::unique_ptr<xmlSecDSigCtx, FreeContext>;

/// Refuses an encrypted key, because no person can be asked for a passphrase.
int no_passphrase(char*, int, int, void*) {
  return -1;
}

Key load(const std::filesystem::path& path, xmlSecKeyDataFormat format, const std::string& kind) {
  Key key(
      xmlSecCryptoAppKeyLoad(path.c_str(), format, nullptr, reinterpret_cast<void*>(no_passphrase), nullptr));
  if (!key)
    throw std::invalid_argument(path.string() + ": no " + kind + "; required: PEM, without a passphrase");
  return key;
}

xmlSecTransformId method_of(const xmlSecKey& key, const std::filesystem::path& path) {
  const xmlSecKeyData* value = key.value;
  if (xmlSecKeyDataCheckId(value, xmlSecKeyDataRsaId)) return xmlSecTransformRsaSha256Id;
  if (xmlSecKeyDataCheckId(value, xmlSecKeyDataEcdsaId)) return xmlSecTransformEcdsaSha256Id;
  throw std::invalid_argument(path.string() + ": a key of another kind; required: RSA or elliptic curve");
}

constexpr const char* kSignatureId = "abcal-signature";
constexpr const char* kDocumentId = "abcal-document";

/// The facts that XAdES-BES signs beside the document: when, with which certificate, and of what format it
/// is.
void add_signed_properties(xmlNode* signature, const std::string& utc, const std::string& certificate_pem) {
  XmlElement object(xmlSecTmplSignatureAddObject(signature, nullptr, nullptr, nullptr));
  xmlNode* node = xmlNewChild(object.node(), nullptr, as_xml("QualifyingProperties"), nullptr);
  xmlSetNs(node, xmlNewNs(node, as_xml(kXadesNamespace), as_xml("xades")));
  XmlElement qualifying(node);
  qualifying.attribute("Target", std::string("#") + kSignatureId);
  XmlElement properties = qualifying.add("xades:SignedProperties");
  properties.attribute("Id", kSignedPropertiesId);
  XmlElement of_signature = properties.add("xades:SignedSignatureProperties");
  of_signature.add("xades:SigningTime", utc);
  XmlElement digest =
      of_signature.add("xades:SigningCertificateV2").add("xades:Cert").add("xades:CertDigest");
  digest.add("ds:DigestMethod").attribute("Algorithm", kSha256Algorithm);
  digest.add("ds:DigestValue", digest_of_certificate(certificate_pem));
  XmlElement format = properties.add("xades:SignedDataObjectProperties").add("xades:DataObjectFormat");
  format.attribute("ObjectReference", std::string("#") + kDocumentId);
  format.add("xades:MimeType", "text/xml");
}

/// Makes the attributes "Id" known, to which references of a signature point.
void know_ids(xmlDoc* document) {
  const xmlChar* names[] = {as_xml("Id"), nullptr};
  xmlSecAddIDs(document, xmlDocGetRootElement(document), names);
}

/// An empty signature at the end of the document: everything but itself, its signed properties, and room for
/// the certificate.
xmlNode* add_template(xmlDoc* document, xmlSecTransformId method, const std::string& utc,
                      const std::string& certificate_pem) {
  xmlNode* signature = xmlSecTmplSignatureCreateNsPref(document, xmlSecTransformExclC14NId, method,
                                                       as_xml(kSignatureId), as_xml("ds"));
  xmlAddChild(xmlDocGetRootElement(document), signature);
  xmlNode* reference = xmlSecTmplSignatureAddReference(signature, xmlSecTransformSha256Id,
                                                       as_xml(kDocumentId), as_xml(""), nullptr);
  xmlSecTmplReferenceAddTransform(reference, xmlSecTransformEnvelopedId);
  xmlSecTmplReferenceAddTransform(reference, xmlSecTransformExclC14NId);
  const std::string to_properties = std::string("#") + kSignedPropertiesId;
  xmlNode* properties =
      xmlSecTmplSignatureAddReference(signature, xmlSecTransformSha256Id, nullptr,
                                      as_xml(to_properties.c_str()), as_xml(kSignedPropertiesType));
  xmlSecTmplReferenceAddTransform(properties, xmlSecTransformExclC14NId);
  xmlNode* data = xmlSecTmplKeyInfoAddX509Data(xmlSecTmplSignatureEnsureKeyInfo(signature, nullptr));
  xmlSecTmplX509DataAddCertificate(data);
  add_signed_properties(signature, utc, certificate_pem);
  return signature;
}

Context context_with(Key key) {
  Context context(xmlSecDSigCtxCreate(nullptr));
  if (!context) throw std::runtime_error("out of memory while the certificate was signed");
  context->signKey = key.release();
  return context;
}

std::string unformatted(xmlDoc* document) {
  xmlChar* bytes = nullptr;
  int size = 0;
  // The signed bytes must not change: another blank would break the signature.
  xmlDocDumpMemoryEnc(document, &bytes, &size, "UTF-8");
  std::string text(reinterpret_cast<const char*>(bytes), static_cast<std::size_t>(size));
  xmlFree(bytes);
  return text;
}

}  // namespace

bool has_good_signature(const std::string& xml, const std::filesystem::path& certificate) {
  start_xmlsec();
  const XmlDocument document = parse_xml(xml, "the signed certificate");
  know_ids(document.get());
  xmlNode* signature =
      xmlSecFindNode(xmlDocGetRootElement(document.get()), xmlSecNodeSignature, xmlSecDSigNs);
  const Context context = context_with(load(certificate, xmlSecKeyDataFormatCertPem, "X.509 certificate"));
  return signature != nullptr && xmlSecDSigCtxVerify(context.get(), signature) >= 0 &&
         context->status == xmlSecDSigStatusSucceeded;
}

std::string add_xml_signature(const std::string& xml, const SigningKey& with, const std::string& utc) {
  start_xmlsec();
  Key key = load(with.key, xmlSecKeyDataFormatPem, "private key");
  if ((xmlSecKeyGetType(key.get()) & xmlSecKeyDataTypePrivate) == 0)
    throw std::invalid_argument(with.key.string() + ": a public key; required: the private one");
  if (xmlSecCryptoAppKeyCertLoad(key.get(), with.certificate.c_str(), xmlSecKeyDataFormatPem) < 0)
    throw std::invalid_argument(with.certificate.string() + ": no X.509 certificate; required: PEM");

  const XmlDocument document = parse_xml(xml, "the certificate");
  xmlNode* signature =
      add_template(document.get(), method_of(*key, with.key), utc, read_file(with.certificate));
  know_ids(document.get());
  const Context context = context_with(std::move(key));
  if (xmlSecDSigCtxSign(context.get(), signature) < 0)
    throw std::runtime_error(with.key.string() + ": the certificate could not be signed with it");
  std::string signed_xml = unformatted(document.get());
  if (!has_good_signature(signed_xml, with.certificate)) {
    throw std::invalid_argument(with.certificate.string() + ": does not belong to the key " +
                                with.key.string() + ", the signature does not verify with it");
  }
  return signed_xml;
}

}  // namespace abcal
