#pragma once

#include <string>
#include <string_view>

#include "app/laboratory/certificate/words.h"

namespace abcal {

/// A decimal of a certificate's XML as a page shows it: true minus, powers of ten instead of "e", the decimal
/// mark of the language: "-1.2e-05" becomes "−1.2 × 10⁻⁵".
std::string typeset_number(std::string_view decimal, const Words& words);

/// A unit of D-SI as a page shows it: "\volt\second\tothe{2}\metre\tothe{-1}" becomes "V/(m/s²)", "\one" "1",
/// "|g" "g". Unknown units stay unchanged.
std::string typeset_unit(std::string_view d_si);

/// A number of the XML, for choosing rows to show, and for curves. NaN: the text is no number.
double number_in_xml(std::string_view word);

}  // namespace abcal
