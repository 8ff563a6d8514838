#include "app/console/target.h"

#include <boost/url/parse.hpp>
#include <boost/url/url_view.hpp>

namespace abcal::console {

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
  const auto token = url->params().find("token");
  if (token != url->params().end()) target.token = (*token).value;
  return target;
}

}  // namespace abcal::console
