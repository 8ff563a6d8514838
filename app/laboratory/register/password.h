#pragma once

#include <string>
#include <string_view>

namespace abcal::lab {

/// Cost of checking a password, and of guessing it.
enum class PasswordCost {
  kUsual,     ///< Argon2id with 64 MiB and two passes (libsodium's "interactive").
  kForTests,  ///< The least that the library permits.
};

/// The Argon2id hash of a password with its salt and cost, as text.
/// @throws std::runtime_error if memory is insufficient
std::string hash_password(std::string_view password, PasswordCost cost = PasswordCost::kUsual);

/// A random hash that fits no password, at the usual cost, in the form of Argon2 (RFC 9106): to check a
/// password against it takes as long as against a person's. It is made without hashing.
std::string hash_of_no_password();

/// Whether a hash was made from this password.
bool is_password(std::string_view password, const std::string& hash);

/// 256 random bits in hexadecimal.
std::string random_token();

/// Why a password is refused; empty: it is not.
std::string weakness_of(std::string_view password);

/// The rule of a password: "at least 10 characters".
std::string password_rule();

}  // namespace abcal::lab
