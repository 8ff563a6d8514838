#pragma once

#include <cstdio>
#include <string>

#include "app/document/document.h"

namespace abcal {

/// The document as plain text for a terminal: figures are left out, tables are set in columns, colours as
/// `stream` allows. Characters that would control the terminal are shown as "?".
std::string document_text(const Document& document, std::FILE* stream);

}  // namespace abcal
