#pragma once

#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "app/document/drawing.h"

namespace abcal {

// A report as content without form: written once, shown on a terminal (document_text.h), as a page
// (document_html.h) and as pages of paper (document_pdf.h). Texts are plain: they are made safe for HTML
// where HTML is written.

/// A sentence or several.
struct Paragraph {
  std::string text;
};

/// Separate sentences, one a line.
struct BulletList {
  std::vector<std::string> items;
};

/// Facts, each with its name.
struct FactList {
  std::vector<std::pair<std::string, std::string>> facts;
};

/// Two lists of facts, next to each other on pages, one after the other in text.
struct SideBySide {
  FactList left, right;
};

/// How the cells of a column are set.
enum class CellKind {
  kText,
  kSymbol,  ///< "s_ux", "phi_uv": the part after "_" is an index.
  kNumber,
  kUnit,    ///< "g/g_loc", "degree", "m/s2"
  kLimits,  ///< "0.98 to 1.02 g/g_loc": numbers with a unit, on several lines where they are long.
};

struct Column {
  std::string heading;
  CellKind kind = CellKind::kText;
};

/// A row with one cell is a heading within the table.
struct DocumentTable {
  std::string caption;  ///< May be empty.
  std::vector<Column> columns;
  std::vector<std::vector<std::string>> rows;
  CellKind caption_kind = CellKind::kText;
  bool may_break = false;  ///< May break over two pages even if it fits on one, to leave no page half empty.
  bool dense = false;      ///< Many narrow columns: little room between them.
};

/// A picture with its words. Pages only.
struct Figure {
  std::string caption;
  Drawing drawing;
};

using Block = std::variant<Paragraph, BulletList, FactList, SideBySide, DocumentTable, Figure>;

struct Section {
  std::string title;  ///< Empty: it belongs to the title of the document.
  std::vector<Block> blocks;
  bool on_new_page = false;
};

/// Content of a page or of a terminal.
struct Document {
  std::string language = "en";  ///< ISO 639-1.
  std::string page_words = "page {} of {}";
  std::string figure_words = "Figure {}: {}";  ///< Number and caption of a figure.
  std::string title;
  std::string subtitle;
  std::string identification;  ///< Identification of run and item; on every page.
  std::string origin;          ///< Program and time; on every page.
  std::string created_utc;     ///< ISO 8601; empty: no date.
  /// Warnings shown before anything else, in large letters.
  std::vector<std::string> cautions;
  /// A word across every page ("DRAFT"); empty for none.
  std::string page_mark;
  std::vector<Section> sections;
};

}  // namespace abcal
