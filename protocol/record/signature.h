#pragma once

#include <string>
#include <string_view>

namespace abcal {

/// A new private Ed25519 key, as PEM (PKCS #8, not encrypted).
std::string make_private_key();

/// The public part of a private key's PEM, as PEM.
/// @throws std::invalid_argument if it is not a private Ed25519 key
std::string public_key_of(const std::string& private_pem);

/// SHA-256, in hexadecimal, of a public key in its DER form.
/// @throws std::invalid_argument if the PEM is not a public key
std::string fingerprint_of(const std::string& public_pem);

/// The Ed25519 signature of a message, 64 bytes.
/// @throws std::invalid_argument if it is not a private Ed25519 key
std::string sign(std::string_view message, const std::string& private_pem);

/// Whether a signature of a message was made by the owner of a public key. False for a text that is not a
/// key.
bool is_signature(std::string_view message, std::string_view signature, const std::string& public_pem);

/// @throws std::invalid_argument if the PEM is not a private Ed25519 key
void require_private_key(const std::string& private_pem);

/// Text that a bench signs for a closed run. It names the SHA-256 of its bytes, so that the signature serves
/// no other purpose.
std::string statement_of_run(std::string_view run_sha256);

}  // namespace abcal
