#include "app/laboratory/register/register.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "app/laboratory/register/password.h"
#include "protocol/record/sha256.h"
#include "tests/app/laboratory/register_fixtures.h"

namespace abcal::lab {
namespace {

using testing::HasSubstr;
using testing::Not;

class RegisterTest : public OnDatabase {};
ABCAL_ON_BOTH_DATABASES(RegisterTest);

NumberRequest request_for(const std::string& run) {
  return {sha256_of(run), "Maker M-3 SN-42", "Operator N. N.", {}, {}};
}

TEST_P(RegisterTest, IsMadeOnceAndOpenedAgain) {
  EXPECT_THAT(refusal([&] { Register::open(location, at(0)); }), HasSubstr("abcal lab init"));
  const std::string identity = Register::create(location, facts(), at(0)).facts().identity;
  Register opened = Register::open(location, at(1));
  EXPECT_EQ(opened.facts().identity, identity);
  EXPECT_EQ(opened.facts().name, "Example laboratory");
  EXPECT_FALSE(opened.facts().training);
  EXPECT_THAT(refusal([&] { Register::create(location, facts(), at(0)); }), HasSubstr("never overwritten"));
  EXPECT_EQ(bad(opened), "");
}

TEST(PasswordTest, TheHashThatStandsForAnUnknownPersonCostsAsMuchAsAPersons) {
  const std::string persons = hash_password(kPassword, PasswordCost::kUsual), nobodys = hash_of_no_password();
  const auto cost = [](const std::string& hash) {
    return hash.substr(0, hash.find('$', hash.find("p=")) + 1);
  };
  EXPECT_EQ(cost(nobodys), cost(persons));
  EXPECT_EQ(nobodys.size(), persons.size());
  EXPECT_NE(nobodys, hash_of_no_password());
  EXPECT_TRUE(is_password(kPassword, persons));
  EXPECT_FALSE(is_password(kPassword, nobodys));
}

TEST_P(RegisterTest, APasswordLetsInForAWhileAndNoOtherDoes) {
  Register made = with_people();
  EXPECT_THAT(refusal([&] { made.log_in("Operator N. N.", "wrong password", at(2), std::chrono::hours(8)); }),
              HasSubstr("refused"));
  EXPECT_THAT(refusal([&] { made.log_in("Nobody", kPassword, at(2), std::chrono::hours(8)); }),
              HasSubstr("refused"));
  const std::string token = made.log_in("Operator N. N.", kPassword, at(2), std::chrono::minutes(10));
  EXPECT_EQ(made.who(token, at(2 + 599)).name(), "Operator N. N.");
  EXPECT_THAT(refusal([&] { made.who(token, at(2 + 600)); }), HasSubstr("log in again"));
  EXPECT_THAT(refusal([&] { made.who("another", at(3)); }), HasSubstr("not known"));
  made.log_out(token, at(4));
  EXPECT_THAT(refusal([&] { made.who(token, at(5)); }), HasSubstr("not known"));
  // The refused attempt with a known name stands in the audit.
  std::size_t refused = 0;
  for (const AuditEntry& entry : made.audit()) refused += entry.what == "login refused" ? 1U : 0U;
  EXPECT_EQ(refused, 1U);
}

TEST_P(RegisterTest, ARightIsNeededForEachChange) {
  Register made = with_people();
  const LoggedIn operator_ = login(made, "Operator N. N.");
  EXPECT_THAT(refusal([&] {
                made.add_person(operator_, {"X", "r", "", {}, {}, {}}, "", at(3));
              }),
              HasSubstr("the right to administer"));
  EXPECT_THAT(refusal([&] {
                made.add_equipment(operator_, {"S", "Stage", "", "", "1", "angle", {}}, at(3));
              }),
              HasSubstr("the right to operate"));
  EXPECT_THAT(refusal([&] { made.reserve_number(operator_, request_for("run"), at(3)); }),
              HasSubstr("the right to approve"));
  made.set_password(operator_, "Operator N. N.", "another password", at(3), PasswordCost::kForTests);
  EXPECT_THAT(refusal([&] { made.set_password(operator_, "Approver N. N.", "another password", at(3)); }),
              HasSubstr("the right to administer"));
}

TEST_P(RegisterTest, ARetiredPersonIsOutAtOnceAndTheLastAdministratorStays) {
  Register made = with_people();
  const LoggedIn admin = login(made, "Admin N. N.");
  const std::string token = made.log_in("Operator N. N.", kPassword, at(2), std::chrono::hours(8));
  EXPECT_THAT(refusal([&] { made.retire_person(admin, "Operator N. N.", "", at(3)); }),
              HasSubstr("no reason"));
  made.retire_person(admin, "Operator N. N.", "left", at(3));
  EXPECT_THAT(refusal([&] { made.who(token, at(4)); }), HasSubstr("not known"));
  EXPECT_THAT(refusal([&] { made.log_in("Operator N. N.", kPassword, at(4), std::chrono::hours(8)); }),
              HasSubstr("refused"));
  EXPECT_THAT(refusal([&] { made.retire_person(admin, "Admin N. N.", "left", at(3)); }),
              HasSubstr("only administrator"));
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterTest, KeepsEquipmentWithItsCalibrations) {
  Register made = with_people();
  const LoggedIn admin = login(made, "Admin N. N.");
  made.add_equipment(admin, {"STAGE-1", "Stage", "Maker", "C-1", "118001234", "angle", {}}, at(3));
  const Calibration good{"EX-ANGLE-1",
                         "STAGE-1",
                         "Institute",
                         "2026-01-10",
                         "2027-01-10",
                         "",
                         {{"step_deg", "deg", 3e-4, 2e-4, 2.0}}};
  made.add_calibration(admin, good, at(4));
  ASSERT_EQ(made.calibrations().size(), 1U);
  EXPECT_EQ(made.calibrations()[0].values.at(0).expanded_uncertainty, 2e-4);
  EXPECT_TRUE(good.holds_on("2026-01-10"));
  EXPECT_TRUE(good.holds_on("2027-01-10"));
  EXPECT_FALSE(good.holds_on("2027-01-11"));
  EXPECT_FALSE(good.holds_on("2026-01-09"));

  Calibration wrong = good;
  wrong.certificate = "EX-ANGLE-2";
  wrong.performed = "2026-03-02";  // Tomorrow.
  EXPECT_THAT(refusal([&] { made.add_calibration(admin, wrong, at(4)); }), HasSubstr("after today"));
  wrong.performed = "2026-02-30";
  wrong.values[0].expanded_uncertainty = 0.0;
  EXPECT_THAT(refusal([&] { made.add_calibration(admin, wrong, at(4)); }),
              testing::AllOf(HasSubstr("2026-02-30"), HasSubstr("U > 0")));
  wrong = good;
  EXPECT_THAT(refusal([&] { made.add_calibration(admin, wrong, at(4)); }),
              HasSubstr("in the register already"));
  wrong.certificate = "EX-ANGLE-3";
  wrong.equipment = "STAGE-2";
  EXPECT_THAT(refusal([&] { made.add_calibration(admin, wrong, at(4)); }),
              HasSubstr("is not in the register"));
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterTest, GivesANumberOnceAndARunOneCertificate) {
  Register made = with_people();
  const LoggedIn approver = login(made, "Approver N. N.");
  EXPECT_EQ(made.reserve_number(approver, request_for("a"), at(3)).number, "EX-2026-0001");
  EXPECT_EQ(made.reserve_number(approver, request_for("a"), at(4)).number,
            "EX-2026-0001");  // Not issued yet: the same again.
  EXPECT_EQ(made.reserve_number(approver, request_for("b"), at(5)).number, "EX-2026-0002");
  made.record_issued(approver, "EX-2026-0001", sha256_of("xml"), "2026-03-01", at(6));
  EXPECT_THAT(refusal([&] { made.reserve_number(approver, request_for("a"), at(7)); }),
              HasSubstr("--replaces EX-2026-0001"));
  EXPECT_THAT(
      refusal([&] { made.record_issued(approver, "EX-2026-0001", sha256_of("xml"), "2026-03-01", at(7)); }),
      HasSubstr("is issued already"));
  NumberRequest amendment = request_for("a");
  amendment.replaces = "EX-2026-0001";
  amendment.reason = "address";
  NumberRequest of_another = request_for("c");
  of_another.replaces = amendment.replaces;
  of_another.reason = amendment.reason;
  of_another.item = "another one";
  EXPECT_THAT(refusal([&] { made.reserve_number(approver, of_another, at(8)); }),
              testing::AllOf(HasSubstr("another item"), HasSubstr("required: one of another one")));
  EXPECT_EQ(made.reserve_number(approver, amendment, at(8)).number, "EX-2026-0003");
  made.record_issued(approver, "EX-2026-0003", sha256_of("new xml"), "2026-03-01", at(9));
  ASSERT_EQ(made.certificates_of(sha256_of("a")).size(), 2U);
  EXPECT_EQ(made.certificates_of(sha256_of("a"))[0].state, "replaced");
  EXPECT_EQ(made.certificates_of(sha256_of("a"))[1].state, "issued");
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterTest, WhoMeasuredCannotApprove) {
  Register made = with_people();
  const LoggedIn approver = login(made, "Approver N. N.");
  NumberRequest own = request_for("a");
  own.measured_by = "Approver N. N.";
  EXPECT_THAT(refusal([&] { made.reserve_number(approver, own, at(3)); }), HasSubstr("another person"));
}

TEST_P(RegisterTest, FindsWhatWasChangedBehindItsBack) {
  Register made = with_people();
  const LoggedIn approver = login(made, "Approver N. N.");
  made.record_issued(approver, made.reserve_number(approver, request_for("a"), at(3)).number,
                     sha256_of("xml"), "2026-03-01", at(4));
  ASSERT_EQ(bad(made), "");
  const std::string kept = made.backup();
  const std::pair<const char*, const char*> changes[] = {
      {"delete from certificate", "certificate/EX-2026-0001 is missing"},
      {"update certificate set approved_by = 'X'", "is not as the audit says"},
      {"update person set rights = 'measure, operate, approve, administer'",
       "person/Operator N. N. is not as"},
      {"update person set password = 'x' where name = 'Operator N. N.'", "person/Operator N. N. is not as"},
      {"update audit set who = 'X' where entry = 2", "audit: entry 2"},
      {"delete from audit where entry = 2", "audit: entry 2 is missing"},
      {"delete from audit where entry = (select max(entry) from audit)", "last entries are missing"},
      {"update counter set last = 0", "0 given, 1 known"},
  };
  for (const auto& [sql, words] : changes) {
    Register copy = Register::restore(new_location(), kept, at(5));
    ASSERT_EQ(bad(copy), "");
    Database(copy.location()).execute(sql);
    EXPECT_THAT(bad(copy), HasSubstr(words)) << sql;
  }
}

TEST_P(RegisterTest, ANumberIsNotGivenTwiceThoughItsRowIsDeletedAndTheCounterSetBack) {
  Register made = with_people();
  const LoggedIn approver = login(made, "Approver N. N.");
  ASSERT_EQ(made.reserve_number(approver, request_for("a"), at(3)).number, "EX-2026-0001");
  Database(location).execute("delete from certificate");
  Database(location).execute("update counter set last = 0");
  EXPECT_THAT(refusal([&] { made.reserve_number(approver, request_for("b"), at(4)); }),
              HasSubstr("was given before"));
  EXPECT_TRUE(made.certificates().empty());  // Nothing was written.
}

TEST_P(RegisterTest, AnIssuedCertificateIsComparedWithTheRun) {
  const CertificateRecord issued{"EX-1", "issued", "run", "hash", "", "", "A", "", "", "", "", ""};
  const auto words = [](const std::vector<RegisterFinding>& findings) {
    std::string text;
    for (const RegisterFinding& finding : findings)
      if (!finding.good) text += finding.what + ": " + finding.found + "\n";
    return text;
  };
  EXPECT_EQ(words(compare_with_run({issued}, {{"EX-1", "hash"}})), "");
  EXPECT_THAT(words(compare_with_run({issued}, {})), HasSubstr("does not have it"));
  EXPECT_THAT(words(compare_with_run({issued}, {{"EX-1", "other"}})), HasSubstr("not what was approved"));
  EXPECT_THAT(words(compare_with_run({}, {{"EX-1", "hash"}})), HasSubstr("did not give this number"));
}

TEST_P(RegisterTest, ABackupIsRestoredOnEitherDatabase) {
  Register made = with_people();
  const LoggedIn approver = login(made, "Approver N. N.");
  (void)made.reserve_number(approver, request_for("a"), at(3));
  const std::string backup = made.backup();
  Register same_kind = Register::restore(new_location(), backup, at(5));
  Register file = Register::restore((folder / "restored.db").string(), backup, at(5));
  for (Register* restored : {&same_kind, &file}) {
    EXPECT_EQ(restored->facts().identity, made.facts().identity);
    EXPECT_EQ(restored->audit().size(), made.audit().size());
    EXPECT_EQ(bad(*restored), "");
    EXPECT_EQ(login(*restored, "Operator N. N.").name(), "Operator N. N.");
    EXPECT_EQ(restored->reserve_number(login(*restored, "Approver N. N."), request_for("b"), at(6)).number,
              "EX-2026-0002");
  }
  EXPECT_THAT(refusal([&] { Register::restore((folder / "x.db").string(), "{}", at(5)); }),
              HasSubstr("is none"));
  std::string damaged = backup;
  damaged.replace(damaged.find("technician"), 10, "Technician");
  EXPECT_THAT(refusal([&] { Register::restore((folder / "y.db").string(), damaged, at(5)); }),
              HasSubstr("not whole"));
}

TEST_P(RegisterTest, ExportsHoldNoSecrets) {
  Register made = with_people();
  (void)login(made, "Operator N. N.");
  for (const std::string& text : {made.export_json(), made.export_csv("person")}) {
    EXPECT_THAT(text, HasSubstr("Operator N. N."));
    EXPECT_THAT(text, Not(HasSubstr("argon2")));
    EXPECT_THAT(text, Not(HasSubstr("token")));
  }
  EXPECT_THAT(refusal([&] { made.export_csv("login"); }), HasSubstr("not exported"));
}

/// A spreadsheet carries out a cell that begins like a formula.
TEST_P(RegisterTest, NoCellOfAnExportIsAFormula) {
  Register made = with_people();
  const LoggedIn admin = login(made, "Admin N. N.");
  const std::vector<std::string> names{"=cmd|' /C calc'!A0", "+1+1", "-1+1", "@SUM(1)", "\t=1", "\r=1"};
  for (const std::string& name : names)
    made.add_equipment(admin, {name, "Stage", "", "", "-12.5", "angle", {}}, at(3));
  const std::string csv = made.export_csv("equipment");
  for (const std::string cell : {"'=cmd|' /C calc'!A0", "'+1+1", "'-1+1", "'@SUM(1)", "'\t=1", "\\u000d=1"})
    EXPECT_THAT(csv, HasSubstr("\n" + cell + ",Stage,")) << cell;
  EXPECT_THAT(csv, HasSubstr(",-12.5,")) << "a number stays one";
}

TEST_P(RegisterTest, AnExportShowsCharactersThatWouldBeObeyed) {
  Register made = with_people();
  const std::string name = "Stage \x1b[31m \u202egolana";
  made.add_equipment(login(made, "Admin N. N."), {name, "Stage", "", "", "1", "angle", {}}, at(3));
  const std::string csv = made.export_csv("equipment"), json = made.export_json();
  for (const std::string& text : {csv, json}) {
    EXPECT_THAT(text, HasSubstr("Stage \\u001b[31m \\u202egolana"));
    EXPECT_THAT(text, AllOf(Not(HasSubstr("\x1b")), Not(HasSubstr("\u202e"))));
  }
  EXPECT_EQ(nlohmann::json::parse(json).at("tables").at("equipment").at(0).at("identity"), name);
}

TEST_P(RegisterTest, ATrainingRegisterNumbersItsCertificatesApart) {
  NewRegister training = facts();
  training.training = true;
  Register made = Register::create(location, training, at(0));
  const LoggedIn admin = login(made, "Admin N. N.");
  EXPECT_TRUE(made.facts().training);
  EXPECT_EQ(made.reserve_number(admin, request_for("a"), at(3)).number, "T-2026-0001");
}

TEST(RegisterFile, OnlyItsOwnerCanReadIt) {
  const test::TemporaryFolder folder;
  const std::string path = (folder / "a \\ b' register.db").string();
  (void)Register::create(path, {"Lab", false, "EX-", "Admin N. N.", kPassword, PasswordCost::kForTests},
                         at(0));
  EXPECT_EQ(std::filesystem::status(path).permissions(),
            std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
}

TEST(RegisterFile, OfANewerProgramIsRefused) {
  const test::TemporaryFolder folder;
  const std::string path = (folder / "register.db").string();
  (void)Register::create(path, {"Lab", false, "EX-", "Admin N. N.", kPassword, PasswordCost::kForTests},
                         at(0));
  Database(path).execute("insert into schema_step(step, utc, program_version) values(99, '', '')");
  EXPECT_THAT(refusal([&] { Register::open(path, at(1)); }), HasSubstr("newer abcal"));
}

TEST(RegisterLocation, ShowsNoPassword) {
  EXPECT_EQ(without_password("postgresql://user:secret@host:5432/lab"), "postgresql://user@host:5432/lab");
  EXPECT_EQ(without_password("postgresql://user@host:5432/lab"), "postgresql://user@host:5432/lab");
  EXPECT_EQ(without_password("/a:b@c/register.db"), "/a:b@c/register.db");
  EXPECT_THAT(refusal([] { Database("postgresql://user:secret@127.0.0.1:1/lab"); }),
              Not(HasSubstr("secret")));
}

TEST(Password, IsHashedWithArgon2idAndItsUsualCost) {
  const std::string hash = hash_password("a password");
  EXPECT_THAT(hash, HasSubstr("$argon2id$v=19$m=65536,t=2,p=1$"));  // 64 MiB, two passes.
  EXPECT_TRUE(is_password("a password", hash));
  EXPECT_FALSE(is_password("A password", hash));
  EXPECT_FALSE(is_password("", ""));
  EXPECT_NE(hash, hash_password("a password"));
}

}  // namespace
}  // namespace abcal::lab
