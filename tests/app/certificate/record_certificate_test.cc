// The certificate of a result that uses a record of the stage.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "app/laboratory/certificate/issue_certificate.h"
#include "app/laboratory/certificate/report_certificate.h"
#include "protocol/record/sha256.h"
#include "protocol/record/stage_record.h"
#include "tests/app/certificate/record_fixtures.h"
#include "tests/app/certificate/schematron.h"
#include "tests/app/certificate/xml_query.h"
#include "tests/support/test_data.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

/// A record of the stage that item C100 taught, and runs that use it: of another item in two mountings, and
/// of C100 itself.
class RecordCertificateTest : public CertificateTest {
 protected:
  static void SetUpTestSuite() {
    shared_ = new test::TemporaryFolder;
    measure(bench_of("C100", kAsIs, 1), "m1.run", *shared_);
    measure(bench_of("C100", kAboutX, 2), "m2.run", *shared_);
    const auto learned =
        test::run_program({"stage", "learn", "m1.run", "m2.run", "-o", "b.stage"}, shared_->path());
    ASSERT_EQ(learned.exit_code, 0) << learned.err;
    measure(bench_of("SN-42", kAsIs, 11, kRecord), "k1.run", *shared_);
    measure(bench_of("SN-42", kAboutX, 12, kRecord), "k2.run", *shared_);
    measure(bench_of("C100", kAsIs, 13, kRecord), "own.run", *shared_);
  }
  static void TearDownTestSuite() {
    delete shared_;
    shared_ = nullptr;
  }
  void SetUp() override {
    for (const auto& entry : std::filesystem::directory_iterator(shared_->path()))
      std::filesystem::copy_file(entry.path(), folder / entry.path().filename().string());
    test::write_file(folder / "lab.toml", laboratory());
  }

  static std::string hash() { return sha256_of_file(*shared_ / "b.stage"); }
  static std::string entry(const std::string& performed = "2000-01-01", const std::string& due = "2000-06-30",
                           const std::string& sha256 = hash()) {
    return record_entry(sha256, performed, due);
  }
  static std::string laboratory(const std::string& record = entry()) {
    return replaced(example_laboratory(), "[decision] ", record + "[decision] ");
  }
  CertificateRequest request(const std::string& laboratory_toml = laboratory(), const char* run = "k1.run") {
    CertificateRequest asked;
    asked.laboratory = parse_laboratory_file(laboratory_toml, "lab.toml");
    asked.run = gather_report(folder / run, any_time());
    add_monte_carlo(asked);
    asked.together = gather_runs(asked.run, any_time());
    return asked;
  }
  std::string xml_of(CertificateRequest asked) {
    return checked_xml(make_certificate(std::move(asked)), nullptr);
  }
  /// A request whose run began and ended on a later date.
  CertificateRequest at(const std::string& date, const std::string& laboratory_toml) {
    CertificateRequest later = request(laboratory_toml);
    later.run.run->header.created_utc = date + "T12:00:00.000Z";
    for (RunEvent& event : later.run.run->events) event.utc = date + "T13:00:00.000Z";
    return later;
  }

  static inline test::TemporaryFolder* shared_ = nullptr;
};

constexpr const char* kStatement = "//dcc:statement[@refType='abc_stageRecord']/dcc:declaration/dcc:content";

TEST_F(RecordCertificateTest, NamesTheRecordAndOnWhatItRests) {
  const test::TrainingRegister registered(folder.path());
  const auto issued = abcal({"issue", "k1.run", "--laboratory", "lab.toml", "--dcc", "a.xml"});
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  const std::string text = test::read_file(folder / "a.xml");
  const CertificateXml xml(text);
  EXPECT_THAT(xml.text(kStatement),
              AllOf(HasSubstr("taken from record SR-1, approved by Approver N. N. on 2000-01-01, valid until "
                              "2000-06-30 (SHA-256 " +
                              hash() + ")."),
                    HasSubstr("learned on 2000-01-01 from 2 runs, and was 0.0 months old"),
                    HasSubstr("closure of the full circle of each axis, on local gravity"),
                    HasSubstr("no standard of angle is part of it"), HasSubstr("Its part of the variance"),
                    HasSubstr("This calibration agrees with it in all"),
                    Not(HasSubstr("one of those that taught it"))));
  const std::string equipment = "//dcc:measuringEquipment[@refType='abc_stageRecord']";
  EXPECT_EQ(xml.text(equipment + "/dcc:certificate/dcc:value"), hash());
  EXPECT_THAT(xml.text(equipment + "/dcc:description/dcc:content"),
              HasSubstr("record SR-1, approved by Approver N. N. on 2000-01-01, valid until 2000-06-30"));
  EXPECT_THAT(xml.text("//dcc:result[@refType='abc_sensitivityMatrix']/dcc:description/dcc:content"),
              HasSubstr("in the frame of the axes that the record of the stage states"));
  // Trials of the whole evaluation do not draw from a record: none are claimed.
  EXPECT_EQ(xml.text("//dcc:statement[@refType='abc_monteCarlo']/dcc:declaration/dcc:content"), "");
  EXPECT_THAT(xml.text("//dcc:statement[@refType='abc_uncertainty']/dcc:declaration/dcc:content"),
              HasSubstr("trials of the whole evaluation (JCGM 101) were not made"));
  EXPECT_THAT(xml.text("//dcc:metaData[@refType='abc_stageRecordTest']/dcc:description/dcc:content"),
              AllOf(HasSubstr("fine map of X "), HasSubstr("; wobble of Z ")));
  // The sizes that the bench file states or leaves to defaults are not those on which the result rests.
  EXPECT_THAT(xml.texts("//dcc:usedMethodQuantity[@refType='abc_effect']/dcc:name/dcc:content"),
              AllOf(Not(testing::Contains(HasSubstr("step"))), Not(testing::Contains(HasSubstr("wobble")))));
  EXPECT_THAT(
      xml.texts("//dcc:list[@refType='abc_budgetLine'][dcc:measurementMetaData//dcc:content='record of "
                "the stage']/dcc:name/dcc:content"),
      testing::Contains(testing::StartsWith("stage record, ")));
  const auto page = abcal({"report", "k1.run"});
  EXPECT_THAT(page.out,
              AllOf(HasSubstr("Record of the stage"), HasSubstr("SR-1"), HasSubstr("stage record")));
  EXPECT_EQ(abcal({"verify", "k1.run"}).exit_code, 0);
  ABCAL_SHARED_DATA_OR_SKIP(rules, "dcc/schematron/dcc.svrl");
  if (!has_schematron_reader(folder)) GTEST_SKIP() << "Saxon-HE (libsaxonhe-java) or java is not installed";
  EXPECT_THAT(schematron_errors(text, rules, folder), IsEmpty());
}

TEST_F(RecordCertificateTest, IsRefusedForEachReasonOfItsOwn) {
  EXPECT_EQ(refusal(request()), "");
  EXPECT_THAT(refusal(request(example_laboratory())),
              AllOf(HasSubstr("run, record of the stage: found SHA-256 " + hash() +
                              ", which the laboratory does not state"),
                    HasSubstr("quantity = \"stage record\" and this certificate_sha256")));
  EXPECT_THAT(refusal(request(laboratory(entry("2000-01-01", "2000-06-30", std::string(64, 'a'))))),
              HasSubstr("; the laboratory states \"SR-1\" (SHA-256 aaaa"));
  EXPECT_THAT(
      refusal(at("2000-02-01", laboratory(entry("2000-01-01", "2000-01-31")))),
      HasSubstr("found SR-1, approved on 2000-01-01, valid until 2000-01-31; required: one that holds on "
                "2000-02-01, the day of run \"k1.run\""));
  EXPECT_THAT(refusal(request(laboratory(entry("2000-01-02")))), HasSubstr("one that holds on 2000-01-01"));
  EXPECT_THAT(
      refusal(request(laboratory(entry("1999-12-31")))),
      HasSubstr("approved on 1999-12-31; required: a date not before 2000-01-01, when it was learned"));
  EXPECT_THAT(
      refusal(at("2001-02-01", laboratory(entry("2000-01-01", "2010-01-01")))),
      AllOf(HasSubstr("SR-1, 13.1 months old at run \"k1.run\""), HasSubstr("required: at most 6.5 months")));
  // A record of the stage that is stated and not used needs not hold, and is not on the certificate.
  CertificateRequest other = request(replaced(
      laboratory(), "[decision] ",
      replaced(entry("1999-01-01", "1999-06-30", std::string(64, 'a')), "SR-1", "SR-0") + "[decision] "));
  EXPECT_THAT(xml_of(std::move(other)), Not(HasSubstr("SR-0")));
  const ReadLaboratoryFile without_hash = parse_laboratory_file(
      replaced(laboratory(), "certificate_sha256 = \"" + hash() + "\"\n", ""), "lab.toml");
  ASSERT_EQ(without_hash.problems.size(), 1U);
  EXPECT_THAT(to_string(without_hash.problems.front()), HasSubstr("`abcal stage show` prints"));
}

TEST_F(RecordCertificateTest, IsRefusedWhereARunOfItOrItsOwnItemTaughtTheRecord) {
  CertificateRequest pair = request();
  pair.as_found = gather_report(folder / "m1.run", any_time());
  EXPECT_THAT(refusal(std::move(pair)), HasSubstr("record of the stage: found run \"m1.run\" taught it"));
  EXPECT_THAT(refusal(request(laboratory(), "own.run")),
              AllOf(HasSubstr("it was learned from the item itself, Maker M-3, serial number C100"),
                    HasSubstr("record_of_own_item = \"stated\"")));
  const std::string stated =
      replaced(laboratory(), "[laboratory]\n", "[laboratory]\nrecord_of_own_item = \"stated\"\n");
  EXPECT_THAT(CertificateXml(xml_of(request(stated, "own.run"))).text(kStatement),
              HasSubstr("The item calibrated here is one of those that taught it."));
  CertificateRequest series = request();
  series.series.push_back(series.run);
  EXPECT_THAT(refusal(std::move(series)), HasSubstr("a result with a record of the stage; required: points"));
}

TEST_F(RecordCertificateTest, ARunThatContradictsTheRecordStaysDoubtful) {
  measure(bench_of("SN-42", kAsIs, 14, kRecord, 8), "other.run", folder);
  EXPECT_THAT(refusal(request(laboratory(), "other.run")),
              HasSubstr("verdict: found doubtful: this run contradicts the record of its stage"));
  CertificateRequest draft = request(laboratory(), "other.run");
  draft.draft = true;
  EXPECT_THAT(CertificateXml(xml_of(std::move(draft))).text(kStatement),
              AllOf(HasSubstr("This calibration contradicts it in "), Not(HasSubstr("agrees with it"))));
}

TEST_F(RecordCertificateTest, IsInTheLanguageOfTheLaboratory) {
  const CertificateXml german(
      xml_of(request(replaced(laboratory(), "language = \"en\"", "language = \"de\""))));
  EXPECT_THAT(german.texts(std::string(kStatement) + "/@lang"), testing::ElementsAre("de"));
  EXPECT_THAT(german.text(kStatement), AllOf(HasSubstr("Kreisschluss"), Not(HasSubstr(" of "))));
  EXPECT_THAT(
      german.text("//dcc:metaData[@refType='abc_stageRecordTest']/dcc:description/dcc:content"),
      AllOf(HasSubstr("feine Teilungsfehler von X"), Not(HasSubstr("wobble")), Not(HasSubstr("zeros"))));
}

TEST_F(RecordCertificateTest, AMeasurementOfSeveralRunsUsesOneAsWell) {
  const auto combined = abcal({"combine", "k1.run", "k2.run", "-o", "k.measurement"});
  ASSERT_EQ(combined.exit_code, 0) << combined.err;
  ASSERT_THAT(combined.out, HasSubstr("Result: usable")) << combined.out;
  const CertificateXml xml(xml_of(request(laboratory(), "k.measurement")));
  EXPECT_THAT(xml.text(kStatement), AllOf(HasSubstr("record SR-1"), HasSubstr("agrees with it")));
  CertificateRequest late = request(laboratory(entry("2000-01-01", "2000-01-31")), "k.measurement");
  for (RunEvent& event : late.together.back().run->events) event.utc = "2000-02-01T13:00:00.000Z";
  EXPECT_THAT(refusal(std::move(late)), HasSubstr("one that holds on 2000-02-01, the day of run \"k2.run\""));
  // A run that taught the record is no part of a measurement that uses it.
  const auto taught =
      abcal({"combine", "m1.run", "own.run", "--stage-record", "b.stage", "-o", "t.measurement"});
  EXPECT_EQ(taught.exit_code, 2);
  EXPECT_THAT(taught.err, HasSubstr("m1.run: this run taught the record"));
}

TEST_F(RecordCertificateTest, WithARegisterItIsEquipmentWhoseWithdrawalReachesTheCertificate) {
  test::TrainingRegister registered(folder.path());
  registered.lab({"add", "equipment", "STAGE-1", "--name", "Stage", "--quantity", "angle", "--serial-number",
                  "118001234"});
  registered.lab({"add", "calibration", "EX-ANGLE-1", "--equipment", "STAGE-1", "--issuer", "Institute",
                  "--performed", "2000-01-01", "--due", "2099-01-01"});
  registered.lab({"add", "equipment", "RECORD-1", "--name", "Errors of the stage", "--quantity",
                  "stage record", "--serial-number", "118001234"});
  const auto measured = [&](const char* run, int number) {
    registered.log_in("Operator N. N.");
    measure(bench_of("SN-42", kAsIs, number, kRecord), run, folder);
    registered.log_in("Approver N. N.");
  };
  const auto issue = [&](const char* run) { return abcal({"issue", run, "--laboratory", "lab.toml"}); };
  // The laboratory file states the record, but the register that the run asked has none.
  measured("early.run", 21);
  const auto early = issue("early.run");
  EXPECT_EQ(early.exit_code, 1);
  EXPECT_THAT(early.err, HasSubstr("which the laboratory does not state"));
  registered.lab({"add", "calibration", "SR-1", "--equipment", "RECORD-1", "--issuer", "Approver N. N.",
                  "--performed", "2000-01-01", "--due", "2099-01-01", "--sha256", hash()});
  measured("late.run", 22);
  measured("later.run", 23);
  const auto issued = issue("late.run");
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  const std::string number = test::number_of(issued.out);
  EXPECT_EQ(abcal({"lab", "status", number}).exit_code, 0);
  registered.lab({"withdraw", "calibration", "SR-1", "--reason", "the stage was moved"});
  const auto status = abcal({"lab", "status", number});
  EXPECT_EQ(status.exit_code, 1);
  EXPECT_THAT(status.out, HasSubstr("it rests on calibration SR-1, withdrawn on"));
  EXPECT_THAT(registered.lab({"affected", "RECORD-1"}),
              AllOf(HasSubstr(number), HasSubstr("record of the stage")));
  const auto refused = issue("later.run");
  EXPECT_EQ(refused.exit_code, 1);
  EXPECT_THAT(refused.err, HasSubstr("record of the stage: calibration SR-1, withdrawn on"));
}

}  // namespace
}  // namespace abcal
