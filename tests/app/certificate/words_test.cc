#include "app/laboratory/certificate/words.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <regex>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/bench_file/item_identity.h"
#include "app/laboratory/certificate/derived.h"
#include "app/laboratory/certificate/issue_certificate.h"
#include "app/laboratory/certificate/language_files.h"
#include "app/laboratory/certificate/page_numbers.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/effect_words.h"
#include "protocol/model/effects.h"
#include "protocol/plan/effect_sizes.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/xml_query.h"

namespace abcal {
namespace {

using testing::IsEmpty;

/// The sources in which sentences of certificates are made.
std::vector<std::filesystem::path> sources() {
  std::vector<std::filesystem::path> files;
  for (const char* folder :
       {"protocol/estimators", "protocol/model", "protocol/plan", "protocol/record", "protocol/uncertainty",
        "app/formats", "app/results/analysis", "app/laboratory/certificate", "app/laboratory/issuing"})
    for (const auto& entry : std::filesystem::recursive_directory_iterator(test::source_folder() / folder))
      if (entry.path().extension() == ".cc" || entry.path().extension() == ".h")
        files.push_back(entry.path());
  return files;
}

/// Every sentence of a message or for Words, without formats of numbers, and with adjacent literals joined.
std::vector<std::string> sentences_of_sources() {
  std::vector<std::string> sentences;
  static const std::regex kCall(
      "(?:\\b(?:words|say|fact|identification|Message|Message [a-z_]+)[({](?:from, [a-z]+, )?|return \\{)"
      "((?:\\s*\"(?:[^\"\\\\]|\\\\.)*\")+)"),
      kLiteral("\"((?:[^\"\\\\]|\\\\.)*)\""), kFormat("(\\{[a-z0-9_]+):[^}]*\\}"), kPlace("\\{[a-z0-9_]+\\}");
  for (const std::filesystem::path& file : sources()) {
    const std::string source = test::read_file(file);
    for (std::sregex_iterator call(source.begin(), source.end(), kCall), end; call != end; ++call) {
      const std::string literals = (*call)[1];
      std::string sentence;
      for (std::sregex_iterator part(literals.begin(), literals.end(), kLiteral); part != end; ++part)
        sentence += std::regex_replace((*part)[1].str(), std::regex(R"(\\")"), "\"");
      sentence = std::regex_replace(sentence, kFormat, "$1}");
      const std::string outside = std::regex_replace(sentence, kPlace, "");
      const bool has_words =
          std::any_of(outside.begin(), outside.end(), [](unsigned char c) { return std::isalpha(c) != 0; });
      const bool has_places = outside.size() != sentence.size();
      // A list of units or names begins like a message, and XmlQuery has a function of the same name.
      if (!has_words || ((*call)[0].str().starts_with("return") && !has_places)) continue;
      if (sentence.find(":X509") == std::string::npos && !sentence.starts_with("si:"))
        sentences.push_back(sentence);
    }
  }
  return sentences;
}

/// Words that come with the data: of effects, quantities, roles, decisions.
std::vector<std::string> words_of_data() {
  std::vector<std::string> words;
  for (const EffectSizeKey& key : effect_size_keys()) {
    words.emplace_back(key.words);
    if (!key.uncovered.empty()) words.emplace_back(key.uncovered);
  }
  for (const StageEffect& effect : stage_effects()) words.emplace_back(effect.name.english());
  for (const ItemEffect& effect : item_effects()) words.emplace_back(effect.name.english());
  for (const std::vector<ItemFact>* facts : {&kItemSettings, &kItemMounting})
    for (const ItemFact& fact : *facts) words.emplace_back(fact.words);
  for (std::string name : names_of_quantities()) {
    name.resize(name.rfind('_'));
    std::replace(name.begin(), name.end(), '_', ' ');
    words.push_back(name);
  }
  for (const char* word :
       {"pass",        "conditionalPass", "conditionalFail", "fail",       "angle",    "gravity", "voltage",
        "temperature", "humidity",        "pressure",        "level",      "other",    "stage",   "as found",
        "as left",     "normal",          "rectangular",     "triangular", "u-shaped", "."})
    words.emplace_back(word);
  return words;
}

class WordsTest : public CertificateTest {};

TEST_F(WordsTest, EveryLanguageHasEverySentence) {
  std::vector<std::string> sentences = sentences_of_sources();
  EXPECT_GT(sentences.size(), 350U);
  const std::vector<std::string> of_data = words_of_data();
  sentences.insert(sentences.end(), of_data.begin(), of_data.end());
  ASSERT_GE(Words::languages().size(), 2U);
  for (const std::string& language : Words::languages())
    if (language != "en") {
      EXPECT_THAT(missing_in_language(language, sentences), IsEmpty()) << language;
    }
  // The check can fail.
  EXPECT_THAT(missing_in_language("de", {"no such sentence"}), testing::SizeIs(1));
}

TEST_F(WordsTest, MessagesAreTranslatedWithTheirValues) {
  const Words german("de"), english;
  const Message chi2("chi2 {chi2:.4g} for {degrees} degrees of freedom (probability {probability:.2g})",
                     98.23, 101, 0.56);
  EXPECT_EQ(english(chi2).text, "chi2 98.23 for 101 degrees of freedom (probability 0.56)");
  const Wording why = german(in_sequence({chi2, Message("non-linearity fitted")}));
  EXPECT_EQ(why.text,
            "Chi-Quadrat 98,23 bei 101 Freiheitsgraden (Wahrscheinlichkeit 0,56); Nichtlinearit\u00e4t "
            "mitbestimmt");
  EXPECT_EQ(why.language, "de");
  const Wording unknown = german(Message("something that nobody has said before"));
  EXPECT_EQ(unknown.text, "something that nobody has said before");
  EXPECT_EQ(unknown.language, "");
  EXPECT_EQ(german(Message::bare("customer")).text, "customer");
}

TEST_F(WordsTest, WhatAPersonWroteStaysAsItIs) {
  const Words german("de");
  // The table has "customer" and "stage"; the decimal mark of German is a comma.
  for (const char* text : {"customer", "report 1.5; customer; stage"})
    EXPECT_EQ(german("source \"{source}\"", text).text, fmt::format("Quelle \"{}\"", text));
  EXPECT_EQ(german(word_of(kPlaces, "customer")).text, "beim Auftraggeber");
  EXPECT_EQ(german(word_of(kPlaces, "stage")).text, "stage");
}

/// A certificate whose bench and laboratory files have one text wherever a person may write any.
/// @param draft  of a run that is not traceable, with the reasons
std::string with_text_of_a_person(CertificateRequest asked, const std::string& text, bool draft) {
  if (!draft) as_if_real(asked.run);
  for (const EffectSizeKey& key : effect_size_keys())
    asked.run.record.tolerances.sources[std::string(key.key)] = text;
  asked.run.record.g_loc.source = draft ? "formula " + text : text;
  if (draft) asked.run.run->header.labels["replay.of"] = text;
  LaboratoryFile& file = asked.laboratory.file;
  for (std::string* one : {&file.job.item_name, &file.job.condition, &file.job.procedure, &file.job.sampling,
                           &file.job.deviations, &file.job.external_results, &file.job.opinions,
                           &file.customer.name, &file.laboratory.gravity_site})
    *one = text;
  file.job.customer_supplied = {text};
  for (Equipment& one : file.equipment) {
    one.name = one.certificate = one.certificate_issuer = text;
    if (!draft) continue;
    one.serial_number = text;
    one.due = one.performed;
  }
  asked.draft = draft;
  asked.run.results = analyse_all(asked.run.record);
  asked.run.budget = make_budget(asked.run.record, asked.run.result());
  return xml_text(dcc_document(make_certificate(std::move(asked))));
}

TEST_F(WordsTest, AGermanCertificateTranslatesNothingThatAPersonWrote) {
  const std::string german = replaced(example_laboratory(), "language = \"en\"", "language = \"de\"");
  // The program has these words too, for places, states and distributions that these certificates do not
  // have.
  for (const auto& [text, translation] :
       {std::pair<std::string, std::string>{"customer", "beim Auftraggeber"},
        {"as found", "vor der Justierung"},
        {"triangular", "dreieckverteilt"},
        {"report 7.25", "7,25"}}) {
    for (const bool draft : {false, true}) {
      const std::string xml = with_text_of_a_person(request(german), text, draft);
      EXPECT_THAT(xml, testing::Not(testing::HasSubstr(translation))) << text << (draft ? ", draft" : "");
      EXPECT_THAT(xml, testing::HasSubstr("Standardmessunsicherheit; Quelle: " + text)) << draft;
    }
  }
}

nlohmann::json table_of(std::string_view language) {
  for (const LanguageFile& file : language_files())
    if (file.path == language) return nlohmann::json::parse(file.body);
  return {};
}

/// The literal parts of the English side of a table that are long enough to identify a sentence of
/// certificates.
std::vector<std::string> english_of(const std::string& language) {
  constexpr std::size_t kTelling = 14;
  std::vector<std::string> parts;
  const nlohmann::json table = table_of(language);
  const std::vector<std::string> sentences = sentences_of_sources(), words = words_of_data();
  for (const auto& [english, translated] : table.items()) {
    if (!std::ranges::count(sentences, english) && !std::ranges::count(words, english)) continue;
    std::string_view rest = english;
    while (!rest.empty()) {
      const std::size_t at = std::min(rest.find('{'), rest.size()),
                        end = std::min(rest.find('}', at), rest.size());
      const std::string part(rest.substr(0, at));
      if (part.size() >= kTelling && translated.get<std::string>().find(part) == std::string::npos)
        parts.push_back(part);
      rest.remove_prefix(std::min(end + 1, rest.size()));
    }
  }
  return parts;
}

/// English sentences in a German certificate.
std::vector<std::string> english_in(const std::string& xml) {
  std::vector<std::string> found;
  const CertificateXml read(xml);
  const std::vector<std::string> english = english_of("de");
  for (const std::string& text : read.texts("//text()"))
    for (const std::string& part : english)
      if (text.find(part) != std::string::npos) found.push_back(part + ": " + text);
  // A description without a language is a sentence that the table does not have.
  for (const std::string& text : read.texts("//dcc:description/dcc:content[not(@lang)]"))
    found.push_back(text);
  return found;
}

TEST_F(WordsTest, AGermanCertificateHasNoEnglishSentence) {
  const std::string german =
      replaced(replaced(example_laboratory(), "language = \"en\"", "language = \"de\""), "range of the item",
               "Angaben zum Gegenstand");
  IssueFacts facts;
  facts.number = "T-1";
  facts.approved_by = "Approver N. N.";
  facts.date = *parse_date("2999-01-02");
  facts.register_identity = "a register";
  facts.training = true;
  facts.entry = RegisteredEntry{"0123456789abcdef0123456789abcdef", 17, std::string(64, 'a')};
  for (const char* estimator : {"abc", "joint"}) {
    CertificateRequest issued = request(german);
    issued.run.estimator = estimator;
    issued.issue = facts;
    EXPECT_THAT(english_in(checked_xml(make_certificate(std::move(issued)), nullptr)), IsEmpty())
        << estimator;
  }
  // A draft that lists many missing requirements.
  CertificateRequest draft =
      request(replaced(replaced(replaced(german, "performed = 2025-12-31", "performed = 1998-12-31"),
                                "due = 2030-12-31", "due = 1999-12-31"),
                       "serial_number = \"118001234\"", "serial_number = \"1\""));
  draft.draft = true;
  draft.run.run->environment.clear();
  draft.run.record.g_loc.source = "formula GRS80";
  draft.run.record.tolerances.sources["drift"] = "stated";
  draft.run.run->header.labels["replay.of"] = "other.run";
  draft.run.run->header.labels["item.maker"] = "";
  for (DwellRecord& dwell : draft.run.record.dwells)
    if (dwell.n == 4) dwell.mean[0] += 0.01;
  draft.run.results = analyse_all(draft.run.record);
  const std::string xml = checked_xml(make_certificate(std::move(draft)), nullptr);
  EXPECT_THAT(english_in(xml), IsEmpty());
  EXPECT_THAT(
      xml, testing::AllOf(testing::HasSubstr("simuliert: Drehtisch"),
                          testing::HasSubstr("kalibriert am 1998-12-31"), testing::HasSubstr("zweifelhaft")));
  // One on a stage that reports no serial number, with another gravity.
  for (const char* stated : {"", "118001234"}) {
    CertificateRequest other = request(german);
    other.draft = true;
    as_if_real(other.run);
    for (InstrumentIdentity& instrument : other.run.run->header.instruments) instrument.serial_number.clear();
    if (*stated != '\0') other.run.run->header.labels["stage.stated_serial_number"] = stated;
    if (*stated == '\0') other.run.record.g_loc.source = "1.5";
    EXPECT_THAT(english_in(checked_xml(make_certificate(std::move(other)), nullptr)), IsEmpty()) << stated;
  }
  // The check can fail.
  EXPECT_FALSE(english_in(checked_xml(make_certificate(request()), nullptr)).empty());
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
