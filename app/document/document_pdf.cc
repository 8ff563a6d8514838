#include "app/document/document_pdf.h"

#include <cairo/cairo-pdf.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <numbers>
#include <numeric>
#include <stdexcept>
#include <utility>
#include <variant>
#include <vector>

#include "app/document/number_text.h"
#include "app/document/page_text.h"
#include "app/document/pango_text.h"
#include "app/document/paper.h"
#include "app/document/valid_text.h"

namespace abcal {
namespace {

constexpr double kMm = 72.0 / 25.4;
constexpr double kPaperWidth = 210.0 * kMm, kPaperHeight = 297.0 * kMm;
constexpr double kSide = 15.0 * kMm, kTop = 20.0 * kMm, kBottom = 17.0 * kMm;
constexpr double kWidth = kPaperWidth - 2.0 * kSide, kHeight = kPaperHeight - kTop - kBottom;

constexpr PaperColour kBlue = 0x10324e, kGrey = 0x505050, kDarkGrey = 0x303030, kRed = 0xb00020;
constexpr double kTableSize = 8.2, kTableLeading = 1.3;

void rectangle(cairo_t* cairo, double x, double y, double width, double height, PaperColour colour) {
  set_colour(cairo, colour);
  cairo_rectangle(cairo, x, y, width, height);
  cairo_fill(cairo);
}

// --- Figures -----------------------------------------------------------------------------------------------

/// "#10324e"
PaperColour colour_of(const std::string& text) {
  constexpr int kHexadecimal = 16;
  return static_cast<PaperColour>(std::strtoul(text.c_str() + 1, nullptr, kHexadecimal));
}

void draw(cairo_t* cairo, const TextSetter&, const PicturePath& path) {
  for (const std::vector<PicturePoint>& line : path.lines) {
    for (std::size_t k = 0; k < line.size(); ++k)
      (k == 0 ? cairo_move_to : cairo_line_to)(cairo, line[k][0], line[k][1]);
    if (!path.fill.empty()) cairo_close_path(cairo);
  }
  if (!path.fill.empty()) {
    set_colour(cairo, colour_of(path.fill), path.opacity);
    cairo_fill_preserve(cairo);
  }
  if (!path.stroke.empty()) {
    set_colour(cairo, colour_of(path.stroke));
    cairo_set_line_width(cairo, path.width);
    cairo_stroke_preserve(cairo);
  }
  cairo_new_path(cairo);
}

void draw(cairo_t* cairo, const TextSetter& setter, const PictureLabel& label) {
  const TextLines text(setter, label.text, {.size = label.size, .colour = colour_of(label.colour)});
  cairo_save(cairo);
  cairo_translate(cairo, label.at[0], label.at[1]);
  if (label.upwards) cairo_rotate(cairo, -std::numbers::pi / 2.0);
  text.draw(cairo, -label.alignment * text.width(), -text.base());
  cairo_restore(cairo);
}

// --- Tables ------------------------------------------------------------------------------------------------

/// How much room a column needs.
struct ColumnNeed {
  double least = 0.0;    ///< So that no word is broken.
  double natural = 0.0;  ///< So that no line is broken.
};

/// Distributes the width of a table, as browsers do.
std::vector<double> column_widths(const std::vector<ColumnNeed>& needs, double width) {
  double least = 0.0, natural = 0.0;
  for (const ColumnNeed& need : needs) {
    least += need.least;
    natural += need.natural;
  }
  std::vector<double> widths;
  for (const ColumnNeed& need : needs) {
    if (natural <= width) {
      widths.push_back(need.natural * width / natural);
    } else if (least < width) {
      widths.push_back(need.least + (need.natural - need.least) * (width - least) / (natural - least));
    } else {
      widths.push_back(need.least * width / least);
    }
  }
  return widths;
}

/// The longest word of a text.
std::string longest_word(const std::string& text) {
  std::string longest;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find(' ', at), text.size());
    if (end - at > longest.size()) longest = text.substr(at, end - at);
    at = end + 1;
  }
  return longest;
}

struct CellPadding {
  double left = 1.6 * kMm, right = 1.6 * kMm;
};

/// A row of cells, and how it is drawn.
struct Row {
  std::vector<TextLines> cells;
  std::vector<CellPadding> padding;
  std::vector<double> x, widths;  ///< Left ends and widths of the columns, with padding.
  double above = 0.3 * kMm, below = 0.3 * kMm;
  double line = 0.15 * kMm;  ///< Below the row.
  PaperColour line_colour = 0xd4d9de;
  const char* element = "TD";
  bool is_head = false;

  int lines() const {
    int most = 1;
    for (const TextLines& cell : cells) most = std::max(most, cell.count());
    return most;
  }
  double height_of(int count) const { return above + count * cells.front().line_height() + below + line; }
  void draw(const PaperPen& pen, double y, int first, int end) const {
    const double height = height_of(end - first), width = x.back() + widths.back() - x.front();
    constexpr PaperColour kHeadGround = 0xe8eef3;
    pen.as_artifact([&] {
      if (is_head) rectangle(pen.cairo, x.front(), y, width, height, kHeadGround);
      rectangle(pen.cairo, x.front(), y + height - line, width, line, line_colour);
    });
    for (std::size_t c = 0; c < cells.size(); ++c) {
      const int count = std::min(cells[c].count(), end);
      // Heads stand at the foot of their row.
      const double lower = is_head ? (end - first - count) * cells[c].line_height() : 0.0;
      pen.in_element(element, [&] {
        if (first < count) cells[c].draw(pen.cairo, x[c] + padding[c].left, y + above + lower, first, count);
      });
    }
  }
};

// --- The document ------------------------------------------------------------------------------------------

class PaperBuilder {
 public:
  explicit PaperBuilder(const Document& content) : content_(content), setter_(content.language) {}

  std::string build() {
    add_lines(content_.title, {.size = 17.0, .leading = 1.2, .bold = true, .colour = kBlue}, "H1", 0.0,
              content_.subtitle.empty() ? 0.0 : 1.0 * kMm);
    if (!content_.subtitle.empty()) add_lines(content_.subtitle, {.colour = kGrey}, "P", 0.0, 4.0 * kMm);
    for (const std::string& caution : content_.cautions) add_caution(typeset_numbers(caution));
    for (const Section& section : content_.sections) {
      on_new_page_ = section.on_new_page;
      if (!section.title.empty()) add_heading(section.title);
      for (const Block& block : section.blocks) std::visit([&](const auto& each) { add(each); }, block);
    }
    return written(pages_of(pieces_, kHeight));
  }

 private:
  void add_piece(Piece piece) {
    piece.on_new_page = std::exchange(on_new_page_, false);
    pieces_.push_back(std::move(piece));
  }
  PaperTag next(const char* name) { return {name, ++tags_}; }
  TextLines lines(const std::string& text, const TextStyle& style, double width = kWidth) const {
    return std::move(TextLines(setter_, text, style).fit(width));
  }

  // --- Sentences ---

  /// Lines of a text, of which three stay together at its begin and its end.
  void add_lines(const std::string& text, const TextStyle& style, const char* element, double above,
                 double below) {
    add_lines(text, style, {document_, next(element)}, above, below, 0.0);
  }
  void add_lines(const std::string& text, const TextStyle& style, const std::vector<PaperTag>& tags,
                 double above, double below, double indent) {
    const auto all = std::make_shared<TextLines>(lines(text, style, kWidth - indent));
    constexpr int kTogether = 3;
    const int count = all->count();
    for (int k = 0; k < count; ++k)
      add_piece({.height = all->line_height(),
                 .above = k == 0 ? above : 0.0,
                 .below = k + 1 == count ? below : 0.0,
                 .keep_with_next = k + 1 < count && (k + 1 < kTogether || k + kTogether >= count),
                 .tags = tags,
                 .draw = [this, all, k, indent](const PaperPen& pen, double y) {
                   constexpr double kBulletBefore = 9.0;
                   if (k == 0 && indent > 0.0) bullet_.draw(pen.cairo, kSide + indent - kBulletBefore, y);
                   all->draw(pen.cairo, kSide + indent, y, k, k + 1);
                 }});
  }

  void add_caution(const std::string& text) {
    constexpr double kBorder = 0.8 * kMm, kInside = 3.0 * kMm, kOver = 1.5 * kMm;
    constexpr PaperColour kGround = 0xfff4f4;
    const auto words =
        std::make_shared<TextLines>(lines(text, {.size = 10.0, .leading = 1.3, .bold = true, .colour = kRed},
                                          kWidth - 2.0 * (kBorder + kInside)));
    const double height = words->height() + 2.0 * (kBorder + kOver);
    add_piece({.height = height,
               .above = kOver,
               .below = kOver,
               .tags = {document_, next("P")},
               .draw = [words, height](const PaperPen& pen, double y) {
                 pen.as_artifact([&] {
                   rectangle(pen.cairo, kSide, y, kWidth, height, kRed);
                   rectangle(pen.cairo, kSide + kBorder, y + kBorder, kWidth - 2.0 * kBorder,
                             height - 2.0 * kBorder, kGround);
                 });
                 words->draw(pen.cairo, kSide + kBorder + kInside, y + kBorder + kOver);
               }});
  }

  void add_heading(const std::string& text) {
    constexpr double kRule = 0.4 * kMm, kAboveRule = 0.7 * kMm;
    const auto words =
        std::make_shared<TextLines>(lines(text, {.size = 11.5, .bold = true, .colour = kBlue}));
    const double height = words->height() + kAboveRule + kRule;
    add_piece({.height = height,
               .above = 4.5 * kMm,
               .below = 1.5 * kMm,
               .keep_with_next = true,
               .tags = {document_, next("H2")},
               .draw = [words, height](const PaperPen& pen, double y) {
                 words->draw(pen.cairo, kSide, y);
                 pen.as_artifact(
                     [&] { rectangle(pen.cairo, kSide, y + height - kRule, kWidth, kRule, kBlue); });
               }});
  }

  void add(const Paragraph& paragraph) {
    add_lines(typeset_numbers(paragraph.text), {}, "P", 1.5 * kMm, 1.5 * kMm);
  }

  void add(const BulletList& bullets) {
    constexpr double kIndent = 5.0 * kMm, kAround = 1.5 * kMm;
    const PaperTag list = next("L");
    for (std::size_t k = 0; k < bullets.items.size(); ++k)
      add_lines(typeset_numbers(bullets.items[k]), {}, {document_, list, next("LI")}, k == 0 ? kAround : 0.0,
                k + 1 == bullets.items.size() ? kAround : 0.0, kIndent);
  }

  // --- Tables ---

  /// Pieces of a row: one, or several where it is too high for a page.
  void add_row(std::shared_ptr<const Row> row, const PaperTag& table,
               const std::shared_ptr<const Piece>& head, const Piece& how) {
    constexpr double kHighest = kHeight / 2.0;
    const int count = row->lines();
    const double of_line = row->cells.front().line_height();
    const int at_once = std::max(1, static_cast<int>((kHighest - row->height_of(0)) / of_line));
    const PaperTag tag = next("TR");
    for (int first = 0; first < count; first += at_once) {
      const int end = std::min(count, first + at_once);
      add_piece({.height = row->height_of(end - first),
                 .above = first == 0 ? how.above : 0.0,
                 .below = end == count ? how.below : 0.0,
                 .keep_with_next = how.keep_with_next && end == count,
                 .tags = {document_, table, tag},
                 .draw = [row, first, end](const PaperPen& pen, double y) { row->draw(pen, y, first, end); },
                 .head = head});
    }
  }

  Row facts_row(const std::pair<std::string, std::string>& fact, double left, double width,
                double name_width) const {
    constexpr TextStyle kStyle{.size = kTableSize, .leading = kTableLeading};
    TextStyle of_name = kStyle;
    of_name.colour = kGrey;
    const CellPadding padding;
    const double inside = padding.left + padding.right;
    Row row{.cells = {},
            .padding = {padding, padding},
            .x = {left, left + name_width},
            .widths = {name_width, width - name_width},
            .line_colour = 0xe4e8eb};
    row.cells.push_back(lines(fact.first, of_name, name_width - inside));
    row.cells.push_back(lines(fact.second, kStyle, width - name_width - inside));
    return row;
  }

  void add(const FactList& list) {
    constexpr double kNameWidth = 56.0 * kMm;
    const PaperTag table = next("Table");
    for (std::size_t k = 0; k < list.facts.size(); ++k)
      add_row(std::make_shared<Row>(facts_row(list.facts[k], kSide, kWidth, kNameWidth)), table, nullptr,
              {.above = k == 0 ? 2.0 * kMm : 0.0,
               .below = k + 1 == list.facts.size() ? 3.0 * kMm : 0.0,
               .draw = {}});
  }

  void add(const SideBySide& lists) {
    constexpr double kNameWidth = 33.0 * kMm, kPart = 0.965, kHalf = kWidth / 2.0;
    struct Side {
      PaperTag table;
      std::vector<Row> rows;
      double height = 0.0;
    };
    std::vector<Side> sides;
    for (const FactList* list : {&lists.left, &lists.right}) {
      const bool is_left = sides.empty();
      Side& side = sides.emplace_back(Side{next("Table"), {}});
      for (const auto& fact : list->facts) {
        side.rows.push_back(
            facts_row(fact, is_left ? kSide : kSide + kHalf, is_left ? kPart * kHalf : kHalf, kNameWidth));
        side.height += side.rows.back().height_of(side.rows.back().lines());
      }
    }
    const double height = std::max(sides[0].height, sides[1].height);
    add_piece({.height = height,
               .below = 1.0 * kMm,
               .tags = {document_, next("Div")},
               .draw = [sides = std::make_shared<std::vector<Side>>(std::move(sides))](const PaperPen& pen,
                                                                                       double top) {
                 for (const Side& side : *sides)
                   pen.in_element("Table", [&] {
                     double y = top;
                     for (const Row& row : side.rows) {
                       pen.in_element("TR", [&] { row.draw(pen, y, 0, row.lines()); });
                       y += row.height_of(row.lines());
                     }
                   });
               }});
  }

  /// The text of a cell in one line.
  TextLines cell(const std::string& text, CellKind kind, const TextStyle& style) const {
    return TextLines(setter_, cell_runs(text, kind), style);
  }

  static TextStyle cell_style(const DocumentTable& table, const Column& column) {
    constexpr double kDenseSize = 8.0;
    return {.size = table.dense ? kDenseSize : kTableSize,
            .leading = kTableLeading,
            .alignment = column.kind == CellKind::kNumber ? 1.0 : 0.0};
  }

  static CellPadding cell_padding(const DocumentTable& table, const Column& column) {
    if (!table.dense) return {};
    constexpr double kNarrow = 0.7 * kMm, kBeforeWords = 2.0 * kMm;
    const bool is_words = column.kind != CellKind::kNumber && column.kind != CellKind::kSymbol;
    return {is_words ? kBeforeWords : kNarrow, kNarrow};
  }

  /// A row with the text of every cell in one line.
  Row table_row(const DocumentTable& table, const std::vector<std::string>& texts, bool is_head) const {
    Row row{.cells = {}, .padding = {}, .x = {}, .widths = {}};
    for (std::size_t c = 0; c < texts.size(); ++c) {
      const Column& column = table.columns[c];
      TextStyle style = cell_style(table, column);
      style.bold = is_head;
      row.cells.push_back(cell(texts[c], is_head ? heading_kind(column) : column.kind, style));
      row.padding.push_back(cell_padding(table, column));
    }
    if (!is_head) return row;
    row.above = row.below = 0.9 * kMm;
    row.line = 0.3 * kMm;
    row.line_colour = kBlue;
    row.element = "TH";
    row.is_head = true;
    return row;
  }

  /// A heading within the table.
  Row group_row(const std::string& text) const {
    Row row{.cells = {}, .padding = {CellPadding{}}, .x = {kSide}, .widths = {kWidth}};
    row.cells.push_back(lines(text,
                              {.size = kTableSize, .leading = kTableLeading, .bold = true, .colour = kBlue},
                              kWidth - row.padding[0].left - row.padding[0].right));
    row.above = 2.0 * kMm;
    row.below = 0.9 * kMm;
    row.line = 0.2 * kMm;
    row.line_colour = 0x8a9aa8;
    row.element = "TH";
    return row;
  }

  /// The widths that a cell needs, with its padding.
  ColumnNeed need_of(const TextLines& in_one_line, const std::string& text, CellKind kind,
                     const TextStyle& style, const CellPadding& padding) const {
    const double inside = padding.left + padding.right, natural = in_one_line.width() + inside;
    if (kind == CellKind::kNumber || kind == CellKind::kUnit) return {natural, natural};
    // A long word may be broken: a file's name, a hash.
    constexpr std::size_t kPart = 12;
    std::string word = longest_word(text);
    if (kind == CellKind::kText && has_long_word(word)) word.resize(std::min(word.size(), kPart));
    if (word.size() == text.size()) return {natural, natural};
    return {cell(word, kind, style).width() + inside, natural};
  }

  /// Gives every row the widths of the columns.
  void fit(const DocumentTable& table, std::vector<Row>& rows,
           const std::vector<const std::vector<std::string>*>& texts) const {
    std::vector<ColumnNeed> needs(table.columns.size());
    for (std::size_t r = 0; r < rows.size(); ++r) {
      if (texts[r] == nullptr) continue;  // a heading within the table
      for (std::size_t c = 0; c < rows[r].cells.size(); ++c) {
        const bool is_head = rows[r].is_head;
        TextStyle style = cell_style(table, table.columns[c]);
        style.bold = is_head;
        const CellKind kind = is_head ? heading_kind(table.columns[c]) : table.columns[c].kind;
        const ColumnNeed need = need_of(rows[r].cells[c], (*texts[r])[c], kind, style, rows[r].padding[c]);
        needs[c].least = std::max(needs[c].least, need.least);
        needs[c].natural = std::max(needs[c].natural, need.natural);
      }
    }
    const std::vector<double> widths = column_widths(needs, kWidth);
    std::vector<double> x{kSide};
    for (const double width : widths) x.push_back(x.back() + width);
    for (std::size_t r = 0; r < rows.size(); ++r) {
      if (texts[r] == nullptr) continue;
      // A row with fewer cells still has its line over the whole table.
      rows[r].x.assign(x.begin(), x.end() - 1);
      rows[r].widths = widths;
      for (std::size_t c = 0; c < rows[r].cells.size(); ++c)
        rows[r].cells[c].fit(widths[c] - rows[r].padding[c].left - rows[r].padding[c].right);
    }
  }

  void add(const DocumentTable& table) {
    std::vector<std::string> headings;
    for (const Column& column : table.columns) headings.push_back(column.heading);
    std::vector<Row> rows;
    std::vector<const std::vector<std::string>*> texts{&headings};
    rows.push_back(table_row(table, headings, true));
    for (const std::vector<std::string>& cells : table.rows) {
      require_columns(table, cells);
      const bool is_group = cells.size() == 1 && table.columns.size() > 1;
      rows.push_back(is_group ? group_row(cells.front()) : table_row(table, cells, false));
      texts.push_back(is_group ? nullptr : &cells);
    }
    fit(table, rows, texts);

    constexpr double kAbove = 2.0 * kMm, kBelow = 3.0 * kMm;
    const PaperTag tag = next("Table");
    if (!table.caption.empty()) add_caption(table, tag, kAbove);
    const bool whole = stays_whole(table);
    std::shared_ptr<const Piece> head;
    for (std::size_t r = 0; r < rows.size(); ++r) {
      const bool is_last = r + 1 == rows.size();
      // The first two rows stay with the head, and the last ones with each other.
      const bool together = whole || r <= 1 || texts[r] == nullptr || r + kLastRowsTogether >= rows.size();
      add_row(std::make_shared<Row>(std::move(rows[r])), tag, head,
              {.above = r == 0 && table.caption.empty() ? kAbove : 0.0,
               .below = is_last ? kBelow : 0.0,
               .keep_with_next = together && !is_last,
               .draw = {}});
      if (r == 0) head = std::make_shared<Piece>(pieces_.back());
    }
  }

  void add_caption(const DocumentTable& table, const PaperTag& tag, double above) {
    constexpr TextStyle kStyle{.size = kTableSize, .leading = kTableLeading, .colour = kDarkGrey};
    const auto words = std::make_shared<TextLines>(std::move(
        TextLines(setter_, cell_runs(caption_text(table), table.caption_kind), kStyle).fit(kWidth)));
    add_piece({.height = words->height(),
               .above = above,
               .below = 1.0 * kMm,
               .keep_with_next = true,
               .tags = {document_, tag, next("Caption")},
               .draw = [words](const PaperPen& pen, double y) { words->draw(pen.cairo, kSide, y); }});
  }

  // --- Figures ---

  void add(const Figure& figure) {
    constexpr double kScale = kWidth / kPictureWidth, kBeforeCaption = 1.0 * kMm;
    const auto words = std::make_shared<TextLines>(
        lines(fmt::format(fmt::runtime(content_.figure_words), ++figures_, figure.caption),
              {.size = kTableSize, .colour = kDarkGrey}));
    const double height = kScale * figure.drawing.height;
    add_piece({.height = height + kBeforeCaption + words->height(),
               .above = 3.0 * kMm,
               .below = 4.0 * kMm,
               .tags = {document_},
               .draw = [this, words, height, &figure](const PaperPen& pen, double y) {
                 pen.in_element("Figure", [&] {
                   cairo_save(pen.cairo);
                   cairo_translate(pen.cairo, kSide, y);
                   cairo_scale(pen.cairo, kScale, kScale);
                   for (const auto& element : figure.drawing.elements)
                     std::visit([&](const auto& each) { draw(pen.cairo, setter_, each); }, element);
                   cairo_restore(pen.cairo);
                 });
                 pen.in_element("Caption",
                                [&] { words->draw(pen.cairo, kSide, y + height + kBeforeCaption); });
               }});
  }

  // --- Pages ---

  /// Texts at the left and at the right of a margin.
  void draw_margin(cairo_t* cairo, double middle, const std::string& left, const std::string& right,
                   const TextStyle& of_right) const {
    constexpr double kSize = 8.0, kGap = 4.0 * kMm, kMostOfRight = 0.5 * kWidth;
    TextLines at_right(setter_, right, of_right);
    at_right.fit(std::min(at_right.width(), kMostOfRight));
    const double width = right.empty() ? 0.0 : std::min(at_right.width(), kMostOfRight) + kGap;
    const TextLines at_left = lines(left, {.size = kSize, .colour = kGrey}, kWidth - width);
    at_left.draw(cairo, kSide, middle - at_left.height() / 2.0);
    at_right.draw(cairo, kPaperWidth - kSide - width + kGap, middle - at_right.height() / 2.0);
  }

  void draw_mark(cairo_t* cairo) const {
    constexpr double kOpacity = 0.13, kTurn = -35.0 * std::numbers::pi / 180.0;
    const TextLines mark(setter_, content_.page_mark, {.size = 90.0, .bold = true, .colour = kRed});
    cairo_save(cairo);
    cairo_translate(cairo, kPaperWidth / 2.0, kPaperHeight / 2.0);
    cairo_rotate(cairo, kTurn);
    cairo_push_group(cairo);
    mark.draw(cairo, -mark.width() / 2.0, -mark.height() / 2.0);
    cairo_pop_group_to_source(cairo);
    cairo_paint_with_alpha(cairo, kOpacity);
    cairo_restore(cairo);
  }

  void draw_margins(cairo_t* cairo, int number, std::size_t count) const {
    constexpr double kSize = 8.0;
    if (!content_.page_mark.empty()) draw_mark(cairo);
    draw_margin(cairo, kTop / 2.0, content_.identification, margin_cautions(content_),
                {.size = kSize, .bold = true, .colour = kRed});
    draw_margin(cairo, kPaperHeight - kBottom / 2.0, content_.origin,
                fmt::format(fmt::runtime(content_.page_words), number, count),
                {.size = kSize, .colour = kGrey});
  }

  static cairo_status_t append(void* to, const unsigned char* data, unsigned length) {
    static_cast<std::string*>(to)->append(reinterpret_cast<const char*>(data), length);
    return CAIRO_STATUS_SUCCESS;
  }

  std::string written(const std::vector<std::vector<PlacedPiece>>& pages) const {
    std::string bytes;
    const std::unique_ptr<cairo_surface_t, decltype(&cairo_surface_destroy)> surface(
        cairo_pdf_surface_create_for_stream(append, &bytes, kPaperWidth, kPaperHeight),
        cairo_surface_destroy);
    cairo_pdf_surface_set_metadata(surface.get(), CAIRO_PDF_METADATA_TITLE,
                                   valid_text(content_.title + ", " + content_.identification).c_str());
    {
      const std::unique_ptr<cairo_t, decltype(&cairo_destroy)> cairo(cairo_create(surface.get()),
                                                                     cairo_destroy);
      draw_pages(cairo.get(), pages, kTop,
                 [&](int number) { draw_margins(cairo.get(), number, pages.size()); });
    }
    cairo_surface_finish(surface.get());
    if (const cairo_status_t status = cairo_surface_status(surface.get()); status != CAIRO_STATUS_SUCCESS)
      throw std::runtime_error(fmt::format("the pages cannot be drawn: {}", cairo_status_to_string(status)));
    return bytes;
  }

  const Document& content_;
  TextSetter setter_;
  TextLines bullet_{setter_, "•", {}};
  std::vector<Piece> pieces_;
  const PaperTag document_{"Document", 0};
  int tags_ = 0, figures_ = 0;
  bool on_new_page_ = false;
};

}  // namespace

std::string document_pdf(const Document& document) {
  return PaperBuilder(document).build();
}

}  // namespace abcal
