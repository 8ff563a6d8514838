#pragma once

#include <string>
#include <string_view>

namespace abcal {

/// "10⁻⁶"; "1" for 0.
std::string power_of_ten(int exponent);

/// A text of sentences and numbers as it is printed: "-1.2e-05" becomes "−1.2 × 10⁻⁵". A minus or an exponent
/// within a word ("7e-05x", "a-1") is left as it is.
std::string typeset_numbers(std::string_view text);

/// The power of ten of the second digit with which a positive number is printed: -3 for 0.012; -2 for 0.0996,
/// which is printed as 0.10.
int place_of_second_digit(double number);

/// A formatted number without the sign of a zero: "-0.0" is "0.0".
std::string without_negative_zero(std::string number);

}  // namespace abcal
