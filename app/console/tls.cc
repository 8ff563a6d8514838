#include "app/console/tls.h"

#include <fmt/format.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/rand.h>
#include <openssl/x509.h>
#include <openssl/x509v3.h>

#include <array>
#include <boost/asio/ip/address.hpp>
#include <chrono>
#include <cstdint>
#include <ctime>
#include <stdexcept>

#include "app/system/private_file.h"
#include "app/system/read_file.h"
#include "protocol/record/openssl_parts.h"

namespace abcal::console {
namespace {

using TlsCertificate = std::unique_ptr<X509, OpensslFree<X509_free>>;
using TlsExtension = std::unique_ptr<X509_EXTENSION, OpensslFree<X509_EXTENSION_free>>;

constexpr std::time_t kTlsLife = std::time_t{730} * 24 * 3600;
constexpr const char* kTlsFile = "console-tls.pem";

void require_tls(bool done, const char* what) {
  if (done) return;
  std::array<char, 256> words{};
  ERR_error_string_n(ERR_get_error(), words.data(), words.size());
  ERR_clear_error();
  throw std::runtime_error(fmt::format("TLS certificate: {}: {}", what, words.data()));
}

TlsCertificate tls_certificate(const std::string& pem) {
  const OpensslBio bio = readable(pem);
  TlsCertificate certificate(PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr));
  ERR_clear_error();
  return certificate;
}

OpensslKey tls_key(const std::string& pem) {
  const OpensslBio bio = readable(pem);
  // No passphrase, as nobody is present to type it.
  OpensslKey key(PEM_read_bio_PrivateKey(
      bio.get(), nullptr, [](char*, int, int, void*) { return -1; }, nullptr));
  ERR_clear_error();
  return key;
}

bool is_address(const std::string& name) {
  boost::system::error_code error;
  boost::asio::ip::make_address(name, error);
  return !error;
}

void add_extension(X509* certificate, int kind, const std::string& value) {
  const TlsExtension extension(X509V3_EXT_conf_nid(nullptr, nullptr, kind, value.c_str()));
  require_tls(extension && X509_add_ext(certificate, extension.get(), -1) == 1, value.c_str());
}

TlsIdentity make_own(const std::vector<std::string>& names, std::time_t begin) {
  const OpensslKey key(EVP_EC_gen("P-256"));
  const TlsCertificate certificate(X509_new());
  require_tls(key && certificate, "a new key");
  std::uint64_t serial = 0;
  require_tls(RAND_bytes(reinterpret_cast<unsigned char*>(&serial), sizeof serial) == 1, "serial number");
  X509_set_version(certificate.get(), X509_VERSION_3);
  ASN1_INTEGER_set_uint64(X509_get_serialNumber(certificate.get()), serial >> 1U);
  ASN1_TIME_set(X509_getm_notBefore(certificate.get()), begin);
  ASN1_TIME_set(X509_getm_notAfter(certificate.get()), begin + kTlsLife);
  X509_NAME* subject = X509_get_subject_name(certificate.get());
  constexpr const char* kSubject = "abcal console";
  require_tls(X509_NAME_add_entry_by_txt(subject, "CN", MBSTRING_UTF8,
                                         reinterpret_cast<const unsigned char*>(kSubject), -1, -1, 0) == 1 &&
                  X509_set_issuer_name(certificate.get(), subject) == 1 &&
                  X509_set_pubkey(certificate.get(), key.get()) == 1,
              "subject");
  std::string alternatives;
  for (const std::string& name : names)
    alternatives +=
        fmt::format("{}{}:{}", alternatives.empty() ? "" : ",", is_address(name) ? "IP" : "DNS", name);
  add_extension(certificate.get(), NID_subject_alt_name, alternatives);
  add_extension(certificate.get(), NID_basic_constraints, "critical,CA:FALSE");
  add_extension(certificate.get(), NID_ext_key_usage, "serverAuth");
  require_tls(X509_sign(certificate.get(), key.get(), EVP_sha256()) > 0, "signature");
  const OpensslBio certificate_pem = writable(), key_pem = writable();
  require_tls(PEM_write_bio_X509(certificate_pem.get(), certificate.get()) == 1, "certificate");
  require_tls(
      PEM_write_bio_PKCS8PrivateKey(key_pem.get(), key.get(), nullptr, nullptr, 0, nullptr, nullptr) == 1,
      "private key");
  return {written(certificate_pem), written(key_pem), true};
}

/// Whether a certificate is valid now and for one more day, and has these names.
bool serves(X509* certificate, const std::vector<std::string>& names, std::time_t now) {
  std::time_t tomorrow = now + 24 * 3600;
  if (X509_cmp_time(X509_get0_notBefore(certificate), &now) > 0 ||
      X509_cmp_time(X509_get0_notAfter(certificate), &tomorrow) < 0)
    return false;
  for (const std::string& name : names) {
    const int found = is_address(name) ? X509_check_ip_asc(certificate, name.c_str(), 0)
                                       : X509_check_host(certificate, name.c_str(), 0, 0, nullptr);
    if (found != 1) return false;
  }
  return true;
}

}  // namespace

TlsIdentity read_tls_identity(const std::filesystem::path& certificate, const std::filesystem::path& key) {
  TlsIdentity identity{read_file(certificate), read_private_file(key, "--tls-key"), false};
  const TlsCertificate parsed = tls_certificate(identity.certificate_pem);
  if (!parsed)
    throw std::invalid_argument(
        fmt::format("--tls-certificate {}: no X.509 certificate; required: PEM, the console's own first, "
                    "then those up to its authority",
                    certificate.string()));
  const OpensslKey parsed_key = tls_key(identity.key_pem);
  if (!parsed_key)
    throw std::invalid_argument(
        fmt::format("--tls-key {}: no private key; required: PEM, without a passphrase", key.string()));
  const bool belongs = X509_check_private_key(parsed.get(), parsed_key.get()) == 1;
  ERR_clear_error();
  if (!belongs)
    throw std::invalid_argument(fmt::format("--tls-key {}: another key than that of the certificate {}",
                                            key.string(), certificate.string()));
  return identity;
}

TlsIdentity own_tls_identity(const std::filesystem::path& folder, const std::vector<std::string>& names,
                             Clock::UtcTime now) {
  const std::filesystem::path file = folder / kTlsFile;
  const std::time_t seconds = std::chrono::system_clock::to_time_t(
      std::chrono::time_point_cast<std::chrono::system_clock::duration>(now));
  if (std::filesystem::exists(file)) {
    const std::string pem = read_private_file(file, "TLS certificate");
    const TlsCertificate certificate = tls_certificate(pem);
    if (certificate && tls_key(pem) && serves(certificate.get(), names, seconds)) return {pem, pem, true};
    std::filesystem::remove(file);
  }
  TlsIdentity made = make_own(names, seconds);
  std::filesystem::create_directories(folder);
  write_private_file(file, made.certificate_pem + made.key_pem);
  return made;
}

std::string tls_fingerprint(const TlsIdentity& identity) {
  const TlsCertificate certificate = tls_certificate(identity.certificate_pem);
  std::array<unsigned char, EVP_MAX_MD_SIZE> bytes{};
  unsigned int length = 0;
  require_tls(certificate && X509_digest(certificate.get(), EVP_sha256(), bytes.data(), &length) == 1,
              "fingerprint");
  std::string words;
  for (unsigned int i = 0; i < length; ++i) words += fmt::format("{}{:02X}", i == 0 ? "" : ":", bytes[i]);
  return words;
}

}  // namespace abcal::console
