#pragma once

#include <filesystem>
#include <string>

namespace abcal {

/// Key for signing certificates: a private key (RSA or elliptic curve, PEM, not encrypted) and the X.509
/// certificate that belongs to it (PEM).
struct SigningKey {
  std::filesystem::path key, certificate;
};

/// Adds an enveloped XML signature with the X.509 certificate as the last element, and verifies it with the
/// certificate's public key: XML-DSig (exclusive canonicalisation, SHA-256) that also signs the properties of
/// XAdES-BES (ETSI EN 319 132-1): when it was signed, and the digest of the certificate. The bytes before it
/// do not change. The helper program abcal-sign does the work.
/// @param utc  time of signing, as format_utc() writes it
/// @throws ProgramMissing, RunInterrupted, std::runtime_error
/// @throws std::invalid_argument  if key or certificate cannot be read, or do not belong together
std::string sign_xml(const std::string& xml, const SigningKey& with, const std::string& utc);

/// Names of XML-DSig and XAdES, for those that write a signature and those that check it.
inline constexpr const char* kXadesNamespace = "http://uri.etsi.org/01903/v1.3.2#";
inline constexpr const char* kSignedPropertiesType = "http://uri.etsi.org/01903#SignedProperties";
inline constexpr const char* kSignedPropertiesId = "abcal-signed-properties";
inline constexpr const char* kSha256Algorithm = "http://www.w3.org/2001/04/xmlenc#sha256";

/// Why the XML signature of a document does not verify with a certificate (PEM); empty: it does.
/// @throws ProgramMissing, RunInterrupted, std::runtime_error
std::string why_signature_fails(const std::string& xml, const std::string& certificate_pem);

}  // namespace abcal
