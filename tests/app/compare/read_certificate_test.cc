#include "app/laboratory/compare/read_certificate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>

#include "app/formats/xml_tree.h"
#include "app/results/analysis/other_file.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/test_data.h"

namespace abcal {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

std::string certificate_with(const std::string& results) {
  return "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"
         "<dcc:digitalCalibrationCertificate xmlns:dcc=\"https://ptb.de/dcc\" xmlns:si=\"https://ptb.de/si\">"
         "<dcc:measurementResults><dcc:measurementResult><dcc:results>" +
         results +
         "</dcc:results></dcc:measurementResult></dcc:measurementResults>"
         "</dcc:digitalCalibrationCertificate>";
}

std::string list_of(const std::string& labels, const std::string& values, const std::string& unit,
                    const std::string& expanded, const std::string& more = "") {
  return "<si:realListXMLList><si:labelXMLList>" + labels + "</si:labelXMLList><si:valueXMLList>" + values +
         "</si:valueXMLList><si:unitXMLList>" + unit +
         "</si:unitXMLList><si:measurementUncertaintyUnivariateXMLList><si:expandedMUXMLList>"
         "<si:valueExpandedMUXMLList>" +
         expanded +
         "</si:valueExpandedMUXMLList><si:coverageFactorXMLList>2</si:coverageFactorXMLList>"
         "</si:expandedMUXMLList></si:measurementUncertaintyUnivariateXMLList>" +
         more + "</si:realListXMLList>";
}

class ReadCertificateTest : public testing::Test {
 protected:
  ComparedResult read(const std::string& text) {
    test::write_file(folder / "certificate.xml", text);
    return read_certificate(folder / "certificate.xml");
  }
  std::string refusal(const std::string& text) {
    try {
      read(text);
    } catch (const std::exception& error) {
      return error.what();
    }
    return "read without a word";
  }
  test::TemporaryFolder folder;
};

TEST_F(ReadCertificateTest, ReadsTheHandMadeExample) {
  ABCAL_SHARED_DATA_OR_SKIP(path, "dcc/examples/abc_example_dcc_3.3.0.xml");
  EXPECT_TRUE(looks_like_xml(path));
  // One row only is in the example: the nine of a matrix are not complete, the angles are.
  const ComparedResult result = read_certificate(path);
  EXPECT_EQ(result.what, "LAB-2026-0001");
  EXPECT_EQ(result.item_serial_number, "SN-42");
  EXPECT_EQ(result.date, "2026-01-07");
  EXPECT_EQ(result.unit_name, "V");
  EXPECT_FALSE(result.matrix.has_value());
  EXPECT_NEAR(result.values(3), 90.012, 1e-12);
  EXPECT_NEAR(std::sqrt(result.covariance(4, 4)), 0.005, 1e-12);
  EXPECT_TRUE(std::isnan(result.values(0)));
  ASSERT_TRUE(result.g_loc.has_value());
  EXPECT_EQ(result.g_loc->value, 9.80101);
  EXPECT_FALSE(result.with_correlations);
}

TEST_F(ReadCertificateTest, BringsListsIntoBaseUnits) {
  const ComparedResult result = read(certificate_with(
      list_of("s_u s_v s_w", "100 101 102", "\\milli\\volt\\second\\tothe{2}\\metre\\tothe{-1}", "0.2") +
      list_of("O_u O_v O_w", "0.1 0.2 +3e-1", "\\volt", "0.02 0.04 0.06") +
      list_of("phi_uv phi_vw phi_wu", "1.5 1.6 1.7", "\\radian", "0.002")));
  EXPECT_EQ(result.unit_name, "V");
  EXPECT_NEAR(result.values(1), 0.101, 1e-15);
  EXPECT_NEAR(std::sqrt(result.covariance(2, 2)), 1e-4, 1e-15);
  EXPECT_NEAR(result.values(4), 1.6 * 180.0 / std::acos(-1.0), 1e-12);
  EXPECT_NEAR(std::sqrt(result.covariance(7, 7)), 0.02, 1e-15);
  EXPECT_NEAR(result.values(8), 0.3, 1e-15);
}

TEST_F(ReadCertificateTest, ComputesFromTheMatrixWhatIsNotStated) {
  const ComparedResult result =
      read(certificate_with(list_of("s_ux s_uy s_uz", "0.3 0.4 0", "\\one", "0.002") +
                            list_of("s_vx s_vy s_vz", "-0.8 0.6 0", "\\one", "0.002") +
                            list_of("s_wx s_wy s_wz", "0 0 2", "\\one", "0.002")));
  ASSERT_TRUE(result.matrix.has_value());
  EXPECT_EQ(result.unit_name, "m/s2");
  EXPECT_NEAR(result.values(0), 0.5, 1e-15);
  EXPECT_NEAR(result.values(1), 1.0, 1e-15);
  EXPECT_NEAR(result.values(3), 90.0, 1e-12);
  // u of a length from three equal independent u is that u; of an angle u/|s_u| and u/|s_v| together.
  EXPECT_NEAR(std::sqrt(result.covariance(0, 0)), 0.001, 1e-15);
  EXPECT_NEAR(std::sqrt(result.covariance(3, 3)), std::hypot(0.002, 0.001) * 180.0 / std::acos(-1.0), 1e-12);
  EXPECT_TRUE(std::isnan(result.values(6)));
}

TEST_F(ReadCertificateTest, ReadsCovariancesByColumn) {
  const auto column = [](const std::string& values) {
    return "<si:columnXMLList><si:covarianceXMLList><si:valueXMLList>" + values +
           "</si:valueXMLList><si:unitXMLList>\\one</si:unitXMLList></si:covarianceXMLList></"
           "si:columnXMLList>";
  };
  const auto covariance = [&](const std::string& columns) {
    return "<si:measurementUncertaintyMultivariateXMLList><si:ellipsoidalRegionMUXMLList>"
           "<si:covarianceMatrixXMLList>" +
           columns +
           "</si:covarianceMatrixXMLList></si:ellipsoidalRegionMUXMLList>"
           "</si:measurementUncertaintyMultivariateXMLList>";
  };
  const ComparedResult result = read(
      certificate_with(list_of("s_u s_v s_w", "1 2 3", "\\one", "2",
                               covariance(column("1 0.5 0") + column("0.5 1 0.25") + column("0 0.25 1")))));
  EXPECT_EQ(result.covariance(0, 1), 0.5);
  EXPECT_EQ(result.covariance(2, 1), 0.25);
  EXPECT_THAT(refusal(certificate_with(
                  list_of("s_u s_v", "1 2", "\\one", "2", covariance(column("1 0.5") + column("0.4 1"))))),
              HasSubstr("not symmetric"));
  EXPECT_THAT(refusal(certificate_with(list_of("s_u s_v", "1 2", "\\one", "2", covariance(column("1 0.5"))))),
              HasSubstr("1 columns; required: 2"));
}

TEST_F(ReadCertificateTest, NamesEveryProblemAtOnce) {
  const std::string words = refusal(certificate_with(
      list_of("s_u s_v s_w", "1 2", "\\one", "2") + list_of("O_u O_v O_w", "1 zwei 3", "\\one", "2") +
      list_of("phi_uv phi_vw phi_wu", "90 90 90", "\\furlong", "2")));
  EXPECT_THAT(words, AllOf(HasSubstr("has 2 entries; required: 1 or 3"),
                           HasSubstr("\"zwei\" is not a number"), HasSubstr("\\furlong")));
}

TEST_F(ReadCertificateTest, RefusesWhatCannotBeAnUncertainty) {
  const auto standard = [](const std::string& u) {
    return "<si:measurementUncertaintyUnivariateXMLList><si:standardMUXMLList><si:valueStandardMUXMLList>" +
           u +
           "</si:valueStandardMUXMLList></si:standardMUXMLList></si:measurementUncertaintyUnivariateXMLList>";
  };
  const auto stated = [&](const std::string& u) {
    return refusal(
        certificate_with("<si:realListXMLList><si:labelXMLList>s_u</si:labelXMLList><si:valueXMLList>1"
                         "</si:valueXMLList><si:unitXMLList>\\one</si:unitXMLList>" +
                         standard(u) + "</si:realListXMLList>"));
  };
  EXPECT_THAT(stated("0"), HasSubstr("standard uncertainty 0; required: greater than 0"));
  EXPECT_THAT(stated("-1e-3"), HasSubstr("required: greater than 0"));
  EXPECT_THAT(stated("nan"), HasSubstr("a finite one"));
  EXPECT_THAT(refusal(certificate_with(list_of("s_u", "1", "\\one", "0"))), HasSubstr("both greater than 0"));
  EXPECT_THAT(refusal(certificate_with(list_of("s_u", "1", "\\one", "-2"))),
              HasSubstr("both greater than 0"));
  EXPECT_THAT(refusal(certificate_with(list_of("s_u", "inf", "\\one", "2"))), HasSubstr("a finite one"));
}

TEST_F(ReadCertificateTest, RefusesWhatIsMadeToExhaustTheReader) {
  std::string attributes = "<a";
  for (int k = 0; k < 30'000; ++k) attributes += " a" + std::to_string(k) + "=''";
  EXPECT_THAT(refusal(certificate_with(attributes + "/>")), HasSubstr("more than 20000 attributes"));
  std::string elements;
  for (int k = 0; k < 150'000; ++k) elements += "<a/>";
  EXPECT_THAT(refusal(certificate_with(elements)), HasSubstr("more than 100000 elements"));
  EXPECT_THAT(refusal(certificate_with("<a>" + std::string(13u << 20, 'x') + "</a>")),
              HasSubstr("required: at most that"));
  std::string labels;
  for (int k = 0; k < 300'000; ++k) labels += "s_u ";
  EXPECT_THAT(refusal(certificate_with(list_of(labels, "1", "\\one", "2"))), HasSubstr("a list of"));
  labels.resize(4 * 2000);
  EXPECT_THAT(refusal(certificate_with(list_of(labels, "1", "\\one", "2"))),
              HasSubstr("2000 labels; required: at most 1000"));
  std::string deep;
  for (int k = 0; k < 2000; ++k) deep += "<a>";
  EXPECT_THAT(refusal(certificate_with(deep)), HasSubstr("Excessive depth"));
}

TEST_F(ReadCertificateTest, RefusesUnitsThatDoNotGoTogether) {
  EXPECT_THAT(
      refusal(certificate_with(list_of("s_u", "1", "\\volt\\second\\tothe{2}\\metre\\tothe{-1}", "2") +
                               list_of("O_u", "1", "\\ampere", "2"))),
      HasSubstr("does not go with"));
  EXPECT_THAT(refusal(certificate_with(list_of("phi_uv", "1", "\\volt", "2"))), HasSubstr("an angle"));
}

TEST_F(ReadCertificateTest, RefusesWhatIsNoCertificateOfAnAccelerometer) {
  EXPECT_THAT(refusal("<a/>"), HasSubstr("not a digital calibration certificate"));
  EXPECT_THAT(refusal("<a>"), HasSubstr("line 1: Premature end of data"));
  EXPECT_THAT(refusal(certificate_with("")), HasSubstr("no list of numbers"));
  EXPECT_THAT(refusal(certificate_with(list_of("T_1 T_2", "1 2", "\\kelvin", "1"))),
              HasSubstr("no list of numbers"));
}

// A certificate comes from somebody else: no file of this machine may be read through it.
TEST_F(ReadCertificateTest, ExpandsNoEntities) {
  test::write_file(folder / "secret", "1 2 3");
  std::string text = certificate_with(list_of("s_u s_v s_w", "&secret;", "\\one", "2"));
  text.insert(text.find("<dcc:"), "<!DOCTYPE x [<!ENTITY secret SYSTEM \"secret\">]>");
  EXPECT_THAT(refusal(text), HasSubstr("document type declaration"));
}

TEST_F(ReadCertificateTest, RefusesMoreThanACertificateCanBe) {
  EXPECT_THAT(refusal("<a>" + std::string(kLargestXml, ' ') + "</a>"), HasSubstr("required: at most"));
}

}  // namespace
}  // namespace abcal
