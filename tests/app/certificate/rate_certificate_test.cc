// Certificates of a run at a constant rate: results at rest, and the response at each rate.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "app/document/document_text.h"
#include "app/laboratory/certificate/business_rules.h"
#include "app/laboratory/certificate/certificate_json.h"
#include "app/laboratory/certificate/certificate_page.h"
#include "app/laboratory/certificate/dcc_xml.h"
#include "app/laboratory/certificate/schema_check.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/xml_query.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

constexpr double kLowPassHz = 5.0;

class RateCertificateTest : public CertificateTest {
 protected:
  static void SetUpTestSuite() {
    folder_ = new test::TemporaryFolder;
    std::string bench =
        replaced(certificate_bench(), "steps = 12\nstep_deg = 30.0\nsettle_s = 0.05\ndwell_readings = 10\n",
                 "motion = \"constant_rate\"\nrate_deg_per_s = [60, 20]\nacceleration_deg_per_s2 = 200.0\n"
                 "steps = 36\nstep_deg = 10.0\nsettle_s = \"auto\"\n");
    bench = replaced(bench, "noise = 1e-4\n", "noise = 1e-4\nlow_pass_hz = 5.0\ngroup_delay_s = 0.02\n");
    measure(bench, "rate.run", *folder_);
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }

  static std::filesystem::path run_file() { return *folder_ / "rate.run"; }
  static Certificate draft(const std::string& laboratory = example_laboratory()) {
    CertificateRequest asked;
    asked.laboratory = parse_laboratory_file(laboratory, "lab.toml");
    asked.run = gather_report(run_file(), any_time());
    return make_certificate(std::move(asked));
  }
  static std::string page_of(const Certificate& certificate) {
    return document_text(certificate_page(xml_text(dcc_document(certificate))), stderr);
  }

 private:
  static inline test::TemporaryFolder* folder_ = nullptr;
};

TEST_F(RateCertificateTest, StatesAmplitudeAndPhaseAtEachFrequency) {
  const Certificate made = draft();
  const CertificateXml xml(xml_text(dcc_document(made)));
  const std::string at = "//dcc:result[@refType='abc_responseAtRates']//dcc:list";
  const std::vector<double> rates{20.0, 60.0};
  EXPECT_EQ(xml.texts(at + "/dcc:name").size(), rates.size());
  for (std::size_t i = 0; i < rates.size(); ++i) {
    const std::string of_rate = at + "[" + std::to_string(i + 1) + "]/dcc:quantity";
    const double rate = xml.numbers(of_rate + "[@refType='abc_rate']/si:real/si:value").at(0);
    const double hz = xml.numbers(of_rate + "[@refType='abc_frequency']/si:real/si:value").at(0);
    EXPECT_NEAR(rate, rates[i], 0.01);
    EXPECT_NEAR(hz, rate / 360.0, 1e-3 * hz);
    const std::string measured = of_rate + "[@refType='basic_measuredValue']";
    const auto amplitude = xml.numbers("(" + measured + ")[1]//si:valueXMLList"),
               expanded = xml.numbers("(" + measured + ")[1]//si:valueExpandedMUXMLList");
    ASSERT_EQ(amplitude.size(), 3U);
    for (std::size_t j = 0; j < 3; ++j)
      EXPECT_NEAR(amplitude[j], 1.0 / std::hypot(1.0, hz / kLowPassHz), 2.0 * expanded.at(j)) << hz << " Hz";
    EXPECT_NEAR(xml.numbers("(" + measured + ")[2]//si:valueXMLList").at(0), 0.0,
                xml.numbers("(" + measured + ")[2]//si:valueExpandedMUXMLList").at(0));
  }
  // No scope covers them.
  EXPECT_EQ(xml.texts(at + "//dcc:metaData[@refType='" + kOutsideScopeMark + "']").empty(),
            made.run.stated.marks.empty());
}

TEST_F(RateCertificateTest, KeepsSchemaAndRules) {
  const XmlDocument document = dcc_document(draft());
  EXPECT_EQ(to_string(check_business_rules(document)), "");
  ABCAL_SHARED_DATA_OR_SKIP(path, "dcc/xsd");
  EXPECT_EQ(to_string(DccSchema(path).check(parse_xml(xml_text(document), "draft"))), "");
}

TEST_F(RateCertificateTest, ItsPageAndItsNumbersForProgramsHaveTheResponse) {
  const Certificate made = draft();
  EXPECT_THAT(page_of(made), AllOf(HasSubstr("Response at constant rates"), HasSubstr("0.1667 Hz, 60 °/s"),
                                   HasSubstr("0.05556 Hz, 20 °/s"), HasSubstr("apparent positions")));
  EXPECT_THAT(xml_text(dcc_document(made)),
              AllOf(HasSubstr("so that gravity becomes a sine"), HasSubstr("Measurement 189 (2022), 110528"),
                    Not(HasSubstr("at each angle the outputs are averaged"))));
  const auto json = certificate_json(xml_text(dcc_document(made)));
  const auto response = std::find_if(json["results"].begin(), json["results"].end(),
                                     [](const auto& one) { return one["result"] == "abc_responseAtRates"; });
  ASSERT_NE(response, json["results"].end());
  EXPECT_EQ((*response)["statements"].size(), 2U * (2U + 3U + 1U));
}

TEST_F(RateCertificateTest, SaysWhichUncertaintyIsStated) {
  CertificateRequest asked;
  asked.laboratory = parse_laboratory_file(example_laboratory(), "lab.toml");
  asked.run = gather_report(run_file(), any_time());
  asked.draft = true;
  add_monte_carlo(asked);
  const Certificate made = make_certificate(std::move(asked));
  ASSERT_TRUE(made.run.monte_carlo);
  const auto json = certificate_json(xml_text(dcc_document(made)));
  EXPECT_THAT(json["monte_carlo"].get<std::string>(),
              AllOf(HasSubstr("2000 trials of the whole evaluation (seed " +
                              std::to_string(seed_of_sha256(made.run.data.sha256.value())) + ")"),
                    HasSubstr(made.run.monte_carlo->any_larger() ? "that of the trials and its covariance"
                                                                 : "the evaluated one is stated")));
}

TEST_F(RateCertificateTest, AsFoundAndAsLeftEachHaveTheirResponse) {
  CertificateRequest asked;
  asked.laboratory = parse_laboratory_file(
      replaced(example_laboratory(), "deviations = \"\" ", "adjustment = \"set\" "), "lab.toml");
  asked.run = gather_report(run_file(), any_time());
  asked.as_found = gather_report(run_file(), any_time());
  const std::string page = page_of(make_certificate(std::move(asked)));
  EXPECT_THAT(page, AllOf(HasSubstr("Response at constant rates: DRAFT: Calibration"), HasSubstr("as found"),
                          HasSubstr("as left")));
  const std::string heading = "0.1667 Hz, 60 °/s";
  const std::size_t first = page.find(heading);
  ASSERT_NE(first, std::string::npos);
  EXPECT_NE(page.find(heading, first + 1), std::string::npos);
}

TEST_F(RateCertificateTest, InGerman) {
  const std::string page =
      page_of(draft(replaced(example_laboratory(), "language = \"en\"", "language = \"de\"")));
  EXPECT_THAT(page, AllOf(HasSubstr("Frequenzgang bei konstanten Drehraten"), HasSubstr("0,1667 Hz, 60 °/s"),
                          Not(HasSubstr("Response"))));
}

}  // namespace
}  // namespace abcal
