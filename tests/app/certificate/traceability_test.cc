#include "app/certificate/traceability.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "app/certificate/dcc_xml.h"
#include "app/certificate/issue.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/app/certificate/xml_query.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class TraceabilityTest : public CertificateTest {
 protected:
  /// A request to issue that nothing speaks against.
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
  /// As a run keeps it from the register.
  static std::string registered_equipment(const std::string& serial_number, const std::string& quantity) {
    return R"({"equipment":"S","name":"of the register","maker":"","model":"","serial_number":")" +
           serial_number + R"(","quantity":")" + quantity +
           R"(","certificate":"C-9","issuer":"I","performed":"2026-01-01","due":"2027-01-01","sha256":"","values":[]})";
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
  EXPECT_THAT(why, AllOf(HasSubstr("simulated: stage"), HasSubstr("by formula GRS80"),
                         HasSubstr("performed not stated"), HasSubstr("default sizes are used"),
                         HasSubstr("run, voltage")));
  // A training certificate lets it pass and says so.
  asked.run.record.response_unit = "g";
  asked.issue->training = true;
  const Certificate training = make_certificate(asked);
  EXPECT_EQ(traceable(training), "");
  EXPECT_THAT(xml_text(dcc_document(training)),
              AllOf(HasSubstr("abc_training"), HasSubstr("by formula GRS80")));
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
  EXPECT_THAT(refusal(issuable(laboratory)), HasSubstr("equipment for angle with serial number 118001234"));
  // A voltmeter's reading is a voltage, whatever unit a scale makes of it.
  CertificateRequest asked = issuable();
  asked.run.bench->accelerometer.driver = "scpi_voltmeter";
  for (InstrumentIdentity& instrument : asked.run.run->header.instruments)
    if (instrument.role == "accelerometer") instrument.serial_number = "MY-1";
  asked.run.record.response_unit = "g";
  EXPECT_THAT(refusal(asked), HasSubstr("run, voltage: found no calibrated equipment"));
  const std::string voltmeter =
      "[[equipment]]\nname = \"Voltmeter\"\nquantity = \"voltage\"\nserial_number = \"MY-12\"\n"
      "certificate = \"C-2\"\ncertificate_issuer = \"I\"\nperformed = 2026-01-01\ndue = 2027-01-01\n";
  asked.laboratory = issuable(example_laboratory() + voltmeter).laboratory;
  EXPECT_THAT(refusal(asked), HasSubstr("equipment for voltage with serial number MY-1 and"));
  asked.laboratory = issuable(example_laboratory() + replaced(voltmeter, "MY-12", "MY-1")).laboratory;
  EXPECT_EQ(refusal(asked), "");
  // U without the voltmeter's part is not that of the calibration.
  asked.run.record.tolerances.sources.erase("voltmeter_gain");
  EXPECT_THAT(refusal(asked), HasSubstr("run, voltmeter: found not stated: gain of the voltmeter"));
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
              HasSubstr("stage: found serial number 118001234"));
}

TEST_F(TraceabilityTest, WhoMeasuredIsWhoTheEventsSay) {
  CertificateRequest asked = issuable();
  // The operator of the run may approve others, but not this one, whatever name is given for who measured.
  asked.run.run->events.push_back({asked.run.ended_utc(), "operator stated", "Approver N. N."});
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
  auto& events = asked.run.run->events;
  std::erase_if(events, [](const RunEvent& event) { return event.kind == "operator stated"; });
  events.push_back({asked.run.ended_utc(), "operator logged in", "Operator N. N., register 00ff"});
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
