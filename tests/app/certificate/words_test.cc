#include "app/certificate/words.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <regex>
#include <string>
#include <vector>

#include "app/certificate/derived.h"
#include "app/certificate/page_numbers.h"
#include "protocol/plan/effect_sizes.h"
#include "tests/app/certificate/certificate_fixtures.h"

namespace abcal {
namespace {

using testing::IsEmpty;

/// Every sentence that the sources of certificates give to Words, with adjacent literals joined.
std::vector<std::string> sentences_of_sources() {
  std::vector<std::string> sentences;
  static const std::regex kCall(
      "\\b(?:words|say|fact|identification)\\(((?:[^\"();]*\\?)?(?:from, [a-z]+, "
      ")?(?:\\s*:?\\s*\"(?:[^\"\\\\]|\\\\.)*\")+)"),
      kLiteral("(:?)\\s*\"((?:[^\"\\\\]|\\\\.)*)\"");
  for (const auto& entry : std::filesystem::directory_iterator(test::source_folder() / "app/certificate")) {
    if (entry.path().extension() != ".cc") continue;
    const std::string source = test::read_file(entry.path());
    for (std::sregex_iterator call(source.begin(), source.end(), kCall), end; call != end; ++call) {
      const std::string literals = (*call)[1];
      std::string sentence;
      for (std::sregex_iterator part(literals.begin(), literals.end(), kLiteral); part != end; ++part) {
        if ((*part)[1] == ":") {  // The other of two: condition ? "one" : "two"
          sentences.push_back(sentence);
          sentence.clear();
        }
        sentence += (*part)[2];
      }
      // XmlQuery has a function of the same name.
      if (sentence.find(":X509") == std::string::npos && !sentence.starts_with("si:"))
        sentences.push_back(sentence);
    }
  }
  return sentences;
}

/// Words that come with the data: of effects, quantities, roles, decisions.
std::vector<std::string> words_of_data() {
  std::vector<std::string> words;
  for (const EffectSizeKey& key : effect_size_keys()) words.emplace_back(key.words);
  for (std::string name : names_of_quantities()) {
    name.resize(name.rfind('_'));
    std::replace(name.begin(), name.end(), '_', ' ');
    words.push_back(name);
  }
  for (const char* word : {"pass", "conditionalPass", "conditionalFail", "fail", "angle", "gravity",
                           "voltage", "temperature", "humidity", "pressure", "level", "other", "stage",
                           "as found", "as left", "normal", "rectangular", "."})
    words.emplace_back(word);
  return words;
}

class WordsTest : public CertificateTest {};

TEST_F(WordsTest, EveryLanguageHasEverySentence) {
  std::vector<std::string> sentences = sentences_of_sources();
  EXPECT_GT(sentences.size(), 150U);
  for (const DerivedGroup& group : make_certificate(request()).run.derived)
    if (group.name.find("ensitivity") == std::string::npos || group.name == "transverse_sensitivity")
      sentences.push_back(group.words);
  const std::vector<std::string> of_data = words_of_data();
  sentences.insert(sentences.end(), of_data.begin(), of_data.end());
  ASSERT_GE(Words::languages().size(), 2U);
  for (const std::string& language : Words::languages())
    if (language != "en") {
      EXPECT_THAT(missing_in_language(language, sentences), IsEmpty()) << language;
    }
  // The check can fail.
  EXPECT_THAT(missing_in_language("de", {"no such sentence", "{} to {} and {}"}), testing::SizeIs(2));
}

TEST_F(WordsTest, AnUnknownLanguageIsRefusedWithThoseThatThereAre) {
  try {
    Words("xx");
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_THAT(error.what(), testing::AllOf(testing::HasSubstr("\"xx\""), testing::HasSubstr("en, de")));
  }
  const auto read = parse_laboratory_file(
      replaced(example_laboratory(), "language = \"en\"", "language = \"xx\""), "lab.toml");
  EXPECT_EQ(read.problems.size(), 1U);
}

TEST(PageNumbersTest, NumbersAreTypeset) {
  const Words english, german("de");
  EXPECT_EQ(typeset_number("-1.0023", english), "\u22121.0023");
  EXPECT_EQ(typeset_number("1.2e-05", english), "1.2 \u00d7 10\u207b\u2075");
  EXPECT_EQ(typeset_number("3.4e+12", english), "3.4 \u00d7 10\u00b9\u00b2");
  EXPECT_EQ(typeset_number("-1.0023", german), "\u22121,0023");
  EXPECT_EQ(typeset_number("", german), "");
}

TEST(PageNumbersTest, UnitsAreThoseOfPeople) {
  EXPECT_EQ(typeset_unit("\\volt\\second\\tothe{2}\\metre\\tothe{-1}"), "V/(m/s\u00b2)");
  EXPECT_EQ(typeset_unit("\\milli\\volt"), "mV");
  EXPECT_EQ(typeset_unit("\\metre\\second\\tothe{-2}"), "m/s\u00b2");
  EXPECT_EQ(typeset_unit("\\one"), "1");
  EXPECT_EQ(typeset_unit("|g"), "g");
  EXPECT_EQ(typeset_unit("|g\\second\\tothe{2}\\metre\\tothe{-1}"), "g/(m/s\u00b2)");
  EXPECT_EQ(typeset_unit("\\second\\tothe{2}\\metre\\tothe{-1}"), "1/(m/s\u00b2)");
  EXPECT_EQ(typeset_unit("\\degreecelsius"), "\u00b0C");
  EXPECT_EQ(typeset_unit("\\furlong"), "\\furlong");
}

}  // namespace
}  // namespace abcal
