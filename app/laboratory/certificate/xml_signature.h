#pragma once

#include <string>

#include "app/laboratory/certificate/sign.h"

namespace abcal {

/// sign_xml() in this process: in the program abcal-sign, which alone loads the library for XML signatures.
/// @throws std::invalid_argument  as sign_xml()
std::string add_xml_signature(const std::string& xml, const SigningKey& with, const std::string& utc);

/// Whether the signature of a document verifies with the key of a certificate (a PEM file).
/// @throws std::invalid_argument (no certificate), std::runtime_error (no XML)
bool has_good_signature(const std::string& xml, const std::filesystem::path& certificate);

}  // namespace abcal
