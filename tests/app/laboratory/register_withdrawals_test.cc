// Records that runs rest on, withdrawals, and how long records are kept.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "app/laboratory/register/affected_queries.h"
#include "app/laboratory/register/register_schema.h"
#include "protocol/record/sha256.h"
#include "tests/app/laboratory/register_fixtures.h"
#include "tests/support/project_paths.h"

namespace abcal::lab {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

constexpr const char* kItem = "Maker M-3 SN-42";

class RegisterWithdrawalsTest : public OnDatabase {
 protected:
  Register with_calibrations() {
    Register made = with_people();
    const LoggedIn admin = login(made, "Admin N. N.");
    made.add_equipment(admin, {"STAGE-1", "Stage", "Maker", "C-1", "118001234", "angle", {}}, at(3));
    made.add_equipment(admin, {"STAGE-2", "Stage", "Maker", "C-1", "118009999", "angle", {}}, at(3));
    for (const auto& [number, stage] : {std::pair{"EX-ANGLE-1", "STAGE-1"}, {"EX-ANGLE-2", "STAGE-2"}})
      made.add_calibration(admin, {number, stage, "Institute", "2026-01-10", "2027-01-10", "", {}}, at(4));
    return made;
  }
  static RegisteredRun run_on(const std::string& name, const std::string& stage_number) {
    return {sha256_of(name),
            "/runs/" + name,
            kItem,
            "2026-03-01",
            {{kCalibrationKind, "EX-ANGLE-" + stage_number, stage_number == "1" ? "118001234" : "118009999",
              "angle of the stage"}}};
  }
  static NumberRequest request_for(const RegisteredRun& run) {
    NumberRequest request{run.run_sha256, kItem, "Operator N. N.", {}, {}};
    request.runs = {run};
    return request;
  }
  /// Issues the certificate of a run. @return its number
  static std::string issue(Register& in, const NumberRequest& request, const std::string& customer = {}) {
    const LoggedIn approver = login(in, "Approver N. N.");
    const std::string number = in.reserve_number(approver, request, at(10)).number;
    in.record_issued(approver, number, sha256_of("xml of " + number), "2026-03-01", at(11));
    if (!customer.empty())
      in.tell_certificate(approver, number, {customer, "1 Street, Town", "", "en"}, {request.run_sha256},
                          at(11));
    return number;
  }
  static std::vector<std::string> numbers(const Affected& affected) {
    std::vector<std::string> list;
    for (const AffectedCertificate& one : affected.certificates) list.push_back(one.record.number);
    return list;
  }
};
ABCAL_ON_BOTH_DATABASES(RegisterWithdrawalsTest);

TEST_P(RegisterWithdrawalsTest, ACalibrationNamesEveryRunAndCertificateThatUsedItAndNoOther) {
  Register made = with_calibrations();
  const std::string first = issue(made, request_for(run_on("a", "1")), "Customer A");
  const std::string second = issue(made, request_for(run_on("b", "2")), "Customer B");
  made.tell_run(login(made, "Operator N. N."), run_on("c", "1"), at(12));  // Without a certificate.
  for (const char* name : {"EX-ANGLE-1", "STAGE-1", "118001234"}) {
    const Affected affected = made.affected_by(name);
    EXPECT_THAT(numbers(affected), ElementsAre(first)) << name;
    ASSERT_THAT(affected.runs, SizeIs(2)) << name;
    EXPECT_EQ(affected.runs[0].sources.at(0).role, "angle of the stage");
    EXPECT_EQ(affected.certificates[0].addressee->name, "Customer A");
    EXPECT_THAT(affected.unknown, IsEmpty());
  }
  EXPECT_THAT(numbers(made.affected_by(second)), ElementsAre(second));
  EXPECT_FALSE(made.affected_by("EX-ANGLE-").is_known);
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterWithdrawalsTest, ACertificateOfSeveralRunsIsAffectedByTheSourcesOfEach) {
  Register made = with_calibrations();
  NumberRequest request = request_for(run_on("as left", "1"));
  request.runs.push_back(run_on("as found", "2"));
  const std::string number = issue(made, request);
  made.tell_certificate(login(made, "Approver N. N."), number, {"C", "", "", "en"},
                        {sha256_of("as found"), sha256_of("as left")}, at(12));
  EXPECT_THAT(numbers(made.affected_by("EX-ANGLE-2")), ElementsAre(number));
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterWithdrawalsTest, AWithdrawnCalibrationQuestionsItsCertificatesAndRefusesNewOnes) {
  Register made = with_calibrations();
  const std::string number = issue(made, request_for(run_on("a", "1")));
  const LoggedIn approver = login(made, "Approver N. N."), admin = login(made, "Admin N. N.");
  EXPECT_THAT(refusal([&] { made.withdraw(approver, kCalibrationKind, "EX-ANGLE-1", "why", at(20)); }),
              HasSubstr("the right to operate"));
  EXPECT_THAT(refusal([&] { made.withdraw(admin, kCalibrationKind, "EX-ANGLE-1", " ", at(20)); }),
              HasSubstr("no reason"));
  EXPECT_THAT(refusal([&] { made.withdraw(admin, kCalibrationKind, "EX-ANGLE-9", "why", at(20)); }),
              HasSubstr("is not in the register"));
  made.withdraw(admin, kCalibrationKind, "EX-ANGLE-1", "encoder was loose", at(20));
  EXPECT_THAT(refusal([&] { made.withdraw(admin, kCalibrationKind, "EX-ANGLE-1", "again", at(21)); }),
              HasSubstr("already, by Admin N. N."));
  const CertificateStatus status = *made.status_of(number);
  EXPECT_EQ(
      status.words(),
      "valid, issued on 2026-03-01; it rests on calibration EX-ANGLE-1, withdrawn on 2026-03-01 because "
      "encoder was loose");
  EXPECT_THAT(made.affected_by("STAGE-1").withdrawn, SizeIs(1));
  // A run that rests on it gets no certificate, another does.
  EXPECT_THAT(refusal([&] { made.reserve_number(approver, request_for(run_on("b", "1")), at(22)); }),
              AllOf(HasSubstr("/runs/b, angle of the stage: calibration EX-ANGLE-1, withdrawn on 2026-03-01"),
                    HasSubstr("required: a run with records that hold")));
  EXPECT_EQ(issue(made, request_for(run_on("c", "2"))), "EX-2026-0002");
  EXPECT_EQ(made.audit().back().subject.substr(0, 11), "certificate");
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterWithdrawalsTest, TheStatusOfACertificateIsThatOfItsHistory) {
  Register made = with_calibrations();
  const LoggedIn approver = login(made, "Approver N. N.");
  EXPECT_FALSE(made.status_of("EX-2026-0001"));
  const std::string number = made.reserve_number(approver, request_for(run_on("a", "1")), at(10)).number;
  EXPECT_EQ(made.status_of(number)->word(), "not issued");
  EXPECT_THAT(refusal([&] { made.withdraw(approver, kCertificateKind, number, "why", at(10)); }),
              HasSubstr("required: one that is valid"));
  made.record_issued(approver, number, sha256_of("xml"), "2026-03-01", at(11));
  EXPECT_TRUE(made.status_of(number)->is_valid());
  EXPECT_THAT(
      refusal([&] { made.withdraw(login(made, "Operator N. N."), kCertificateKind, number, "why", at(12)); }),
      HasSubstr("the right to approve"));
  made.withdraw(approver, kCertificateKind, number, "wrong item", at(12));
  EXPECT_EQ(made.status_of(number)->words(), "withdrawn on 2026-03-01 because wrong item");
  EXPECT_FALSE(made.status_of(number)->is_valid());
  // A new certificate of its run names it as its predecessor, and there is one successor.
  EXPECT_THAT(refusal([&] { made.reserve_number(approver, request_for(run_on("a", "1")), at(13)); }),
              HasSubstr("was withdrawn; a new one replaces it: --replaces " + number));
  NumberRequest amendment = request_for(run_on("a", "1"));
  amendment.replaces = number;
  amendment.reason = "the right item";
  const std::string next = issue(made, amendment);
  EXPECT_EQ(made.status_of(number)->words(),
            "withdrawn on 2026-03-01 because wrong item; amended by " + next + " on 2026-03-01");
  EXPECT_THAT(refusal([&] { made.reserve_number(approver, amendment, at(14)); }), HasSubstr(next));
  // An amended one.
  NumberRequest again = amendment;
  again.replaces = next;
  const std::string last = issue(made, again);
  EXPECT_EQ(made.status_of(next)->words(), "amended by " + last + " on 2026-03-01");
  EXPECT_THAT(refusal([&] { made.withdraw(approver, kCertificateKind, next, "why", at(15)); }),
              HasSubstr("amended by " + last));
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterWithdrawalsTest, ARecordOfAnyKindIsWithdrawnOnceARunNamesIt) {
  Register made = with_calibrations();
  const LoggedIn admin = login(made, "Admin N. N.");
  EXPECT_THAT(refusal([&] { made.withdraw(admin, "stage record", "SR-7", "why", at(5)); }),
              HasSubstr("one of the kinds certificate, calibration"));
  RegisteredRun run = run_on("a", "1");
  run.sources.push_back({"stage record", "SR-7", "118001234", "step errors"});
  const std::string number = issue(made, request_for(run));
  made.withdraw(admin, "stage record", "SR-7", "measured warm", at(20));
  EXPECT_THAT(numbers(made.affected_by("SR-7")), ElementsAre(number));
  EXPECT_THAT(made.status_of(number)->words(), HasSubstr("it rests on stage record SR-7, withdrawn"));
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterWithdrawalsTest, ARecordOfAStageIsAddedByWhoApprovesIt) {
  Register made = with_calibrations();
  const LoggedIn admin = login(made, "Admin N. N."), approver = login(made, "Approver N. N.");
  made.add_equipment(admin, {"RECORD-1", "Errors", "Maker", "C-1", "118001234", kStageRecordQuantity, {}},
                     at(5));
  Calibration record{"SR-1", "RECORD-1", "Approver N. N.", "2026-01-10", "2026-07-10", sha256_of("r"), {}};
  made.add_person(admin, {"Keeper N. N.", "technician", "", {Right::kOperate}, {}, {}}, kPassword, at(5),
                  PasswordCost::kForTests);
  const LoggedIn keeper = login(made, "Keeper N. N.");
  EXPECT_THAT(refusal([&] { made.add_calibration(keeper, record, at(6)); }),
              HasSubstr("the right to approve"));
  Calibration without = record;
  without.sha256.clear();
  without.issuer = "Institute";
  EXPECT_THAT(refusal([&] { made.add_calibration(approver, without, at(6)); }),
              AllOf(HasSubstr("the SHA-256 of the record"), HasSubstr("who approves it, Approver N. N.")));
  made.add_calibration(approver, record, at(6));
  RegisteredRun run = run_on("a", "1");
  run.sources.push_back({kCalibrationKind, "SR-1", "118001234", "record of the stage"});
  const std::string number = issue(made, request_for(run));
  made.withdraw(admin, kCalibrationKind, "SR-1", "measured warm", at(20));
  EXPECT_THAT(numbers(made.affected_by("RECORD-1")), ElementsAre(number));
  EXPECT_FALSE(made.status_of(number)->holds());
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterWithdrawalsTest, AWithdrawalThatIsRemovedBehindItsBackIsFound) {
  Register made = with_calibrations();
  const std::string number = issue(made, request_for(run_on("a", "1")), "Customer A");
  made.withdraw(login(made, "Approver N. N."), kCertificateKind, number, "why", at(12));
  {
    Database database(location);
    database.execute("delete from withdrawal");
    database.execute("update certificate set state = 'issued'");
    database.execute("update addressee set name = 'Another'");
    database.execute("delete from used_source");
  }
  EXPECT_THAT(bad(made),
              AllOf(HasSubstr("withdrawal/certificate/" + number + " is missing"),
                    HasSubstr("certificate/" + number + " is not as the audit says"),
                    HasSubstr("addressee/" + number + " is not as the audit says"),
                    HasSubstr("used_source/" + sha256_of("a") + "/calibration/EX-ANGLE-1 is missing")));
}

TEST_P(RegisterWithdrawalsTest, WhatTheRegisterDoesNotKnowIsSaid) {
  Register made = with_calibrations();
  NumberRequest old{sha256_of("old"), kItem, "Operator N. N.", {}, {}};  // As versions before asked.
  const std::string number = issue(made, old);
  EXPECT_THAT(made.affected_by("EX-ANGLE-1").unknown, ElementsAre(number));
  const LoggedIn who = login(made, "Operator N. N.");
  EXPECT_TRUE(made.tell_run(who, run_on("old", "1"), at(20)));
  EXPECT_FALSE(made.tell_run(who, run_on("old", "1"), at(21)));
  EXPECT_THAT(made.affected_by("EX-ANGLE-1").unknown, IsEmpty());
  EXPECT_THAT(numbers(made.affected_by("EX-ANGLE-1")), ElementsAre(number));
}

TEST_P(RegisterWithdrawalsTest, RecordsAreListedWhenTheirTimeHasPassedAndNothingIsDeleted) {
  Register made = with_calibrations();
  const std::string number = issue(made, request_for(run_on("a", "1")));
  const LoggedIn admin = login(made, "Admin N. N.");
  EXPECT_THAT(refusal([&] { made.set_retention(admin, "audit", 10, at(5)); }), HasSubstr("without end"));
  EXPECT_THAT(refusal([&] { made.set_retention(admin, "letters", 10, at(5)); }), HasSubstr("one of"));
  EXPECT_THAT(refusal([&] { made.set_retention(admin, "run", 0, at(5)); }), HasSubstr("1 to 100"));
  EXPECT_THAT(refusal([&] { made.set_retention(login(made, "Approver N. N."), "run", 10, at(5)); }),
              HasSubstr("the right to administer"));
  made.set_retention(admin, kCertificateKind, 5, at(5));
  made.set_retention(admin, kCertificateKind, 10, at(6));
  made.set_retention(admin, "run", 2, at(6));
  constexpr int kYear = 366 * 24 * 3600;
  EXPECT_THAT(made.past_retention(at(kYear)), IsEmpty());
  const auto runs = made.past_retention(at(3 * kYear));
  ASSERT_THAT(runs, SizeIs(1));
  EXPECT_EQ(runs[0].name, "/runs/a");
  EXPECT_EQ(runs[0].until, "2028-03-01");
  const auto all = made.past_retention(at(11 * kYear));
  ASSERT_THAT(all, SizeIs(2));
  EXPECT_EQ(all[0].name, number);
  EXPECT_EQ(all[0].until, "2036-03-01");
  EXPECT_EQ(made.certificates().size(), 1U);
  EXPECT_EQ(bad(made), "");
}

// A record of a day that a later year lacks is kept to the last of February, and on that day too.
TEST_P(RegisterWithdrawalsTest, ALeapDayIsFollowedByTheLastOfFebruary) {
  using namespace std::chrono;
  Register made = with_calibrations();
  const LoggedIn admin = login(made, "Admin N. N.");
  made.add_calibration(admin, {"EX-ANGLE-3", "STAGE-1", "Institute", "2026-01-10", "2028-02-29", "", {}},
                       at(4));
  const auto noon = [](year_month_day day) { return Clock::UtcTime(sys_days(day).time_since_epoch() + 12h); };
  const auto kept_until = [&](int years) {
    made.set_retention(admin, kCalibrationKind, years, at(5));
    for (const RetainedRecord& record : made.past_retention(noon(year(2200) / 1 / 1)))
      if (record.name == "EX-ANGLE-3") return record.until;
    return std::string("for ever");
  };
  EXPECT_EQ(kept_until(3), "2031-02-28");
  EXPECT_EQ(kept_until(4), "2032-02-29");
  EXPECT_EQ(kept_until(72), "2100-02-28") << "a century without a leap day";
  made.set_retention(admin, kCalibrationKind, 1, at(5));
  const auto past = [&](year_month_day day) {
    std::vector<std::string> names;
    for (const RetainedRecord& record : made.past_retention(noon(day))) names.push_back(record.name);
    return names;
  };
  EXPECT_THAT(past(2029y / 2 / 28), ElementsAre("EX-ANGLE-1", "EX-ANGLE-2"));
  EXPECT_THAT(past(2029y / 3 / 1), ElementsAre("EX-ANGLE-1", "EX-ANGLE-2", "EX-ANGLE-3"));
}

TEST_P(RegisterWithdrawalsTest, ABackupHasWhatWasWithdrawn) {
  Register made = with_calibrations();
  const std::string number = issue(made, request_for(run_on("a", "1")), "Customer A");
  made.withdraw(login(made, "Approver N. N."), kCertificateKind, number, "why", at(12));
  Register restored = Register::restore(new_location(), made.backup(), at(20));
  EXPECT_EQ(restored.status_of(number)->words(), made.status_of(number)->words());
  EXPECT_EQ(restored.affected_by("STAGE-1").certificates.at(0).addressee->name, "Customer A");
  EXPECT_EQ(bad(restored), "");
}

/// The steps of SQLite's plan for a question.
std::string plan_of(Database& database, const std::string& question) {
  std::string plan;
  for (const auto& row : database.query(4, "explain query plan " + question, {{"name", "EX-ANGLE-1"}}))
    plan += row[3] + "\n";
  return plan;
}

TEST(AffectedQueries, GoByIndicesInARegisterOfTenThousandCertificates) {
  const test::TemporaryFolder folder;
  const std::string location = (folder / "register.db").string();
  Register made = Register::create(
      location, {"Example laboratory", false, "EX-", "Admin N. N.", kPassword, PasswordCost::kForTests},
      at(0));
  Database database(location);
  DatabaseTransaction transaction(database);
  database.execute("insert into equipment values('STAGE-1','Stage','','','118001234','angle','')");
  database.execute(
      "insert into calibration values('EX-ANGLE-1','STAGE-1','I','2026-01-10','2027-01-10','','[]')");
  // Each tenth certificate is of a run on STAGE-1.
  const std::string numbers =
      "with recursive n(i) as (select 1 union all select i + 1 from n where i < 10000) ";
  database.execute(numbers +
                   "insert into known_run select 'r' || i, 'f', 'item', '2026-03-01', 'x', 'u' from n");
  database.execute(numbers +
                   "insert into used_source select 'r' || i || '/a', 'r' || i, 'calibration',"
                   " 'EX-ANGLE-' || (i % 10), 's' || (i % 10), 'angle' from n");
  database.execute(numbers +
                   "insert into certificate select 'EX-' || i, 'issued', 'r' || i, '', 'item', '', '',"
                   " '2026-03-01', '', '', 'u', '' from n");
  transaction.commit();
  EXPECT_THAT(made.affected_by("EX-ANGLE-1").certificates, SizeIs(1000));
  EXPECT_THAT(made.affected_by("STAGE-1").runs, SizeIs(1000));
  for (const std::string& question : {affected_runs(), affected_certificates()}) {
    const std::string plan = plan_of(database, question);
    for (const char* table : {"known_run", "used_source", "certificate", "certified_run", "addressee", "r",
                              "u", "m", "c", "f", "a"})
      EXPECT_THAT(plan, testing::Not(testing::ContainsRegex(std::string("SCAN ") + table + "\n"))) << plan;
    EXPECT_THAT(plan, HasSubstr("used_source_by_name")) << plan;
  }
}

TEST(ArchivedRegister, OfTheStepBeforeIsBroughtToTheNewestAndKnowsItsCertificate) {
  const test::TemporaryFolder folder;
  const std::filesystem::path path = folder / "register.db";
  std::filesystem::copy_file(test::source_folder() / "tests/data/register_step_4/register.db", path);
  {
    Database database(path.string());
    ASSERT_EQ(schema_step(database), 4);
  }
  const Clock::UtcTime later = at(365 * 24 * 3600);
  Register opened = Register::open(path.string(), later);
  {
    Database database(path.string());
    EXPECT_EQ(schema_step(database), kNewestSchemaStep);
  }
  for (const RegisterFinding& finding : opened.verify()) EXPECT_TRUE(finding.good) << finding.found;
  EXPECT_THAT(opened.status_of("T-2026-0001")->words(),
              HasSubstr("TRAINING, certifies nothing; valid, issued on 2026-"));
  EXPECT_THAT(opened.affected_by("EX-ANGLE-0815").unknown, ElementsAre("T-2026-0001"));
  const LoggedIn who =
      opened.who(opened.log_in("Approver N. N.", kPassword, later, std::chrono::hours(1)), later);
  opened.withdraw(who, kCertificateKind, "T-2026-0001", "of a simulated run", later);
  EXPECT_EQ(opened.status_of("T-2026-0001")->word(), "withdrawn");
  for (const RegisterFinding& finding : opened.verify()) EXPECT_TRUE(finding.good) << finding.found;
  // Its backup is restored by way of the older step, too.
  EXPECT_EQ(Register::restore((folder / "again.db").string(), opened.backup(), later)
                .status_of("T-2026-0001")
                ->word(),
            "withdrawn");
}

}  // namespace
}  // namespace abcal::lab
