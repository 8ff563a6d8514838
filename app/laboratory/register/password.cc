#include "app/laboratory/register/password.h"

#include <fmt/format.h>
#include <sodium.h>

#include <array>
#include <stdexcept>

namespace abcal::lab {
namespace {

constexpr std::size_t kShortest = 10;

void start_sodium() {
  static const bool kStarted = sodium_init() >= 0;
  if (!kStarted) throw std::runtime_error("libsodium cannot be started: the system gives no random numbers");
}

}  // namespace

std::string hash_password(std::string_view password, PasswordCost cost) {
  start_sodium();
  std::array<char, crypto_pwhash_STRBYTES> hash{};
  const bool usual = cost == PasswordCost::kUsual;
  if (crypto_pwhash_str(hash.data(), password.data(), password.size(),
                        usual ? crypto_pwhash_OPSLIMIT_INTERACTIVE : crypto_pwhash_OPSLIMIT_MIN,
                        usual ? crypto_pwhash_MEMLIMIT_INTERACTIVE : crypto_pwhash_MEMLIMIT_MIN) != 0)
    throw std::runtime_error("a password cannot be hashed: not enough memory (64 MiB)");
  return hash.data();
}

bool is_password(std::string_view password, const std::string& hash) {
  start_sodium();
  return !hash.empty() && crypto_pwhash_str_verify(hash.c_str(), password.data(), password.size()) == 0;
}

std::string hash_of_no_password() {
  start_sodium();
  constexpr int kVariant = sodium_base64_VARIANT_ORIGINAL_NO_PADDING;
  std::array<unsigned char, crypto_pwhash_SALTBYTES> salt{};
  std::array<unsigned char, 32> key{};
  randombytes_buf(salt.data(), salt.size());
  randombytes_buf(key.data(), key.size());
  std::array<char, sodium_base64_ENCODED_LEN(32, kVariant)> salt_text{}, key_text{};
  sodium_bin2base64(salt_text.data(), salt_text.size(), salt.data(), salt.size(), kVariant);
  sodium_bin2base64(key_text.data(), key_text.size(), key.data(), key.size(), kVariant);
  return fmt::format("{}v=19$m={},t={},p=1${}${}", crypto_pwhash_STRPREFIX,
                     crypto_pwhash_MEMLIMIT_INTERACTIVE / 1024, crypto_pwhash_OPSLIMIT_INTERACTIVE,
                     salt_text.data(), key_text.data());
}

std::string random_token() {
  start_sodium();
  std::array<unsigned char, 32> bytes{};
  randombytes_buf(bytes.data(), bytes.size());
  std::string token;
  for (const unsigned char byte : bytes) token += fmt::format("{:02x}", byte);
  return token;
}

std::string password_rule() {
  return fmt::format("at least {} characters", kShortest);
}

std::string weakness_of(std::string_view password) {
  if (password.size() < kShortest)
    return fmt::format("it has {} characters; required: {}", password.size(), kShortest);
  return {};
}

}  // namespace abcal::lab
