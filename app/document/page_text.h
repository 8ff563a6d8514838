#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "app/document/document.h"

namespace abcal {

// Rules that a page on a screen and a page of paper share: how texts are set, and which rows stay together.

/// A piece of a text that is set in one way.
struct TextRun {
  std::string text;
  bool is_index = false;  ///< Smaller and lower.
};

/// The text of a cell as it is printed: "s_ux" with its index, Greek letters, "°" and "²", the minus of
/// numbers.
std::vector<TextRun> cell_runs(const std::string& text, CellKind kind);

/// Whether a heading is a symbol ("s_ux") or words.
CellKind heading_kind(const Column& column);

/// The caption of a table, whose numbers are set as in sentences where it is words.
std::string caption_text(const DocumentTable& table);

/// A word that may be broken anywhere, since it could be wider than the page.
bool has_long_word(const std::string& text);

/// Mark and cautions for the margin of every page, in capital letters: "SIMULATED · NOT COMPLETE".
std::string margin_cautions(const Document& document);

/// Whether all rows stand on one page.
bool stays_whole(const DocumentTable& table);

/// So many last rows of a table stay together, so that none is alone on the next page.
inline constexpr std::size_t kLastRowsTogether = 3;

/// @throws std::logic_error if a row has more cells than the table has columns
void require_columns(const DocumentTable& table, const std::vector<std::string>& row);

}  // namespace abcal
