// Certificates of a series over temperature: the run at the reference and, as a section, the series.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "app/laboratory/certificate/dcc_xml.h"
#include "protocol/record/sha256.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/xml_query.h"
#include "tests/app/temperature_text.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::json;

constexpr std::size_t kPoints = 7;  // reference, three up, two down, reference

/// The short series of the tests, on a bench and with an item that a certificate can name.
std::string certificate_series_bench() {
  std::string text = replaced(SeriesText().text(), "[item]\n",
                              "[item]\nmaker = \"Maker\"\nmodel = \"M-3\"\nserial_number = \"SN-42\"\n");
  text = replaced(text, "g_loc_mps2 = 9.81\n",
                  "name = \"bench 1\"\ng_loc_mps2 = 9.81\ng_loc_expanded_uncertainty_mps2 = 0.00003\n"
                  "g_loc_k = 2.0\ng_loc_source = \"survey of 2025, EX-GRAV-7\"\n");
  return text +
         "[operator]\nname = \"Operator N. N.\"\n[environment]\ntemperature_degc = 23.0\n"
         "humidity_percent = 45.0\n";
}

class SeriesCertificateTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    shared_ = new test::TemporaryFolder;
    test::write_file(*shared_ / "t.toml", certificate_series_bench());
    const auto result = test::run_program({"temperature", "t.toml", "--json"}, shared_->path());
    ASSERT_EQ(result.exit_code, 0) << result.err;
    test::write_file(*shared_ / "series.json", result.out);
    test::write_file(*shared_ / "lab.toml", replaced(example_laboratory(), "serial_number = \"118001234\"",
                                                     "serial_number = \"SIM-1\"    "));
  }
  static void TearDownTestSuite() {
    delete shared_;
    shared_ = nullptr;
  }
  void SetUp() override {
    for (const auto& entry : std::filesystem::directory_iterator(shared_->path()))
      std::filesystem::copy(entry.path(), folder / entry.path().filename().string(),
                            std::filesystem::copy_options::recursive);
  }

  static std::string point(std::size_t number) { return "t-temperature-0" + std::to_string(number) + ".run"; }

  /// `abcal WORDS --laboratory lab.toml --temperature` and the points from `first` to `last`.
  test::ProgramResult with_points(std::vector<std::string> words, std::size_t first = 1,
                                  std::size_t last = kPoints) {
    words.insert(words.end(), {"--laboratory", "lab.toml"});
    if (const auto schemas = test::shared_data("dcc/xsd"))
      words.insert(words.end(), {"--schemas", schemas->string()});
    words.emplace_back("--temperature");
    for (std::size_t number = first; number <= last; ++number) words.push_back(point(number));
    return abcal(words);
  }
  test::ProgramResult abcal(const std::vector<std::string>& words) {
    return test::run_program(words, folder.path());
  }

  test::TemporaryFolder folder;

 private:
  static inline test::TemporaryFolder* shared_ = nullptr;
};

/// The numbers of a quantity of the series, in the unit of the certificate's own list.
std::vector<double> numbers_of(const CertificateXml& xml, const std::string& result,
                               const std::string& quantity, const std::string& what) {
  return xml.numbers("//dcc:measurementResult[@refType='abc_temperatureSeries']//dcc:result[@refType='" +
                     result + "']//dcc:quantity[dcc:name/dcc:content='" + quantity +
                     "']/si:hybrid/si:realListXMLList[last()]/" + what);
}

TEST_F(SeriesCertificateTest, AnIssuedCertificateHasTheSeriesAsASection) {
  const test::TrainingRegister registered(folder.path());
  const auto issued = with_points({"issue", point(kPoints), "--dcc", "c.xml"});
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  const std::string text = test::read_file(folder / "c.xml");
  const CertificateXml xml(text);
  ASSERT_EQ(xml.texts("//dcc:measurementResult").size(), 2U);
  EXPECT_EQ(xml.text("//dcc:quantity[@refType='abc_referenceTemperature']/si:hybrid/si:real[2]/si:value"),
            "23");

  // The numbers are those of `abcal temperature --json`, with k = 2 or that of few degrees of freedom.
  const Json json = Json::parse(test::read_file(folder / "series.json"));
  const std::vector<double> slopes =
      numbers_of(xml, "abc_temperatureCoefficientsOfSensitivity", "Slope at T0", "si:valueXMLList");
  const std::vector<double> expanded = numbers_of(xml, "abc_temperatureCoefficientsOfSensitivity",
                                                  "Slope at T0", "*/*/si:valueExpandedMUXMLList");
  const std::vector<double> k = numbers_of(xml, "abc_temperatureCoefficientsOfSensitivity", "Slope at T0",
                                           "*/*/si:coverageFactorXMLList");
  ASSERT_EQ(slopes.size(), 3U);
  ASSERT_EQ(expanded.size(), 3U);
  ASSERT_EQ(k.size(), 3U);
  for (std::size_t i = 0; i < 3; ++i) {
    const Json& own = json["coefficients"][i];
    const double u = own["standard_uncertainty"];
    EXPECT_NEAR(slopes[i], own["at_reference"].get<double>(), u) << "rounded to the last place of U";
    EXPECT_NEAR(expanded[i], k[i] * u, 0.06 * k[i] * u) << "two digits";
    EXPECT_GE(k[i], 2.0);
  }
  // Polynomials and points: all digits, and every point.
  const std::vector<double> polynomial =
      numbers_of(xml, "abc_temperaturePolynomials", "O_w", "si:valueXMLList");
  const Json& own = json["polynomials"][8]["coefficients"];
  ASSERT_EQ(polynomial.size(), own.size());
  for (std::size_t i = 0; i < own.size(); ++i)
    EXPECT_NEAR(polynomial[i], own[i].get<double>(), 1e-9 * std::abs(own[i].get<double>()));
  const std::vector<double> at_points =
      numbers_of(xml, "abc_temperaturePoints", "g_loc*s_u", "si:valueXMLList");
  ASSERT_EQ(at_points.size(), kPoints);
  for (std::size_t i = 0; i < kPoints; ++i)
    EXPECT_NEAR(at_points[i], json["points"][i]["values"][0].get<double>(), 1e-4);

  // The evidence is named by its bytes; verification reports a file that changed or is gone.
  for (std::size_t number = 1; number <= kPoints; ++number)
    EXPECT_THAT(text, HasSubstr(sha256_of_file(folder / point(number)))) << number;
  const auto verified = abcal({"verify", point(kPoints)});
  EXPECT_EQ(verified.exit_code, 0) << verified.out << verified.err;
  EXPECT_THAT(verified.out, HasSubstr("point over temperature " + point(2)));
  std::filesystem::remove(folder / point(3));
  std::filesystem::copy_file(folder / point(1), folder / point(2),
                             std::filesystem::copy_options::overwrite_existing);
  const auto changed = abcal({"verify", point(kPoints)});
  EXPECT_NE(changed.exit_code, 0);
  EXPECT_THAT(changed.out, AllOf(HasSubstr("required: that of the certificate"),
                                 HasSubstr("not in the folder of the run")));

  // A later report shows the issued certificate, and no other series.
  EXPECT_EQ(with_points({"report", point(kPoints), "--dcc", "again.xml"}, 4).exit_code, 0);
  EXPECT_EQ(test::read_file(folder / "again.xml"), text);
}

TEST_F(SeriesCertificateTest, ThePageHasTheTableAndThePicture) {
  const auto result = with_points({"report", point(1), "--html", "c.html"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(test::read_file(folder / "c.html"),
              AllOf(HasSubstr("Calibration over temperature"), HasSubstr("Change over temperature"),
                    HasSubstr("Way up minus way down, where it is largest"), HasSubstr("Closure: last point"),
                    HasSubstr("<svg")));
}

TEST_F(SeriesCertificateTest, ASeriesThatIsNotWholeIsRefused) {
  const auto result = with_points({"report", point(kPoints), "--dcc", "c.xml"}, 2, kPoints - 1);
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, AllOf(HasSubstr("no point 1, 7 of 7"),
                                HasSubstr("every point of the series, with its return to the reference")));
  EXPECT_FALSE(std::filesystem::exists(folder / "c.xml"));
}

TEST_F(SeriesCertificateTest, EveryContradictionIsSaidAtOnceAndOnce) {
  // Another item's series, measured with another bench file; and a certificate about a run at -40 degC.
  test::write_file(folder / "other.toml", replaced(certificate_series_bench(), "serial_number = \"SN-42\"",
                                                   "serial_number = \"SN-43\""));
  ASSERT_EQ(abcal({"temperature", "other.toml", "-o", "other", "--json"}).exit_code, 0);
  std::filesystem::rename(folder / "other-01.run", folder / point(1));
  std::filesystem::rename(folder / "other-01.run.results", folder / (point(1) + ".results"));
  test::write_file(folder / "lab.toml", example_laboratory());  // without the angles of this stage
  const auto result = with_points({"report", point(2), "--dcc", "c.xml"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err,
              AllOf(HasSubstr("item.serial_number: found \"SN-43\"; required: the item of the run"),
                    HasSubstr("measured with another bench file"),
                    HasSubstr("required: a run at the reference temperature of the series"),
                    HasSubstr("run, stage: found serial number \"SIM-1\""),
                    Not(HasSubstr("runs over temperature, stage"))));
}

TEST_F(SeriesCertificateTest, WithoutASensorTheTemperatureIsTheSetPointAndSaysSo) {
  const auto xml_of = [&](bool with_sensor) {
    CertificateRequest asked;
    asked.laboratory = parse_laboratory_file(test::read_file(folder / "lab.toml"), "lab.toml");
    for (std::size_t number = 1; number <= kPoints; ++number)
      asked.series.push_back(gather_report(folder / point(number), any_time()));
    for (ReportData& data : asked.series)
      for (DwellRecord& dwell : data.record.dwells)
        if (!with_sensor) dwell.temperature_degc.reset();
    asked.run = asked.series.back();
    return xml_text(dcc_document(make_certificate(std::move(asked))));
  };
  const std::string with = xml_of(true), without = xml_of(false);
  EXPECT_THAT(with, AllOf(HasSubstr("kelvins are those that it shows"), Not(HasSubstr("has no sensor"))));
  EXPECT_THAT(without, AllOf(HasSubstr("the set point of the chamber, as the item has no sensor"),
                             HasSubstr("Temperature, as the chamber was set"), Not(HasSubstr("own sensor"))));
  EXPECT_EQ(CertificateXml(without).text(
                "//dcc:quantity[@refType='abc_lowestTemperature']/si:hybrid/si:real[2]/si:value"),
            "-40");
}

}  // namespace
}  // namespace abcal
