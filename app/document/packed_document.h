#pragma once

#include <string>
#include <string_view>

#include "app/document/document.h"

namespace abcal {

/// A document as bytes (CBOR), for a program on the same computer.
std::string packed(const Document& document);

/// The document of packed().
/// @throws std::runtime_error if the bytes are none
Document unpacked(std::string_view bytes);

}  // namespace abcal
