// The printed certificate: its numbers are those of the XML, its structure that of tagged PDF/A-3, its pages
// are full.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <optional>
#include <qpdf/QPDF.hh>
#include <qpdf/QPDFEmbeddedFileDocumentHelper.hh>
#include <qpdf/QPDFPageDocumentHelper.hh>
#include <regex>
#include <set>
#include <string>
#include <vector>

#include "app/formats/xml_query.h"
#include "app/formats/xml_tree.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::IsEmpty;

void replace_all(std::string& text, const std::string& from, const std::string& to) {
  for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
    text.replace(at, from.size(), to);
}

/// Every number in a text, in one form: "−1.5 × 10⁻³" as "-1.5e-03", as the XML has it.
std::multiset<std::string> numbers_in(std::string text) {
  replace_all(text, "\u2212", "-");
  // Superscripts become marked digits: behind "× 10" they are an exponent, elsewhere the power of a unit.
  for (const auto& [sign, digit] : {std::pair{"\u207b", "-"},
                                    {"\u2070", "0"},
                                    {"\u00b9", "1"},
                                    {"\u00b2", "2"},
                                    {"\u00b3", "3"},
                                    {"\u2074", "4"},
                                    {"\u2075", "5"},
                                    {"\u2076", "6"},
                                    {"\u2077", "7"},
                                    {"\u2078", "8"},
                                    {"\u2079", "9"}})
    replace_all(text, sign, std::string("\x01") + digit);
  std::string plain;
  static const std::regex kPower("\\s*\u00d7\\s*10((\x01-)?(\x01[0-9])+)");
  std::sregex_iterator power(text.begin(), text.end(), kPower), end;
  std::size_t at = 0;
  for (; power != end; ++power) {
    std::string exponent = (*power)[1];
    exponent.erase(std::remove(exponent.begin(), exponent.end(), '\x01'), exponent.end());
    const int value = std::stoi(exponent);
    const std::string digits = std::to_string(std::abs(value));
    plain += text.substr(at, static_cast<std::size_t>(power->position()) - at) + (value < 0 ? "e-" : "e+") +
             (digits.size() < 2 ? "0" : "") + digits;
    at = static_cast<std::size_t>(power->position() + power->length());
  }
  plain += text.substr(at);
  plain = std::regex_replace(plain, std::regex("\x01[-0-9]"), "");
  static const std::regex kNumber("-?[0-9]+(\\.[0-9]+)?(e[-+][0-9]+)?");
  std::multiset<std::string> numbers;
  for (std::sregex_iterator each(plain.begin(), plain.end(), kNumber); each != end; ++each)
    numbers.insert(each->str());
  return numbers;
}

class PrintedCertificateTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new test::TemporaryFolder;
    std::string bench = test::read_file(test::source_folder() / "docs/examples/simulated.toml");
    for (const auto& [line, with] : {std::pair<std::string, std::string>{"steps = 72", "steps = 12"},
                                     {"step_deg = 5.0", "step_deg = 30.0"},
                                     {"dwell_readings = 1000", "dwell_readings = 50"}})
      bench = std::regex_replace(bench, std::regex(line), with);
    test::write_file(*folder_ / "bench.toml", bench);
    test::write_file(*folder_ / "lab.toml",
                     test::read_file(test::source_folder() / "docs/examples/laboratory.toml"));
    abcal({"run", "bench.toml", "-o", "a.run"});
    if (!shell("command -v weasyprint && command -v pdftotext")) return;
    registered_ = new test::TrainingRegister(folder_->path());
    registered_->lab(
        {"key", "Approver N. N.", "--kind", "person", "-o", "approver.pem", "--certificate", "approver.crt"});
    const test::ProgramResult issued =
        abcal({"issue", "a.run", "--laboratory", "lab.toml", "--dcc", "a.xml", "--pdf", "a.pdf", "--sign",
               "approver.pem", "--certificate", "approver.crt"});
    ASSERT_EQ(issued.exit_code, 0) << issued.err;
    printed_ = true;
  }
  static void TearDownTestSuite() {
    delete registered_;
    delete folder_;
    registered_ = nullptr;
    folder_ = nullptr;
  }
  void SetUp() override {
    if (!printed_) GTEST_SKIP() << "weasyprint or pdftotext (poppler-utils) is not installed";
  }

  static test::ProgramResult abcal(const std::vector<std::string>& words) {
    return test::run_program(words, folder_->path());
  }
  static bool shell(const std::string& command) {
    return std::system(("cd '" + folder_->path().string() + "' && (" + command + ") > log 2>&1").c_str()) ==
           0;
  }
  static std::string file(const std::string& name) { return test::read_file(*folder_ / name); }

  /// The text of the pages, without the lines that repeat on each of them.
  static std::string text_of(const std::string& pdf) {
    EXPECT_TRUE(shell("pdftotext -layout " + pdf + " text.txt")) << file("log");
    return std::regex_replace(file("text.txt"), std::regex("(page|Seite) [0-9]+ (of|von) [0-9]+"), "");
  }

  static inline test::TemporaryFolder* folder_ = nullptr;
  static inline test::TrainingRegister* registered_ = nullptr;
  static inline bool printed_ = false;
};

TEST_F(PrintedCertificateTest, EveryNumberOfThePagesIsInTheXml) {
  const std::string xml = file("a.xml");
  const XmlDocument document = parse_xml(xml, "a.xml");
  std::string words;
  for (const std::string& text : XmlQuery(document.get()).texts("//text()")) words += text + "\n";
  const auto known = numbers_in(words), shown = numbers_in(text_of("a.pdf"));
  EXPECT_GT(shown.size(), 200U);
  // A hash is longer than a line and is broken anywhere.
  std::string hashes;
  static const std::regex kHash("[0-9a-f]{64}");
  for (std::sregex_iterator each(words.begin(), words.end(), kHash), end; each != end; ++each)
    hashes += each->str() + " ";
  std::set<std::string> unknown;
  for (const std::string& number : shown)
    if (known.count(number) == 0 && hashes.find(number) == std::string::npos) unknown.insert(number);
  EXPECT_THAT(unknown, IsEmpty());
}

TEST_F(PrintedCertificateTest, TheMainResultsAreOnTheFirstPageAndTheSignaturesOnTheThird) {
  const XmlDocument document = parse_xml(file("a.xml"), "a.xml");
  const XmlQuery xml(document.get());
  for (const std::string page : {"1", "2", "3"})
    ASSERT_TRUE(shell("pdftotext -layout -f " + page + " -l " + page + " a.pdf " + page + ".txt"));
  const std::string first = file("1.txt"), second = file("2.txt"), third = file("3.txt");
  for (const std::string result : {"abc_intrinsicSensitivities", "abc_intrinsicAngles", "abc_offsets"}) {
    const std::string at = "//dcc:result[@refType='" + result + "']/dcc:data//si:realListXMLList[1]/";
    for (const std::string path :
         {"si:valueXMLList", "si:measurementUncertaintyUnivariateXMLList//si:valueExpandedMUXMLList"})
      for (std::string word : xml.words(at + path)) {
        replace_all(word, "-", "\u2212");
        if (word.find('e') == std::string::npos) {
          EXPECT_THAT(first, HasSubstr(word)) << result;
        }
      }
  }
  EXPECT_THAT(first, HasSubstr("Date of calibration"));
  EXPECT_THAT(first, HasSubstr("Conformity with specification, number of decisions: pass: 3."));
  for (const std::string words : {"Conformity", "Equation for use", "Mounting", "Stated mounting"})
    EXPECT_THAT(second, HasSubstr(words));
  for (const std::string words :
       {"Metrological traceability", "approved by", "exclusions from the method", "None."})
    EXPECT_THAT(third, HasSubstr(words));
  EXPECT_THAT(second, testing::Not(HasSubstr("Annex")));
  EXPECT_LT(third.find("approved by"), third.find("Annex"));
}

TEST_F(PrintedCertificateTest, HasTheStructureOfTaggedPdfA3) {
  QPDF pdf;
  pdf.processFile((*folder_ / "a.pdf").c_str());
  QPDFObjectHandle root = pdf.getRoot();
  QPDFObjectHandle intent = root.getKey("/OutputIntents").getArrayItem(0);
  EXPECT_EQ(intent.getKey("/S").getName(), "/GTS_PDFA1");
  EXPECT_GT(intent.getKey("/DestOutputProfile").getStreamData()->getSize(), 128U);
  EXPECT_EQ(intent.getKey("/DestOutputProfile").getDict().getKey("/N").getIntValueAsInt(), 3);
  const auto metadata = root.getKey("/Metadata").getStreamData();
  const std::string xmp(reinterpret_cast<const char*>(metadata->getBuffer()), metadata->getSize());
  EXPECT_THAT(xmp, testing::AllOf(HasSubstr("<pdfaid:part>3<"), HasSubstr("<pdfaid:conformance>B<"),
                                  HasSubstr("<pdfuaid:part>1<"), HasSubstr("Calibration certificate")));
  EXPECT_NO_THROW(parse_xml(xmp, "metadata"));
  EXPECT_TRUE(root.getKey("/MarkInfo").getKey("/Marked").getBoolValue());
  EXPECT_EQ(root.getKey("/Lang").getUTF8Value(), "en");
  EXPECT_FALSE(pdf.getTrailer().hasKey("/Info"));
  EXPECT_FALSE(pdf.isEncrypted());

  const auto files = QPDFEmbeddedFileDocumentHelper(pdf).getEmbeddedFiles();
  ASSERT_EQ(files.size(), 1U);
  QPDFFileSpecObjectHelper& attached = *files.begin()->second;
  EXPECT_EQ(attached.getObjectHandle().getKey("/AFRelationship").getName(), "/Data");
  EXPECT_EQ(attached.getObjectHandle().getObjGen(), root.getKey("/AF").getArrayItem(0).getObjGen());
  EXPECT_EQ(attached.getEmbeddedFileStream().getDict().getKey("/Subtype").getName(), "/text/xml");
  const auto bytes = attached.getEmbeddedFileStream().getStreamData(qpdf_dl_all);
  EXPECT_EQ(std::string(reinterpret_cast<const char*>(bytes->getBuffer()), bytes->getSize()), file("a.xml"));

  std::set<std::string> tags, not_embedded;
  for (QPDFObjectHandle object : pdf.getAllObjects()) {
    if (!object.isDictionary()) continue;
    if (object.getKey("/S").isName() && object.hasKey("/P")) tags.insert(object.getKey("/S").getName());
    if (!object.getKey("/Type").isNameAndEquals("/FontDescriptor")) continue;
    if (!object.hasKey("/FontFile") && !object.hasKey("/FontFile2") && !object.hasKey("/FontFile3"))
      not_embedded.insert(object.getKey("/FontName").getName());
  }
  for (const char* tag : {"/H1", "/H2", "/Table", "/TR", "/TH", "/TD", "/P"})
    EXPECT_THAT(tags, Contains(tag));
  EXPECT_THAT(not_embedded, IsEmpty());
  for (QPDFPageObjectHelper& page : QPDFPageDocumentHelper(pdf).getAllPages())
    EXPECT_EQ(page.getObjectHandle().getKey("/Tabs").getName(), "/S");
  if (shell("command -v verapdf")) {
    EXPECT_TRUE(shell("verapdf -f 3b a.pdf")) << file("log");
  }
}

// The lowest word of each page but the last is in its lowest quarter, and the first row of a table is never
// alone at the end of a page.
TEST_F(PrintedCertificateTest, NoPageIsMoreThanAQuarterEmpty) {
  ASSERT_TRUE(shell("pdftotext -bbox a.pdf boxes.html")) << file("log");
  const std::string boxes = file("boxes.html");
  std::vector<double> filled;
  const std::string page_tag = "<page width=", last_edge = "yMax=\"";
  for (std::size_t page = boxes.find(page_tag); page != std::string::npos;) {
    const std::size_t next = boxes.find(page_tag, page + 1);
    constexpr double kHeight = 841.89, kTop = 20.0 / 297.0, kBottom = 280.0 / 297.0;  // as in the style
    double lowest = 0.0;
    for (std::size_t at = boxes.find(last_edge, page); at < std::min(next, boxes.size());
         at = boxes.find(last_edge, at + 1)) {
      const double y = std::stod(boxes.substr(at + last_edge.size(), 12)) / kHeight;
      if (y < kBottom) lowest = std::max(lowest, y);
    }
    filled.push_back((lowest - kTop) / (kBottom - kTop));
    page = next;
  }
  ASSERT_GE(filled.size(), 4U);
  for (std::size_t i = 0; i + 1 < filled.size(); ++i) EXPECT_GE(filled[i], 0.75) << "page " << i + 1;
}

TEST_F(PrintedCertificateTest, NothingIsSetInLessThanEightPoints) {
  ASSERT_EQ(abcal({"report", "a.run", "--html", "a.html"}).exit_code, 0);
  const std::string page = file("a.html");
  static const std::regex kSize("font-size: ([0-9.]+)(pt|%)");
  int found = 0;
  for (std::sregex_iterator each(page.begin(), page.end(), kSize), end; each != end; ++each, ++found) {
    ASSERT_EQ((*each)[2], "pt") << each->str();
    EXPECT_GE(std::stod((*each)[1]), 8.0) << each->str();
  }
  EXPECT_GT(found, 5);
}

TEST_F(PrintedCertificateTest, TheSignaturesAreVerifiedAndAreTheApprovers) {
  const test::ProgramResult good = abcal({"verify", "a.run", "--pdf", "a.pdf"});
  EXPECT_EQ(good.exit_code, 0) << good.out;
  EXPECT_THAT(good.out, testing::AllOf(HasSubstr("signature of certificate T-"),
                                       HasSubstr("a.pdf.p7s: verifies by a key of Approver N. N."),
                                       HasSubstr("a.pdf, XML inside: is certificate T-")));
  // Programs of others agree.
  if (shell("command -v openssl")) {
    EXPECT_TRUE(
        shell("openssl cms -verify -binary -inform DER -in a.pdf.p7s -content a.pdf -CAfile approver.crt "
              "-purpose any -out /dev/null"))
        << file("log");
    EXPECT_TRUE(shell("openssl x509 -in approver.crt -noout -text | grep prime256v1 >/dev/null"))
        << file("log");
  }
  if (shell("command -v xmlsec1")) {
    EXPECT_TRUE(shell("xmlsec1 --verify --trusted-pem approver.crt a.xml")) << file("log");
  }

  // One byte of the PDF, or the signature of another.
  std::string bytes = file("a.pdf");
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 1);
  test::write_file(*folder_ / "b.pdf", bytes);
  test::write_file(*folder_ / "b.pdf.p7s", file("a.pdf.p7s"));
  EXPECT_NE(abcal({"verify", "a.run", "--pdf", "b.pdf"}).exit_code, 0);
  registered_->lab(
      {"key", "Operator N. N.", "--kind", "person", "-o", "other.pem", "--certificate", "other.crt"});
  test::write_file(*folder_ / "c.pdf", file("a.pdf"));
  ASSERT_TRUE(
      shell("openssl cms -sign -binary -in c.pdf -signer other.crt -inkey other.pem -outform DER -out "
            "c.pdf.p7s"))
      << file("log");
  // Pages without a signature: the XML inside is compared, and nobody says that the pages show it.
  test::write_file(*folder_ / "d.pdf", file("a.pdf"));
  const test::ProgramResult pages_alone = abcal({"verify", "a.run", "--pdf", "d.pdf"});
  EXPECT_EQ(pages_alone.exit_code, 1);
  EXPECT_THAT(pages_alone.out, testing::AllOf(HasSubstr("d.pdf, XML inside: is certificate T-"),
                                              HasSubstr("d.pdf.p7s: is not there: nobody signed the pages")));
  const test::ProgramResult another = abcal({"verify", "a.run", "--pdf", "c.pdf"});
  EXPECT_EQ(another.exit_code, 1);
  EXPECT_THAT(another.out, HasSubstr("verifies by a key of Operator N. N., but Approver N. N. approved"));
}

TEST_F(PrintedCertificateTest, AKeyOfAnotherPersonIsRefused) {
  registered_->lab(
      {"key", "Operator N. N.", "--kind", "person", "-o", "third.pem", "--certificate", "third.crt"});
  std::filesystem::copy_file(*folder_ / "a.run", *folder_ / "again.run");
  std::filesystem::copy_file(*folder_ / "a.run.results", *folder_ / "again.run.results");
  const test::ProgramResult refused = abcal({"issue", "again.run", "--laboratory", "lab.toml", "--sign",
                                             "third.pem", "--certificate", "third.crt"});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, HasSubstr("none of Approver N. N.'s in the register"));
}

// A German certificate is entirely in German.
TEST_F(PrintedCertificateTest, AGermanCertificateIsGerman) {
  const test::ProgramResult draft =
      abcal({"report", "a.run", "--draft", "--laboratory", "lab.toml", "--language", "de", "--html",
             "de.html", "--dcc", "de.xml", "--pdf", "de.pdf"});
  ASSERT_EQ(draft.exit_code, 0) << draft.err;
  const std::string page = file("de.html");
  for (const std::string words :
       {"Kalibrierschein", "erweiterte Messunsicherheit", "Metrologische R\u00fcckf\u00fchrung", "Seite\\20 ",
        "ENTWURF", "freigegeben", "Messunsicherheitsbudget", "Deutschland", "Keine."})
    EXPECT_THAT(page, HasSubstr(words));
  const XmlDocument document = parse_xml(file("de.xml"), "de.xml");
  const XmlQuery xml(document.get());
  EXPECT_EQ(xml.text("//dcc:usedLangCodeISO639_1"), "de");
  EXPECT_THAT(xml.texts("//dcc:content[@lang='en']"), IsEmpty());
  // Three pages are for the customer in this language, too.
  ASSERT_TRUE(shell("pdftotext -layout -f 3 -l 3 de.pdf 3.txt && pdftotext -layout -f 2 -l 2 de.pdf 2.txt"));
  EXPECT_THAT(file("3.txt"), HasSubstr("Verantwortliche und Unterschriften"));
  EXPECT_THAT(file("2.txt"), HasSubstr("Bild 1: Angegebene Montage"));
  EXPECT_THAT(file("2.txt"), testing::Not(HasSubstr("Anhang")));
}

}  // namespace
}  // namespace abcal
