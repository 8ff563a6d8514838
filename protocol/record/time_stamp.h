#pragma once

#include <string>
#include <string_view>

namespace abcal {

// Time stamps of RFC 3161: an authority signs a hash with the time at which it saw it.

/// A request for a time stamp of a SHA-256, in DER, with a random number that the answer must repeat.
/// @param sha256  in hexadecimal
std::string time_stamp_request(std::string_view sha256);

/// Content of an authority's answer to a request.
struct TimeStampAnswer {
  std::string token;    ///< DER of the time stamp, to be kept; empty: refused.
  std::string refused;  ///< Reason why the authority gave none, or why its answer does not match the request.
};
TimeStampAnswer read_time_stamp_answer(std::string_view answer, std::string_view request);

/// Result of checking a stored time stamp.
struct TimeStampCheck {
  bool good = false;
  std::string utc;             ///< The time that the authority states, "2026-03-01T12:00:00Z".
  std::string authority;       ///< Name of the signer in its certificate.
  bool for_this_hash = false;  ///< Valid for any signer.
  std::string found;           ///< Why it is not good.
};

/// Whether a time stamp is for a SHA-256, and signed by an authority whose certificate chain ends in one of
/// `trusted_pem` (certificates, PEM).
TimeStampCheck check_time_stamp(std::string_view token, std::string_view sha256,
                                const std::string& trusted_pem);

}  // namespace abcal
