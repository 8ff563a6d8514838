#pragma once

#include <string>

namespace abcal {

/// Opens an address in the person's browser, where there is a desktop. A browser that cannot be opened is not
/// a failure: callers print the address as well.
/// @param needed_by  completes "... xdg-open", for the message of a missing program
/// @returns whether one was asked to
bool open_in_browser(const std::string& address, const std::string& needed_by);

}  // namespace abcal
