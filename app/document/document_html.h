#pragma once

#include <string>

#include "app/document/document.h"

namespace abcal {

/// The document as one HTML page in UTF-8: no scripts, nothing loaded from elsewhere, figures inside as SVG,
/// set for A4 paper with the identification, the cautions and the page number on every printed page. All text
/// is put into libxml2's tree as text, so that markup in a name stays a name.
/// @throws std::bad_alloc
std::string document_html(const Document& document);

/// A section as a part of a page of others, without a style: one <div>. Its figures have captions without
/// numbers.
/// @throws std::bad_alloc
std::string embedded_html(const Section& section);

}  // namespace abcal
