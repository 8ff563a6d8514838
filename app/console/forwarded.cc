#include "app/console/forwarded.h"

#include <algorithm>
#include <boost/algorithm/string/classification.hpp>
#include <boost/algorithm/string/predicate.hpp>
#include <boost/algorithm/string/split.hpp>
#include <boost/algorithm/string/trim.hpp>
#include <boost/asio/ip/address.hpp>

namespace abcal::console {
namespace {

std::vector<std::string> split_list(std::string_view text, char at) {
  std::vector<std::string> parts;
  boost::algorithm::split(parts, text, [at](char c) { return c == at; });
  for (std::string& part : parts) boost::algorithm::trim(part);
  return parts;
}

/// The address of "192.0.2.1", "192.0.2.1:4711", "2001:db8::1", "[2001:db8::1]:4711".
std::optional<std::string> address_of_node(std::string text) {
  if (text.starts_with('[')) {
    const std::size_t end = text.find(']');
    if (end == std::string::npos) return std::nullopt;
    return plain_address(std::string_view(text).substr(1, end - 1));
  }
  if (std::count(text.begin(), text.end(), ':') == 1) text.resize(text.find(':'));
  return plain_address(text);
}

/// The node of for=... in one element of Forwarded; nullopt if absent.
std::optional<std::string> node_of_element(const std::string& element) {
  for (const std::string& pair : split_list(element, ';')) {
    if (!boost::algorithm::istarts_with(pair, "for=")) continue;
    std::string node = pair.substr(4);
    if (node.size() >= 2 && node.front() == '"' && node.back() == '"') node = node.substr(1, node.size() - 2);
    return address_of_node(node);
  }
  return std::nullopt;
}

}  // namespace

std::optional<std::string> plain_address(std::string_view text) {
  boost::system::error_code error;
  auto address = boost::asio::ip::make_address(std::string(text), error);
  if (error) return std::nullopt;
  if (address.is_v6() && address.to_v6().is_v4_mapped())
    address = boost::asio::ip::make_address_v4(boost::asio::ip::v4_mapped, address.to_v6());
  return address.to_string();
}

std::optional<std::string> forwarded_client(const ForwardedHeaders& headers,
                                            const std::vector<std::string>& proxies) {
  // A proxy writes one header and may pass on the other as received: with both, neither can be trusted.
  if (headers.forwarded.empty() == headers.x_forwarded_for.empty()) return std::nullopt;
  const bool standard = !headers.forwarded.empty();
  std::vector<std::string> elements = split_list(standard ? headers.forwarded : headers.x_forwarded_for, ',');
  // Each proxy appends its client. Addresses before the last one that is not a trusted proxy may be forged.
  std::reverse(elements.begin(), elements.end());
  std::optional<std::string> client;
  for (const std::string& element : elements) {
    client = standard ? node_of_element(element) : address_of_node(element);
    if (!client || std::find(proxies.begin(), proxies.end(), *client) == proxies.end()) return client;
  }
  return client;
}

}  // namespace abcal::console
