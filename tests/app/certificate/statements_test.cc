// One meaning, one number: whatever a certificate says of a quantity, it says once. A reader written apart
// from the writer extracts every statement of random certificates and looks for two that disagree.

#include "app/laboratory/certificate/statements.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <map>
#include <random>
#include <set>

#include "app/document/document_html.h"
#include "app/document/document_text.h"
#include "app/formats/typed_unit.h"
#include "app/laboratory/certificate/amendment.h"
#include "app/laboratory/certificate/business_rules.h"
#include "app/laboratory/certificate/certificate_json.h"
#include "app/laboratory/certificate/certificate_page.h"
#include "app/laboratory/certificate/dcc_xml.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/mountings.h"
#include "protocol/uncertainty/budget.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/statement_reader.h"
#include "tests/app/certificate/statement_relations.h"
#include "tests/app/certificate/xml_query.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

/// Multiplies a result and its uncertainties, as another output would have them.
struct OutputScale {
  std::string unit;
  double of_output = 1.0;       ///< Number of the new unit in one of the old.
  double of_uncertainty = 1.0;  ///< Without that.

  void apply(Quantity& quantity, double output, const std::string& new_unit) const {
    quantity.value *= output;
    for (double* u : {&quantity.standard_uncertainty, quantity.type_a ? &*quantity.type_a : nullptr,
                      quantity.type_b ? &*quantity.type_b : nullptr})
      if (u != nullptr) *u *= output * of_uncertainty;
    quantity.unit = new_unit;
  }

  void apply(CalibrationResult& result) const {
    const std::string per = TypedUnit{unit, PerAcceleration::kLocal}.name();
    for (std::size_t j = 0; j < 3; ++j) {
      for (std::size_t k = 0; k < 3 && result.sensitivity_matrix; ++k)
        apply((*result.sensitivity_matrix)[j][k], of_output, per);
      apply(result.offset[j], of_output, unit);
      apply(result.intrinsic_sensitivity[j], of_output, per);
      apply(result.intrinsic_angle[j], 1.0, "degree");
    }
    const double factor = of_output * of_uncertainty;
    for (auto* covariance : {&result.covariance, &result.covariance_type_a, &result.covariance_type_b})
      if (*covariance) **covariance *= factor * factor;
    Eigen::Matrix<double, 9, 1> nine = Eigen::Matrix<double, 9, 1>::Constant(factor);
    nine.segment<3>(3).setConstant(of_uncertainty);
    for (auto* covariance : {&result.covariance_intrinsic, &result.covariance_intrinsic_type_a,
                             &result.covariance_intrinsic_type_b})
      if (*covariance) **covariance = nine.asDiagonal() * **covariance * nine.asDiagonal();
    result.response_unit = unit;
  }

  void apply(ReportData& data) const {
    for (CalibrationResult& result : data.results) apply(result);
    data.record.response_unit = unit;
    for (BudgetLine& line : data.budget->lines)
      for (int k = 0; k < kStudyOutputs; ++k)
        line.contribution(k) *= of_uncertainty * (k < kFirstIntrinsicAngle ? of_output : 1.0);
  }
};

/// The 24 ways to mount an item along the axes of the platter.
std::vector<Eigen::Matrix3d> all_positions() {
  std::vector<Eigen::Matrix3d> all;
  std::array<int, 3> axes{0, 1, 2};
  do {
    for (int signs = 0; signs < 8; ++signs) {
      Eigen::Matrix3d one = Eigen::Matrix3d::Zero();
      for (int j = 0; j < 3; ++j)
        one(j, axes[static_cast<std::size_t>(j)]) = (signs >> j) % 2 == 0 ? 1.0 : -1.0;
      if (one.determinant() > 0.0) all.push_back(one);
    }
  } while (std::next_permutation(axes.begin(), axes.end()));
  return all;
}

/// Draws certificates of one analysed run: mountings, other outputs, uncertainties, local gravity, limits,
/// scopes, estimators, languages, decision rules, before and after adjustment.
class RandomCertificates {
 public:
  RandomCertificates(const ReportData& run, ReadLaboratoryFile laboratory)
      : laboratory_(std::move(laboratory)) {
    for (const char* estimator : {"abc", "joint"}) {
      ReportData& data = runs_.emplace_back(run);
      data.estimator = estimator;
      data.budget = make_budget(data.record, data.result());
    }
  }

  Certificate draw(unsigned seed) {
    random_.seed(seed);
    CertificateRequest request;
    request.run = one_of(runs_);
    request.laboratory = laboratory_;
    request.draft = true;  // The simulated run has no real equipment; its marks are taken off below.
    const std::string unit = one_of(std::vector<std::string>{"g", "mg", "V", "mV", "m/s2", "LSB"});
    const OutputScale scale{unit,
                            unit == "g"      ? 1.0
                            : unit == "mg"   ? 1e3
                            : unit == "m/s2" ? kStandardGravity
                                             : std::pow(10.0, between(-2.0, 4.0)),
                            std::pow(10.0, between(-1.0, 2.0))};
    scale.apply(request.run);
    const double g_loc = between(9.78, 9.83), u = g_loc * std::pow(10.0, between(-7.0, -4.0));
    for (CalibrationResult& result : request.run.results) {
      result.g_loc.value = g_loc;
      result.g_loc.standard_uncertainty = u;
    }
    request.run.record.g_loc.value_mps2 = g_loc;
    request.run.record.g_loc.expanded_uncertainty_mps2 = 2.0 * u;
    turn(request.run);
    fill(request.laboratory.file, request.run);
    if (coin()) {
      request.as_found = request.run;
      as_if_real(*request.as_found, "1999-12-01");
      OutputScale{unit, 1.0 + between(-1e-3, 1e-3), 1.0}.apply(*request.as_found);
      request.laboratory.file.job.adjustment = "set";
    }
    Certificate made = make_certificate(std::move(request));
    made.issue.emplace();
    made.issue->number = made.number = fmt::format("EX-{}", seed);
    made.issue->approved_by = "Approver N. N.";
    made.issue->date = Date{std::chrono::year(2026), std::chrono::month(1), std::chrono::day(2)};
    made.reservations.clear();
    return made;
  }

 private:
  /// Mounts the item in another of the 24 positions, as the run states it.
  void turn(ReportData& data) {
    const Eigen::Matrix3d turned = one_of(positions_);
    data.record.expected.mounting = mounting_words(turned).value();
    Covariance12 by = Covariance12::Identity();
    for (Eigen::Index j = 0; j < 3; ++j) by.block<3, 3>(3 * j, 3 * j) = turned.transpose();
    for (CalibrationResult& result : data.results) {
      if (!result.sensitivity_matrix) continue;
      const auto before = *result.sensitivity_matrix;
      for (std::size_t j = 0; j < 3; ++j)
        for (std::size_t k = 0; k < 3; ++k)
          for (std::size_t from = 0; from < 3; ++from) {
            const double sign = turned(static_cast<Eigen::Index>(from), static_cast<Eigen::Index>(k));
            if (sign == 0.0) continue;
            (*result.sensitivity_matrix)[j][k] = before[j][from];
            (*result.sensitivity_matrix)[j][k].value *= sign;
          }
      for (auto* covariance : {&result.covariance, &result.covariance_type_a, &result.covariance_type_b})
        if (*covariance) **covariance = Covariance12(by * **covariance * by.transpose());
    }
    for (BudgetLine& line : data.budget->lines)
      line.contribution.head<9>() = by.topLeftCorner<9, 9>().cwiseAbs() * line.contribution.head<9>().eval();
  }

  double between(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  std::size_t below(std::size_t n) { return std::uniform_int_distribution<std::size_t>(0, n - 1)(random_); }
  bool coin() { return below(2) == 0; }
  template <class T>
  const T& one_of(const std::vector<T>& list) {
    return list[below(list.size())];
  }

  /// Units of the same kind as a quantity's.
  std::vector<std::string> units_of_kind(const std::string& unit) {
    static const std::vector<std::vector<std::string>> kKinds{
        {"V", "mV", "uV"}, {"g", "mg", "m/s2"}, {"LSB"}, {"degree", "mrad"}, {"%"}};
    const TypedUnit typed = typed_unit(unit);
    const auto kind = std::find_if(kKinds.begin(), kKinds.end(), [&](const std::vector<std::string>& units) {
      return std::find(units.begin(), units.end(), typed.output) != units.end();
    });
    if (typed.per == PerAcceleration::kNone) return *kind;
    std::vector<std::string> all;
    for (const std::string& output : *kind)
      for (const PerAcceleration per :
           {PerAcceleration::kSi, PerAcceleration::kStandard, PerAcceleration::kLocal})
        all.push_back(TypedUnit{output, per}.name());
    return all;
  }

  void fill(LaboratoryFile& file, const ReportData& data) {
    file.language = coin() ? "en" : "de";
    file.laboratory.accreditation = coin() ? "EX-K-1" : "";
    file.decision->kind = one_of(
        std::vector<DecisionKind>{DecisionKind::kSimple, DecisionKind::kGuardBand, DecisionKind::kNonBinary});
    file.decision->guard_factor = one_of(std::vector<double>{0.5, 0.83, 1.0, 1.5});
    const CalibrationResult& result = data.result();
    file.units = {TypedUnit{one_of(units_of_kind(result.response_unit)), PerAcceleration::kStandard}.name()};
    const StatedResult stated = stated_result(result, {.mounting = data.record.expected.mounting});
    file.limits.clear();
    for (std::size_t n = below(8); n > 0; --n) {
      SpecificationLimit limit;
      limit.quantity = one_of(names_of_quantities());
      const Quantity quantity = *stated_quantity(stated, limit.quantity);
      limit.unit = one_of(units_of_kind(quantity.unit));
      const double ratio = *ratio_of_units(quantity.unit, limit.unit, result.g_loc.value);
      // Mostly near the value, where a second number would decide otherwise.
      const double expanded = coverage_factor(quantity) * quantity.standard_uncertainty;
      const auto bound = [&](double low, double high) {
        return std::stod(
            fmt::format("{:.{}g}", ratio * (quantity.value + between(low, high) * expanded), 5 + below(6)));
      };
      if (coin()) limit.lower = bound(-3.0, -0.2);
      if (!limit.lower || coin()) limit.upper = bound(0.2, 3.0);
      if (coin()) std::swap(limit.lower, limit.upper);  // An item that fails.
      if (limit.lower && limit.upper && !(*limit.lower < *limit.upper)) std::swap(limit.lower, limit.upper);
      limit.source = "order";
      file.limits.push_back(limit);
    }
    file.scope.clear();
    for (std::size_t n = below(4); n > 0; --n) {
      ScopeLimit entry;
      entry.quantity = one_of(scope_quantities());
      const Quantity& covered = entry.quantity == "angle"    ? result.intrinsic_angle[0]
                                : entry.quantity == "offset" ? result.offset[0]
                                                             : result.intrinsic_sensitivity[0];
      entry.unit = one_of(units_of_kind(covered.unit));
      const double size =
          std::abs(covered.value) * *ratio_of_units(covered.unit, entry.unit, result.g_loc.value);
      entry.from = coin() ? 0.0 : 0.5 * size;
      entry.to = 20.0 * size;
      entry.relative = coin();
      entry.cmc = std::pow(10.0, between(-6.0, -2.0)) * (entry.relative ? 1.0 : size);
      file.scope.push_back(entry);
    }
  }

  ReadLaboratoryFile laboratory_;
  std::vector<ReportData> runs_;
  std::vector<Eigen::Matrix3d> positions_ = all_positions();
  std::mt19937_64 random_;
};

class StatementsTest : public CertificateTest {
 protected:
  static RandomCertificates certificates() {
    CertificateRequest asked = request();
    as_if_real(asked.run, "2000-01-01");
    return RandomCertificates(asked.run, asked.laboratory);
  }

  /// The limits of a laboratory file replaced by these lines.
  static std::string with_limits(const std::string& limits) {
    std::string laboratory = example_laboratory();
    const std::size_t from = laboratory.find("[[limit]]"), to = laboratory.find("[units]");
    return laboratory.substr(0, from) + limits + laboratory.substr(to);
  }
  static std::string limit_on_s_u(const std::string& unit, double upper) {
    return fmt::format(
        "[[limit]]\nquantity = \"intrinsic_sensitivity_u\"\nunit = \"{}\"\nupper = {:.12g}\nsource = "
        "\"sheet\"\n",
        unit, upper);
  }

  /// The JSON of a certificate says what its XML says, in the same order.
  static void compare_with_json(const std::string& xml, const test::Reading& in_xml, bool last) {
    const test::Reading in_json = test::read_json(certificate_json(xml), xml, last);
    EXPECT_THAT(in_json.contradictions, IsEmpty());
    ASSERT_EQ(in_json.claims.size(), in_xml.claims.size());
    for (std::size_t i = 0; i < in_xml.claims.size(); ++i) {
      EXPECT_EQ(in_json.claims[i].quantity, in_xml.claims[i].quantity);
      EXPECT_THAT(test::disagreements({in_json.claims[i], in_xml.claims[i]}), IsEmpty());
    }
    EXPECT_EQ(decisions_of({in_json}), decisions_of({in_xml}));
    EXPECT_EQ(in_json.marked_outside > 0, in_xml.marked_outside > 0);
    EXPECT_EQ(in_json.marked_raised > 0, in_xml.marked_raised > 0);
  }

  /// Every calibration of a certificate, without contradiction in itself.
  static std::vector<test::Reading> calibrations_of(const std::string& xml) {
    std::vector<test::Reading> all{test::read_xml(xml)};
    if (all.front().calibrations > 1) all.push_back(test::read_xml(xml, false));
    for (const test::Reading& one : all) {
      const bool last = &one == &all.front();
      EXPECT_THAT(one.contradictions, IsEmpty());
      EXPECT_THAT(test::disagreements(one.claims), IsEmpty());
      EXPECT_THAT(test::broken_relations(xml, one, last), IsEmpty());
    }
    return all;
  }

  static std::multiset<std::string> decisions_of(const std::vector<test::Reading>& readings) {
    std::multiset<std::string> all;
    for (const test::Reading& reading : readings)
      for (const test::Claim& claim : reading.claims)
        if (!claim.verdict.empty()) all.insert(claim.quantity + " " + claim.verdict);
    return all;
  }

  static bool shell(const std::string& command) {
    return std::system((command + " > /dev/null 2>&1").c_str()) == 0;
  }

  /// Prints certificates and reads their pages as pdftotext shows them.
  void print_and_read(unsigned first, unsigned last) {
    if (!shell("command -v weasyprint && command -v pdftotext"))
      GTEST_SKIP() << "weasyprint or pdftotext (poppler-utils) is not installed";
    RandomCertificates random = certificates();
    for (unsigned seed = first; seed <= last; ++seed) {
      const std::string xml = xml_text(dcc_document(random.draw(seed)));
      const Document page = certificate_page(xml);
      test::write_file(folder / "a.html", document_html(page));
      ASSERT_TRUE(shell("cd '" + folder.path().string() +
                        "' && weasyprint a.html a.pdf && pdftotext -layout a.pdf a.txt"));
      const std::vector<test::Reading> in_xml = calibrations_of(xml);
      const test::Reading on_page = test::read_page(page, in_xml.front()),
                          printed = test::read_text(test::read_file(folder / "a.txt"), in_xml.front());
      EXPECT_THAT(test::not_stated(printed.claims, in_xml), IsEmpty()) << "seed " << seed;
      EXPECT_THAT(printed.contradictions, IsEmpty()) << "seed " << seed;
      EXPECT_EQ(printed.claims.size(), on_page.claims.size()) << "seed " << seed;
      EXPECT_EQ(decisions_of({printed}), decisions_of({on_page})) << "seed " << seed;
    }
  }
};

// Seen in version 1.0: one item passed 1.0025 in one unit and failed 1002.5 in the other, in one table.
TEST_F(StatementsTest, ALimitPerGIsRefusedWithBothReadings) {
  const std::string why = refusal(request(with_limits(limit_on_s_u("mg/g", 1002.5))));
  EXPECT_THAT(
      why, AllOf(HasSubstr("[limit] unit of intrinsic_sensitivity_u: found \"mg/g\", which has two readings"),
                 HasSubstr("unit = \"mg/g_n\", per standard gravity, 9.80665 m/s2"),
                 HasSubstr("unit = \"mg/g_loc\", per local gravity, 9.80101 m/s2"),
                 HasSubstr("upper = 0.1022266 g/(m/s2)"), HasSubstr("upper = 0.1022854 g/(m/s2)")));
  EXPECT_THAT(refusal(request(with_limits(limit_on_s_u("g/g", 1.0)))), HasSubstr("\"g/g_n\""));
  // A kind that the quantity is not of names those that it may be.
  EXPECT_THAT(refusal(request(with_limits(limit_on_s_u("g", 1.0)))),
              HasSubstr("one of \"g/(m/s2)\", \"g/g_n\", \"g/g_loc\""));
  EXPECT_THAT(refusal(request(replaced(example_laboratory(), "[\"mg/g_n\"]", "[\"mg/g\"]"))),
              HasSubstr("required: \"mg/g_n\", which is per standard gravity"));
}

// One limit in three units is one limit, and each decision is on the number of the first page.
TEST_F(StatementsTest, OneLimitInAnyUnitIsDecidedOnce) {
  const Certificate plain = make_certificate(request());
  const double s_u = stated_quantity(plain.run.stated, "intrinsic_sensitivity_u")->value * kStandardGravity;
  for (const double off : {-3e-4, 3e-4}) {
    const double bound = s_u + off;
    const Certificate made = make_certificate(request(with_limits(
        limit_on_s_u("mg/g_n", 1e3 * bound) + limit_on_s_u("g/g_loc", bound * 9.80101 / kStandardGravity) +
        limit_on_s_u("g/(m/s2)", bound / kStandardGravity) + limit_on_s_u("m/s2/(m/s2)", bound))));
    ASSERT_EQ(made.run.decisions.size(), 4U);
    const test::Reading read = test::read_xml(xml_text(dcc_document(made)));
    EXPECT_THAT(read.contradictions, IsEmpty());
    for (const Decision& decision : made.run.decisions) {
      EXPECT_EQ(decision.conformity, off > 0.0 ? Conformity::kPass : Conformity::kFail)
          << decision.stated.unit;
      EXPECT_EQ(decision.value, made.run.decisions.front().value);
      EXPECT_NEAR(*decision.limit.upper, bound, 1e-11);
    }
    const auto first_page =
        std::find_if(read.claims.begin(), read.claims.end(), [](const test::Claim& claim) {
          return claim.where == "XML abc_intrinsicSensitivities" &&
                 claim.quantity == "intrinsic_sensitivity_u";
        });
    EXPECT_EQ(first_page->value.value, made.run.decisions.front().value);
    EXPECT_EQ(first_page->expanded.value, made.run.decisions.front().expanded_uncertainty);
    // The unit keeps what it is per.
    const std::string text = document_text(certificate_page(xml_text(dcc_document(made))), stderr);
    EXPECT_THAT(text, AllOf(HasSubstr(" mg/g_n"), HasSubstr(" g/g_loc")));
  }
}

// A value right at the printed acceptance limit passes, one digit outside it fails: whoever has the page can
// decide.
TEST(PrintedDecisionTest, IsMadeFromThePrintedNumbers) {
  DecisionRule rule;
  rule.guard_factor = 0.83;
  SpecificationLimit limit;
  limit.quantity = "offset_u";
  limit.lower = 0.98;
  limit.upper = 1.02;
  const auto decided = [&](const std::string& value) {
    Quantity quantity;
    quantity.unit = "V";
    return decide_printed(rule, limit, quantity, {value, "0.00012", -5});
  };
  const Decision at = decided("1.01990");  // 1.02 - 0.0000996 = 1.0199004
  EXPECT_EQ(at.conformity, Conformity::kPass);
  EXPECT_NEAR(*at.upper_acceptance, 1.01990, 1e-12);
  EXPECT_NEAR(*at.lower_acceptance, 0.98010, 1e-12);
  EXPECT_EQ(decided("1.01991").conformity, Conformity::kFail);
  EXPECT_EQ(decided("0.98010").conformity, Conformity::kPass);
  EXPECT_EQ(decided("0.98009").conformity, Conformity::kFail);
  rule.kind = DecisionKind::kNonBinary;
  EXPECT_EQ(decided("1.02000").conformity, Conformity::kConditionalPass);
  EXPECT_EQ(decided("1.02001").conformity, Conformity::kConditionalFail);
  EXPECT_EQ(decided("1.02010").conformity, Conformity::kFail);
  EXPECT_THROW(decide_printed(rule, SpecificationLimit{}, {}, {"1.0", "0.1", -1}), std::invalid_argument);
}

// ILAC-P14: u, covariance, ellipsoid, budget and derived quantities have one uncertainty, raised once.
TEST_F(StatementsTest, AScopeRaisesEverythingThatRestsOnIt) {
  const std::string scope =
      "[[scope]]\nquantity = \"sensitivity\"\nunit = \"g/g_loc\"\nfrom = 0.5\nto = 2.0\ncmc = 1e-3\n"
      "[[scope]]\nquantity = \"angle\"\nunit = \"degree\"\nfrom = 0\nto = 180\ncmc = 0.5\n"
      "[[scope]]\nquantity = \"offset\"\nunit = \"mg\"\nfrom = 0\nto = 10\ncmc = 20\n\n[decision]";
  const Certificate plain = make_certificate(request()),
                    made = make_certificate(request(replaced(example_laboratory(), "[decision]", scope)));
  const CalibrationResult &before = plain.run.stated.result, &after = made.run.stated.result;
  const Covariance12 &c = *before.covariance, &raised = *after.covariance;
  // No combination of the outputs is less uncertain than it was.
  EXPECT_GE(Eigen::SelfAdjointEigenSolver<Covariance12>(raised - c).eigenvalues().minCoeff(),
            -1e-12 * raised.trace());
  const Quantity& s_ux = (*after.sensitivity_matrix)[0][0];
  EXPECT_GE(coverage_factor(s_ux) * s_ux.standard_uncertainty, 1e-3 * (1.0 - 1e-9));
  EXPECT_NEAR(std::sqrt(raised(0, 0)), s_ux.standard_uncertainty, 1e-15);
  // In version 1.1 U of the angle was raised, and that of the same angle from S and its covariance was not.
  const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(after.sensitivity_values());
  for (Eigen::Index j = 3; j < 6; ++j) {
    const Quantity& phi = after.intrinsic_angle[static_cast<std::size_t>(j - 3)];
    EXPECT_NEAR(coverage_factor(phi) * phi.standard_uncertainty, 0.5, 0.5 * 0.05);
    EXPECT_NEAR(std::sqrt((jacobian.row(j) * raised).dot(jacobian.row(j))), phi.standard_uncertainty,
                1e-9 * phi.standard_uncertainty);
  }
  for (std::size_t j = 0; j < 3; ++j)
    for (const Quantity* one :
         {&after.intrinsic_sensitivity[j], &after.intrinsic_angle[j], &after.offset[j]}) {
      const auto n = static_cast<Eigen::Index>(one == &after.intrinsic_angle[j] ? 3 + j
                                               : one == &after.offset[j]        ? 6 + j
                                                                                : j);
      EXPECT_NEAR(std::sqrt((*after.covariance_intrinsic)(n, n)), one->standard_uncertainty,
                  1e-9 * one->standard_uncertainty);
    }
  // No number of the budget, of a covariance or of an annex is smaller than the list says.
  const std::string xml = xml_text(dcc_document(made));
  const test::Reading read = test::read_xml(xml);
  EXPECT_THAT(read.contradictions, IsEmpty());
  EXPECT_THAT(test::disagreements(read.claims), IsEmpty());
  EXPECT_THAT(test::broken_relations(xml, read), IsEmpty());
  EXPECT_EQ(read.budget_lines, test::read_xml(xml_text(dcc_document(plain))).budget_lines + 1);
  EXPECT_GT(read.marked_raised, 3);
  // Off-diagonal sensitivities, offsets above 10 mg and what depends on the mounting are in no entry.
  EXPECT_EQ(made.run.stated.mark("sensitivity_ux"), ScopeMark::kRaised);
  EXPECT_EQ(made.run.stated.mark("sensitivity_uy"), ScopeMark::kOutside);
  EXPECT_EQ(made.run.stated.mark("transverse_sensitivity_u"), ScopeMark::kOutside);
  EXPECT_EQ(made.run.stated.mark("non_orthogonality_vw"), ScopeMark::kRaised);
  // An amendment lists a quantity once, whatever the number of its units.
  const std::vector<ChangedStatement> changed = changed_statements(xml_text(dcc_document(plain)), xml);
  for (const char* label : {"s_ux", "s_u", "phi_uv", "covariance"})
    EXPECT_EQ(std::count_if(changed.begin(), changed.end(),
                            [&](const ChangedStatement& one) {
                              return one.name.ends_with(fmt::format(", {}", label));
                            }),
              1)
        << label;
  const Document page = certificate_page(xml);
  const std::string text = document_text(page, stderr);
  EXPECT_THAT(text,
              AllOf(HasSubstr("s_uy *"), HasSubstr("transverse sensitivity u *"), Not(HasSubstr("s_ux *")),
                    HasSubstr("*: outside the scope"), Not(HasSubstr("As computed"))));
  EXPECT_THAT(document_text(certificate_page(xml_text(dcc_document(plain))), stderr), Not(HasSubstr(" *")));
}

// An accreditation without a scope covers nothing that the program knows of.
TEST_F(StatementsTest, AnAccreditationWithoutAScopeLeavesEverythingOutside) {
  const Certificate made = make_certificate(
      request(replaced(example_laboratory(), "accreditation = \"\"", "accreditation = \"EX-K-1\"")));
  for (const auto& [name, mark] : made.run.stated.marks) EXPECT_EQ(mark, ScopeMark::kOutside) << name;
  EXPECT_EQ(made.run.stated.result.offset[0].standard_uncertainty,
            made.run.data.result().offset[0].standard_uncertainty);
}

TEST_F(StatementsTest, AThousandRandomCertificatesSayEverythingOnce) {
  RandomCertificates random = certificates();
  std::size_t claims = 0, decisions = 0, passed = 0;
  int raised = 0, outside = 0;
  for (unsigned seed = 1; seed <= 1000; ++seed) {
    const Certificate made = random.draw(seed);
    const XmlDocument document = dcc_document(made);
    if (seed % 50 == 0) {
      ASSERT_EQ(to_string(check_business_rules(document)), "") << "seed " << seed;
    }
    const std::string xml = xml_text(document);
    const std::vector<test::Reading> in_xml = calibrations_of(xml);
    if (seed % 4 == 0) compare_with_json(xml, in_xml.front(), true);
    const test::Reading on_page = test::read_page(certificate_page(xml), in_xml.front());
    ASSERT_THAT(on_page.contradictions, IsEmpty()) << "seed " << seed;
    ASSERT_THAT(test::not_stated(on_page.claims, in_xml), IsEmpty()) << "seed " << seed;
    const std::multiset<std::string> decided = decisions_of({on_page});
    ASSERT_EQ(decided, decisions_of(in_xml)) << "seed " << seed;
    ASSERT_FALSE(HasFailure()) << "seed " << seed;
    decisions += decided.size();
    for (const std::string& decision : decided) passed += decision.ends_with(" pass") ? 1 : 0;
    for (const test::Reading& one : in_xml) claims += one.claims.size();
    raised += in_xml.front().marked_raised > 0 ? 1 : 0;
    outside += in_xml.front().marked_outside > 0 ? 1 : 0;
  }
  // The drawn certificates have something to say.
  EXPECT_GT(claims, 80'000U);
  EXPECT_GT(decisions, 2'000U);
  EXPECT_GT(passed, decisions / 10);
  EXPECT_LT(passed, 9 * decisions / 10);
  EXPECT_GT(raised, 100);
  EXPECT_GT(outside, 300);
}

// The reader finds what it has to find.
TEST_F(StatementsTest, TheReaderSeesADigitAVerdictAndAUnitThatDiffer) {
  const std::string good = xml_text(dcc_document(make_certificate(request())));
  EXPECT_THAT(test::disagreements(test::read_xml(good).claims), IsEmpty());
  const CertificateXml xml(good);
  const std::string value =
      xml.text("//dcc:result[@refType='abc_conformity']//dcc:quantity[1]//si:real[1]/si:value");
  std::string digit = good;
  const std::size_t at = digit.find(value, digit.find("abc_conformity"));
  digit[at + value.size() - 1] = digit[at + value.size() - 1] == '0' ? '7' : '0';
  EXPECT_THAT(test::disagreements(test::read_xml(digit).claims), Not(IsEmpty()));
  EXPECT_THAT(test::read_xml(replaced(good, "<dcc:conformity>pass", "<dcc:conformity>fail")).contradictions,
              testing::SizeIs(1));
  EXPECT_THAT(test::read_xml(replaced(good, "<si:unit>|g/g_n", "<si:unit>|mg/g_n")).contradictions,
              testing::SizeIs(1));
  const test::Reading read = test::read_xml(good);
  EXPECT_THAT(test::broken_relations(good, read), IsEmpty());
  for (const char* name : {"M_xv", "intrinsic_angle_vw", "bias_w", "g_loc*sensitivity_uz"}) {
    test::Reading other = read;
    for (test::Claim& claim : other.claims)
      if (claim.quantity == name) claim.value.value += 3.0 * claim.expanded.value;
    EXPECT_THAT(test::broken_relations(good, other), testing::SizeIs(1)) << name;
    other = read;
    for (test::Claim& claim : other.claims)
      if (claim.quantity == name) claim.expanded.value *= 0.8;
    EXPECT_THAT(test::broken_relations(good, other), testing::SizeIs(1)) << name;
  }
  test::Reading page = test::read_page(certificate_page(good), read);
  ASSERT_GT(page.claims.size(), 40U);
  page.claims.front().expanded.value *= 1.1;
  page.claims.insert(page.claims.end(), read.claims.begin(), read.claims.end());
  EXPECT_THAT(test::disagreements(page.claims), Not(IsEmpty()));
}

TEST_F(StatementsTest, PrintedPagesSayWhatTheXmlSays) {
  print_and_read(1, 6);
}

using LongStatementsTest = StatementsTest;
TEST_F(LongStatementsTest, TwentyPrintedCertificatesSayWhatTheirXmlSays) {
  print_and_read(7, 26);
}

}  // namespace
}  // namespace abcal
