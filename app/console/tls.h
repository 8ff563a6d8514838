#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"

namespace abcal::console {

/// The certificate chain of the console and its private key, both PEM.
struct TlsIdentity {
  std::string certificate_pem;  ///< The console's own first, then those up to an authority.
  std::string key_pem;
  bool self_signed = false;  ///< Made here: browsers warn, and people compare the fingerprint.
};

/// Reads a certificate and its key from two files. Only the owner may have access to the key, which has no
/// passphrase. @throws std::invalid_argument that states the file, what was found and what is required
TlsIdentity read_tls_identity(const std::filesystem::path& certificate, const std::filesystem::path& key);

/// The self-signed certificate that is kept in a folder. A new one is made if there is none, if it expires
/// within a day, or if it lacks one of the names.
/// @param names  host names and addresses
/// @throws std::runtime_error
TlsIdentity own_tls_identity(const std::filesystem::path& folder, const std::vector<std::string>& names,
                             Clock::UtcTime now);

/// SHA-256 of the certificate as browsers show it: "AB:CD:..."
std::string tls_fingerprint(const TlsIdentity& identity);

}  // namespace abcal::console
