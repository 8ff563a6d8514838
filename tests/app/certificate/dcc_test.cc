#include "app/laboratory/certificate/dcc_xml.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fmt/format.h>

#include <algorithm>
#include <clocale>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <nlohmann/json.hpp>
#include <random>
#include <sstream>

#include "app/document/document_text.h"
#include "app/laboratory/certificate/business_rules.h"
#include "app/laboratory/certificate/certificate_page.h"
#include "app/laboratory/certificate/issue_certificate.h"
#include "app/laboratory/certificate/schema_check.h"
#include "app/laboratory/compare/read_certificate.h"
#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/uncertainty/budget.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/schematron.h"
#include "tests/app/certificate/xml_query.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class DccTest : public CertificateTest {
 protected:
  static Certificate certificate(const std::string& laboratory = example_laboratory()) {
    return make_certificate(request(laboratory));
  }
};

TEST_F(DccTest, ADraftOfASimulatedRunKeepsSchemaAndRules) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "dcc/xsd");
  const Certificate draft = certificate();
  const XmlDocument document = dcc_document(draft);
  EXPECT_EQ(to_string(check_business_rules(document)), "");
  EXPECT_EQ(to_string(DccSchema(path).check(parse_xml(xml_text(document), "draft"))), "");
  EXPECT_THAT(xml_text(document),
              AllOf(HasSubstr("DRAFT: this certificate is not issued"), HasSubstr("SIMULATED")));
  EXPECT_THAT(draft.number, testing::StartsWith("DRAFT-"));
}

// Each value is that of `analyse --json`, rounded to two digits of its expanded uncertainty.
TEST_F(DccTest, NumbersAreThoseOfTheAnalysis) {
  const auto analysed = test::run_program({"analyse", shared_run().string(), "--json"}, folder.path());
  ASSERT_EQ(analysed.exit_code, 0) << analysed.err;
  const auto json = nlohmann::json::parse(analysed.out);
  const Certificate made = certificate();
  const CertificateXml xml(xml_text(dcc_document(made)));

  // The output is in g, which the SI does not know: the second list of each hybrid is in g, as the JSON is.
  const auto expect_list = [&](const std::string& result, int quantity, const nlohmann::json& of) {
    const std::string at = "//dcc:result[@refType='" + result +
                           "']/dcc:data/descendant::dcc:quantity[not(ancestor::dcc:metaData)][" +
                           std::to_string(quantity) +
                           "]/*[self::si:hybrid or self::si:realListXMLList]"
                           "/descendant-or-self::si:realListXMLList[last()]";
    const auto values = xml.numbers(at + "/si:valueXMLList");
    const auto expanded = xml.numbers(at + "//si:valueExpandedMUXMLList");
    auto factors = xml.numbers(at + "//si:expandedMUXMLList/si:coverageFactorXMLList");
    auto places = xml.numbers(at + "/si:significantDigitXMLList");
    ASSERT_EQ(values.size(), of.size()) << result;
    factors.resize(values.size(), factors.front());
    places.resize(values.size(), places.front());
    for (std::size_t i = 0; i < values.size(); ++i) {
      const double digit = std::pow(10.0, places[i]), u = of[i]["standard_uncertainty"].get<double>();
      Quantity analysis;
      if (of[i]["degrees_of_freedom"].is_number())
        analysis.degrees_of_freedom = of[i]["degrees_of_freedom"].get<double>();
      EXPECT_NEAR(factors[i], coverage_factor(analysis), 0.0051) << result << " " << i;
      EXPECT_NEAR(values[i], of[i]["value"].get<double>(), 0.51 * digit) << result << " " << i;
      EXPECT_NEAR(expanded[i], coverage_factor(analysis) * u, 0.51 * digit) << result << " " << i;
      EXPECT_LE(digit, 0.11 * expanded[i]) << "two significant digits of U";
    }
  };
  for (int row = 0; row < 3; ++row)
    expect_list("abc_sensitivityMatrixPerGravity", row + 1,
                json["sensitivity_matrix"][static_cast<std::size_t>(row)]);
  expect_list("abc_intrinsicSensitivitiesPerGravity", 1, json["intrinsic_sensitivity"]);
  expect_list("abc_intrinsicAngles", 1, json["intrinsic_angle"]);
  expect_list("abc_offsets", 1, json["offset"]);

  for (std::size_t column = 0; column < 12; ++column) {
    const auto values = xml.numbers(
        "//dcc:result[@refType='abc_allOutputsPerGravity']/descendant::si:realListXMLList[.//"
        "si:columnXMLList][last()]"
        "//si:columnXMLList[" +
        std::to_string(column + 1) + "]//si:valueXMLList");
    ASSERT_EQ(values.size(), 12U);
    for (std::size_t row = 0; row < 12; ++row) {
      const double stored = json["covariance"][row][column].get<double>();
      EXPECT_NEAR(values[row], stored, 1e-7 * std::abs(stored)) << row << " " << column;
    }
  }
  EXPECT_EQ(xml.text("(//dcc:result[@refType='abc_allOutputsPerGravity']//si:ellipsoidalRegionMUXMLList/"
                     "si:coverageFactorXMLList)[1]")
                .substr(0, 5),
            "4.620");
  // The SI list is the same in m/s2.
  const auto si = xml.numbers("//dcc:result[@refType='abc_offsets']//si:realListXMLList[1]/si:valueXMLList");
  const double in_si = json["offset"][0]["value"].get<double>() * 9.80665;
  EXPECT_NEAR(si.at(0), in_si, 1e-2 * std::abs(in_si));
  EXPECT_EQ(xml.numbers("//dcc:influenceCondition[@refType='abc_localGravity']//si:value").at(0), 9.80101);
}

// Sensitivities and offsets have no unit in common: their covariance is row by row, one list a unit.
TEST_F(DccTest, TheStateHasTheCovarianceOfAllOutputs) {
  const Certificate made = certificate();
  const CertificateXml xml(xml_text(dcc_document(made)));
  const Covariance12 covariance = covariance_of_outputs(made.run.stated, *made.run.stated.result.covariance);
  const double g = kStandardGravity;  // the output is in g, the state in m/s2
  const std::string list = "//dcc:list[@refType='abc_stateCovariance']/dcc:quantity";
  EXPECT_EQ(xml.texts(list + "/dcc:name").size(), 24U);
  for (Eigen::Index i = 0; i < 12; ++i)
    for (const bool of_offsets : {false, true}) {
      const Eigen::Index first = of_offsets ? 9 : 0, size = of_offsets ? 3 : 9;
      const std::string row = fmt::format("({})[{}]", list, 2 * i + (of_offsets ? 2 : 1));
      EXPECT_EQ(xml.text(row + "/dcc:name/dcc:content"), kOutputSymbols[static_cast<std::size_t>(i)]);
      const auto values = xml.numbers(row + "//si:valueXMLList");
      ASSERT_EQ(std::ssize(values), size);
      for (Eigen::Index j = 0; j < size; ++j)
        EXPECT_NEAR(values[static_cast<std::size_t>(j)], g * g * covariance(i, first + j),
                    1e-11 * g * g * std::sqrt(covariance(i, i) * covariance(first + j, first + j)));
    }
  EXPECT_EQ(xml.texts("//dcc:list[@refType='abc_stateCovarianceAsMeasured']").size(), 0U);
}

// In version 1.1 six laboratories whose stages report no number were "on the same stage (XPS-C8 not stated)".
TEST_F(DccTest, AStageWithoutASerialNumberIsNoStageThatAnotherHas) {
  Certificate made = certificate();
  const auto read = [&] {
    test::write_file(folder / "a.xml", xml_text(dcc_document(made)));
    return read_certificate(folder / "a.xml");
  };
  EXPECT_EQ(on_same_stage(read(), read()), SameStage::kYes);
  for (InstrumentIdentity& instrument : made.run.data.run->header.instruments)
    instrument.serial_number.clear();
  const ComparedResult first = read();
  EXPECT_FALSE(first.stage.empty());
  EXPECT_EQ(first.stage_serial_number, "");
  EXPECT_EQ(on_same_stage(first, read()), SameStage::kUnknown);
  EXPECT_EQ(test::read_file(folder / "a.xml").find("not stated</dcc:value>"), std::string::npos);
  // As 1.1 wrote it.
  std::string older = test::read_file(folder / "a.xml");
  const std::size_t at =
      older.find("</dcc:model>", older.find("abc_stage")) + std::string("</dcc:model>").size();
  older.insert(at,
               "<dcc:identifications><dcc:identification><dcc:issuer>manufacturer</dcc:issuer><dcc:value>not "
               "stated</dcc:value></dcc:identification></dcc:identifications>");
  test::write_file(folder / "a.xml", older);
  EXPECT_EQ(read_certificate(folder / "a.xml").stage_serial_number, "");
}

// The budget in the XML adds up to the uncertainty of each output.
TEST_F(DccTest, TheBudgetAddsUpToTheUncertainty) {
  const Certificate made = certificate();
  const CertificateXml xml(xml_text(dcc_document(made)));
  const std::size_t lines = xml.texts("//dcc:list[@refType='abc_budgetLine']/dcc:name").size();
  ASSERT_GT(lines, 5U);
  for (std::size_t axis = 0; axis < 3; ++axis) {  // s_u, s_v, s_w, as intrinsic sensitivities.
    double squares = 0.0;
    for (std::size_t line = 1; line <= lines; ++line) {
      const auto contributions =
          xml.numbers("(//dcc:list[@refType='abc_budgetLine'])[" + std::to_string(line) +
                      "]/dcc:quantity[@refType='abc_contribution'][1]/si:realListXMLList/si:valueXMLList");
      squares += std::pow(contributions.at(9 + axis), 2);
    }
    // In m/s2 per m/s2, local gravity included, as on the first page.
    const double u =
        kStandardGravity *
        stated_quantity(made.run.stated, std::string("intrinsic_sensitivity_") + kOutputNames[axis])
            ->standard_uncertainty;
    EXPECT_NEAR(std::sqrt(squares), u, 0.05 * u) << axis;  // Contributions have two digits.
  }
}

// Every row of the budget contributes, and names its source; the readings, whose size the run estimated, have
// their degrees of freedom on the page too.
TEST_F(DccTest, EveryRowOfTheBudgetHasASourceAndDegreesOfFreedom) {
  CertificateRequest asked = request();
  as_if_real(asked.run);
  for (DwellRecord& dwell : asked.run.record.dwells) dwell.u_mean.reset();
  asked.run.results = {analyse_joint(asked.run.record)};
  asked.run.budget = make_budget(asked.run.record, asked.run.result());
  BudgetLine idle = asked.run.budget->lines.front();
  idle.input = Message("a row that does not apply");
  idle.contribution.setZero();
  asked.run.budget->lines.push_back(idle);
  const XmlDocument document = dcc_document(make_certificate(std::move(asked)));
  EXPECT_EQ(to_string(check_business_rules(document)), "");
  const std::string text = xml_text(document);
  EXPECT_THAT(text, Not(HasSubstr("does not apply")));
  const CertificateXml xml(text);
  const std::size_t rows = xml.texts("//dcc:list[@refType='abc_budgetLine']/dcc:name").size();
  const std::string of_row = "//dcc:list[@refType='abc_budgetLine']/dcc:measurementMetaData/dcc:metaData";
  const auto sources = xml.texts(of_row + "[@refType='abc_source']/dcc:data/dcc:text/dcc:content");
  EXPECT_EQ(sources.size(), rows);
  EXPECT_THAT(sources,
              testing::IsSupersetOf({"data sheet", "survey of 2025, EX-GRAV-7", "the readings of this run"}));
  const std::string degrees = of_row + "[@refType='abc_degreesOfFreedom']//si:realListXMLList";
  ASSERT_EQ(xml.texts(degrees + "/si:labelXMLList").size(), 1U) << "stated values have infinitely many";
  const auto numbers = xml.numbers(degrees + "/si:valueXMLList");
  // Where the readings hardly contribute, their share of the degrees of freedom is beyond 1000.
  EXPECT_GE(numbers.size(), 12U);
  for (const double nu : numbers) EXPECT_TRUE(nu >= 1.0 && nu < 1000.0) << nu;
  const std::string page = document_text(certificate_page(text), stderr);
  EXPECT_THAT(page, AllOf(HasSubstr("survey of 2025"), HasSubstr("the readings of this run")));
}

TEST_F(DccTest, TheMethodNamesTwoFaces) {
  const std::string faces = "//dcc:usedMethodQuantity[@refType='abc_faces']";
  EXPECT_TRUE(CertificateXml(xml_text(dcc_document(certificate()))).texts(faces + "//si:value").empty());
  CertificateRequest asked = request();
  for (DwellRecord& dwell : asked.run.record.dwells) dwell.face = dwell.n % 2 == 0 ? 2 : 1;
  const std::string text = xml_text(dcc_document(make_certificate(std::move(asked))));
  EXPECT_THAT(CertificateXml(text).texts(faces + "//si:value"), testing::ElementsAre("2"));
  const std::string page = document_text(certificate_page(text), stderr);
  EXPECT_THAT(std::regex_replace(page, std::regex("\\s+"), " "),
              HasSubstr("Faces, in each of which half of the angles are measured: 2"));
}

// A check of U, and no result: in XML and on the page, in either language, with the digits of one rounding.
TEST_F(DccTest, TheMagnitudeOnHeldOutPosesIsOnTheCertificate) {
  for (const char* language : {"en", "de"}) {
    CertificateRequest asked = request(
        replaced(example_laboratory(), "language = \"en\"", fmt::format("language = \"{}\"", language)));
    ASSERT_TRUE(asked.run.held_out_norm) << "the run declares the joint estimator";
    HeldOutNorm& norm = *asked.run.held_out_norm;
    EXPECT_EQ(norm.poses, 39);  // 12 angles of each experiment, and the closing one
    norm.rms = 1.23456e-5;
    norm.rms_of_model = 2.34567e-6;
    norm.rms_expected = 3.45678e-6;
    norm.probability = 1e-7;
    const XmlDocument document = dcc_document(make_certificate(std::move(asked)));
    EXPECT_EQ(to_string(check_business_rules(document)), "");
    const std::string text = xml_text(document);
    const CertificateXml xml(text);
    const std::string check = "//dcc:metaData[@refType='abc_heldOutNorm']";
    EXPECT_THAT(xml.texts(check + "//si:value"), testing::ElementsAre("1.2e-05", "2.3e-06", "3.5e-06"));
    EXPECT_EQ(xml.text(check + "/dcc:description/dcc:content/@lang"), language) << "every part is translated";
    const std::string page = test::unwrapped(document_text(certificate_page(text), stderr));
    const bool german = std::string_view(language) == "de";
    EXPECT_THAT(page, HasSubstr(german ? "1,2 × 10⁻⁵ g_loc" : "1.2 × 10⁻⁵ g_loc"));
    EXPECT_THAT(page, HasSubstr(german ? "MEHR ALS ZUFALL" : "MORE THAN CHANCE"));
    EXPECT_THAT(page, HasSubstr(german ? "nicht unabhängig von g_loc" : "not independent of g_loc"));
    EXPECT_THAT(
        page, HasSubstr(german ? "Anzugsmoment der Befestigungsschrauben" : "torque of the mounting screws"));
  }
}

TEST_F(DccTest, EachResultHasARefTypeOfItsOwn) {
  const CertificateXml xml(xml_text(dcc_document(certificate())));
  std::vector<std::string> types = xml.texts("//dcc:result/@refType");
  ASSERT_GT(types.size(), 10U);
  std::sort(types.begin(), types.end());
  EXPECT_EQ(std::adjacent_find(types.begin(), types.end()), types.end());
}

// Programs that set the locale of their user print "0,1" with printf; the certificate must not.
TEST_F(DccTest, DoesNotDependOnTheLocale) {
  const std::string here = xml_text(dcc_document(certificate()));
  const char* found = nullptr;
  for (const char* name : {"de_DE.UTF-8", "de_DE.utf8", "fr_FR.UTF-8", "de_DE"})
    if (found == nullptr) found = std::setlocale(LC_ALL, name);
  if (found == nullptr) GTEST_SKIP() << "no locale with a decimal comma is installed";
  const std::string there = xml_text(dcc_document(certificate()));
  std::setlocale(LC_ALL, "C");
  EXPECT_EQ(here, there);
}

TEST_F(DccTest, MarkupAndOtherScriptsStayText) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "dcc/xsd");
  std::string laboratory = example_laboratory();
  laboratory = replaced(laboratory, "name = \"Example customer\"",
                        "name = \"<b>M\u00fcller & S\u00f6hne</b> ]]> \u8a08\u91cf \\u0001\"");
  CertificateRequest asked = request(laboratory);
  asked.run.run->header.labels["item.model"] = "</dcc:model><!-- & \"quoted\" 'single' \xff\xfe";
  const Certificate made = make_certificate(std::move(asked));
  const std::string text = xml_text(dcc_document(made));
  const XmlDocument document = parse_xml(text, "draft");
  EXPECT_EQ(to_string(DccSchema(path).check(document)), "");
  EXPECT_EQ(to_string(check_business_rules(document)), "");
  const CertificateXml xml(text);
  EXPECT_EQ(xml.text("//dcc:customer/dcc:name/dcc:content"),
            "<b>M\u00fcller & S\u00f6hne</b> ]]> \u8a08\u91cf \ufffd");
  EXPECT_EQ(xml.text("//dcc:item/dcc:model"), "</dcc:model><!-- & \"quoted\" 'single' \ufffd\ufffd");
}

TEST_F(DccTest, ANumberThatIsNotFiniteStopsItAndIsNamed) {
  Certificate made = certificate();
  made.run.stated.result.offset[2].value = std::numeric_limits<double>::quiet_NaN();
  try {
    checked_xml(made, nullptr);
    FAIL();
  } catch (const CertificateRefused& refused) {
    EXPECT_THAT(refused.what(), HasSubstr("O_w is not a finite number"));
  }
  made = certificate();
  (*made.run.stated.result.covariance)(3, 4) = std::numeric_limits<double>::infinity();
  EXPECT_THROW(checked_xml(made, nullptr), CertificateRefused);
}

// ---- two hundred certificates ---------------------------------------------------------------------------

class Chance {
 public:
  explicit Chance(unsigned seed) : random_(seed) {}

  std::size_t below(std::size_t n) { return std::uniform_int_distribution<std::size_t>(0, n - 1)(random_); }
  bool coin() { return below(2) == 0; }
  template <class T>
  const T& one_of(const std::vector<T>& list) {
    return list[below(list.size())];
  }

  /// Any finite number whose square and tenfold are finite too: ordinary, huge, tiny, denormal, zero.
  double number() {
    const double sign = coin() ? 1.0 : -1.0;
    switch (below(6)) {
      case 0:
        return 0.0;
      case 1:
        return sign * std::ldexp(1.0 + uniform(), static_cast<int>(below(900)) - 450);
      case 2:
        return sign * std::numeric_limits<double>::denorm_min() * static_cast<double>(1 + below(1000));
      case 3:
        return sign * 1e300 * uniform();
      case 4:
        return sign * static_cast<double>(below(1'000'000'000));
      default:
        return sign * uniform();
    }
  }
  double not_negative() { return std::abs(number()); }
  double uniform() { return std::uniform_real_distribution<double>(0.0, 1.0)(random_); }

  std::string text() {
    static const std::vector<std::string> kPieces{"Stra\u00dfe",
                                                  "\u010cesk\u00fd",
                                                  "\u8a08\u91cf\u7814\u7a76\u6240",
                                                  "\U0001F4D0",
                                                  "<b>",
                                                  "</dcc:content>",
                                                  "&amp;",
                                                  "&",
                                                  "]]>",
                                                  "\"",
                                                  "'",
                                                  "<!--",
                                                  "--",
                                                  "\t",
                                                  "\n",
                                                  "  ",
                                                  "\u00a0",
                                                  "\u202e",
                                                  "A",
                                                  "z9",
                                                  "%s",
                                                  "\\",
                                                  "{}",
                                                  "\u0301"};
    std::string text = "N";
    for (std::size_t i = below(12); i > 0; --i) text += one_of(kPieces);
    return text;
  }

 private:
  std::mt19937_64 random_;
};

void scramble(Quantity& quantity, Chance& chance, const std::string& unit) {
  quantity.value = chance.number();
  quantity.standard_uncertainty = chance.not_negative();
  quantity.unit = unit;
}

std::string per_gravity(const std::string& unit) {
  return (unit.find('/') == std::string::npos ? unit : "(" + unit + ")") + "/g_loc";
}

void scramble(CalibrationResult& result, Chance& chance) {
  static const std::vector<std::string> kUnits{"V",
                                               "mV",
                                               "uV",
                                               "\u00b5V",
                                               "mV/V",
                                               "A",
                                               "g",
                                               "mg",
                                               "m/s2",
                                               "R",
                                               "LSB",
                                               "counts",
                                               "1",
                                               "%",
                                               "m/s\u00b2",
                                               "strange <unit> & co",
                                               "digit per step",
                                               "\u00b5g"};
  const std::string unit = chance.one_of(kUnits);
  result.response_unit = unit;
  // A matrix that could be one, of any size: the angles between its rows have derivatives.
  const double size = std::ldexp(1.0, static_cast<int>(chance.below(300)) - 150);
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 3; ++k) {
      Quantity& quantity = (*result.sensitivity_matrix)[j][k];
      scramble(quantity, chance, per_gravity(unit));
      quantity.value = size * ((j == k ? 2.0 : 0.0) + chance.uniform() - 0.5);
    }
    scramble(result.offset[j], chance, unit);
    scramble(result.intrinsic_sensitivity[j], chance, per_gravity(unit));
    scramble(result.intrinsic_angle[j], chance, "degree");
  }
  // Up to 1e100, since they are multiplied by squares of derivatives and summed.
  const auto covariance = [&] { return std::clamp(chance.number(), -1e100, 1e100); };
  *result.covariance = Covariance12::NullaryExpr([&] { return covariance(); });
  *result.covariance_intrinsic = Covariance9::NullaryExpr([&] { return covariance(); });
  result.why = Message::bare(chance.text());
  result.g_loc_source = chance.text();
}

void scramble(Contact& contact, Chance& chance) {
  for (std::string* text : {&contact.name, &contact.street, &contact.city, &contact.state, &contact.post_code,
                            &contact.email, &contact.phone})
    *text = chance.text();
}

void scramble(Certificate& certificate, Chance& chance) {
  CertifiedRun& run = certificate.run;
  CalibrationResult& result = run.stated.result;
  scramble(result, chance);
  run.data.results.front().why = result.why;
  run.data.results.front().g_loc_source = result.g_loc_source;
  run.data.record.response_unit = result.response_unit;
  for (DerivedGroup& group : run.stated.derived) {
    for (DerivedQuantity& quantity : group.quantities) {
      scramble(quantity.value, chance,
               quantity.value.unit.find("g/(m/s2)") != std::string::npos ? result.response_unit + "/(m/s2)"
                                                                         : quantity.value.unit);
      quantity.gradient.setConstant(chance.uniform());
    }
  }
  for (Decision& decision : run.decisions) {
    scramble(
        decision.quantity, chance,
        decision.quantity.unit == "g/(m/s2)" ? result.response_unit + "/(m/s2)" : decision.quantity.unit);
    decision.guard_band = chance.number();
    for (std::optional<double>* limit :
         {&decision.limit.lower, &decision.limit.upper, &decision.stated.lower, &decision.stated.upper,
          &decision.lower_acceptance, &decision.upper_acceptance})
      *limit = chance.coin() ? std::optional(chance.number()) : std::nullopt;
    decision.conformance_probability = chance.uniform();
    decision.conformity = static_cast<Conformity>(chance.below(4));
    decision.limit.source = chance.text();
  }
  LaboratoryFile& laboratory = certificate.laboratory;
  scramble(laboratory.laboratory.contact, chance);
  scramble(laboratory.customer, chance);
  laboratory.laboratory.accreditation = chance.coin() ? chance.text() : "";
  laboratory.laboratory.gravity_site = chance.text();
  Job& job = laboratory.job;
  for (std::string* text : {&job.item_name, &job.condition, &job.owner_id, &job.order, &job.procedure,
                            &job.sampling, &job.deviations, &job.external_results, &job.opinions})
    *text = chance.coin() ? chance.text() : "";
  job.customer_supplied = {chance.text(), chance.text()};
  if (chance.coin()) job.recalibration = job.received;
  if (chance.coin()) job.received.reset();
  for (Equipment& one : laboratory.equipment) {
    for (std::string* text :
         {&one.name, &one.maker, &one.model, &one.serial_number, &one.certificate, &one.certificate_issuer})
      *text = chance.text();
    if (chance.coin())
      one.certificate_sha256 = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";
  }
  for (auto& [key, label] : run.data.run->header.labels) label = chance.coin() ? chance.text() : "";
  for (InstrumentIdentity& instrument : run.data.run->header.instruments)
    for (std::string* text : {&instrument.maker, &instrument.model, &instrument.serial_number,
                              &instrument.firmware, &instrument.details})
      *text = chance.text() + (chance.coin() ? std::string("\x01\xff\x1b[2J") : "");
  for (StoredEnvironment& look : run.data.run->environment) {
    look.temperature_degc = chance.number();
    look.pressure_hpa = chance.number();
  }
  certificate.reservations = {Message::bare(chance.text()), Message::bare(chance.text())};
  if (chance.coin()) {
    certificate.issue.emplace();
    certificate.issue->approved_by = chance.text();
    certificate.issue->date = Date{std::chrono::year(2026), std::chrono::month(1), std::chrono::day(2)};
    certificate.number = certificate.issue->number = chance.text();
    if (chance.coin()) certificate.issue->replaces = Replacement{chance.text(), chance.text(), ""};
  }
}

TEST_F(DccTest, TwoHundredCertificatesOfAnythingValidate) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "dcc/xsd");
  const DccSchema schema(path);
  const Certificate base = certificate();
  int issued = 0;
  for (unsigned seed = 1; seed <= 200; ++seed) {
    Chance chance(seed);
    Certificate any = base;
    scramble(any, chance);
    issued += any.draft() ? 0 : 1;
    std::string text;
    ASSERT_NO_THROW(text = xml_text(dcc_document(any))) << "seed " << seed;
    const XmlDocument read = parse_xml(text, "certificate");
    ASSERT_EQ(to_string(check_business_rules(read)), "") << "seed " << seed;
    ASSERT_EQ(to_string(schema.check(read)), "") << "seed " << seed;
    // Nothing is lost on the way: the first row of the matrix, in the unit of the output.
    const auto row = CertificateXml(text).numbers(
        "//dcc:result[@refType='abc_sensitivityMatrixPerGravity']//dcc:quantity[1]/"
        "*[self::si:hybrid or self::si:realListXMLList]/descendant-or-self::si:realListXMLList[last()]/"
        "si:valueXMLList");
    ASSERT_EQ(row.size(), 3U);
    for (std::size_t k = 0; k < 3; ++k) {
      const Quantity& q = (*any.run.stated.result.sensitivity_matrix)[0][k];
      ASSERT_NEAR(row[k], q.value,
                  0.051 * coverage_factor(q) * q.standard_uncertainty + 1e-11 * std::abs(q.value))
          << "seed " << seed;
    }
  }
  EXPECT_GT(issued, 60);  // both kinds
  EXPECT_LT(issued, 140);
}

TEST_F(DccTest, TheSchemaRefusesWhatItMust) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "dcc/xsd");
  const DccSchema schema(path);
  const std::string good = xml_text(dcc_document(certificate()));
  const auto broken =
      replaced(good, "<dcc:performanceLocation>laboratory<", "<dcc:performanceLocation>moon<");
  const auto problems = schema.check(parse_xml(broken, "broken"));
  ASSERT_FALSE(problems.empty());
  EXPECT_THAT(problems.front().where, HasSubstr("line "));
  EXPECT_THAT(to_string(problems), HasSubstr("moon"));
  EXPECT_THROW(DccSchema(folder.path()), std::invalid_argument);
}

// ---- programs of others ---------------------------------------------------------------------------------

TEST_F(DccTest, XmllintFindsItValid) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "dcc/xsd/v3.3.0/dcc.xsd");
  if (shell("command -v xmllint", folder).first != 0)
    GTEST_SKIP() << "xmllint (libxml2-utils) is not installed";
  test::write_file(folder / "a.xml", xml_text(dcc_document(certificate())));
  const auto [code, said] =
      shell("xmllint --nonet --noout --schema '" + path.string() + "' '" + (folder / "a.xml").string() + "'",
            folder);
  EXPECT_EQ(code, 0) << said;
  EXPECT_THAT(said, HasSubstr("validates"));
}

TEST_F(DccTest, TheSchematronOfThePtbFindsNothing) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "dcc/schematron/dcc.svrl");
  if (!has_schematron_reader(folder)) GTEST_SKIP() << "Saxon-HE (libsaxonhe-java) or java is not installed";
  const auto errors_of = [&](const std::string& xml) { return schematron_errors(xml, path, folder); };
  const std::string good = xml_text(dcc_document(certificate()));
  EXPECT_THAT(errors_of(good), testing::IsEmpty());
  for (unsigned seed = 1; seed <= 3; ++seed) {
    Chance chance(seed);
    Certificate any = certificate();
    scramble(any, chance);
    EXPECT_THAT(errors_of(xml_text(dcc_document(any))), testing::IsEmpty()) << "seed " << seed;
  }
  EXPECT_THAT(errors_of(xml_text(dcc_document(
                  certificate(replaced(example_laboratory(), "language = \"en\"", "language = \"de\""))))),
              testing::IsEmpty());
  // The check can fail.
  EXPECT_THAT(errors_of(replaced(good, "<dcc:release>v", "<dcc:release>")), testing::Not(testing::IsEmpty()));
}

}  // namespace
}  // namespace abcal
