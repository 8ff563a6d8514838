#pragma once

#include <string>
#include <string_view>

#include "drivers/instrument/clock.h"

namespace abcal {

/// A private key and the X.509 certificate that belongs to it, both PEM.
struct SigningIdentity {
  std::string private_pem, certificate_pem;
};

/// A new ECDSA P-256 key of a person, with a certificate that the key itself signs, for three years. An
/// authority's certificate of another key serves as well.
SigningIdentity make_signing_identity(const std::string& person, const std::string& laboratory,
                                      Clock::UtcTime now);

/// Name in a certificate, its public key, and its period of validity.
struct CertificateSubject {
  std::string name;  ///< "O = Example laboratory, CN = Approver N. N."
  std::string public_pem;
  std::string valid_from_utc, valid_to_utc;  ///< Times as format_utc() writes them.
};

/// @throws std::invalid_argument if it is no X.509 certificate in PEM
CertificateSubject subject_of(const std::string& certificate_pem);

/// SHA-256 of the DER form of an X.509 certificate (PEM), in base64: how XAdES names it.
/// @throws std::invalid_argument if it is no X.509 certificate in PEM
std::string digest_of_certificate(const std::string& certificate_pem);

/// The detached signature of any bytes (CMS, DER; RFC 5652), with the certificate inside. Anyone verifies it:
/// openssl cms -verify -binary -inform DER -in FILE.p7s -content FILE -CAfile CERT.pem -out /dev/null
/// @throws std::invalid_argument if key or certificate is invalid, or they do not belong together
std::string sign_detached(std::string_view bytes, const SigningIdentity& by);

/// Result of checking a detached signature.
struct DetachedSignature {
  bool good = false;
  std::string certificate_pem;  ///< Certificate of the signer, contained in the signature; empty: none.
  std::string why_not;
};

/// Checks that the signature belongs to the bytes and was made by the key of its own certificate. The caller
/// must identify the owner of that certificate.
DetachedSignature check_detached(std::string_view bytes, std::string_view signature_der);

}  // namespace abcal
