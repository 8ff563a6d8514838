#include "app/console/target.h"

#include <boost/url/parse.hpp>
#include <boost/url/src.hpp>  // Here and nowhere else: what the headers only declare.
#include <boost/url/url_view.hpp>

namespace abcal::console {

std::optional<Target> parse_target(std::string_view text) {
  const auto url = boost::urls::parse_origin_form({text.data(), text.size()});
  if (!url) return std::nullopt;
  Target target;
  target.path = url->encoded_path();
  for (const std::string& word : url->segments()) target.words.push_back(word);
  const auto token = url->params().find("token");
  if (token != url->params().end()) target.token = (*token).value;
  return target;
}

}  // namespace abcal::console
