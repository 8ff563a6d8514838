#include "app/document/document_html.h"

#include <fmt/format.h>
#include <libxml/HTMLtree.h>
#include <libxml/parser.h>
#include <libxml/tree.h>

#include <algorithm>
#include <cctype>
#include <functional>
#include <memory>
#include <new>
#include <string_view>

#include "app/document/drawing_svg.h"
#include "app/document/number_text.h"
#include "app/document/page_text.h"
#include "app/document/valid_text.h"
#include "app/formats/xml_tree.h"

namespace abcal {
namespace {

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
  const auto box = [](const char* place, const std::string& content, const char* more) {
    return fmt::format(
        "  @{} {{ content: {}; font-family: \"DejaVu Sans\", sans-serif; font-size: 8pt; {} }}\n", place,
        content, more);
  };
  constexpr const char* kGrey = "color: #505050;";
  return "@page {\n  size: A4;\n  margin: 20mm 15mm 17mm 15mm;\n" +
         box("top-left", css_string(document.identification), kGrey) +
         box("top-right", css_string(margin_cautions(document)), "color: #b00020; font-weight: 700;") +
         box("bottom-left", css_string(document.origin), kGrey) +
         box("bottom-right", page_number(document.page_words), kGrey) + "}\n";
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
    case CellKind::kLimits:
    case CellKind::kText:
      break;
  }
  return nullptr;
}

class PageBuilder {
 public:
  explicit PageBuilder(const Document& content) : content_(content), document_(xmlNewDoc(as_xml("1.0"))) {
    if (!document_) throw std::bad_alloc();
    document_->type = XML_HTML_DOCUMENT_NODE;
    xmlCreateIntSubset(document_.get(), as_xml("html"), nullptr, nullptr);
  }

  std::string build() {
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
    return serialised([this](xmlOutputBuffer* buffer) {
      htmlDocContentDumpFormatOutput(buffer, document_.get(), "UTF-8", 0);
    });
  }

  std::string build_part() {
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
    const bool whole = stays_whole(content);
    // WeasyPrint breaks after a first row whose second does not fit, in spite of the style.
    if (!whole) add(part, "div", "room");
    xmlNode* table = add(part, "table",
                         whole           ? content.dense ? "whole dense" : "whole"
                         : content.dense ? "dense"
                                         : nullptr);
    if (!content.caption.empty())
      cell_text(add(table, "caption"), caption_text(content), content.caption_kind);
    xmlNode* heading = add(add(table, "thead"), "tr");
    for (const Column& column : content.columns) {
      cell_text(add(heading, "th", column.kind == CellKind::kNumber ? "number" : nullptr), column.heading,
                heading_kind(column));
    }
    const std::size_t rows = content.rows.size();
    xmlNode* body = nullptr;
    for (std::size_t r = 0; r < rows; ++r) {
      const std::vector<std::string>& cells = content.rows[r];
      const bool ends = !whole && r > 0 && r + kLastRowsTogether == rows;
      if (r == 0 || ends) body = add(table, "tbody", ends ? "together" : nullptr);
      xmlNode* row = add(body, "tr");
      if (cells.size() == 1) {
        attribute(row, "class", "group");
        xmlNode* group = add(row, "th", "group", cells.front());
        attribute(group, "colspan", std::to_string(content.columns.size()));
        continue;
      }
      require_columns(content, cells);
      for (std::size_t c = 0; c < cells.size(); ++c) {
        const CellKind kind = content.columns[c].kind;
        const char* css = kind == CellKind::kText && has_long_word(cells[c]) ? "long" : css_class(kind);
        cell_text(add(row, "td", css), cells[c], kind);
      }
    }
  }

  void block(xmlNode* part, const Figure& figure) {
    xmlNode* node = add(part, "figure");
    add_svg(node, figure.drawing, figure.caption);
    add(node, "figcaption", nullptr,
        fmt::format(fmt::runtime(content_.figure_words), ++figures_, figure.caption));
  }

  void cell_text(xmlNode* node, const std::string& text, CellKind kind) {
    for (const TextRun& run : cell_runs(text, kind))
      run.is_index ? static_cast<void>(add(node, "sub", nullptr, run.text)) : add_text(node, run.text);
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
  int figures_ = 0;
};

}  // namespace

std::string document_html(const Document& document) {
  return PageBuilder(document).build();
}

std::string embedded_html(const Section& section) {
  Document document;
  document.figure_words = "{1}";
  document.sections.push_back(section);
  return PageBuilder(document).build_part();
}

}  // namespace abcal
