// A document as pages of paper: all its text in its order, within the edges, and the same bytes each time.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <filesystem>
#include <regex>
#include <sstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "app/document/band_figure.h"
#include "app/document/document_html.h"
#include "app/document/packed_document.h"
#include "app/document/write_pdf.h"
#include "app/system/child_process.h"
#include "app/system/helper_program.h"
#include "tests/support/parsed_page.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr const char* kHeading = "Eingangsgröße";

/// A document with blocks of every kind, of several pages, in German.
Document german_document() {
  Document document;
  document.language = "de";
  document.page_words = "Seite {} von {}";
  document.figure_words = "Bild {}: {}";
  document.title = "Bericht über eine Kalibrierung";
  document.subtitle = "Prüfling Ä-1";
  document.identification = "a.run · Straße";
  document.origin = "abcal, 29. November";
  document.created_utc = "2026-11-29T12:34:56.000Z";
  document.cautions = {
      "Simuliert: nicht an einem wirklichen Gerät gemessen, was hier in so vielen Worten steht, "
      "dass eine zweite Zeile nötig ist."};
  std::string sentences;
  for (int k = 1; k <= 60; ++k)
    sentences += fmt::format("Satz {} mit der Größe -1.2e-05 und offiziellem Fluss. ", k);
  DocumentTable table{
      "Werte von s_ux in g/g_loc",
      {{kHeading, CellKind::kSymbol}, {"Wert", CellKind::kNumber}, {"Einheit", CellKind::kUnit}, {"Worte"}},
      {}};
  table.caption_kind = CellKind::kUnit;
  table.may_break = true;
  for (int k = 1; k <= 90; ++k) {
    if (k % 30 == 10) table.rows.push_back({fmt::format("Gruppe {}", k)});
    table.rows.push_back({fmt::format("phi_u{}", k), fmt::format("{:.2e}", -1e-3 / k), "degree",
                          sentences.substr(0, static_cast<std::size_t>(20 * (k % 9)))});
  }
  const Figure figure =
      band_figure("Streifen & Kurve", "T (°C)", {{"s_u <µV>", {0, 1, 2}, {1, 3, 2}, {1, 1, 1}, {}, {}}});
  document.sections = {
      {"Ergebnis",
       {Paragraph{sentences}, BulletList{{"erster Punkt", sentences}},
        FactList{{{"Datei", "a.run"}, {"Ort", "Köln"}}},
        SideBySide{{{{"links", "eins"}}}, {{{"rechts", "zwei"}, {"rechts unten", "drei"}}}}}},
      {"Tabelle", {table}},
      {"Bild", {figure}}};
  document.sections.back().on_new_page = true;
  return document;
}

std::string without_blanks(std::string text) {
  text.erase(std::remove_if(text.begin(), text.end(), [](unsigned char c) { return c <= ' '; }), text.end());
  return text;
}

/// Removes all places but the first `kept` ones.
void remove_all(std::string& text, const std::string& what, int kept = 0) {
  for (std::size_t at = 0; (at = text.find(what, at)) != std::string::npos;)
    kept-- > 0 ? static_cast<void>(at += what.size()) : static_cast<void>(text.erase(at, what.size()));
}

class DocumentPdfTest : public testing::Test {
 protected:
  void SetUp() override {
    set_helper_folder(std::filesystem::path(test::abcal_program()).parent_path());
    if (!is_installed({"pdftotext", "the test needs", "poppler-utils"}))
      GTEST_SKIP() << "poppler-utils is not installed";
  }
  std::string bytes_of(const Document& document) {
    write_pdf(document, folder / "a.pdf", std::nullopt);
    return test::read_file(folder / "a.pdf");
  }
  std::string tool(const std::vector<std::string>& arguments) {
    test::Program program("/usr/bin/env", arguments, folder.path());
    EXPECT_EQ(program.wait(), 0) << program.err();
    return program.out();
  }

  test::TemporaryFolder folder;
};

TEST_F(DocumentPdfTest, HasTheTextOfThePageInItsOrder) {
  const Document document = german_document();
  bytes_of(document);
  std::istringstream pages(tool({"pdftotext", "-raw", "a.pdf", "-"}));
  std::vector<std::string> texts;
  for (std::string page; std::getline(pages, page, '\f');) texts.push_back(page);
  ASSERT_GE(texts.size(), 4U);
  std::string text;
  for (std::size_t k = 0; k < texts.size(); ++k) {
    // The margins of every page are no part of the text.
    std::string page = without_blanks(texts[k]);
    for (const std::string& margin : {document.identification, std::string("SIMULIERT"), document.origin,
                                      fmt::format("Seite {} von {}", k + 1, texts.size())}) {
      EXPECT_THAT(page, HasSubstr(without_blanks(margin))) << k;
      page.erase(page.find(without_blanks(margin)), without_blanks(margin).size());
    }
    text += page;
  }
  // The head of the table is repeated, and lists have points.
  const std::string head = without_blanks(std::string(kHeading) + "Wert Einheit Worte");
  EXPECT_NE(text.find(head), text.rfind(head));
  remove_all(text, head, 1);
  remove_all(text, "•");
  std::string expected;
  for (const std::string& each : test::ParsedPage(document_html(document)).find("//body//text()"))
    expected += each;
  EXPECT_EQ(text, without_blanks(expected));
}

TEST_F(DocumentPdfTest, NothingIsOutsideTheMargins) {
  Document document = german_document();
  DocumentTable wide{"", {{"words"}}, {{std::string(400, 'w')}}};
  std::vector<std::string>& row = wide.rows.front();
  for (int k = 0; k < 16; ++k) {
    wide.columns.push_back({"value of a column", CellKind::kNumber});
    row.emplace_back("-123456.789e-05");
  }
  std::string long_text;
  for (int k = 0; k < 900; ++k) long_text += "so many words that no page has room for them ";
  DocumentTable high{"", {{"a"}, {"b"}}, {{"1", long_text}, {"2", "x"}}};
  document.sections.push_back(
      {std::string(300, 'H'), {wide, high, FactList{{{std::string(90, 'n'), std::string(400, 'v')}}}}});
  document.identification = std::string(200, 'i');
  document.cautions.push_back(std::string(500, 'c'));
  bytes_of(document);
  const std::string boxes = tool({"pdftotext", "-bbox", "a.pdf", "-"});
  static const std::regex kWord(
      "<word xMin=\"(-?[0-9.]+)\" yMin=\"(-?[0-9.]+)\" xMax=\"(-?[0-9.]+)\" yMax=\"(-?[0-9.]+)\">");
  int words = 0;
  for (std::sregex_iterator each(boxes.begin(), boxes.end(), kWord), end; each != end; ++each, ++words) {
    constexpr double kMm = 72.0 / 25.4, kRounding = 0.5;
    EXPECT_GE(std::stod((*each)[1]), 15.0 * kMm - kRounding) << each->str();
    EXPECT_LE(std::stod((*each)[3]), 195.0 * kMm + kRounding) << each->str();
    EXPECT_GE(std::stod((*each)[2]), 0.0) << each->str();
    EXPECT_LE(std::stod((*each)[4]), 297.0 * kMm) << each->str();
  }
  EXPECT_GT(words, 9000);
}

TEST_F(DocumentPdfTest, TheBytesDependOnTheDocumentAlone) {
  const Document document = german_document();
  const std::string first = bytes_of(document);
  // A date of the clock would be another one now.
  std::this_thread::sleep_for(std::chrono::milliseconds(1100));
  EXPECT_EQ(bytes_of(document), first);
  Document other = document;
  other.created_utc = "2026-11-29T12:34:57.000Z";
  EXPECT_NE(bytes_of(other), first);
}

TEST_F(DocumentPdfTest, NamesItsTitleItsDateAndItsTags) {
  bytes_of(german_document());
  EXPECT_THAT(tool({"pdfinfo", "a.pdf"}), AllOf(testing::ContainsRegex("Tagged: +yes"), HasSubstr("A4")));
  EXPECT_THAT(tool({"pdfinfo", "-meta", "a.pdf"}),
              AllOf(HasSubstr("Bericht über eine Kalibrierung, a.run · Straße"),
                    HasSubstr("<xmp:CreateDate>2026-11-29T12:34:56.000Z<"), HasSubstr("<pdfaid:part>3<")));
  const std::string structure = tool({"pdfinfo", "-struct", "a.pdf"});
  for (const char* tag :
       {"Document", "H1", "H2", "P (block)", "LI", "Table", "Caption", "TR", "TH", "TD", "Figure"})
    EXPECT_THAT(structure, HasSubstr(tag));
}

TEST(PackedDocumentTest, GivesTheSameDocumentBack) {
  const Document document = german_document();
  const std::string bytes = packed(document);
  EXPECT_EQ(packed(unpacked(bytes)), bytes);
  EXPECT_EQ(document_html(unpacked(bytes)), document_html(document));
  for (const std::string_view other :
       {std::string_view("no document"), std::string_view(bytes).substr(0, 100), std::string_view()})
    EXPECT_THROW(unpacked(other), std::runtime_error);
}

}  // namespace
}  // namespace abcal
