#include "app/document/document_text.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>
#include <string_view>
#include <vector>

#include "app/document/valid_text.h"
#include "app/system/terminal.h"
#include "app/system/text_layout.h"

namespace abcal {
namespace {

constexpr std::size_t kWidth = 110;
constexpr std::size_t kNarrowest = 30;  // of a column of sentences

/// A name out of a bench file must not move the cursor or clear the screen.
std::string shown(const std::string& text) {
  std::string line = valid_text(text);
  std::replace_if(
      line.begin(), line.end(), [](char c) { return c == '\n' || c == '\t'; }, ' ');
  return line;
}

struct TextOf {
  std::FILE* stream;

  std::string operator()(const Paragraph& paragraph) const {
    return wrapped(shown(paragraph.text), "", "", kWidth);
  }

  std::string operator()(const BulletList& list) const {
    std::string text;
    for (const std::string& item : list.items) text += wrapped(shown(item), "- ", "  ", kWidth);
    return text;
  }

  std::string operator()(const FactList& list) const {
    std::size_t width = 0;
    for (const auto& [name, value] : list.facts) width = std::max(width, display_width(name));
    std::string text;
    for (const auto& [name, value] : list.facts) {
      text += wrapped(shown(value), "  " + padded(shown(name), width, false) + "  ",
                      std::string(width + 4, ' '), kWidth);
    }
    return text;
  }

  std::string operator()(const SideBySide& lists) const {
    FactList all = lists.left;
    all.facts.insert(all.facts.end(), lists.right.facts.begin(), lists.right.facts.end());
    return (*this)(all);
  }

  std::string operator()(const DocumentTable& table) const {
    std::vector<std::size_t> widths;
    for (const Column& column : table.columns) widths.push_back(display_width(column.heading));
    for (const auto& row : table.rows) {
      if (row.size() == 1) continue;
      for (std::size_t c = 0; c < row.size(); ++c) widths[c] = std::max(widths[c], display_width(row[c]));
    }
    // Sentences are in the last column; they are wrapped there.
    std::size_t before_last = 0;
    for (std::size_t c = 0; c + 1 < widths.size(); ++c) before_last += widths[c] + 2;
    if (table.columns.back().kind == CellKind::kText)
      widths.back() =
          std::min(widths.back(), std::max(kNarrowest, kWidth - std::min(kWidth, before_last + 2)));
    const auto line = [&](const auto& cell_of) {
      std::string text = " ";
      for (std::size_t c = 0; c + 1 < widths.size(); ++c)
        text += " " + padded(cell_of(c), widths[c], table.columns[c].kind == CellKind::kNumber) + " ";
      const std::vector<std::string> last = lines_of(cell_of(widths.size() - 1), widths.back());
      for (std::size_t k = 0; k < last.size(); ++k) {
        if (k > 0) text += std::string(before_last + 1, ' ');
        text += " " + padded(last[k], widths.back(), table.columns.back().kind == CellKind::kNumber);
        text.erase(text.find_last_not_of(' ') + 1);
        text += "\n";
      }
      return text;
    };
    std::string text = table.caption.empty() ? "" : wrapped(shown(table.caption), "", "", kWidth);
    text += line([&](std::size_t c) { return table.columns[c].heading; });
    for (const auto& row : table.rows) {
      text += row.size() == 1 ? "  " + emphasised(stream, Emphasis::kHeading, shown(row.front())) + "\n"
                              : line([&](std::size_t c) { return shown(row[c]); });
    }
    return text;
  }

  std::string operator()(const Figure&) const { return {}; }
};

bool has_text(const Section& section) {
  return std::any_of(section.blocks.begin(), section.blocks.end(),
                     [](const Block& block) { return !std::holds_alternative<Figure>(block); });
}

}  // namespace

std::string document_text(const Document& document, std::FILE* stream) {
  std::string text = emphasised(stream, Emphasis::kHeading, document.title) + "\n";
  if (!document.subtitle.empty()) text += shown(document.subtitle) + "\n";
  if (!document.page_mark.empty()) text += emphasised(stream, Emphasis::kBad, document.page_mark) + "\n";
  for (const std::string& caution : document.cautions) {
    std::string large = wrapped(shown(caution), "!!! ", "    ", kWidth);
    large.pop_back();
    text += emphasised(stream, Emphasis::kBad, large) + "\n";
  }
  for (const Section& section : document.sections) {
    if (!has_text(section)) continue;
    text += "\n";
    if (!section.title.empty()) text += emphasised(stream, Emphasis::kHeading, section.title) + "\n";
    bool first = true;
    for (const Block& block : section.blocks) {
      const std::string part = std::visit(TextOf{stream}, block);
      if (part.empty()) continue;
      if (!first) text += "\n";
      text += part;
      first = false;
    }
  }
  return text;
}

}  // namespace abcal
