#pragma once

#include <string>

#include "app/document/document.h"

namespace abcal {

/// The document as pages of A4 in PDF, by cairo and Pango: the identification, the cautions and the page
/// number in the margins of every page, heads of tables repeated on each page that they reach, texts and
/// figures as elements of a structure ("tagged"). All fonts are embedded. The same document gives the same
/// pages; a date is only in its dictionary of information, which make_archive() removes.
/// @throws std::runtime_error with cairo's words
std::string document_pdf(const Document& document);

}  // namespace abcal
