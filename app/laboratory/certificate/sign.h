#pragma once

#include <filesystem>
#include <string>

namespace abcal {

/// Key for signing certificates: a private key (RSA or elliptic curve, PEM, not encrypted) and the X.509
/// certificate that belongs to it (PEM).
struct SigningKey {
  std::filesystem::path key, certificate;
};

/// Adds an enveloped XML signature (XML-DSig: exclusive canonicalisation, SHA-256) with the X.509 certificate
/// as the last element, and verifies it with the certificate's public key. The bytes before it do not change.
/// The helper program abcal-sign does the work.
/// @throws ProgramMissing, RunInterrupted, std::runtime_error
/// @throws std::invalid_argument  if key or certificate cannot be read, or do not belong together
std::string sign_xml(const std::string& xml, const SigningKey& with);

/// Why the XML signature of a document does not verify with a certificate (PEM); empty: it does.
/// @throws ProgramMissing, RunInterrupted, std::runtime_error
std::string why_signature_fails(const std::string& xml, const std::string& certificate_pem);

}  // namespace abcal
