#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace abcal::console {

/// Headers in which proxies state where a request comes from. Empty: absent.
struct ForwardedHeaders {
  std::string_view forwarded;        ///< Forwarded (RFC 7239).
  std::string_view x_forwarded_for;  ///< X-Forwarded-For.
};

/// The client whose request a proxy has passed on: the last address in the header that is not a trusted
/// proxy.
/// @param proxies  addresses of trusted proxies, as plain_address() writes them
/// @return nullopt if the headers are not reliable: both are present, or one cannot be parsed.
std::optional<std::string> forwarded_client(const ForwardedHeaders& headers,
                                            const std::vector<std::string>& proxies);

/// "192.0.2.1", "2001:db8::1": an address as this program writes it; an IPv4 address in IPv6 is IPv4.
/// @return nullopt if the text is not an address
std::optional<std::string> plain_address(std::string_view text);

}  // namespace abcal::console
