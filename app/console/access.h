#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace abcal::console {

/// The rules on who may use the console. Pure functions of a request's headers apply them, so that each
/// rule can be tested alone.
struct AccessRules {
  /// Required of everyone, where not empty: as a cookie, or as "Authorization: Bearer TOKEN".
  std::string token;
  /// Requires a person of the register, or the token where one is set.
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
  std::string_view origin;         ///< Header Origin: the page that asks; only browsers send it.
  std::string_view cookie;         ///< Header Cookie.
  std::string_view authorization;  ///< Header Authorization.
  std::string address;             ///< This end of the connection: "127.0.0.1", "[::1]".
  std::string port;                ///< Port of this end, ":8080"; empty for 80, with TLS for 443.
  bool loopback = false;           ///< This end is on the loopback interface.
};

enum class Access {
  kGranted,
  kWrongHost,    ///< Not a name of this console: guards against DNS rebinding.
  kWrongOrigin,  ///< The request comes from a page of another origin.
  kNoToken,      ///< The visitor is not identified.
};

/// Whether a request may be answered at all.
Access judge(const AccessRules& rules, const Caller& caller);

/// The secret that follows "Bearer " in an Authorization header; empty: none.
std::string_view bearer_of(std::string_view authorization);

/// Whether two secrets are equal, in a time that depends on the length of `given` only.
bool same_secret(std::string_view given, std::string_view secret);

/// 256 random bits in hexadecimal.
std::string make_token();

/// The token in the first line of a file that only its owner can read.
/// @throws std::invalid_argument that states what was found and what is required
std::string read_token(const std::filesystem::path& file);

/// The value of a cookie in a Cookie header, or empty.
std::string_view cookie_value(std::string_view header, std::string_view name);

}  // namespace abcal::console
