#pragma once

#include <string>

namespace abcal {

/// Name of a country in a language ("DE", "en": "Germany"), by ICU; empty for a code that it does not know.
std::string country_name(const std::string& code, const std::string& language);

}  // namespace abcal
