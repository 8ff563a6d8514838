#include "protocol/record/signature.h"

#include <fmt/format.h>
#include <openssl/pem.h>
#include <openssl/x509.h>

#include <array>
#include <stdexcept>

#include "protocol/record/openssl_parts.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

using DigestContext = std::unique_ptr<EVP_MD_CTX, OpensslFree<EVP_MD_CTX_free>>;

/// An encrypted key is refused, because no person is there to type a passphrase.
int no_passphrase(char*, int, int, void*) {
  return -1;
}

OpensslKey private_key(const std::string& pem) {
  OpensslKey key(PEM_read_bio_PrivateKey(readable(pem).get(), nullptr, no_passphrase, nullptr));
  if (!key || EVP_PKEY_get_id(key.get()) != EVP_PKEY_ED25519)
    throw std::invalid_argument(
        "found no private Ed25519 key; required: an unencrypted PEM file, as `abcal lab key` makes");
  return key;
}

OpensslKey public_key(const std::string& pem) {
  return OpensslKey(PEM_read_bio_PUBKEY(readable(pem).get(), nullptr, no_passphrase, nullptr));
}

}  // namespace

std::string make_private_key() {
  const OpensslKey key(EVP_PKEY_Q_keygen(nullptr, nullptr, "ED25519"));
  const OpensslBio pem = writable();
  if (!key || PEM_write_bio_PKCS8PrivateKey(pem.get(), key.get(), nullptr, nullptr, 0, nullptr, nullptr) != 1)
    throw std::runtime_error(
        "the key could not be made: OpenSSL has no Ed25519, or the system gave no random numbers");
  return written(pem);
}

std::string public_key_of(const std::string& private_pem) {
  const OpensslKey key = private_key(private_pem);
  const OpensslBio pem = writable();
  if (PEM_write_bio_PUBKEY(pem.get(), key.get()) != 1)
    throw std::runtime_error("a public key could not be written");
  return written(pem);
}

std::string fingerprint_of(const std::string& public_pem) {
  const OpensslKey key = public_key(public_pem);
  if (!key) throw std::invalid_argument("no public key; required: PEM");
  const OpensslBio der = writable();
  if (i2d_PUBKEY_bio(der.get(), key.get()) != 1)
    throw std::runtime_error("a public key could not be written");
  return sha256_of(written(der));
}

std::string sign(std::string_view message, const std::string& private_pem) {
  const OpensslKey key = private_key(private_pem);
  const DigestContext context(EVP_MD_CTX_new());
  const auto* bytes = reinterpret_cast<const unsigned char*>(message.data());
  std::array<unsigned char, 64> signature{};
  std::size_t size = signature.size();
  if (!context || EVP_DigestSignInit(context.get(), nullptr, nullptr, nullptr, key.get()) != 1 ||
      EVP_DigestSign(context.get(), signature.data(), &size, bytes, message.size()) != 1)
    throw std::runtime_error("a signature could not be made");
  return {reinterpret_cast<const char*>(signature.data()), size};
}

bool is_signature(std::string_view message, std::string_view signature, const std::string& public_pem) {
  const OpensslKey key = public_key(public_pem);
  if (!key || EVP_PKEY_get_id(key.get()) != EVP_PKEY_ED25519) return false;
  const DigestContext context(EVP_MD_CTX_new());
  return context && EVP_DigestVerifyInit(context.get(), nullptr, nullptr, nullptr, key.get()) == 1 &&
         EVP_DigestVerify(context.get(), reinterpret_cast<const unsigned char*>(signature.data()),
                          signature.size(), reinterpret_cast<const unsigned char*>(message.data()),
                          message.size()) == 1;
}

void require_private_key(const std::string& private_pem) {
  (void)private_key(private_pem);
}

std::string statement_of_run(std::string_view run_sha256) {
  return fmt::format("abcal: a closed run with SHA-256 {}\n", run_sha256);
}

}  // namespace abcal
