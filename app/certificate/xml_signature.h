#pragma once

#include <string>

#include "app/certificate/sign.h"

namespace abcal {

/// sign_xml() in this process: in the program abcal-sign, which alone loads the library for XML signatures.
/// @throws std::invalid_argument  as sign_xml()
std::string add_xml_signature(const std::string& xml, const SigningKey& with);

}  // namespace abcal
