#include "app/console/target.h"

#include <libxml/uri.h>
#include <libxml/xmlmemory.h>

#include <algorithm>
#include <boost/algorithm/string/predicate.hpp>
#include <memory>
#include <new>

#include "drivers/text/text.h"

namespace abcal::console {
namespace {

using Uri = std::unique_ptr<xmlURI, void (*)(xmlURI*)>;

/// Reads a target in origin form as part of a URI, with its escapes (RFC 3986). Null if it is not one, or if
/// it contains a zero byte, which would end a string of libxml2.
Uri parse_origin_form(std::string_view text) {
  Uri uri(nullptr, xmlFreeURI);
  if (!text.starts_with('/') || text.find('\0') != std::string_view::npos ||
      text.find("%00") != std::string_view::npos)
    return uri;
  constexpr int kKeepEscapes = 1;
  uri.reset(xmlParseURIRaw(("http://host" + std::string(text)).c_str(), kKeepEscapes));
  if (uri && uri->fragment != nullptr) uri.reset();
  return uri;
}

std::string decoded(std::string_view part) {
  const std::unique_ptr<char, void (*)(void*)> text(
      xmlURIUnescapeString(std::string(part).c_str(), 0, nullptr), xmlFree);
  if (!text) throw std::bad_alloc();
  return text.get();
}

}  // namespace

std::string in_origin_form(std::string_view target, std::string_view host) {
  for (const std::string_view scheme : {"http://", "https://"}) {
    if (!boost::algorithm::istarts_with(target, scheme)) continue;
    const std::string_view rest = target.substr(scheme.size());
    const std::size_t end = std::min(rest.find_first_of("/?"), rest.size());
    if (host.empty() || !boost::algorithm::iequals(rest.substr(0, end), host)) break;
    return (rest.substr(end).starts_with('/') ? "" : "/") + std::string(rest.substr(end));
  }
  return std::string(target);
}

std::optional<Target> parse_target(std::string_view text) {
  const Uri uri = parse_origin_form(text);
  if (!uri) return std::nullopt;
  Target target;
  target.path = uri->path;
  if (target.path == "/") return target;
  for (const std::string_view part : pieces::split(std::string_view(target.path).substr(1), '/'))
    target.words.push_back(decoded(part));
  return target;
}

std::optional<std::map<std::string, std::string>> parse_form(std::string_view body) {
  const Uri uri = parse_origin_form("/?" + std::string(body));
  if (!uri) return std::nullopt;
  std::map<std::string, std::string> fields;
  std::string query = uri->query_raw == nullptr ? "" : uri->query_raw;
  std::replace(query.begin(), query.end(), '+', ' ');
  for (const std::string_view field : pieces::split(query, '&')) {
    if (field.empty()) continue;
    const std::size_t end = std::min(field.find('='), field.size());
    fields.emplace(decoded(field.substr(0, end)), decoded(field.substr(std::min(end + 1, field.size()))));
  }
  return fields;
}

std::string field_of(const std::map<std::string, std::string>& form, const std::string& name) {
  const auto found = form.find(name);
  return found == form.end() ? std::string() : found->second;
}

}  // namespace abcal::console
