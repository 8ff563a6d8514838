#pragma once

#include <optional>
#include <string>

#include "app/laboratory/register/register.h"

namespace abcal::lab {

/// Where the register is: as given, otherwise from the environment variable ABCAL_REGISTER; empty: none is
/// configured.
std::string register_location(const std::string& given);

/// The person logged in to a register on this machine; absent: no person.
/// @throws RegisterError if the login has expired, or its person was retired
std::optional<LoggedIn> logged_in(Register& of, Clock::UtcTime now);

/// Like logged_in(). @throws RegisterError also if no person is logged in
LoggedIn require_login(Register& of, Clock::UtcTime now);

}  // namespace abcal::lab
