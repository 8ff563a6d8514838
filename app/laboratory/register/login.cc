#include "app/laboratory/register/login.h"

#include <fmt/format.h>

#include <cstdlib>

#include "app/laboratory/register/login_file.h"

namespace abcal::lab {

std::string register_location(const std::string& given) {
  if (!given.empty()) return given;
  const char* configured = std::getenv("ABCAL_REGISTER");
  return configured != nullptr ? configured : "";
}

std::optional<LoggedIn> logged_in(Register& of, Clock::UtcTime now) {
  const auto login = read_login(of.facts().identity);
  if (!login) return std::nullopt;
  return of.who(login->token, now);
}

LoggedIn require_login(Register& of, Clock::UtcTime now) {
  if (auto person = logged_in(of, now)) return *std::move(person);
  throw RegisterError(fmt::format(
      "nobody is logged in to the register of {} here; log in with `abcal lab login NAME`", of.facts().name));
}

}  // namespace abcal::lab
