#pragma once

#include <string>
#include <string_view>

#include "app/certificate/words.h"

namespace abcal {

/// A decimal of a certificate's XML as a page shows it: true minus, powers of ten instead of "e", the decimal
/// mark of the language: "-1.2e-05" becomes "−1.2 × 10⁻⁵".
std::string typeset_number(std::string_view decimal, const Words& words);

/// A unit of D-SI as a page shows it: "\volt\second\tothe{2}\metre\tothe{-1}" becomes "V/(m/s²)", "\one"
/// "1", "|g" "g". What is not known stays as it is.
std::string typeset_unit(std::string_view d_si);

/// A number as the XML has it, for choosing what to show, and for curves. NaN: it is none.
double number_in_xml(std::string_view word);

}  // namespace abcal
