#pragma once

#include <string>
#include <vector>

#include "app/document/document.h"

namespace abcal {

/// A page, and warnings about missing parts.
struct HtmlPage {
  std::string html;
  std::vector<std::string> warnings;  ///< "figures are left out: gnuplot is not installed ...".
};

/// The document as one HTML page in UTF-8: no scripts, nothing loaded from elsewhere, figures inside as SVG,
/// set for A4 paper with the identification, the cautions and the page number on every printed page. All text
/// is put into libxml2's tree as text, so that markup in a name stays a name.
/// @throws std::runtime_error if gnuplot fails; if it is not installed the page reports this in place of the
/// figures
HtmlPage document_html(const Document& document);

/// A section as a part of a page of others, without a style: one <div>. Its figures have captions without
/// numbers.
/// @param figure_prefix  begins the ids of its figures: letters and digits, begins with a letter, unlike that
/// of other parts of the page
/// @throws as document_html()
std::string embedded_html(const Section& section, const std::string& figure_prefix);

}  // namespace abcal
