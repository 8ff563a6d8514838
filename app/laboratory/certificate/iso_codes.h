#pragma once

#include <string_view>

namespace abcal {

/// Country codes of ISO 3166-1, two letters: the list of the business rules of the certificate (DCC 3.3.0),
/// and the five that it lacks (AF, AL, AS, AX, DZ).
bool is_country_code(std::string_view code);

/// Language codes of ISO 639-1.
bool is_language_code(std::string_view code);

}  // namespace abcal
