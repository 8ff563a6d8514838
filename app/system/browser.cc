#include "app/system/browser.h"

#include <cstdlib>
#include <stdexcept>

#include "app/system/child_process.h"
#include "app/system/detached_process.h"
#include "app/system/output.h"

namespace abcal {
namespace {

bool has_desktop() {
  const auto has = [](const char* name) {
    const char* value = std::getenv(name);
    return value != nullptr && *value != '\0';
  };
  return has("DISPLAY") || has("WAYLAND_DISPLAY");
}

}  // namespace

bool open_in_browser(const std::string& address, const std::string& needed_by) {
  const Tool opener{"xdg-open", needed_by, "xdg-utils"};
  if (!has_desktop() || !is_installed(opener)) return false;
  try {
    (void)start_detached(opener, {address});
  } catch (const std::runtime_error& error) {
    print_warning(error.what());
    return false;
  }
  return true;
}

}  // namespace abcal
