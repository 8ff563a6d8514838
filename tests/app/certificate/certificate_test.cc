#include "app/laboratory/certificate/certificate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>

#include "app/laboratory/certificate/dcc_xml.h"
#include "app/laboratory/certificate/issue_certificate.h"
#include "app/results/analysis/analyses.h"
#include "protocol/plan/limits.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/xml_query.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class MakeCertificateTest : public CertificateTest {
 protected:
  static IssueFacts facts() {
    IssueFacts facts;
    facts.number = "EX-1";
    facts.approved_by = "Approver N. N.";
    facts.date = Date{std::chrono::year(2999), std::chrono::month(1), std::chrono::day(2)};
    return facts;
  }
  /// The stage's calibration ended before the simulated run of 2000.
  static std::string overdue() {
    return replaced(replaced(example_laboratory(), "performed = 2025-12-31", "performed = 1998-12-31"),
                    "due = 2030-12-31", "due = 1999-12-31");
  }
};

// ISO/IEC 17025:2017 as listed in docs/theory/certificate_rules.md: where each item stands
// (docs/certificate.md has the table).
TEST_F(MakeCertificateTest, EveryClauseOfReportingHasItsPlace) {
  std::string laboratory = example_laboratory();
  laboratory =
      replaced(laboratory, "deviations = \"\" ",
               "deviations = \"12 angles\"\nsampling = \"one of ten\"\nexternal_results = \"gravity\"\n"
               "opinions = \"stable\"\nrecalibration = 2027-03-01\nadjustment = \"offset register set\" ");
  laboratory = replaced(laboratory, "accreditation = \"\"", "accreditation = \"EX-K-1\"");
  CertificateRequest asked = request(laboratory);
  as_if_real(asked.run);
  asked.as_found = asked.run;
  as_if_real(*asked.as_found, "2026-02-28");  // An earlier run of the same item, as the labels say.
  asked.issue = facts();
  asked.issue->replaces = Replacement{"EX-0", "wrong address", std::string(64, 'a')};
  const Certificate certificate = make_certificate(std::move(asked));
  const CertificateXml xml(xml_text(dcc_document(certificate)));
  const std::vector<std::pair<const char*, const char*>> clauses{
      {"7.8.2.1 a", "/dcc:digitalCalibrationCertificate"},
      {"7.8.2.1 b", "//dcc:calibrationLaboratory/dcc:contact[dcc:name and dcc:location/dcc:street]"},
      {"7.8.2.1 c", "//dcc:performanceLocation"},
      {"7.8.2.1 d", "//dcc:uniqueIdentifier"},
      {"7.8.2.1 e", "//dcc:customer[dcc:name and dcc:location]"},
      {"7.8.2.1 f", "//dcc:usedMethod[@refType='abc_protocol']/dcc:reference"},
      {"7.8.2.1 g", "//dcc:item[dcc:identifications]/dcc:description"},
      {"7.8.2.1 h", "//dcc:receiptDate"},
      {"7.8.2.1 i", "//dcc:beginPerformanceDate | //dcc:endPerformanceDate"},
      {"7.8.2.1 j", "//dcc:issueDate"},
      {"7.8.2.1 k", "//dcc:statement[@refType='abc_sampling']"},
      {"7.8.2.1 l", "//dcc:statement[@refType='abc_scope']"},
      {"7.8.2.1 m", "//dcc:results//si:realListXMLList[si:valueXMLList and si:unitXMLList]"},
      {"7.8.2.1 n", "//dcc:statement[@refType='abc_deviations']"},
      {"7.8.2.1 o", "//dcc:respPerson[dcc:mainSigner='true']"},
      {"7.8.2.1 p", "//dcc:statement[@refType='abc_externalResults']"},
      {"7.8.2.2", "//dcc:statement[@refType='abc_customerSupplied']"},
      {"7.8.4.1 a", "//dcc:results//si:valueExpandedMUXMLList"},
      {"7.8.4.1 a, left out", "//dcc:statement[@refType='abc_notCovered']"},
      {"7.8.4.1 b", "//dcc:influenceCondition[@refType='basic_temperature']"},
      {"7.8.4.1 b, gravity", "//dcc:influenceCondition[@refType='abc_localGravity']//si:expandedMU"},
      {"7.8.4.1 c", "//dcc:statement[@refType='abc_traceability'][dcc:traceable='true']"},
      {"7.8.4.1 c, angle", "//dcc:measuringEquipment[@refType='basic_standardUsed']"},
      {"7.8.4.1 d, as found", "//dcc:measurementResult[1]//dcc:status[.='beforeAdjustment']"},
      {"7.8.4.1 d, as left", "//dcc:measurementResult[2]//dcc:status[.='afterAdjustment']"},
      {"7.8.4.1 e", "//dcc:metaData[@refType='basic_conformity']/dcc:conformity"},
      {"7.8.4.1 f", "//dcc:statement[@refType='abc_opinions']"},
      {"7.8.4.3", "//dcc:statement[@refType='basic_recalibration'][dcc:date and dcc:respAuthority]"},
      {"7.8.6", "//dcc:statement[@refType='abc_decisionRule'][dcc:norm and dcc:reference]/dcc:declaration"},
      {"7.8.6, results, limits", "//dcc:metaData[@refType='basic_conformity']/dcc:data/dcc:quantity"},
      {"7.8.8, original", "//dcc:reportAmendedSubstituted/dcc:replacedUniqueIdentifier"},
      {"7.8.8, hash", "//dcc:previousReport/dcc:value"},
      {"7.8.8, reason", "//dcc:statement[@refType='abc_amendment']"},
      {"7.5 raw data", "//dcc:metaData[@refType='abc_rawDataHash']"},
      {"7.11 software", "//dcc:usedSoftware/dcc:software/dcc:release"},
  };
  for (const auto& [clause, path] : clauses) EXPECT_FALSE(xml.text(path).empty()) << clause;
  if (const auto schemas = test::shared_data("dcc/xsd")) {
    EXPECT_EQ(to_string(DccSchema(*schemas).check(parse_xml(xml_text(dcc_document(certificate)), "c"))), "");
  }
  EXPECT_EQ(xml.texts("//dcc:result[@refType='abc_shift']//dcc:quantity[@refType='abc_difference']").size(),
            9U);
}

// Everything that the certificate requires is named before anything is written, from the file and from the
// run.
TEST_F(MakeCertificateTest, EachMissingItemIsNamed) {
  const std::string good = example_laboratory();
  for (const auto& [from, named] : std::vector<std::pair<std::string, std::string>>{
           {"name = \"Example laboratory\"", "[laboratory] name"},
           {"street = \"1 Example Street\"", "[laboratory] street"},
           {"name = \"Example customer\"", "[customer] name"},
           {"condition = \"no visible damage\"", "[job] condition"},
           {"certificate = \"EX-ANGLE-0815\"", "[equipment] certificate"},
           {"due = 2030-12-31", "[equipment] due"},
           {"source = \"data sheet of the item, revision 1\"", "[limit] source"}})
    EXPECT_THAT(refusal(request(replaced(good, from, ""))), HasSubstr(named));

  const auto without_label = [&](const std::string& key) {
    CertificateRequest asked = request();
    asked.run.run->header.labels.erase(key);
    return refusal(std::move(asked));
  };
  EXPECT_THAT(without_label("item.serial_number"), HasSubstr("[item] serial_number"));
  EXPECT_THAT(without_label("item.maker"), HasSubstr("[item] maker"));
  EXPECT_THAT(without_label("item.model"), HasSubstr("[item] model"));
  EXPECT_THAT(without_label("operator.name"), HasSubstr("[operator] name"));

  CertificateRequest asked = request();
  asked.run.run->environment.clear();
  asked.run.record.g_loc.expanded_uncertainty_mps2 = 0.0;
  asked.run.record.g_loc.source.clear();
  asked.run.run->header.labels.clear();
  EXPECT_THAT(refusal(std::move(asked)),
              AllOf(HasSubstr("temperature of the room"), HasSubstr("local gravity: found no uncertainty"),
                    HasSubstr("local gravity: found no source"), HasSubstr("[item] maker"),
                    HasSubstr("[operator] name")));
}

TEST_F(MakeCertificateTest, EquipmentMustBeThatOfTheRunAndInDate) {
  const std::string due = refusal(request(overdue()));
  EXPECT_THAT(due, AllOf(HasSubstr("Two-axis rotation stage\", due: found 1999-12-31"),
                         HasSubstr("not before that of the run"), HasSubstr("--draft")));
  EXPECT_THAT(refusal(request(replaced(example_laboratory(), "\"118001234\"", "\"4711\""))),
              HasSubstr("stage: found serial number \"118001234\""));
}

TEST_F(MakeCertificateTest, ADraftSaysWhatSpeaksAgainstIt) {
  CertificateRequest asked = request(overdue());
  asked.draft = true;
  const Certificate draft = make_certificate(std::move(asked));
  ASSERT_EQ(draft.reservations.size(), 1U);
  EXPECT_THAT(xml_text(dcc_document(draft)), AllOf(HasSubstr("DRAFT"), HasSubstr("1999-12-31")));
}

TEST_F(MakeCertificateTest, AFailedVerdictGivesNoCertificateAndADraftWithoutNumbers) {
  for (const Verdict verdict : {Verdict::kDoubtful, Verdict::kNotUsable}) {
    CertificateRequest asked = request();
    asked.run.results.front().verdict = verdict;
    asked.run.results.front().why = Message("the closure is large");
    EXPECT_THAT(refusal(asked), AllOf(HasSubstr("verdict"), HasSubstr("the closure is large")));
    asked.draft = true;
    const Certificate draft = make_certificate(std::move(asked));
    const CertificateXml xml(checked_xml(draft, nullptr));
    EXPECT_EQ(xml.text("//dcc:result[@refType='abc_noResult']").empty(), verdict == Verdict::kDoubtful);
    EXPECT_EQ(xml.text("//dcc:results//si:valueXMLList").empty(), verdict == Verdict::kNotUsable);
  }
}

TEST_F(MakeCertificateTest, TheReportedEstimatorIsFoundByName) {
  CertificateRequest asked = request();
  const CalibrationResult joint = result_of(asked.run.results, "joint");
  std::reverse(asked.run.results.begin(), asked.run.results.end());
  const Certificate certificate = make_certificate(asked);
  EXPECT_EQ(certificate.run.data.result().estimator, "joint");
  EXPECT_EQ(certificate.run.data.result().offset[0].value, joint.offset[0].value);
}

// ILAC-P14: no uncertainty below the laboratory's capability, neither stated nor in a decision.
TEST_F(MakeCertificateTest, NoUncertaintyIsBelowTheScope) {
  const std::string scope =
      "[[scope]]\nquantity = \"sensitivity\"\nunit = \"g/g_loc\"\nfrom = 0.5\nto = 2.0\ncmc = "
      "0.01\n\n[decision]";
  const Certificate made = make_certificate(request(replaced(example_laboratory(), "[decision]", scope)));
  const CertificateXml xml(checked_xml(made, nullptr));
  for (const std::string result : {"abc_intrinsicSensitivitiesPerGravity", "abc_intrinsicSensitivities"}) {
    const std::string at = "//dcc:result[@refType='" + result + "']";
    // In g per g_loc, and in m/s2 per m/s2.
    const double least = result == "abc_intrinsicSensitivities" ? 0.01 * 9.80665 / 9.80101 : 0.01 * 9.80665;
    for (const double expanded : xml.numbers(at + "//si:realListXMLList[1]//si:valueExpandedMUXMLList"))
      EXPECT_NEAR(expanded, least, 0.05 * least) << result;
    EXPECT_FALSE(xml.texts(at + "//dcc:metaData[@refType='abc_raisedToScope']").empty());
  }
  // Outside its range, and of other quantities: as computed.
  EXPECT_LT(
      xml.numbers("//dcc:result[@refType='abc_offsets']//si:realListXMLList[1]//si:valueExpandedMUXMLList")
          .at(0),
      0.01);
  EXPECT_TRUE(
      xml.texts("//dcc:result[@refType='abc_offsets']//dcc:metaData[@refType='abc_raisedToScope']").empty());
  EXPECT_NEAR(made.run.decisions[0].expanded_uncertainty, 0.01, 1e-12);
}

// Entries of the scope, results and limits may be in different units of the same quantity.
TEST_F(MakeCertificateTest, NoUncertaintyIsBelowTheScopeInWhateverUnit) {
  const std::string scope =
      "[[scope]]\nquantity = \"sensitivity\"\nunit = \"mg/g_n\"\nfrom = 500\nto = 2000\ncmc = 10\n"
      "[[scope]]\nquantity = \"angle\"\nunit = \"degree\"\nfrom = 80\nto = 100\ncmc = 0.5\n"
      "[[scope]]\nquantity = \"offset\"\nunit = \"mg\"\nfrom = 0\nto = 100\ncmc = 20\n\n[decision]";
  std::string laboratory = replaced(example_laboratory(), "[decision]", scope);
  for (const auto& [quantity, unit] :
       {std::pair<std::string, std::string>{"intrinsic_sensitivity_v", "g/(m/s2)"},
        {"sensitivity_ux", "g/g_loc"},
        {"intrinsic_sensitivity_w", "ug/g_n"},
        {"non_orthogonality_uv", "mrad"},
        {"bias_w", "mg"},
        {"misalignment_u", "mrad"}})
    laboratory = replaced(laboratory, "[units]",
                          "[[limit]]\nquantity = \"" + quantity + "\"\nunit = \"" + unit +
                              "\"\nupper = 900\nsource = \"order\"\n\n[units]");
  const Certificate made = make_certificate(request(laboratory));
  std::map<std::string, double> decided;
  for (const Decision& decision : made.run.decisions) {
    decided[decision.limit.quantity] = decision.expanded_uncertainty;
    EXPECT_DOUBLE_EQ(decision.expanded_uncertainty, decision.coverage_factor * decision.standard_uncertainty);
  }
  // Decisions are in SI units, with two digits of U: 10 mg/g_n, 0.5 degree, 20 mg.
  for (const std::string s :
       {"intrinsic_sensitivity_v", "sensitivity_ux", "intrinsic_sensitivity_u", "intrinsic_sensitivity_w"})
    EXPECT_EQ(decided.at(s), 0.010) << s;
  EXPECT_EQ(decided.at("non_orthogonality_uv"), 8.7);  // mrad
  EXPECT_EQ(decided.at("offset_w"), 0.20);             // m/s2
  EXPECT_EQ(decided.at("bias_w"), 0.20);
  // In no scope, but made of the same matrix as the angles, of which none is known to less than 0.5 degrees.
  EXPECT_GT(decided.at("misalignment_u"), 4.0);
  EXPECT_LT(decided.at("misalignment_u"), 8.7);

  const CertificateXml xml(checked_xml(made, nullptr));
  const auto stated = [&](const std::string& result) {
    return xml.numbers("//dcc:result[@refType='" + result +
                       "']//si:realListXMLList[2]//si:valueExpandedMUXMLList");
  };
  for (const double expanded : stated("abc_sensitivityInUnit1")) EXPECT_NEAR(expanded, 10.0, 0.05);
  for (const double expanded : stated("abc_intrinsicSensitivitiesPerGravity"))
    EXPECT_NEAR(expanded, 0.010, 5e-5);
  for (const double expanded : stated("abc_offsets")) EXPECT_NEAR(expanded, 0.020, 1e-4);
}

// The run alone does not determine the turn about X: `abcal level` measures it.
TEST_F(MakeCertificateTest, ALevellingReducesTheCertifiedUncertainty) {
  const auto expanded = [](const Certificate& certificate) {
    return CertificateXml(checked_xml(certificate, nullptr))
        .numbers(
            "//dcc:result[@refType='abc_sensitivityMatrix']//dcc:quantity[2]"
            "//si:realListXMLList[1]//si:valueExpandedMUXMLList")
        .at(2);  // s_vz
  };
  CertificateRequest levelled = request();
  levelled.run.record.measured_alignment.zy = MeasuredValue{0.0, 5e-6};
  levelled.run.results = analyse_all(levelled.run.record);
  levelled.draft = true;
  EXPECT_LT(expanded(make_certificate(std::move(levelled))), 0.5 * expanded(make_certificate(request())));
}

TEST_F(MakeCertificateTest, AnEstimatorWithoutAMatrixGivesNotEvenADraft) {
  CertificateRequest asked = request();
  asked.run.estimator = "norm";
  asked.draft = true;
  EXPECT_THAT(refusal(std::move(asked)), AllOf(HasSubstr("estimator"), HasSubstr("norm")));
}

TEST_F(MakeCertificateTest, ACsvGetsNoCertificate) {
  CertificateRequest asked = request();
  asked.run.run.reset();
  asked.draft = true;
  EXPECT_THAT(refusal(std::move(asked)), HasSubstr("no run that is traceable"));
}

TEST_F(MakeCertificateTest, AsFoundIsTheSameItemBefore) {
  CertificateRequest asked = request();
  asked.as_found = asked.run;
  asked.as_found->run->header.labels["item.serial_number"] = "SN-43";
  asked.as_found->run->header.created_utc = "2999-01-01T00:00:00.000Z";
  EXPECT_THAT(refusal(std::move(asked)),
              AllOf(HasSubstr("as-found run, item.serial_number"), HasSubstr("[job] adjustment"),
                    HasSubstr("a beginning not after that of the other run")));
}

TEST_F(MakeCertificateTest, ShiftsCompareWhatDoesNotDependOnTheMounting) {
  CertificateRequest asked =
      request(replaced(example_laboratory(), "deviations = \"\" ", "adjustment = \"set\" "));
  asked.as_found = asked.run;
  asked.as_found->run->header.created_utc = asked.as_found->run->events.back().utc =
      "1999-01-01T00:00:00.000Z";
  asked.as_found->results.front().offset[2].value -= 0.5;
  const Certificate made = make_certificate(std::move(asked));
  ASSERT_EQ(made.shifts.size(), 9U);
  const Shift& offset = made.shifts.back();
  EXPECT_EQ(offset.name, "offset_w");
  EXPECT_NEAR(offset.difference.value, 0.5, 1e-12);
  const double u = made.run.stated.result.offset[2].standard_uncertainty;
  EXPECT_NEAR(offset.difference.standard_uncertainty, std::sqrt(2.0) * u, 1e-15);
  const double k = coverage_factor(made.run.stated.result.offset[2]);  // not quite 2
  EXPECT_GT(k, 2.0001);
  EXPECT_NEAR(offset.normalised_error, 0.5 / (k * std::sqrt(2.0) * u), 1e-6);
  EXPECT_EQ(made.shifts.front().difference.value, 0.0);
}

TEST_F(MakeCertificateTest, DecisionsAreThoseOfTheLimits) {
  const Certificate made = make_certificate(request());
  ASSERT_EQ(made.run.decisions.size(), 3U);
  const CalibrationResult& result = made.run.data.result();
  EXPECT_NEAR(made.run.decisions[0].value,
              result.intrinsic_sensitivity[0].value * kStandardGravity / result.g_loc.value,
              made.run.decisions[0].expanded_uncertainty);
  EXPECT_EQ(made.run.decisions[0].conformity, Conformity::kPass);
  const Certificate tight =
      make_certificate(request(replaced(example_laboratory(), "upper = 1.02", "upper = 1.0021")));
  EXPECT_EQ(tight.run.decisions[0].conformity, Conformity::kFail);
  const CertificateXml xml(xml_text(dcc_document(tight)));
  EXPECT_EQ(xml.text("//dcc:metaData[@refType='basic_conformity']/dcc:conformity"), "fail");
  const auto probability =
      xml.numbers("//dcc:quantity[@refType='abc_conformanceProbability']/si:real/si:value");
  EXPECT_NEAR(probability.at(0), tight.run.decisions[0].conformance_probability, 5.1e-7);  // Six decimals.
}

}  // namespace
}  // namespace abcal
