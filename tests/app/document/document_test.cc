// The neutral document as a page and as text: the given texts appear unchanged in both.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <functional>
#include <string>
#include <variant>
#include <vector>

#include "app/document/document_html.h"
#include "app/document/document_text.h"
#include "app/document/gnuplot.h"
#include "app/document/plot.h"
#include "app/document/valid_text.h"
#include "app/document/weasyprint.h"
#include "app/document/write_pdf.h"
#include "app/system/child_process.h"
#include "app/system/helper_program.h"
#include "tests/support/parsed_page.h"
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

TEST(DocumentHtmlTest, MarkupInATextStaysText) {
  Document document = small_document();
  document.title = document.subtitle = document.identification = document.origin = document.page_mark = kEvil;
  document.cautions = {kEvil};
  document.sections = {
      {kEvil,
       {Paragraph{kEvil}, BulletList{{kEvil}}, FactList{{{kEvil, kEvil}}},
        DocumentTable{kEvil, {{kEvil}, {kEvil, CellKind::kSymbol}}, {{kEvil, kEvil}, {kEvil}}}}}};
  const test::ParsedPage page(document_html(document));
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
  const std::string html = document_html(document);
  const std::string style = test::ParsedPage(html).find("//head/style").at(0);
  EXPECT_THAT(style, Not(HasSubstr("display: none")));
  EXPECT_THAT(style, HasSubstr("\\22 \\3b \\20 \\7d \\20 body"));
}

TEST(DocumentHtmlTest, BytesThatAreNoTextAreShownAsSuch) {
  EXPECT_EQ(valid_text("a\xFF\x01z\x1B[2J\tb"), "a\xEF\xBF\xBD z [2J\tb");
  EXPECT_EQ(valid_text("\xC3\xA4 \xE2\x82\xAC \xF0\x9F\x9B\xB0"), "\xC3\xA4 \xE2\x82\xAC \xF0\x9F\x9B\xB0");
  Document document = small_document();
  document.sections = {{"S", {Paragraph{std::string("nul\0 and \xFF", 10)}}}};
  EXPECT_THAT(test::ParsedPage(document_html(document)).find("//section/p").at(0), HasSubstr("nul"));
}

TEST(DocumentHtmlTest, SymbolsAndUnitsGetTheirSigns) {
  Document document = small_document();
  document.sections = {{"S",
                        {DocumentTable{"",
                                       {{"q", CellKind::kSymbol}, {"u", CellKind::kUnit}},
                                       {{"phi_uv", "degree"}, {"s_ux", "g/g_loc"}}}}}};
  const test::ParsedPage page(document_html(document));
  EXPECT_THAT(page.find("//td[@class='symbol']"), ElementsAre("φuv", "sux"));
  EXPECT_THAT(page.find("//td/sub"), ElementsAre("uv", "ux", "loc"));
  EXPECT_THAT(page.find("//td[@class='unit']"), ElementsAre("°", "g/gloc"));
}

// For any text above a table: its second row takes three lines, so that it often does not fit below the
// first.
void expect_no_row_alone(
    const std::function<void(const Document& document, const std::filesystem::path& pdf)>& print) {
  const Tool kPdfText{"pdftotext", "the test needs", "poppler-utils"};
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
  const std::string pdf = (folder / "page.pdf").string();
  print(document, pdf);
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

TEST(DocumentHtmlTest, NoRowStandsAloneAtTheFootOrTheHeadOfAPage) {
  if (!is_installed(kWeasyPrint)) GTEST_SKIP() << "weasyprint is not installed";
  expect_no_row_alone([](const Document& document, const std::filesystem::path& pdf) {
    const std::filesystem::path page = std::filesystem::path(pdf).replace_extension(".html");
    test::write_file(page, document_html(document));
    ASSERT_EQ(
        run_tool_for_words(kWeasyPrint, {"--quiet", page.string(), pdf.string()}, std::chrono::minutes(2))
            .exit_code,
        0);
  });
}

TEST(PaperTest, NoRowStandsAloneAtTheFootOrTheHeadOfAPage) {
  set_helper_folder(std::filesystem::path(test::abcal_program()).parent_path());
  expect_no_row_alone([](const Document& document, const std::filesystem::path& pdf) {
    write_pdf(document, pdf, std::nullopt);
  });
}

TEST(DocumentHtmlTest, PicturesHaveNoIdsAndTheirTextsStayTexts) {
  Document document = small_document();
  const Figure figure{
      "A & B",
      plot({{.title = kEvil,
             .x = {.label = kEvil, .unit = {}},
             .y = {.label = {}, .unit = kEvil},
             .series = {{.name = kEvil, .colour = "#000000", .line = true, .x = {0, 1}, .y = {0, 1}}}}},
           300.0)};
  document.sections = {{"S", {figure, figure}}};
  const test::ParsedPage page(document_html(document));
  EXPECT_EQ(page.find("//*[local-name()='svg']").size(), 2U);
  EXPECT_THAT(page.find("//script"), IsEmpty());
  EXPECT_THAT(page.find("//@id"), IsEmpty());
  EXPECT_THAT(page.find("//@*[local-name()='href']"), IsEmpty());
  const std::vector<std::string> texts = page.find("//*[local-name()='text']");
  EXPECT_EQ(std::count(texts.begin(), texts.end(), kEvil), 2 * 4);
  EXPECT_THAT(page.find("//figcaption"), ElementsAre("Figure 1: A & B", "Figure 2: A & B"));
}

/// The numbers of an axis at the left, and its label.
std::vector<std::string> texts_of(const Drawing& drawing) {
  std::vector<std::string> texts;
  for (const auto& element : drawing.elements)
    if (const auto* label = std::get_if<PictureLabel>(&element)) texts.push_back(label->text);
  return texts;
}

TEST(PlotTest, AnAxisCountsInAPowerOfTenAndItsMarksAreAtTheirPlaces) {
  const PlotSeries series{.name = {},
                          .colour = "#000000",
                          .mark = PlotMark::kDisc,
                          .x = {0.0, 5.0, 10.0},
                          .y = {0.0, 2e-5, std::nan("")},
                          .half_width = {1e-6, 1e-6, 1e-6}};
  const Drawing drawing =
      plot({{.title = "title",
             .x = {.label = "x", .unit = {}, .low = 0.0, .high = 10.0, .step = 5.0},
             .y = {.label = "response", .unit = "V", .low = 0.0, .high = 2e-5, .step = 1e-5},
             .series = {series}}},
           200.0);
  EXPECT_THAT(texts_of(drawing),
              ElementsAre("0", "5", "10", "0", "10", "20", "x", "response (10⁻⁶ V)", "title"));
  // The first mark is in the corner of the frame, the second above the middle; what is no number is left out.
  std::vector<PicturePoint> corners, marks;
  for (const auto& element : drawing.elements) {
    const auto* path = std::get_if<PicturePath>(&element);
    if (path == nullptr) continue;
    if (path->stroke == "#404040") corners = path->lines.front();
    if (path->fill == "#000000")
      for (const std::vector<PicturePoint>& outline : path->lines) marks.push_back(outline.front());
  }
  ASSERT_EQ(marks.size(), 2U);
  ASSERT_GE(corners.size(), 4U);
  EXPECT_NEAR(marks[0][0], corners[0][0], 1e-9);
  EXPECT_NEAR(marks[0][1], corners[2][1] - 2.5, 1e-9) << "the outline begins above the place";
  EXPECT_NEAR(marks[1][0], (corners[0][0] + corners[1][0]) / 2.0, 1e-9);
  EXPECT_NEAR(marks[1][1], corners[0][1] - 2.5, 1e-9);
}

TEST(GnuplotTest, ATextIsNeverACommand) {
  EXPECT_EQ(gnuplot_quoted("it's `date`\n\"$x\""), "'it''s `date` \"$x\"'");
  if (!is_installed(kGnuplot)) GTEST_SKIP() << "gnuplot is not installed";
  const std::string svg = draw_svg("set ylabel " + gnuplot_quoted("`echo run` @x 'q' $y") + "\nplot x", 300);
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
