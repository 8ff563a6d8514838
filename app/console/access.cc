#include "app/console/access.h"

#include <fmt/format.h>
#include <openssl/crypto.h>
#include <openssl/rand.h>
#include <openssl/sha.h>

#include <algorithm>
#include <array>
#include <boost/algorithm/string/predicate.hpp>
#include <stdexcept>

#include "app/system/private_file.h"

namespace abcal::console {
namespace {

std::array<unsigned char, SHA256_DIGEST_LENGTH> digest(std::string_view text) {
  std::array<unsigned char, SHA256_DIGEST_LENGTH> hash{};
  SHA256(reinterpret_cast<const unsigned char*>(text.data()), text.size(), hash.data());
  return hash;
}

bool host_is_ours(const AccessRules& rules, const Caller& caller) {
  const auto is = [&](std::string_view name) { return boost::algorithm::iequals(caller.host, name); };
  if (is(caller.address + caller.port)) return true;
  if (caller.loopback && is("localhost" + caller.port)) return true;
  return std::any_of(rules.hosts.begin(), rules.hosts.end(),
                     [&](const std::string& name) { return is(name) || is(name + caller.port); });
}

bool origin_is_ours(const Caller& caller) {
  if (caller.origin.empty()) return true;  // Not a browser, or a page that the person opened.
  // The host is known to be ours: only our own pages have it as origin. TLS may end at a proxy.
  const auto is = [&](const std::string& origin) { return boost::algorithm::iequals(caller.origin, origin); };
  return is(fmt::format("http://{}", caller.host)) || is(fmt::format("https://{}", caller.host));
}

bool has_token(const AccessRules& rules, const Caller& caller) {
  if (rules.token.empty()) return !rules.persons;
  if (const std::string_view bearer = bearer_of(caller.authorization);
      !bearer.empty() && same_secret(bearer, rules.token))
    return true;
  return same_secret(cookie_value(caller.cookie, rules.cookie), rules.token);
}

}  // namespace

Access judge(const AccessRules& rules, const Caller& caller) {
  if (!host_is_ours(rules, caller)) return Access::kWrongHost;
  if (!origin_is_ours(caller)) return Access::kWrongOrigin;
  if (!has_token(rules, caller)) return Access::kNoToken;
  return Access::kGranted;
}

std::string_view bearer_of(std::string_view authorization) {
  constexpr std::string_view kBearer = "Bearer ";
  return authorization.starts_with(kBearer) ? authorization.substr(kBearer.size()) : std::string_view();
}

bool same_secret(std::string_view given, std::string_view secret) {
  // Hashed first, so that the time reveals neither content nor length of the secret.
  const auto a = digest(given), b = digest(secret);
  return CRYPTO_memcmp(a.data(), b.data(), a.size()) == 0;
}

std::string make_token() {
  std::array<unsigned char, 32> bytes{};
  if (RAND_bytes(bytes.data(), static_cast<int>(bytes.size())) != 1)
    throw std::runtime_error("no token could be made: the system gives no random numbers");
  std::string token;
  for (const unsigned char byte : bytes) token += fmt::format("{:02x}", byte);
  return token;
}

std::string read_token(const std::filesystem::path& file) {
  const std::string text = read_private_file(file, "token");
  std::string token = text.substr(0, text.find('\n'));
  const auto allowed = [](char c) {
    return (c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == '-' || c == '_';
  };
  constexpr std::size_t kShortest = 16, kLongest = 256;
  if (token.size() < kShortest || token.size() > kLongest ||
      !std::all_of(token.begin(), token.end(), allowed))
    throw std::invalid_argument(
        fmt::format("{}: its first line is no token; required: {} to {} letters, digits, \"-\" or \"_\"",
                    file.string(), kShortest, kLongest));
  return token;
}

std::string_view cookie_value(std::string_view header, std::string_view name) {
  while (!header.empty()) {
    const std::size_t end = std::min(header.find(';'), header.size());
    std::string_view pair = header.substr(0, end);
    header.remove_prefix(std::min(end + 1, header.size()));
    while (pair.starts_with(' ')) pair.remove_prefix(1);
    if (pair.size() > name.size() && pair.starts_with(name) && pair[name.size()] == '=')
      return pair.substr(name.size() + 1);
  }
  return {};
}

}  // namespace abcal::console
