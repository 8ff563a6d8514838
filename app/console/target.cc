#include "app/console/target.h"

#include <algorithm>
#include <boost/algorithm/string/predicate.hpp>
#include <boost/url/parse.hpp>
#include <boost/url/url_view.hpp>

namespace abcal::console {

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
  const auto url = boost::urls::parse_origin_form({text.data(), text.size()});
  if (!url) return std::nullopt;
  Target target;
  target.path = url->encoded_path();
  std::string joined;
  for (const auto part : url->encoded_segments()) {
    joined.append("/").append(part.data(), part.size());
    target.words.push_back(part.decode());
  }
  // Boost.URL removes a leading "/.": the parts would not be those that were sent.
  if (joined != target.path && target.path != "/") return std::nullopt;
  return target;
}

std::optional<std::map<std::string, std::string>> parse_form(std::string_view body) {
  // As the query of a target: parse_query() of Boost 1.81 reads beyond the end of an empty text.
  const std::string target = "/?" + std::string(body);
  const auto url = boost::urls::parse_origin_form(target);
  if (!url) return std::nullopt;
  boost::urls::encoding_opts options;
  options.space_as_plus = true;
  std::map<std::string, std::string> fields;
  for (const auto field : url->encoded_params())
    fields.emplace(field.key.decode(options), field.value.decode(options));
  return fields;
}

std::string field_of(const std::map<std::string, std::string>& form, const std::string& name) {
  const auto found = form.find(name);
  return found == form.end() ? std::string() : found->second;
}

}  // namespace abcal::console
