// The neutral document as a page and as text: the given texts appear unchanged in both.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <libxml/HTMLparser.h>
#include <libxml/xpath.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "app/document/document_html.h"
#include "app/document/document_text.h"
#include "app/document/gnuplot.h"
#include "app/document/valid_text.h"
#include "app/document/weasyprint.h"
#include "app/system/child_process.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

constexpr const char* kEvil = "<script>alert(1)</script> & \"</style>\" '</title>' \\22 }";

Document small_document() {
  Document document;
  document.title = "Title";
  document.identification = "a.run";
  document.sections.push_back({"Section", {Paragraph{"text"}}});
  return document;
}

/// A page as a browser reads it.
class ParsedPage {
 public:
  explicit ParsedPage(const std::string& html)
      : document_(htmlReadMemory(html.data(), static_cast<int>(html.size()), nullptr, "utf-8",
                                 HTML_PARSE_NONET | HTML_PARSE_NOERROR | HTML_PARSE_NOWARNING),
                  xmlFreeDoc) {}

  /// The text or attribute values that an XPath expression finds.
  std::vector<std::string> find(const std::string& path) const {
    std::vector<std::string> found;
    const std::unique_ptr<xmlXPathContext, decltype(&xmlXPathFreeContext)> context(
        xmlXPathNewContext(document_.get()), xmlXPathFreeContext);
    const std::unique_ptr<xmlXPathObject, decltype(&xmlXPathFreeObject)> result(
        xmlXPathEvalExpression(reinterpret_cast<const xmlChar*>(path.c_str()), context.get()),
        xmlXPathFreeObject);
    for (int i = 0; result && result->nodesetval != nullptr && i < result->nodesetval->nodeNr; ++i) {
      const std::unique_ptr<xmlChar, decltype(xmlFree)> text(
          xmlNodeGetContent(result->nodesetval->nodeTab[i]), xmlFree);
      found.emplace_back(reinterpret_cast<const char*>(text.get()));
    }
    return found;
  }

 private:
  std::unique_ptr<xmlDoc, decltype(&xmlFreeDoc)> document_;
};

TEST(DocumentHtmlTest, MarkupInATextStaysText) {
  Document document = small_document();
  document.title = document.subtitle = document.identification = document.origin = document.page_mark = kEvil;
  document.cautions = {kEvil};
  document.sections = {
      {kEvil,
       {Paragraph{kEvil}, BulletList{{kEvil}}, FactList{{{kEvil, kEvil}}},
        DocumentTable{kEvil, {{kEvil}, {kEvil, CellKind::kSymbol}}, {{kEvil, kEvil}, {kEvil}}}}}};
  const ParsedPage page(document_html(document).html);
  EXPECT_THAT(page.find("//script"), IsEmpty());
  for (const char* path : {"//h1", "//h2", "//p[@class='caution']", "//section/p", "//li", "//caption",
                           "//table[@class='facts']//td[2]", "//th[@class='group']"}) {
    EXPECT_THAT(page.find(path), ElementsAre(kEvil)) << path;
  }
  // The title and the style sheet end where they should: nothing of them is in the body.
  EXPECT_EQ(page.find("//head/style").size(), 1U);
  EXPECT_THAT(page.find("//body//style"), IsEmpty());
  EXPECT_THAT(page.find("//title").at(0), HasSubstr("alert(1)"));
}

TEST(DocumentHtmlTest, ANameCannotLeaveTheStringOfTheStyleSheet) {
  Document document = small_document();
  document.identification = "\"; } body { display: none } \n\\";
  const std::string html = document_html(document).html;
  const std::string style = ParsedPage(html).find("//head/style").at(0);
  EXPECT_THAT(style, Not(HasSubstr("display: none")));
  EXPECT_THAT(style, HasSubstr("\\22 \\3b \\20 \\7d \\20 body"));
}

TEST(DocumentHtmlTest, BytesThatAreNoTextAreShownAsSuch) {
  EXPECT_EQ(valid_text("a\xFF\x01z\x1B[2J\tb"), "a\xEF\xBF\xBD z [2J\tb");
  EXPECT_EQ(valid_text("\xC3\xA4 \xE2\x82\xAC \xF0\x9F\x9B\xB0"), "\xC3\xA4 \xE2\x82\xAC \xF0\x9F\x9B\xB0");
  Document document = small_document();
  document.sections = {{"S", {Paragraph{std::string("nul\0 and \xFF", 10)}}}};
  EXPECT_THAT(ParsedPage(document_html(document).html).find("//section/p").at(0), HasSubstr("nul"));
}

TEST(DocumentHtmlTest, SymbolsAndUnitsGetTheirSigns) {
  Document document = small_document();
  document.sections = {{"S",
                        {DocumentTable{"",
                                       {{"q", CellKind::kSymbol}, {"u", CellKind::kUnit}},
                                       {{"phi_uv", "degree"}, {"s_ux", "g/g_loc"}}}}}};
  const ParsedPage page(document_html(document).html);
  EXPECT_THAT(page.find("//td[@class='symbol']"), ElementsAre("φuv", "sux"));
  EXPECT_THAT(page.find("//td/sub"), ElementsAre("uv", "ux", "loc"));
  EXPECT_THAT(page.find("//td[@class='unit']"), ElementsAre("°", "g/gloc"));
}

// For any text above a table: its second row takes three lines, so that it often does not fit below the
// first.
TEST(DocumentHtmlTest, NoRowStandsAloneAtTheFootOrTheHeadOfAPage) {
  const Tool kPdfText{"pdftotext", "the test needs", "poppler-utils"};
  if (!is_installed(kWeasyPrint)) GTEST_SKIP() << "weasyprint is not installed";
  if (!is_installed(kPdfText)) GTEST_SKIP() << "poppler-utils is not installed";
  constexpr int kRows = 12;
  // Lines above the table with which its last or its first row stood alone.
  constexpr std::array kAbove{41, 42, 43, 52, 53, 54};
  Document document = small_document();
  for (const int above : kAbove) {
    Section section{"Section", {}};
    section.on_new_page = true;
    std::string lines;
    for (int line = 0; line < above; ++line) lines += std::string(95, 'a') + " ";
    section.blocks.push_back(Paragraph{lines});
    DocumentTable table{"", {{"heading", CellKind::kNumber}, {"words"}}, {}};
    table.may_break = true;
    for (int row = 1; row <= kRows; ++row)
      table.rows.push_back({fmt::format("row {} of {}.", row, above), std::string(row == 2 ? 250 : 1, 'x')});
    section.blocks.emplace_back(std::move(table));
    document.sections.push_back(std::move(section));
  }
  const test::TemporaryFolder folder;
  test::write_file(folder / "page.html", document_html(document).html);
  const std::string page = (folder / "page.html").string(), pdf = (folder / "page.pdf").string();
  ASSERT_EQ(run_tool_for_words(kWeasyPrint, {"--quiet", page, pdf}, std::chrono::minutes(2)).exit_code, 0);
  const std::string shown = (folder / "page.txt").string();
  ASSERT_EQ(run_tool(kPdfText, {"-layout", pdf, shown}), 0);
  const std::string text = test::read_file(shown);
  int broken = 0;
  for (const int above : kAbove) {
    const auto page_of = [&](int row) {
      const std::size_t at = text.find(fmt::format("row {} of {}.", row, above));
      EXPECT_NE(at, std::string::npos) << row << " of " << above;
      return std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(std::min(at, text.size())),
                        '\f');
    };
    EXPECT_EQ(page_of(1), page_of(2)) << above << " lines above the table";
    EXPECT_EQ(page_of(kRows - 1), page_of(kRows)) << above << " lines above the table";
    broken += page_of(1) != page_of(kRows) ? 1 : 0;
  }
  EXPECT_GE(broken, 1) << "no table reached the foot of a page";
}

TEST(DocumentHtmlTest, PicturesOfOnePageDoNotShareIds) {
  if (!is_installed(kGnuplot)) GTEST_SKIP() << "gnuplot is not installed";
  Document document = small_document();
  const Figure figure{"A & B", "plot x with points pt 6"};
  document.sections = {{"S", {figure, figure}}};
  const HtmlPage made = document_html(document);
  EXPECT_THAT(made.warnings, IsEmpty());
  const ParsedPage page(made.html);
  const std::vector<std::string> ids = page.find("//@id");
  EXPECT_GT(ids.size(), 4U);
  EXPECT_EQ(std::set<std::string>(ids.begin(), ids.end()).size(), ids.size());
  // Nothing refers to anything: symbols are drawn in place, as WeasyPrint draws no references.
  EXPECT_THAT(page.find("//@*[local-name()='href']"), IsEmpty());
  EXPECT_THAT(page.find("//figcaption"), ElementsAre("Figure 1: A & B", "Figure 2: A & B"));
}

TEST(GnuplotTest, ATextIsNeverACommand) {
  EXPECT_EQ(gnuplot_quoted("it's `date`\n\"$x\""), "'it''s `date` \"$x\"'");
  if (!is_installed(kGnuplot)) GTEST_SKIP() << "gnuplot is not installed";
  const std::string svg =
      draw_svg({"c", "set ylabel " + gnuplot_quoted("`echo run` @x 'q' $y") + "\nplot x"});
  EXPECT_THAT(svg, HasSubstr("`echo run` @x 'q' $y"));
}

TEST(DocumentTextTest, TablesAreSetInColumnsAndTheTerminalIsLeftAlone) {
  Document document = small_document();
  document.cautions = {"Not complete: 3 of 4"};
  document.sections = {
      {"Numbers",
       {DocumentTable{"", {{"name"}, {"value", CellKind::kNumber}}, {{"a", "1"}, {"longer", "-22.5"}}},
        Paragraph{"clear\x1B[2J\nnext"}}}};
  std::FILE* file = std::tmpfile();  // not a terminal: no colours
  EXPECT_EQ(document_text(document, file),
            "Title\n"
            "!!! Not complete: 3 of 4\n"
            "\nNumbers\n"
            "  name    value\n"
            "  a           1\n"
            "  longer  -22.5\n"
            "\nclear [2J next\n");
  std::fclose(file);
}

}  // namespace
}  // namespace abcal
