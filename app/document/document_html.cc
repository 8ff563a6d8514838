#include "app/document/document_html.h"

#include <fmt/format.h>
#include <libxml/HTMLtree.h>
#include <libxml/parser.h>
#include <libxml/tree.h>

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <cstring>
#include <functional>
#include <map>
#include <memory>
#include <numbers>
#include <optional>
#include <set>
#include <stdexcept>
#include <string_view>

#include "app/document/gnuplot.h"
#include "app/document/number_text.h"
#include "app/document/valid_text.h"
#include "app/formats/xml_tree.h"
#include "app/system/child_process.h"

namespace abcal {
namespace {

std::string_view text_of(const xmlChar* text) {
  return text != nullptr ? reinterpret_cast<const char*>(text) : "";
}

// --- Style -------------------------------------------------------------------------------------------------

/// A string of a style sheet. Everything but letters and digits is escaped: a name from a bench file must end
/// neither the string nor the style sheet.
std::string css_string(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : valid_text(text)) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte >= 0x80 || std::isalnum(byte) != 0) {
      quoted += c;
    } else {
      quoted += fmt::format("\\{:x} ", byte);
    }
  }
  return quoted + "\"";
}

constexpr const char* kStyle = R"(
html { font-family: "DejaVu Sans", "Liberation Sans", Arial, sans-serif; font-size: 8.6pt; line-height: 1.4;
       color: #1a1a1a; }
body { margin: 0 auto; max-width: 180mm; }
h1 { font-size: 17pt; font-weight: 600; line-height: 1.2; margin: 0 0 1mm 0; color: #10324e; }
h2 { font-size: 11.5pt; font-weight: 600; margin: 4.5mm 0 1.5mm 0; padding-bottom: 0.7mm; color: #10324e;
     border-bottom: 0.4mm solid #10324e; break-after: avoid; }
p { margin: 1.5mm 0; }
h2 + p { break-after: avoid; break-inside: avoid; }
p.subtitle { color: #505050; margin: 0 0 4mm 0; }
p.caution { border: 0.8mm solid #b00020; color: #b00020; background: #fff4f4; font-size: 10pt; font-weight: 700;
            line-height: 1.3; padding: 1.5mm 3mm; margin: 1.5mm 0; overflow-wrap: anywhere; }
p.missing { border: 0.3mm dashed #808080; padding: 2mm; color: #505050; }
ul { margin: 1.5mm 0; padding-left: 5mm; }
table { border-collapse: collapse; width: 100%; margin: 2mm 0 3mm 0; font-size: 8.2pt; line-height: 1.3; }
caption { text-align: left; padding-bottom: 1mm; break-after: avoid; color: #303030; }
thead { display: table-header-group; }
tr { break-inside: avoid; }
th { text-align: left; font-weight: 600; background: #e8eef3; border-bottom: 0.3mm solid #10324e;
     padding: 0.9mm 1.6mm; vertical-align: bottom; }
td { border-bottom: 0.15mm solid #d4d9de; padding: 0.3mm 1.6mm; vertical-align: top; }
td.long { overflow-wrap: anywhere; }
table.whole, tbody.together { break-inside: avoid; }
td.number, th.number { text-align: right; }
td.number { white-space: nowrap; font-variant-numeric: tabular-nums; }
td.unit { white-space: nowrap; }
th.group { background: none; border-bottom: 0.2mm solid #8a9aa8; padding-top: 2mm; color: #10324e;
           break-after: avoid; }
table.facts { table-layout: fixed; }
table.facts td { border-bottom: 0.15mm solid #e4e8eb; }
table.facts td.name { width: 56mm; color: #505050; }
sub { font-size: 8pt; line-height: 0; vertical-align: -1.5pt; }
tbody tr:first-child { break-after: avoid; }
tbody tr:last-child { break-before: avoid; }
figure { margin: 3mm 0 4mm 0; break-inside: avoid; }
figure svg { width: 100%; height: auto; display: block; }
figcaption { color: #303030; font-size: 8.2pt; margin-top: 1mm; }
div.room { height: 32mm; margin-bottom: -32mm; break-inside: avoid; break-after: avoid; }
section.new-page { break-before: page; }
div.both { display: table; table-layout: fixed; width: 100%; }
div.left, div.right { display: table-cell; width: 50%; vertical-align: top; }
div.both table.facts { margin: 0 0 1mm 0; }
div.left table.facts { width: 96.5%; }
div.both table.facts td.name { width: 33mm; }
table.dense th, table.dense td { padding-left: 0.7mm; padding-right: 0.7mm; font-size: 8pt; }
table.dense td:not(.number):not(.symbol), table.dense th:not(.number) { padding-left: 2mm; }
tr.group { break-after: avoid; }
p, li { orphans: 3; widows: 3; }
div.mark { position: fixed; top: 95mm; left: 0; width: 100%; text-align: center; font-size: 90pt; font-weight: 700;
           color: #b00020; opacity: 0.13; transform: rotate(-35deg); }
@media screen { body { padding: 8mm; } }
)";

/// "page {} of {}" with counters.
std::string page_number(const std::string& words) {
  std::string content;
  std::string_view rest = words;
  for (const char* counter : {"counter(page)", "counter(pages)"}) {
    const std::size_t at = std::min(rest.find("{}"), rest.size());
    content += css_string(std::string(rest.substr(0, at))) + " " + counter + " ";
    rest.remove_prefix(std::min(at + 2, rest.size()));
  }
  return content + css_string(std::string(rest));
}

std::string page_style(const Document& document) {
  // The text before the colon of each caution: "Not complete".
  std::string cautions = document.page_mark;
  for (const std::string& caution : document.cautions) {
    const std::string word = caution.substr(0, caution.find(':'));
    if (word != document.page_mark) cautions += (cautions.empty() ? "" : " · ") + word;
  }
  std::transform(cautions.begin(), cautions.end(), cautions.begin(),
                 [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
  const auto box = [](const char* place, const std::string& content, const char* more) {
    return fmt::format(
        "  @{} {{ content: {}; font-family: \"DejaVu Sans\", sans-serif; font-size: 8pt; {} }}\n", place,
        content, more);
  };
  constexpr const char* kGrey = "color: #505050;";
  return "@page {\n  size: A4;\n  margin: 20mm 15mm 17mm 15mm;\n" +
         box("top-left", css_string(document.identification), kGrey) +
         box("top-right", css_string(cautions), "color: #b00020; font-weight: 700;") +
         box("bottom-left", css_string(document.origin), kGrey) +
         box("bottom-right", page_number(document.page_words), kGrey) + "}\n";
}

// --- Pictures ----------------------------------------------------------------------------------------------

std::string value_of(const xmlNode* node, const char* attribute) {
  const std::unique_ptr<xmlChar, decltype(xmlFree)> value(xmlGetProp(node, as_xml(attribute)), xmlFree);
  return std::string(text_of(value.get()));
}

bool is(const xmlNode* node, const char* name) {
  return node != nullptr && text_of(node->name) == name;
}

/// Several pictures on one page: gnuplot gives each the same ids, so each gets a prefix of its own, where an
/// id is given and where it is referred to ("#gpDot", "url(#greybox)").
void prefix_ids(xmlNode* node, const std::string& prefix) {
  for (xmlAttr* attribute = node->properties; attribute != nullptr; attribute = attribute->next) {
    const std::unique_ptr<xmlChar, decltype(xmlFree)> content(
        xmlNodeListGetString(node->doc, attribute->children, 1), xmlFree);
    std::string value(text_of(content.get()));
    const std::string_view name = text_of(attribute->name);
    if (name == "id") {
      value = prefix + value;
    } else if (name == "href" && value.starts_with('#')) {
      value = "#" + prefix + value.substr(1);
    } else if (const std::size_t at = value.find("url(#"); at != std::string::npos) {
      value.insert(at + std::strlen("url(#"), prefix);
    } else {
      continue;
    }
    xmlSetNsProp(node, attribute->ns, attribute->name, as_xml(value.c_str()));
  }
}

/// gnuplot draws a mark in the colour of the place of its use ("currentColor"), on which WeasyPrint fails.
/// The place of use gets this colour as its stroke, for a filled mark as its fill, which all readers of SVG
/// inherit alike.
class MarkColours {
 public:
  void set(xmlNode* node) {
    if (is(node->parent, "defs")) {
      if (value_of(node, "stroke") == kColour) xmlUnsetProp(node, as_xml("stroke"));
      if (value_of(node, "fill") != kColour) return;
      xmlUnsetProp(node, as_xml("fill"));
      filled_.insert("#" + value_of(node, "id"));
      return;
    }
    const std::string colour = value_of(node, "color");
    if (!is(node, "use") || colour.empty()) return;
    xmlSetProp(node, as_xml("stroke"), as_xml(colour.c_str()));
    if (filled_.contains(value_of(node, "href"))) xmlSetProp(node, as_xml("fill"), as_xml(colour.c_str()));
  }

 private:
  static constexpr const char* kColour = "currentColor";
  std::set<std::string> filled_;  // The definitions precede their use.
};

/// Where and how large a mark is drawn: "translate(12.5,7) scale(1.65)".
struct Placed {
  double x = 0.0, y = 0.0, scale = 0.0;
};

std::optional<Placed> placed(const std::string& transform) {
  Placed at;
  char rest = '\0';
  if (std::sscanf(transform.c_str(), "translate(%lf,%lf) scale(%lf%c", &at.x, &at.y, &at.scale, &rest) != 4 ||
      rest != ')')
    return std::nullopt;
  return at;
}

/// The outline of a mark of gnuplot as a path; nothing for one that the figures do not use.
std::optional<std::string> outline(std::string_view mark, const Placed& at) {
  const auto& [x, y, s] = at;
  if (mark == "gpPt5" || mark == "gpPt6")
    return fmt::format("M{0:.2f},{1:.2f}a{2:.2f},{2:.2f} 0 1 0 {3:.2f},0a{2:.2f},{2:.2f} 0 1 0 {4:.2f},0z",
                       x - s, y, s, 2.0 * s, -2.0 * s);
  if (mark == "gpPt8")
    return fmt::format("M{:.2f},{:.2f}l{:.2f},{:.2f}h{:.2f}z", x, y - 1.33 * s, -1.33 * s, 2.0 * s, 2.66 * s);
  if (mark == "gpPt12") {
    const double half = std::numbers::sqrt2 * s;
    return fmt::format("M{:.2f},{:.2f}l{:.2f},{:.2f}l{:.2f},{:.2f}l{:.2f},{:.2f}z", x, y - half, half, half,
                       -half, half, -half, -half);
  }
  return std::nullopt;
}

/// Every mark is an element of its own, and WeasyPrint takes a millisecond for each: marks that follow one
/// another become one path.
void join_marks(xmlNode* first) {
  const std::string href = value_of(first, "href"), colour = value_of(first, "color");
  const std::string mark = href.substr(std::min(href.size(), href.rfind('_') + 1));
  std::string path;
  std::vector<xmlNode*> joined;
  for (xmlNode* node = first; is(node, "use"); node = node->next) {
    const auto at = placed(value_of(node, "transform"));
    if (!at || value_of(node, "href") != href || value_of(node, "color") != colour) break;
    const auto one = outline(mark, *at);
    if (!one) return;
    path += *one;
    joined.push_back(node);
  }
  if (joined.size() < 2) return;
  const bool open = mark == "gpPt5";
  xmlNode* drawn = xmlNewDocNode(first->doc, first->ns, as_xml("path"), nullptr);
  xmlNewProp(drawn, as_xml("d"), as_xml(path.c_str()));
  xmlNewProp(drawn, as_xml("stroke"), as_xml(open ? colour.c_str() : "none"));
  xmlNewProp(drawn, as_xml("fill"), as_xml(open ? "none" : colour.c_str()));
  if (open) xmlNewProp(drawn, as_xml("stroke-width"), as_xml("0.4"));
  xmlAddPrevSibling(first, drawn);
  for (xmlNode* node : joined) {
    xmlUnlinkNode(node);
    xmlFreeNode(node);
  }
}

/// join_marks() for a whole picture, in which the marks of one plot follow each other.
void join_all_marks(xmlNode* node) {
  for (xmlNode* child = node->children; child != nullptr;) {
    xmlNode* before = child->prev;
    if (is(child, "use") && !value_of(child, "color").empty()) join_marks(child);
    // The child may be gone; its replacement follows the node before it.
    xmlNode* now = before != nullptr ? before->next : node->children;
    if (now->type == XML_ELEMENT_NODE && !is(now, "use")) join_all_marks(now);
    child = now->next;
  }
}

void remove(xmlNode* node) {
  xmlUnlinkNode(node);
  xmlFreeNode(node);
}

/// Whether a group has only attributes that its children inherit; false for a clipping or an id.
bool only_hands_down(const xmlNode* group) {
  static const std::set<std::string_view> kHandedDown{"fill",         "color",          "stroke",
                                                      "stroke-width", "stroke-linecap", "stroke-linejoin",
                                                      "font-family",  "font-size",      "text-anchor"};
  const bool is_alone = group->children != nullptr && group->children->next == nullptr;
  for (const xmlAttr* attribute = group->properties; attribute != nullptr; attribute = attribute->next) {
    const std::string_view name = text_of(attribute->name);
    // The transformation of a group moves to its only child if that has none.
    if (name == "transform" && is_alone && !is(group->children, "g") &&
        value_of(group->children, "transform").empty())
      continue;
    if (!kHandedDown.contains(name)) return false;
  }
  return true;
}

/// gnuplot wraps each line and word into groups of its own, and leaves hundreds of empty ones; the time of
/// WeasyPrint grows with the number of elements. The attributes of a group are written to its children, which
/// replace it.
void unwrap_groups(xmlNode* node) {
  for (xmlNode* child = node->children; child != nullptr;) {
    xmlNode* next = child->next;
    if (child->type == XML_ELEMENT_NODE) unwrap_groups(child);
    if (is(child, "title") || is(child, "desc") || (is(child, "g") && xmlChildElementCount(child) == 0)) {
      remove(child);
    } else if (is(child, "g") && only_hands_down(child)) {
      while (xmlNode* inner = child->children) {
        if (inner->type == XML_ELEMENT_NODE)
          for (const xmlAttr* attribute = child->properties; attribute != nullptr;
               attribute = attribute->next)
            if (xmlHasProp(inner, attribute->name) == nullptr)
              xmlNewProp(inner, attribute->name,
                         as_xml(value_of(child, reinterpret_cast<const char*>(attribute->name)).c_str()));
        xmlAddPrevSibling(child, inner);
      }
      remove(child);
    }
    child = next;
  }
}

/// Lines of the frame and its grid are grey; data have colours.
bool is_frame(const xmlNode* node) {
  int red = 0, green = 1, blue = 2;
  return is(node, "path") &&
         std::sscanf(value_of(node, "stroke").c_str(), "rgb(%d, %d, %d)", &red, &green, &blue) == 3 &&
         red == green && green == blue && value_of(node, "transform").empty();
}

/// All lines of the frame that are drawn alike become one path.
void join_frame(xmlNode* parent, std::map<std::string, xmlNode*>& joined) {
  for (xmlNode* child = parent->children; child != nullptr;) {
    xmlNode* next = child->next;
    if (is(child, "g")) join_frame(child, joined);
    if (is_frame(child)) {
      std::string drawn;
      for (const char* name : {"stroke", "stroke-width", "stroke-dasharray", "fill", "stroke-linecap"})
        drawn += value_of(child, name) + "|";
      const auto [place, is_first] = joined.emplace(drawn, child);
      if (!is_first) {
        const std::string lines = value_of(place->second, "d") + value_of(child, "d");
        xmlSetProp(place->second, as_xml("d"), as_xml(lines.c_str()));
        remove(child);
      }
    }
    child = next;
  }
}

void prepare_picture(xmlNode* node, const std::string& prefix, MarkColours& marks) {
  for (; node != nullptr; node = node->next) {
    if (node->type != XML_ELEMENT_NODE) continue;
    prefix_ids(node, prefix);
    marks.set(node);
    prepare_picture(node->children, prefix, marks);
  }
}

// --- The page ----------------------------------------------------------------------------------------------

const char* css_class(CellKind kind) {
  switch (kind) {
    case CellKind::kNumber:
      return "number";
    case CellKind::kSymbol:
      return "symbol";
    case CellKind::kUnit:
      return "unit";
    case CellKind::kText:
      break;
  }
  return nullptr;
}

/// A word that may be broken anywhere, since it could be wider than the page. For other cells the style does
/// not allow it: WeasyPrint would need half as long again.
bool has_long_word(const std::string& text) {
  constexpr std::size_t kLong = 24;
  std::size_t length = 0;
  for (const char c : text) {
    length = c == ' ' ? 0 : length + 1;
    if (length > kLong) return true;
  }
  return false;
}

class PageBuilder {
 public:
  explicit PageBuilder(const Document& content) : content_(content), document_(xmlNewDoc(as_xml("1.0"))) {
    if (!document_) throw std::bad_alloc();
    document_->type = XML_HTML_DOCUMENT_NODE;
    xmlCreateIntSubset(document_.get(), as_xml("html"), nullptr, nullptr);
  }

  HtmlPage build() {
    xmlNode* html = xmlNewDocNode(document_.get(), nullptr, as_xml("html"), nullptr);
    xmlDocSetRootElement(document_.get(), html);
    attribute(html, "lang", content_.language);
    head(html);
    xmlNode* body = add(html, "body");
    if (!content_.page_mark.empty()) add(body, "div", "mark", content_.page_mark);
    add(body, "h1", nullptr, content_.title);
    if (!content_.subtitle.empty()) add(body, "p", "subtitle", content_.subtitle);
    for (const std::string& caution : content_.cautions) add(body, "p", "caution", typeset_numbers(caution));
    for (const Section& section : content_.sections)
      blocks(add(body, "section", section.on_new_page ? "new-page" : nullptr), section);
    page_.html = serialised([this](xmlOutputBuffer* buffer) {
      htmlDocContentDumpFormatOutput(buffer, document_.get(), "UTF-8", 0);
    });
    return std::move(page_);
  }

  std::string build_part(const std::string& figure_prefix) {
    figure_prefix_ = figure_prefix;
    xmlNode* part = xmlNewDocNode(document_.get(), nullptr, as_xml("div"), nullptr);
    xmlDocSetRootElement(document_.get(), part);
    for (const Section& section : content_.sections) blocks(part, section);
    return serialised([this, part](xmlOutputBuffer* buffer) {
      htmlNodeDumpFormatOutput(buffer, document_.get(), part, "UTF-8", 0);
    });
  }

 private:
  void blocks(xmlNode* part, const Section& section) {
    if (!section.title.empty()) add(part, "h2", nullptr, section.title);
    for (const Block& block : section.blocks)
      std::visit([&](const auto& each) { this->block(part, each); }, block);
  }

  xmlNode* add(xmlNode* parent, const char* name, const char* css = nullptr, const std::string& text = {}) {
    xmlNode* node = xmlNewChild(parent, nullptr, as_xml(name), nullptr);
    if (node == nullptr) throw std::bad_alloc();
    if (css != nullptr) attribute(node, "class", css);
    if (!text.empty()) add_text(node, text);
    return node;
  }
  void add_text(xmlNode* node, const std::string& text) {
    xmlAddChild(node, xmlNewDocText(document_.get(), as_xml(valid_text(text).c_str())));
  }
  void attribute(xmlNode* node, const char* name, const std::string& value) {
    xmlNewProp(node, as_xml(name), as_xml(valid_text(value).c_str()));
  }

  void head(xmlNode* html) {
    xmlNode* head = add(html, "head");
    attribute(add(head, "meta"), "charset", "utf-8");
    add(head, "title", nullptr, content_.title + ", " + content_.identification);
    const auto meta = [&](const char* name, const std::string& value) {
      xmlNode* node = add(head, "meta");
      attribute(node, "name", name);
      attribute(node, "content", value);
    };
    meta("viewport", "width=device-width, initial-scale=1");
    meta("generator", content_.origin);
    add(head, "style", nullptr, kStyle + page_style(content_));
  }

  void block(xmlNode* part, const Paragraph& paragraph) {
    add(part, "p", nullptr, typeset_numbers(paragraph.text));
  }

  void block(xmlNode* part, const BulletList& bullets) {
    if (bullets.items.empty()) return;
    xmlNode* list = add(part, "ul");
    for (const std::string& item : bullets.items) add(list, "li", nullptr, typeset_numbers(item));
  }

  void block(xmlNode* part, const FactList& list) {
    xmlNode* body = add(add(part, "table", "facts"), "tbody");
    for (const auto& [name, value] : list.facts) {
      xmlNode* row = add(body, "tr");
      add(row, "td", "name", name);
      add(row, "td", has_long_word(value) ? "long" : nullptr, value);
    }
  }

  void block(xmlNode* part, const SideBySide& lists) {
    xmlNode* both = add(part, "div", "both");
    block(add(both, "div", "left"), lists.left);
    block(add(both, "div", "right"), lists.right);
  }

  void block(xmlNode* part, const DocumentTable& content) {
    constexpr std::size_t kFitsOnAPage = 30;
    const bool whole = !content.may_break && content.rows.size() <= kFitsOnAPage;
    // WeasyPrint breaks after a first row whose second does not fit, in spite of the style.
    if (!whole) add(part, "div", "room");
    xmlNode* table = add(part, "table",
                         whole           ? content.dense ? "whole dense" : "whole"
                         : content.dense ? "dense"
                                         : nullptr);
    if (!content.caption.empty())
      cell_text(add(table, "caption"),
                content.caption_kind == CellKind::kText ? typeset_numbers(content.caption) : content.caption,
                content.caption_kind);
    xmlNode* heading = add(add(table, "thead"), "tr");
    for (const Column& column : content.columns) {
      // "s_ux" above a column of numbers.
      const bool is_symbol =
          column.heading.find('_') != std::string::npos && column.heading.find(' ') == std::string::npos;
      cell_text(add(heading, "th", column.kind == CellKind::kNumber ? "number" : nullptr), column.heading,
                is_symbol ? CellKind::kSymbol : CellKind::kText);
    }
    // The last rows stay together, so that none is alone on the next page.
    constexpr std::size_t kTogether = 3;
    const std::size_t rows = content.rows.size();
    xmlNode* body = nullptr;
    for (std::size_t r = 0; r < rows; ++r) {
      const std::vector<std::string>& cells = content.rows[r];
      const bool ends = !whole && r > 0 && r + kTogether == rows;
      if (r == 0 || ends) body = add(table, "tbody", ends ? "together" : nullptr);
      xmlNode* row = add(body, "tr");
      if (cells.size() == 1) {
        attribute(row, "class", "group");
        xmlNode* group = add(row, "th", "group", cells.front());
        attribute(group, "colspan", std::to_string(content.columns.size()));
        continue;
      }
      if (cells.size() > content.columns.size())
        throw std::logic_error(fmt::format("a row of {} cells, \"{}\", stands below a heading of {}",
                                           cells.size(), cells.front(), content.columns.size()));
      for (std::size_t c = 0; c < cells.size(); ++c) {
        const CellKind kind = content.columns[c].kind;
        const char* css = kind == CellKind::kText && has_long_word(cells[c]) ? "long" : css_class(kind);
        cell_text(add(row, "td", css), cells[c], kind);
      }
    }
  }

  void block(xmlNode* part, const Figure& figure) {
    xmlNode* node = add(part, "figure");
    try {
      add_picture(node, figure);
    } catch (const ProgramMissing& missing) {
      add(node, "p", "missing", fmt::format("No figure here: {}", missing.what()));
      if (page_.warnings.empty())
        page_.warnings.push_back(fmt::format("the page has no figures: {}", missing.what()));
    }
    add(node, "figcaption", nullptr,
        fmt::format(fmt::runtime(content_.figure_words), ++figures_, figure.caption));
  }

  void add_picture(xmlNode* node, const Figure& figure) {
    const std::string svg = draw_svg(figure);
    const XmlDocument drawn(xmlReadMemory(svg.data(), static_cast<int>(svg.size()), "figure.svg", nullptr,
                                          XML_PARSE_NONET | XML_PARSE_NOERROR | XML_PARSE_NOBLANKS));
    xmlNode* root = drawn ? xmlDocGetRootElement(drawn.get()) : nullptr;
    if (root == nullptr) throw std::runtime_error("gnuplot drew no picture: \"" + figure.caption + "\"");
    MarkColours marks;
    prepare_picture(root, fmt::format("{}{}_", figure_prefix_, figures_ + 1), marks);
    join_all_marks(root);
    unwrap_groups(root);
    std::map<std::string, xmlNode*> joined;
    join_frame(root, joined);
    xmlSetProp(root, as_xml("role"), as_xml("img"));
    xmlSetProp(root, as_xml("aria-label"), as_xml(valid_text(figure.caption).c_str()));
    xmlNode* copy = xmlDocCopyNode(root, document_.get(), 1);
    if (copy == nullptr) throw std::bad_alloc();
    xmlAddChild(node, copy);
  }

  /// "s_ux" with its index below, Greek letters, "°" and "²".
  void cell_text(xmlNode* node, const std::string& text, CellKind kind) {
    if (kind == CellKind::kNumber) return add_text(node, typeset_numbers(text));
    if (kind != CellKind::kSymbol && kind != CellKind::kUnit) return add_text(node, text);
    std::string_view rest = text;
    while (!rest.empty()) {
      const std::size_t at = std::min(rest.find('_'), rest.size());
      add_text(node, with_signs(rest.substr(0, at)));
      rest.remove_prefix(std::min(at + 1, rest.size()));
      if (rest.empty()) break;
      const auto end =
          std::find_if(rest.begin(), rest.end(), [](unsigned char c) { return std::isalnum(c) == 0; });
      const auto length = static_cast<std::size_t>(end - rest.begin());
      add(node, "sub", nullptr, with_signs(rest.substr(0, length)));
      rest.remove_prefix(length);
    }
  }

  static std::string with_signs(std::string_view text) {
    std::string result(text);
    for (const auto& [word, sign] :
         {std::pair{"phi", "φ"}, {"degree", "°"}, {"m/s2", "m/s²"}, {"g2", "g²"}, {"^2", "²"}, {"^3", "³"}}) {
      if (const std::size_t at = result.find(word); at != std::string::npos)
        result.replace(at, std::strlen(word), sign);
    }
    return result;
  }

  static std::string serialised(const std::function<void(xmlOutputBuffer*)>& write) {
    const std::unique_ptr<xmlOutputBuffer, decltype(&xmlOutputBufferClose)> buffer(
        xmlAllocOutputBuffer(nullptr), xmlOutputBufferClose);
    if (!buffer) throw std::bad_alloc();
    write(buffer.get());
    return {reinterpret_cast<const char*>(xmlOutputBufferGetContent(buffer.get())),
            xmlOutputBufferGetSize(buffer.get())};
  }

  const Document& content_;
  XmlDocument document_;
  HtmlPage page_;
  std::string figure_prefix_ = "f";
  int figures_ = 0;
};

}  // namespace

HtmlPage document_html(const Document& document) {
  return PageBuilder(document).build();
}

std::string embedded_html(const Section& section, const std::string& figure_prefix) {
  Document document;
  document.figure_words = "{1}";
  document.sections.push_back(section);
  return PageBuilder(document).build_part(figure_prefix);
}

}  // namespace abcal
