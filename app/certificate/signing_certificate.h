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

/// Whom a certificate names, its public key, and when it is valid.
struct CertificateSubject {
  std::string name;  ///< "O = Example laboratory, CN = Approver N. N."
  std::string public_pem;
  std::string valid_from_utc, valid_to_utc;  ///< As format_utc() writes times.
};

/// @throws std::invalid_argument if it is no X.509 certificate in PEM
CertificateSubject subject_of(const std::string& certificate_pem);

/// The detached signature of any bytes (CMS, DER; RFC 5652), with the certificate inside. Anyone verifies it:
/// openssl cms -verify -binary -inform DER -in FILE.p7s -content FILE -CAfile CERT.pem -out /dev/null
/// @throws std::invalid_argument if key and certificate are none, or do not belong together
std::string sign_detached(std::string_view bytes, const SigningIdentity& by);

/// What a detached signature says of bytes.
struct DetachedSignature {
  bool good = false;
  std::string certificate_pem;  ///< Of the signer, as the signature has it; empty: none.
  std::string why_not;
};

/// Whether it is that of the bytes by the key of the certificate in it. Whose certificate that is, is for the
/// caller to judge.
DetachedSignature check_detached(std::string_view bytes, std::string_view signature_der);

}  // namespace abcal
