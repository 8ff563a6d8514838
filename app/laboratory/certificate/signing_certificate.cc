#include "app/laboratory/certificate/signing_certificate.h"

#include <openssl/cms.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/rand.h>
#include <openssl/x509.h>

#include <array>
#include <chrono>
#include <ctime>
#include <stdexcept>

#include "protocol/record/openssl_parts.h"
#include "protocol/record/run_file.h"

namespace abcal {
namespace {

using X509Certificate = std::unique_ptr<X509, OpensslFree<X509_free>>;
using CmsContent = std::unique_ptr<CMS_ContentInfo, OpensslFree<CMS_ContentInfo_free>>;
struct FreeCertificates {
  void operator()(STACK_OF(X509) * certificates) const { sk_X509_free(certificates); }
};

/// The last error of OpenSSL in its words; it is forgotten then.
std::string openssl_words() {
  std::array<char, 256> words{};
  ERR_error_string_n(ERR_get_error(), words.data(), words.size());
  ERR_clear_error();
  return words.data();
}

void require_done(bool done, const char* what) {
  if (!done) throw std::runtime_error(std::string(what) + ": " + openssl_words());
}

X509Certificate read_certificate_pem(const std::string& pem) {
  const OpensslBio bio = readable(pem);
  X509Certificate certificate(PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr));
  ERR_clear_error();
  if (!certificate) throw std::invalid_argument("no X.509 certificate; required: PEM");
  return certificate;
}

std::string certificate_pem_of(X509* certificate) {
  const OpensslBio bio = writable();
  require_done(PEM_write_bio_X509(bio.get(), certificate) == 1, "certificate");
  return written(bio);
}

std::string utc_of(const ASN1_TIME* time) {
  std::tm parts{};
  require_done(ASN1_TIME_to_tm(time, &parts) == 1, "a time of the certificate");
  return format_utc(std::chrono::time_point_cast<Clock::Duration>(
      std::chrono::system_clock::from_time_t(::timegm(&parts))));
}

void add_name(X509_NAME* name, const char* field, const std::string& value) {
  require_done(X509_NAME_add_entry_by_txt(name, field, MBSTRING_UTF8,
                                          reinterpret_cast<const unsigned char*>(value.data()),
                                          static_cast<int>(value.size()), -1, 0) == 1,
               field);
}

}  // namespace

SigningIdentity make_signing_identity(const std::string& person, const std::string& laboratory,
                                      Clock::UtcTime now) {
  const OpensslKey key(EVP_EC_gen("P-256"));
  const X509Certificate certificate(X509_new());
  require_done(key && certificate, "a new key");
  std::uint64_t serial = 0;
  require_done(RAND_bytes(reinterpret_cast<unsigned char*>(&serial), sizeof serial) == 1, "serial number");
  const std::time_t begin = std::chrono::system_clock::to_time_t(
      std::chrono::time_point_cast<std::chrono::system_clock::duration>(now));
  constexpr std::time_t kThreeYears = std::time_t{3} * 365 * 24 * 3600;
  X509_set_version(certificate.get(), X509_VERSION_3);
  ASN1_INTEGER_set_uint64(X509_get_serialNumber(certificate.get()), serial >> 1U);
  ASN1_TIME_set(X509_getm_notBefore(certificate.get()), begin);
  ASN1_TIME_set(X509_getm_notAfter(certificate.get()), begin + kThreeYears);
  X509_NAME* name = X509_get_subject_name(certificate.get());
  add_name(name, "O", laboratory);
  add_name(name, "CN", person);
  require_done(X509_set_issuer_name(certificate.get(), name) == 1 &&
                   X509_set_pubkey(certificate.get(), key.get()) == 1 &&
                   X509_sign(certificate.get(), key.get(), EVP_sha256()) > 0,
               "certificate");
  const OpensslBio bio = writable();
  require_done(
      PEM_write_bio_PKCS8PrivateKey(bio.get(), key.get(), nullptr, nullptr, 0, nullptr, nullptr) == 1,
      "private key");
  return {written(bio), certificate_pem_of(certificate.get())};
}

CertificateSubject subject_of(const std::string& certificate_pem) {
  const X509Certificate certificate = read_certificate_pem(certificate_pem);
  const OpensslBio name = writable(), key = writable();
  X509_NAME_print_ex(name.get(), X509_get_subject_name(certificate.get()), 0,
                     XN_FLAG_ONELINE & ~static_cast<unsigned long>(ASN1_STRFLGS_ESC_MSB));
  require_done(PEM_write_bio_PUBKEY(key.get(), X509_get0_pubkey(certificate.get())) == 1, "public key");
  return {written(name), written(key), utc_of(X509_get0_notBefore(certificate.get())),
          utc_of(X509_get0_notAfter(certificate.get()))};
}

std::string digest_of_certificate(const std::string& certificate_pem) {
  const X509Certificate certificate = read_certificate_pem(certificate_pem);
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned int size = 0;
  require_done(X509_digest(certificate.get(), EVP_sha256(), digest.data(), &size) == 1,
               "digest of the certificate");
  std::array<unsigned char, 2 * EVP_MAX_MD_SIZE> text{};
  const int length = EVP_EncodeBlock(text.data(), digest.data(), static_cast<int>(size));
  return {text.begin(), text.begin() + length};
}

std::string sign_detached(std::string_view bytes, const SigningIdentity& by) {
  const X509Certificate certificate = read_certificate_pem(by.certificate_pem);
  const OpensslBio key_bio = readable(by.private_pem), content = readable(bytes), out = writable();
  const OpensslKey key(PEM_read_bio_PrivateKey(key_bio.get(), nullptr, nullptr, nullptr));
  if (!key) throw std::invalid_argument("no private key; required: PEM, without a passphrase");
  if (X509_check_private_key(certificate.get(), key.get()) != 1) {
    ERR_clear_error();
    throw std::invalid_argument("the X.509 certificate does not belong to the key");
  }
  const CmsContent cms(CMS_sign(certificate.get(), key.get(), nullptr, content.get(),
                                CMS_DETACHED | CMS_BINARY | CMS_NOSMIMECAP));
  require_done(cms != nullptr && i2d_CMS_bio(out.get(), cms.get()) == 1, "detached signature");
  return written(out);
}

DetachedSignature check_detached(std::string_view bytes, std::string_view signature_der) {
  const OpensslBio content = readable(bytes), signature = readable(signature_der);
  const CmsContent cms(d2i_CMS_bio(signature.get(), nullptr));
  ERR_clear_error();
  if (!cms) return {false, {}, "it is no signature (CMS, DER)"};
  // The signer is identified by the owner of the key, not by a chain of authorities.
  const bool good = CMS_verify(cms.get(), nullptr, nullptr, content.get(), nullptr,
                               CMS_DETACHED | CMS_BINARY | CMS_NO_SIGNER_CERT_VERIFY) == 1;
  const std::string why = good ? std::string() : openssl_words();
  const std::unique_ptr<STACK_OF(X509), FreeCertificates> signers(good ? CMS_get0_signers(cms.get())
                                                                       : nullptr);
  if (!good) return {false, {}, "it does not verify: " + why};
  if (!signers || sk_X509_num(signers.get()) != 1) return {false, {}, "it has not exactly one signer"};
  return {true, certificate_pem_of(sk_X509_value(signers.get(), 0)), {}};
}

}  // namespace abcal
