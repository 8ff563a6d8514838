// The measurand, the customer's equation, the item and its mounting on a certificate.

#include "app/laboratory/certificate/measurand.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <random>
#include <string>
#include <vector>

#include "app/bench_file/not_real.h"
#include "app/laboratory/certificate/certificate_page.h"
#include "app/laboratory/certificate/dcc_xml.h"
#include "app/results/export/constants.h"
#include "app/results/report/mounting_figure.h"
#include "protocol/plan/limits.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/xml_query.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;

using Vector12 = Eigen::Matrix<double, 12, 1>;

class MeasurandTest : public CertificateTest {
 protected:
  static Certificate draft(CertificateRequest asked) {
    asked.draft = true;
    return make_certificate(std::move(asked));
  }
  static std::string xml_of(const Certificate& certificate) { return xml_text(dcc_document(certificate)); }
  /// The text of all blocks of a page.
  static std::string text_of(const Document& page) {
    std::string text;
    const auto add = [&](const FactList& list) {
      for (const auto& [name, value] : list.facts) text += name + ": " + value + "\n";
    };
    for (const Section& section : page.sections) {
      text += section.title + "\n";
      for (const Block& block : section.blocks) {
        if (const auto* facts = std::get_if<FactList>(&block)) add(*facts);
        if (const auto* both = std::get_if<SideBySide>(&block)) add(both->left), add(both->right);
        if (const auto* paragraph = std::get_if<Paragraph>(&block)) text += paragraph->text + "\n";
        if (const auto* figure = std::get_if<Figure>(&block)) text += "[" + figure->caption + "]\n";
        if (const auto* table = std::get_if<DocumentTable>(&block))
          for (const auto& row : table->rows) text += fmt::format("{}\n", fmt::join(row, " | "));
      }
    }
    return text;
  }
};

TEST_F(MeasurandTest, TheEquationIsTheOneOfExport) {
  const CertificateRequest asked = request();
  const CalibrationResult& result = asked.run.result();
  const CorrectionConstants exported = constants_of(result, ExportFrame::kPlatter);
  const CustomerEquation equation = customer_equation(stated_result(result)).value();
  // Rounding of products of 12 numbers only.
  EXPECT_LT((equation.covariance - exported.covariance).norm(), 1e-12 * exported.covariance.norm());
  for (Eigen::Index i = 0; i < 9; ++i)
    EXPECT_EQ(equation.M[static_cast<std::size_t>(i)].value.value, exported.M(i / 3, i % 3));
  // It undoes the response: S a + O gives back a.
  const Eigen::Vector3d a(3.0, -5.0, 8.0);
  const Eigen::Vector3d r = result.sensitivity_values() / result.g_loc.value * a + result.offset_values();
  EXPECT_LT((exported.M * (r - exported.b) - a).norm(), 1e-12 * a.norm());
}

TEST_F(MeasurandTest, TheCovarianceOfTheEquationIsThatOfDraws) {
  CalibrationResult result = request().run.result();
  result.g_loc.standard_uncertainty = 2e-4;  // As large as the others, so that its part is seen.
  const Eigen::Matrix3d S = result.sensitivity_values();
  const Vector12 means =
      (Vector12() << Eigen::Map<const Eigen::Matrix<double, 9, 1>>(Eigen::Matrix3d(S.transpose()).data()),
       result.offset_values())
          .finished();
  const Eigen::LLT<Covariance12> root(*result.covariance);
  ASSERT_EQ(root.info(), Eigen::Success);
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal;
  constexpr int kDraws = 20000;
  std::vector<Vector12> draws;
  Vector12 mean = Vector12::Zero();
  for (int n = 0; n < kDraws; ++n) {
    const Vector12 outputs =
        means + root.matrixL() * Vector12::NullaryExpr([&](Eigen::Index) { return normal(random); });
    const double g = result.g_loc.value + result.g_loc.standard_uncertainty * normal(random);
    const Eigen::Matrix3d drawn =
        Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(outputs.data());
    const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> M = g * drawn.inverse();
    Vector12& draw = draws.emplace_back();
    draw << Eigen::Map<const Eigen::Matrix<double, 9, 1>>(M.data()), outputs.tail<3>();
    mean += draw / kDraws;
  }
  Covariance12 found = Covariance12::Zero();
  for (const Vector12& draw : draws) found += (draw - mean) * (draw - mean).transpose() / (kDraws - 1);
  const Covariance12 stated = customer_equation(stated_result(result)).value().covariance;
  for (Eigen::Index i = 0; i < 12; ++i)
    for (Eigen::Index j = 0; j < 12; ++j) {
      const double scale = std::sqrt(stated(i, i) * stated(j, j));
      // A coefficient from n draws has the standard deviation 1 / sqrt(n) = 0.007, a variance sqrt(2) of it.
      EXPECT_NEAR(found(i, j) / scale, stated(i, j) / scale, 0.04) << i << " " << j;
    }
}

TEST_F(MeasurandTest, TheScopeRaisesTheEquationWithTheSensitivities) {
  CalibrationResult result = request().run.result();
  // With S = diagonal, M_ii = g_loc / s_ii: equal relative uncertainties.
  for (std::size_t j = 0; j < 3; ++j)
    for (std::size_t k = 0; k < 3; ++k)
      (*result.sensitivity_matrix)[j][k].value = j == k ? 0.5 + static_cast<double>(j) : 0.0;
  for (std::size_t j = 0; j < 3; ++j) result.intrinsic_sensitivity[j].value = 0.5 + static_cast<double>(j);
  ScopeLimit entry;
  entry.quantity = "sensitivity";
  entry.unit = result.response_unit + "/(m/s2)";
  entry.from = 0.01;  // No element besides the diagonal.
  entry.to = 1.0;
  entry.cmc = 0.02;
  entry.relative = true;
  const StatedResult stated = stated_result(result, {.scope = {entry}, .accredited = true});
  const CustomerEquation equation = customer_equation(stated).value();
  for (Eigen::Index i = 0; i < 3; ++i) {
    const Quantity& M = equation.M[static_cast<std::size_t>(4 * i)].value;
    EXPECT_NEAR(M.standard_uncertainty / M.value, 0.01, 0.01 * 0.2) << i;
    const Quantity s =
        *stated_quantity(stated, fmt::format("sensitivity_{}{}", kOutputNames.at(i), kPlatterAxes.at(i)));
    // U = k u with k of the result's degrees of freedom.
    EXPECT_NEAR(M.standard_uncertainty / M.value, s.standard_uncertainty / s.value, 1e-12) << i;
    EXPECT_NEAR(s.standard_uncertainty * coverage_factor(s) / s.value, 0.02, 1e-6) << i;
  }
}

TEST_F(MeasurandTest, TheCertificateHasTheEquationWithItsUncertaintyAndCorrelations) {
  const Certificate made = draft(request());
  const CertificateXml xml(xml_of(made));
  const CorrectionConstants exported = constants_of(made.run.data.result(), ExportFrame::kPlatter);
  const std::string result = "//dcc:result[@refType='abc_customerEquation']";
  std::vector<std::string> labels;
  for (int row = 1; row <= 3; ++row) {
    // The output is in g, so that M is given in SI units and in (m/s2)/g.
    const std::string list =
        fmt::format("{}//dcc:quantity[{}]/si:hybrid/si:realListXMLList[2]/", result, row);
    const std::vector<double> values = xml.numbers(list + "si:valueXMLList"),
                              expanded = xml.numbers(list + "*/*/si:valueExpandedMUXMLList");
    ASSERT_EQ(values.size(), 3U);
    EXPECT_EQ(xml.text(list + "si:unitXMLList"), "|(m/s2)/g");
    for (Eigen::Index k = 0; k < 3; ++k) {
      const double u = exported.u_matrix()(row - 1, k), U = expanded[static_cast<std::size_t>(k)];
      EXPECT_NEAR(values[static_cast<std::size_t>(k)], exported.M(row - 1, k),
                  0.051 * U);        // Two digits of U.
      EXPECT_NEAR(U / u, 2.0, 0.2);  // k of the degrees of freedom, and two digits.
    }
  }
  // M_xu with all of M, in (m/s2 per m/s2)^2 as the output is in g.
  const std::string of_equation = "//dcc:list[@refType='abc_stateCovarianceEquation']/dcc:quantity";
  EXPECT_EQ(xml.texts(of_equation + "/dcc:name").size(), 24U);
  const std::vector<double> covariances = xml.numbers("(" + of_equation + ")[1]//si:valueXMLList");
  EXPECT_NEAR(covariances.at(8) * kStandardGravity * kStandardGravity, exported.covariance(0, 8),
              1e-9 * std::sqrt(exported.covariance(0, 0) * exported.covariance(8, 8)));
  EXPECT_THAT(
      xml.text("//dcc:statement[@refType='abc_measurand']"),
      AllOf(HasSubstr("line response"), HasSubstr("slope at zero acceleration"), HasSubstr("temperature")));
  EXPECT_THAT(xml.text(result + "/dcc:description"),
              AllOf(HasSubstr("a = M (r − b)"), HasSubstr("use the intrinsic")));
}

TEST_F(MeasurandTest, TheItemIsTheOneThatAnswered) {
  // As version 1.0 measured: the instrument reported another identity than the bench file states.
  CertificateRequest asked = request();
  RunHeader& header = asked.run.run->header;
  header.items.front().driver = "microstrain_mip";
  for (InstrumentIdentity& instrument : header.instruments)
    if (instrument.role == "accelerometer")
      instrument = {"accelerometer", "MicroStrain", "3DM-GV7-AR", "6284.123456", "1", ""};
  EXPECT_THAT(
      refusal(asked),
      AllOf(HasSubstr("run, [item] maker: found \"Maker\", but the instrument reported \"MicroStrain\""),
            HasSubstr("run, [item] model: found \"M-3\""),
            HasSubstr("run, [item] serial_number: found \"SN-42\", but the instrument reported "
                      "\"6284.123456\"")));
  // Not so for the item that it is.
  header.labels["item.maker"] = "MicroStrain";
  header.labels["item.model"] = "3DM-GV7-AR";
  header.labels["item.serial_number"] = "6284.123456";
  EXPECT_THAT(refusal(asked), Not(HasSubstr("but the instrument reported")));
  const Certificate made = draft(std::move(asked));
  EXPECT_THAT(text_of(certificate_page(xml_of(made))),
              HasSubstr("Identity: Read from the instrument: Manufacturer, Type, Serial number."));
}

// A number that the instrument reported is not the customer's, in either language; each line is refused once.
TEST_F(MeasurandTest, WhatWasReadIsNotSuppliedByTheCustomer) {
  CertificateRequest asked = request();
  RunHeader& header = asked.run.run->header;
  header.items.front().driver = "microstrain_mip";
  for (InstrumentIdentity& instrument : header.instruments)
    if (instrument.role == "accelerometer") instrument = {"accelerometer", "", "", "SN-42", "1", ""};
  const auto refused = [&](const char* language, const char* supplied) {
    asked.laboratory.file.language = language;
    asked.laboratory.file.job.customer_supplied = {supplied};
    return refusal(asked);
  };
  const std::string read = "read from the instrument: ";
  EXPECT_THAT(refused("en", "Serial number, mounting"), HasSubstr(read + "serial number"));
  EXPECT_THAT(refused("de", "Seriennummer"), HasSubstr(read + "serial number"));
  const std::string all = refused("en", "maker, model and serial number");
  EXPECT_EQ(all.find(read), all.rfind(read));
  // The customer may supply what nobody read.
  EXPECT_THAT(refused("en", "manufacturer and type"), Not(HasSubstr(read)));
}

TEST_F(MeasurandTest, WhatNobodyReadIsSaidToBeStated) {
  const std::string english = text_of(certificate_page(xml_of(draft(request()))));
  EXPECT_THAT(english, HasSubstr("Identity: Stated by the laboratory, not read from an instrument: "
                                 "Manufacturer, Type, Serial number."));
  EXPECT_THAT(english, HasSubstr("Serial number: SN-42 (stated, not read)"));
  CertificateRequest asked = request();
  asked.laboratory.file.language = "de";
  const Document german = certificate_page(xml_of(draft(std::move(asked))));
  EXPECT_THAT(
      text_of(german),
      AllOf(HasSubstr("Vom Laboratorium angegeben, nicht aus einem Gerät ausgelesen: Hersteller, Typ, "
                      "Seriennummer."),
            HasSubstr("Typ: M-3 (nur angegeben)")));
  // Every page has it in its margin.
  EXPECT_THAT(german.identification, HasSubstr("Seriennummer SN-42 (nur angegeben)"));
}

TEST_F(MeasurandTest, TheStatedSerialNumberOfAnInstrumentIsSaidInTheLanguageOfThePage) {
  CertificateRequest asked = request();
  asked.laboratory.file.language = "de";
  RunHeader& header = asked.run.run->header;
  header.labels["stage.stated_serial_number"] = "77";
  for (InstrumentIdentity& instrument : header.instruments)
    if (instrument.role == "stage") {
      instrument.serial_number.clear();
      instrument.details += stated_serial_number_words("77");
    }
  const std::string page = text_of(certificate_page(xml_of(draft(std::move(asked)))));
  EXPECT_THAT(page, AllOf(HasSubstr("Seriennummer 77 (angegeben, nicht ausgelesen)"),
                          Not(HasSubstr("stated by the bench file"))));
}

// Sizes that nobody stated are named; where the operator states them is no matter of the customer's.
TEST_F(MeasurandTest, NoSizeIsAskedOfTheCustomer) {
  for (const char* language : {"en", "de"}) {
    CertificateRequest asked = request();
    asked.laboratory.file.language = language;
    const std::string xml = xml_of(draft(std::move(asked)));
    EXPECT_THAT(xml, HasSubstr(*language == 'e' ? "not stated, so not covered: an offset that comes and goes"
                                                : "nicht angegeben, daher nicht erfasst: ein Nullsignal"));
    for (const char* words : {"[stage_uncertainty]", "[item_uncertainty]", "docs/effects.md"})
      EXPECT_THAT(xml, Not(HasSubstr(words))) << language;
  }
}

TEST_F(MeasurandTest, TheMountingIsPrintedWithItsDrawing) {
  CertificateRequest asked = request();
  auto& labels = asked.run.run->header.labels;
  labels["item.reference_surface"] = "base plate";
  labels["item.direction_marks"] = "arrow shows +u";
  labels["item.fasteners"] = "4 screws M3";
  labels["item.torque"] = "0.6 N m";
  labels["item.cable"] = "clamped";
  asked.run.record.expected.mounting = "-y x z";
  const std::string page = text_of(certificate_page(xml_of(draft(std::move(asked)))));
  for (const char* fact : {"u, v, w along: -y x z", "Reference surface: base plate",
                           "Direction marks: arrow shows +u", "Fasteners: 4 screws M3",
                           "Tightening torque: 0.6 N m", "Cable: clamped", "[Stated mounting: u, v, w"})
    EXPECT_THAT(page, HasSubstr(fact));
  asked = request();
  asked.laboratory.file.language = "de";
  asked.run.run->header.labels["item.torque"] = "0.6 N m";
  EXPECT_THAT(text_of(certificate_page(xml_of(draft(std::move(asked))))), HasSubstr("0,6 N m"));
}

TEST(MountingFigure, HasTheSurfaceAndTheMarksOfTheItem) {
  const std::string surface = "Reference surface: base plate", marks(60, 'm');
  const Figure figure =
      mounting_figure(mounting_matrix("x y z").value(), {"caption", "platter", "up", surface, marks});
  std::vector<std::string> labels;
  for (const auto& element : figure.drawing.elements)
    if (const auto* label = std::get_if<PictureLabel>(&element)) labels.push_back(label->text);
  EXPECT_THAT(labels, Contains(surface));
  EXPECT_THAT(labels, Contains(std::string(44, 'm') + "…"));  // The page has it in full.
}

TEST(MountingFigure, AnArrowPointsWhereTheMountingHasIt) {
  // The arrows of the drawing: lines that are not filled, from begin to end; here up is positive.
  const auto arrows = [](const std::string& mounting) {
    const Figure figure = mounting_figure(mounting_matrix(mounting).value(), {"caption"});
    std::vector<Eigen::Vector2d> all;
    for (const auto& element : figure.drawing.elements) {
      const auto* path = std::get_if<PicturePath>(&element);
      if (path == nullptr || !path->fill.empty()) continue;
      const auto& [from, to] = std::pair{path->lines.at(0).front(), path->lines.at(0).back()};
      all.emplace_back(to[0] - from[0], from[1] - to[1]);
    }
    return all;
  };
  // Three of the item and three of the platter, the last.
  const std::vector<Eigen::Vector2d> plain = arrows("x y z"), turned = arrows("z x y");
  ASSERT_EQ(plain.size(), 6U);
  ASSERT_EQ(turned.size(), 6U);
  const Eigen::Vector2d x = plain[3], y = plain[4], z = plain[5];
  EXPECT_GT(z[1], 20.0) << "z is up";
  EXPECT_NEAR(z[0], 0.0, 1e-9);
  // All axes that are drawn for an output are parallel to that of the platter along which it points.
  const auto parallel = [](const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
    return a.normalized().dot(b.normalized());
  };
  std::vector<Eigen::Vector2d> expected{x, y, z};
  for (const std::vector<Eigen::Vector2d>& drawn : {plain, turned})
    for (const Eigen::Vector2d& axis : expected) {
      int found = 0;
      for (std::size_t k = 0; k < 3; ++k) found += parallel(drawn[k], axis) > 0.9999 ? 1 : 0;
      EXPECT_EQ(found, 1);
    }
  // Upside down: one arrow points down.
  int down = 0;
  const std::vector<Eigen::Vector2d> reversed = arrows("x -y -z");
  for (std::size_t k = 0; k < 3; ++k) down += parallel(reversed[k], z) < -0.9999 ? 1 : 0;
  EXPECT_EQ(down, 1);
}

}  // namespace
}  // namespace abcal
