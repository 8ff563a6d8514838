#include "app/laboratory/certificate/traceability.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "app/laboratory/certificate/dcc_xml.h"
#include "app/laboratory/certificate/issue_certificate.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/xml_query.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class TraceabilityTest : public CertificateTest {
 protected:
  /// A request to issue that meets all requirements.
  static CertificateRequest issuable(const std::string& laboratory = example_laboratory()) {
    CertificateRequest asked = request(laboratory);
    as_if_real(asked.run);
    asked.issue.emplace();
    asked.issue->number = "EX-1";
    asked.issue->approved_by = "Approver N. N.";
    asked.issue->date = *parse_date("2026-03-02");
    asked.issue->today = *parse_date("2026-03-02");
    return asked;
  }
  /// Equipment from the register in the form that a run stores.
  static std::string registered_equipment(const std::string& serial_number, const std::string& quantity,
                                          const std::string& values = "") {
    return R"({"equipment":"S","name":"of the register","maker":"","model":"","serial_number":")" +
           serial_number + R"(","quantity":")" + quantity +
           R"(","certificate":"C-9","issuer":"I","performed":"2026-01-01","due":"2027-01-01","sha256":"","values":[)" +
           values + "]}";
  }
  /// Makes the stage one that reports no serial number, with the bench file's statement of it.
  static void without_reported_number(CertificateRequest& asked, const std::string& role,
                                      const std::string& stated, const std::string& reported = "") {
    for (InstrumentIdentity& instrument : asked.run.run->header.instruments)
      if (instrument.role == role) instrument.serial_number = reported;
    if (!stated.empty()) asked.run.run->header.labels[role + ".stated_serial_number"] = stated;
  }
  static std::string traceable(const Certificate& certificate) {
    return CertificateXml(xml_text(dcc_document(certificate)))
        .text("//dcc:statement[@refType='abc_traceability']/dcc:traceable");
  }
};

TEST_F(TraceabilityTest, IsClaimedWhereEveryChainHolds) {
  EXPECT_EQ(traceable(make_certificate(issuable())), "true");
}

TEST_F(TraceabilityTest, EveryReasonAgainstItIsListedAndRefusesACertificate) {
  std::string laboratory = example_laboratory();
  laboratory = replaced(
      laboratory, "performed = 2025-12-31                      # required to issue a certificate\n", "");
  CertificateRequest asked = issuable(laboratory);
  asked.run.simulated = {"stage"};
  asked.run.record.g_loc.source = "formula GRS80";
  asked.run.record.tolerances.sources.clear();
  asked.run.record.response_unit = "V";
  const std::string why = refusal(asked);
  EXPECT_THAT(why, AllOf(HasSubstr("simulated: stage"), HasSubstr("by \"formula GRS80\""),
                         HasSubstr("performed not stated"), HasSubstr("default sizes are used"),
                         HasSubstr("run, voltage")));
  // A training certificate lets it pass and says so.
  asked.run.record.response_unit = "g";
  asked.issue->training = true;
  const Certificate training = make_certificate(asked);
  EXPECT_EQ(traceable(training), "");
  EXPECT_THAT(xml_text(dcc_document(training)),
              AllOf(HasSubstr("abc_training"), HasSubstr("by \"formula GRS80\"")));
}

TEST_F(TraceabilityTest, ACalibrationHoldsOnTheDayOfTheRun) {
  EXPECT_THAT(
      refusal(issuable(replaced(example_laboratory(), "performed = 2025-12-31 ", "performed = 2026-03-02 "))),
      HasSubstr("run, angle"));  // A day after it.
  EXPECT_EQ(
      refusal(issuable(replaced(example_laboratory(), "performed = 2025-12-31 ", "performed = 2026-03-01 "))),
      "");
  EXPECT_THAT(refusal(issuable(replaced(example_laboratory(), "due = 2035-12-31", "due = 2026-02-28"))),
              HasSubstr("run, gravity"));
  EXPECT_THAT(
      refusal(issuable(replaced(example_laboratory(), "quantity = \"temperature\"", "quantity = \"other\""))),
      HasSubstr("run, temperature: found no calibrated equipment"));
}

TEST_F(TraceabilityTest, TheCalibrationIsThatOfTheInstrumentThatMeasured) {
  // The stage of the run was calibrated after it; another stage's calibration does not help.
  const std::string laboratory =
      replaced(example_laboratory(), "performed = 2025-12-31 ", "performed = 2026-03-02 ") +
      "[[equipment]]\nname = \"Another stage\"\nquantity = \"angle\"\nserial_number = \"7\"\n"
      "certificate = \"C-1\"\ncertificate_issuer = \"I\"\nperformed = 2026-01-01\ndue = 2027-01-01\n";
  EXPECT_THAT(refusal(issuable(laboratory)),
              HasSubstr("equipment for angle with serial number \"118001234\""));
  // A voltmeter's reading is a voltage, whatever unit its scale has.
  CertificateRequest asked = issuable();
  asked.run.bench->items.front().accelerometer.driver = "scpi_voltmeter";
  for (InstrumentIdentity& instrument : asked.run.run->header.instruments)
    if (instrument.role == "accelerometer") instrument.serial_number = "MY-1";
  asked.run.record.response_unit = "g";
  EXPECT_THAT(refusal(asked), HasSubstr("run, voltage: found no calibrated equipment"));
  const std::string voltmeter =
      "[[equipment]]\nname = \"Voltmeter\"\nquantity = \"voltage\"\nserial_number = \"MY-12\"\n"
      "certificate = \"C-2\"\ncertificate_issuer = \"I\"\nperformed = 2026-01-01\ndue = 2027-01-01\n";
  asked.laboratory = issuable(example_laboratory() + voltmeter).laboratory;
  EXPECT_THAT(refusal(asked), HasSubstr("equipment for voltage with serial number \"MY-1\" and"));
  asked.laboratory = issuable(example_laboratory() + replaced(voltmeter, "MY-12", "MY-1")).laboratory;
  EXPECT_EQ(refusal(asked), "");
  // U without the voltmeter's part is not that of the calibration.
  asked.run.record.tolerances.sources.erase("voltmeter_gain");
  EXPECT_THAT(refusal(asked), HasSubstr("run, voltmeter: found not stated: gain of the voltmeter"));
}

TEST_F(TraceabilityTest, AStageThatReportsNoSerialNumberNeedsOneThatTheBenchFileStates) {
  CertificateRequest asked = issuable();
  without_reported_number(asked, "stage", "");
  EXPECT_THAT(refusal(asked),
              HasSubstr("run, stage: found no serial number, neither reported by the instrument "
                        "nor stated; required: [stage] serial_number in the bench file"));
  without_reported_number(asked, "stage", "7");
  EXPECT_THAT(refusal(asked), AllOf(HasSubstr("equipment for angle with serial number \"7\" and"),
                                    HasSubstr("stage: found serial number \"7\"")));
  without_reported_number(asked, "stage", "118001234");
  EXPECT_EQ(refusal(asked), "");
  const Certificate certificate = make_certificate(asked);
  EXPECT_EQ(traceable(certificate), "true");
  EXPECT_THAT(xml_text(dcc_document(certificate)), HasSubstr("stated by the bench file"));
  EXPECT_THAT(xml_text(dcc_document(make_certificate(issuable()))),
              Not(HasSubstr("stated by the bench file")));
  // One of two controllers reports none.
  asked = issuable();
  without_reported_number(asked, "stage", "", " + 118001234");
  EXPECT_THAT(refusal(asked), HasSubstr("run, stage: found no serial number"));
}

/// A bench whose stage reports no serial number, with further keys of [stage].
std::string bench_with_silent_stage(const std::string& keys) {
  return replaced(certificate_bench(), "driver = \"pi_gcs\"\nport = \"simulated\"\n",
                  "driver = \"newport_xps\"\nport = \"simulated\"\n" + keys +
                      "[stage.x]\naxis = \"Group1.Pos\"\n[stage.z]\naxis = \"Group2.Pos\"\n");
}

TEST_F(TraceabilityTest, ARunKeepsTheStatedSerialNumberAsStated) {
  measure(bench_with_silent_stage("serial_number = \"77\"\n"), "stated.run", folder);
  const ReportData data = gather_report(folder / "stated.run", any_time());
  EXPECT_EQ(serial_numbers_of(data, "stage"), "77");
  EXPECT_TRUE(is_serial_number_stated(data, "stage"));
  for (const InstrumentIdentity& instrument : data.run->header.instruments) {
    if (instrument.role != "stage") continue;
    EXPECT_EQ(instrument.serial_number, "");
    EXPECT_THAT(instrument.details, HasSubstr("serial number 77 stated by the bench file"));
  }
  measure(bench_with_silent_stage(""), "silent.run", folder);
  EXPECT_EQ(serial_numbers_of(gather_report(folder / "silent.run", any_time()), "stage"), "");
  // A reported serial number does not count as stated.
  const ReportData reported = gather_report(shared_run(), any_time());
  EXPECT_FALSE(is_serial_number_stated(reported, "stage"));
}

TEST_F(TraceabilityTest, AVoltmeterThatReportsNoSerialNumberNeedsOneThatTheBenchFileStates) {
  const std::string voltmeter =
      "[[equipment]]\nname = \"Voltmeter\"\nquantity = \"voltage\"\nserial_number = \"MY-1\"\n"
      "certificate = \"C-2\"\ncertificate_issuer = \"I\"\nperformed = 2026-01-01\ndue = 2027-01-01\n";
  CertificateRequest asked = issuable(example_laboratory() + voltmeter);
  asked.run.bench->items.front().accelerometer.driver = "scpi_voltmeter";
  without_reported_number(asked, "accelerometer", "", "0");
  EXPECT_THAT(refusal(asked), HasSubstr("run, voltmeter: found no serial number"));
  without_reported_number(asked, "accelerometer", "MY-2", "0");
  EXPECT_THAT(refusal(asked), HasSubstr("equipment for voltage with serial number \"MY-2\""));
  without_reported_number(asked, "accelerometer", "MY-1", "0");
  EXPECT_EQ(refusal(asked), "");
}

TEST_F(TraceabilityTest, LocalGravityIsThatOfTheEquipmentForGravity) {
  const auto with_source = [](const std::string& source) {
    CertificateRequest asked = issuable();
    asked.run.record.g_loc.source = source;
    return refusal(asked);
  };
  EXPECT_THAT(
      with_source("felt about right"),
      HasSubstr("run, local gravity: found source \"felt about right\"; required: [bench] g_loc_mps2 from "
                "a record of the register, or a g_loc_source that names the certificate of the equipment "
                "for gravity: \"EX-GRAV-7\""));
  // Another number that only contains the right one.
  for (const char* source :
       {"certificate EX-GRAV-71", "EX-GRAV-7/2", "EX-GRAV-7-B", "2EX-GRAV-7", "GRAV-7", "7"})
    EXPECT_THAT(with_source(source), HasSubstr("run, local gravity")) << source;
  for (const char* source : {"certificate EX-GRAV-7.", "EX-GRAV-7", "(EX-GRAV-7, 2025)", "survey, report 7"})
    EXPECT_EQ(with_source(source), "") << source;
  // A survey that was valid at the time of the run.
  EXPECT_THAT(refusal(issuable(replaced(example_laboratory(), "due = 2035-12-31", "due = 2026-02-28"))),
              AllOf(HasSubstr("run, gravity"), Not(HasSubstr("run, local gravity"))));
  CertificateRequest both = issuable(replaced(example_laboratory(), "due = 2035-12-31", "due = 2026-02-28"));
  both.run.record.g_loc.source = "felt about right";
  EXPECT_THAT(refusal(both), AllOf(HasSubstr("run, gravity"), HasSubstr("run, local gravity: found source")));
}

TEST_F(TraceabilityTest, LocalGravityHasTheValueOfItsCalibration) {
  const auto with_value = [](const std::string& value, const std::string& expanded) {
    CertificateRequest asked = issuable();
    asked.run.record.g_loc.source = "certificate C-9";
    asked.run.run->header.labels[kCalibrationsLabel] =
        "[" + registered_equipment("118001234", "angle") + "," +
        registered_equipment("g", "gravity",
                             R"({"name":"site","unit":"m/s2","value":)" + value +
                                 R"(,"expanded_uncertainty":)" + expanded + R"(,"coverage_factor":2})") +
        "," + registered_equipment("t", "temperature") + "]";
    return refusal(asked);
  };
  EXPECT_EQ(with_value("9.80101", "0.00003"), "");
  EXPECT_THAT(
      with_value("9.80107", "0.00003"),
      HasSubstr(
          "run, local gravity: found g_loc = 9.80101 m/s2, U = 3e-05 m/s2, k = 2; required: as its source "
          "states it: g_loc = 9.80107 m/s2, U = 3e-05 m/s2, k = 2"));
  // The run states less than its source.
  EXPECT_THAT(with_value("9.80101", "0.00004"), HasSubstr("run, local gravity: found g_loc = 9.80101"));
  EXPECT_EQ(with_value("9.80101", "0.00002"), "");
}

TEST_F(TraceabilityTest, EachSizeAboveZeroHasASource) {
  CertificateRequest asked = issuable();
  auto& sources = asked.run.record.tolerances.sources;
  sources["wobble_urad"] = "stated";
  sources["zero_deg"] = "stated (rectangular, half-width 0.014)";
  sources["drift"] = "tolerances";
  EXPECT_THAT(
      refusal(asked),
      HasSubstr("run, effects: found stated without a source: zeros of the axes; wobble of the axes, each "
                "coefficient to 3/rev; drift of the offset, each order; required: a source for each"));
  // Zero leaves an effect out.
  asked.run.record.tolerances.wobble_urad = 0.0;
  EXPECT_THAT(refusal(asked), AllOf(HasSubstr("zeros of the axes"), Not(HasSubstr("wobble"))));
}

TEST_F(TraceabilityTest, SerialNumbersMatchExactly) {
  const auto missing = [](const std::vector<std::string>& listed, const std::string& serial_numbers) {
    std::vector<Equipment> equipment(listed.size());
    for (std::size_t i = 0; i < listed.size(); ++i) {
      equipment[i].quantity = "angle";
      equipment[i].serial_number = listed[i];
    }
    EXPECT_EQ(serial_number_without_equipment(equipment, "voltage", "7"), "7");
    return serial_number_without_equipment(equipment, "angle", serial_numbers);
  };
  EXPECT_EQ(missing({"1"}, "118001234"), "118001234");
  EXPECT_EQ(missing({"118001234"}, "118001234"), "");
  EXPECT_EQ(missing({"118001234"}, "118001233/118001234"), "118001233");
  EXPECT_EQ(missing({"118001234", "118001233"}, "118001233/118001234"), "");
  EXPECT_EQ(missing({"118001233/118001234"}, "118001233/118001234"), "");
  EXPECT_EQ(missing({"MY-1", "MY-2"}, "MY-1, MY-2, MY-3"), "MY-3");
  EXPECT_EQ(missing({"12345", "118001234"}, "12345 + 118001234"), "");
  EXPECT_EQ(missing({"118001233"}, "118001233/1180012345"), "1180012345");
  EXPECT_THAT(refusal(issuable(replaced(example_laboratory(), "\"118001234\"", "\"1\""))),
              HasSubstr("stage: found serial number \"118001234\""));
}

TEST_F(TraceabilityTest, WhoMeasuredIsWhoTheEventsSay) {
  CertificateRequest asked = issuable();
  // The operator of the run may approve others, but not this one, whatever name is given as the operator.
  asked.run.run->events.push_back(
      {asked.run.ended_utc(), "operator stated", Message::bare("Approver N. N.")});
  asked.issue->measured_by = "Third P.";
  EXPECT_THAT(refusal(asked),
              AllOf(HasSubstr("a person other than the one who measured"), HasSubstr("Third P.")));
}

TEST_F(TraceabilityTest, WithARegisterTheOperatorWasLoggedIn) {
  CertificateRequest asked = issuable();
  asked.issue->register_identity = "00ff";
  EXPECT_THAT(refusal(asked), HasSubstr("stated, not verified"));
  EXPECT_THAT(refusal(asked), HasSubstr("that the register named when the run began"));
  asked.run.run->header.labels[kCalibrationsLabel] = "[" + registered_equipment("118001234", "angle") + "," +
                                                     registered_equipment("g", "gravity") + "," +
                                                     registered_equipment("t", "temperature") + "]";
  asked.run.record.g_loc.source = "calibration C-9 of S by I, performed 2026-01-01, due 2027-01-01";
  auto& events = asked.run.run->events;
  std::erase_if(events, [](const RunEvent& event) { return event.kind == "operator stated"; });
  events.push_back(
      {asked.run.ended_utc(), "operator logged in", Message::bare("Operator N. N., register 00ff")});
  EXPECT_EQ(refusal(asked), "");
  const Certificate certificate = make_certificate(asked);
  ASSERT_EQ(certificate.operators.size(), 1U);
  EXPECT_TRUE(certificate.operators[0].verified());
  EXPECT_THAT(xml_text(dcc_document(certificate)), Not(HasSubstr("stated, not verified")));
  EXPECT_THAT(xml_text(dcc_document(make_certificate(issuable()))),
              HasSubstr("measured by (stated, not verified)"));
}

TEST_F(TraceabilityTest, DatesAgreeWithEachOtherAndWithTheClock) {
  CertificateRequest asked = issuable();
  asked.issue->date = *parse_date("2026-03-03");
  EXPECT_THAT(refusal(asked), HasSubstr("not after today, 2026-03-02"));
  asked.issue->date = *parse_date("2026-02-28");
  EXPECT_THAT(refusal(asked), HasSubstr("not before the run's end"));
  asked = issuable(replaced(example_laboratory(), "received = 2026-01-05", "received = 2026-03-02"));
  EXPECT_THAT(refusal(asked), HasSubstr("not after the run began"));
  asked = issuable();
  asked.issue->today = *parse_date("2026-02-28");
  EXPECT_THAT(refusal(asked), HasSubstr("end of the run: found 2026-03-01"));
}

TEST_F(TraceabilityTest, WhatTheRegisterSaidAtTheStartTakesThePlaceOfTheFile) {
  CertificateRequest asked = issuable();
  asked.run.run->header.labels[kCalibrationsLabel] = "[" + registered_equipment("118001234", "angle") + "]";
  const std::string why = refusal(asked);
  EXPECT_THAT(why,
              AllOf(HasSubstr("run, gravity: found no calibrated equipment"), Not(HasSubstr("run, angle"))));
}

TEST_F(TraceabilityTest, TypedInValuesAreStatedByTheOperator) {
  EXPECT_THAT(xml_text(dcc_document(make_certificate(issuable()))),
              HasSubstr("Temperature of the room, stated by the operator"));
  CertificateRequest asked = issuable();
  asked.run.bench->environment.driver = "text_line_sensor";
  EXPECT_THAT(xml_text(dcc_document(make_certificate(asked))), Not(HasSubstr("stated by the operator")));
}

}  // namespace
}  // namespace abcal
