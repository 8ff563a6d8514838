#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace abcal::console {

/// Who may use the console. Pure functions of the headers of a request, so that each rule can be
/// tested alone.
struct AccessRules {
  /// Required of everyone, where not empty: as a cookie, or as "Authorization: Bearer TOKEN".
  std::string token;
  /// A person of the register is required, or the token where there is one.
  bool persons = false;
  /// Name of the token's cookie. Browsers do not keep the cookies of two ports of one host apart.
  std::string cookie = "abcal_token";
  /// Names by which the console may be called in addition to its address, with our port or the one given:
  /// "bench7.example.org", "proxy.example.org:8080".
  std::vector<std::string> hosts;
};

/// The headers of a request that decide on access. Empty: absent.
struct Caller {
  std::string_view host;           ///< Header Host.
  std::string_view origin;         ///< Header Origin: the page that asks; only browsers say it.
  std::string_view cookie;         ///< Header Cookie.
  std::string_view authorization;  ///< Header Authorization.
  std::string address;             ///< "127.0.0.1", "[::1]": the end of this connection here.
  std::string port;                ///< Its port, ":8080"; empty for 80.
  bool loopback = false;           ///< That end is on the loopback interface.
};

enum class Access {
  kGranted,
  kWrongHost,    ///< A name that is not ours: a page that had its own name resolve to our address.
  kWrongOrigin,  ///< Another page.
  kNoToken,      ///< Nothing is known of who it is.
};

/// Whether a request may be answered at all.
Access judge(const AccessRules& rules, const Caller& caller);

/// What stands behind "Bearer " in an Authorization header, or empty.
std::string_view bearer_of(std::string_view authorization);

/// Whether two secrets are equal, in a time that depends on the length of `given` only.
bool same_secret(std::string_view given, std::string_view secret);

/// 256 random bits in hexadecimal.
std::string make_token();

/// The token in the first line of a file that only its owner can read.
/// @throws std::invalid_argument that says found and required
std::string read_token(const std::filesystem::path& file);

/// The value of a cookie in a Cookie header, or empty.
std::string_view cookie_value(std::string_view header, std::string_view name);

}  // namespace abcal::console
