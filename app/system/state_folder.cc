#include "app/system/state_folder.h"

#include <cstdlib>
#include <string>

namespace abcal {

std::filesystem::path state_folder() {
  const auto value = [](const char* name) {
    const char* text = std::getenv(name);
    return std::string(text == nullptr ? "" : text);
  };
  // A service may have several, divided by colons.
  if (const std::string service = value("STATE_DIRECTORY"); !service.empty())
    return service.substr(0, service.find(':'));
  if (const std::string state = value("XDG_STATE_HOME"); !state.empty())
    return std::filesystem::path(state) / "abcal";
  const std::string home = value("HOME");
  return home.empty() ? std::filesystem::path() : std::filesystem::path(home) / ".local/state/abcal";
}

}  // namespace abcal
