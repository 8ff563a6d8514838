// A forger with write access to all files, but without the key of the witness: `abcal verify` and `abcal
// issue` refuse each forgery. Version 1.0 accepted all of them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "app/document/document_html.h"
#include "app/laboratory/certificate/certificate_page.h"
#include "app/witness/witness_check.h"
#include "app/witness/witness_log.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_operator.h"
#include "protocol/record/signature.h"
#include "protocol/record/verify_run.h"
#include "tests/app/witness/evidence_fixtures.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using namespace std::chrono_literals;

/// A run whose angles a witness has signed, 10 s apart, and a register that holds its key.
class ForgeryTest : public EvidenceTest {
 protected:
  static void SetUpTestSuite() {
    EvidenceTest::SetUpTestSuite();
    register_folder_ = new test::TemporaryFolder;
    register_ = new test::TrainingRegister(register_folder_->path());
    register_->lab({"key", "bench 1", "-o", "bench.pem"});
  }
  static void TearDownTestSuite() {
    delete register_;
    delete register_folder_;
    EvidenceTest::TearDownTestSuite();
  }

  void SetUp() override {
    EvidenceTest::SetUp();
    own_ = std::make_unique<test::TrainingRegister>(*register_, folder.path());
    test::write_file(folder / "lab.toml", example_laboratory());
    key_ = test::read_file(*register_folder_ / "bench.pem");
  }

  /// The statements that the witness signs for the run as it is stored now.
  std::vector<WitnessedLine> witnessed(Clock::Duration between = 10s) {
    Clock::Duration passed{0};
    WitnessLog log(folder / "witness.db", key_, [&] {
      passed += between;
      return WitnessMoment{Clock::UtcTime(std::chrono::sys_days{std::chrono::year{2026} / 3 / 1}) + passed,
                           "boot", passed};
    });
    const RunLinks links = run_links(path);
    std::vector<WitnessedLine> lines;
    WitnessRequest request;
    request.run = request.head = links.head;
    request.bench = "bench 1";
    request.person = person_;
    lines.push_back(log.answer(request, 0));
    request = {};
    request.run = links.head;
    request.what = WitnessAct::kLink;
    request.now = links.head;
    for (const StoredTogether& stored : links.stored) {
      ++request.k;
      request.previous = request.now;
      request.now = stored.link;
      lines.push_back(log.answer(request, 0));
    }
    request.what = WitnessAct::kClose;
    request.previous.clear();
    request.events = links.closing;
    lines.push_back(log.answer(request, 0));
    return lines;
  }

  /// Replaces the statements of the witness in the run, and makes its hash in the results again.
  void store(const std::vector<WitnessedLine>& lines) const {
    change("delete from witness");
    {
      SqliteDatabase run(path, SqliteDatabase::Mode::kReadWrite);
      Transaction transaction(run);
      for (const WitnessedLine& line : lines)
        run.prepare("insert into witness(line, signature) values(?, ?)")
            .bind(1, std::string_view(line.line))
            .bind_blob(2, line.signature)
            .run();
      transaction.commit();
    }
    hash_again();
  }
  void hash_again() const {
    SqliteDatabase(results(), SqliteDatabase::Mode::kReadWrite)
        .prepare("update run set sha256 = :hash")
        .set("hash", std::string_view(sha256_of_file(path)))
        .run();
  }

  test::ProgramResult verify(std::vector<std::string> more = {}) const {
    more.insert(more.begin(), {"verify", path.filename().string()});
    return test::run_program(more, folder.path());
  }
  test::ProgramResult issue(std::vector<std::string> more = {}) const {
    more.insert(more.begin(), {"issue", path.filename().string(), "--laboratory", "lab.toml"});
    return test::run_program(more, folder.path());
  }
  void expect_refused(const std::string& why) const {
    const auto verified = verify();
    EXPECT_EQ(verified.exit_code, 1);
    EXPECT_THAT(verified.out, HasSubstr(why));
    const auto issued = issue();
    EXPECT_NE(issued.exit_code, 0) << issued.out;
    EXPECT_THAT(issued.err, HasSubstr(why));
  }

  static test::TemporaryFolder* register_folder_;
  static test::TrainingRegister* register_;
  std::unique_ptr<test::TrainingRegister> own_;
  std::string key_, person_ = "Operator N. N.";
};
test::TemporaryFolder* ForgeryTest::register_folder_ = nullptr;
test::TrainingRegister* ForgeryTest::register_ = nullptr;

TEST_F(ForgeryTest, ARunWhoseAnglesWereWitnessedIsVerifiedAndCertified) {
  store(witnessed());
  const auto verified = verify({"--require", "witnessed"});
  EXPECT_EQ(verified.exit_code, 0) << verified.out;
  EXPECT_THAT(verified.out, HasSubstr("angles witnessed by the key of bench 1"));
  const auto issued = issue({"--dcc", "a.xml"});
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  EXPECT_THAT(test::read_file(folder / "a.xml"),
              HasSubstr("was signed by the witness with the key of bench 1 when it was measured"));
}

TEST_F(ForgeryTest, AStrippedRunIsRefused) {
  store({});
  expect_refused("not witnessed");
  const auto signed_only = verify({"--require", "signed"});
  EXPECT_EQ(signed_only.exit_code, 1);
}

TEST_F(ForgeryTest, StatementsOfAnotherRunAreRefused) {
  const std::vector<WitnessedLine> of_original = witnessed();
  forge("update meta set value = 'SN-43' where key = 'label.item.serial_number'");
  store(of_original);
  expect_refused("is about another run");
}

TEST_F(ForgeryTest, AReadingThatWasChangedAfterwardsIsRefused) {
  const std::vector<WitnessedLine> of_original = witnessed();
  store(of_original);
  forge(kLargerU);
  hash_again();
  expect_refused("angle 1 is not the one that was signed");
}

TEST_F(ForgeryTest, AConditionOrEventThatWasChangedAfterwardsIsRefused) {
  store(witnessed());
  change("update environment set temperature_degc = 20.0 where moment = 'end'");
  hash_again();
  expect_refused("are not those for which the end of the run was signed");
}

TEST_F(ForgeryTest, ARunThatSomebodyElseBeganIsRefused) {
  person_ = "Somebody Else";
  store(witnessed());
  expect_refused("the run was begun by Somebody Else, who is not among its operators");
}

/// Anybody can make a register that has the name of another.
TEST_F(ForgeryTest, AnOperatorWhoWasNotLoggedInToThisRegisterIsRefused) {
  std::string identity;
  {
    test::write_file(folder / "own.toml", certificate_bench());
    own_->log_in("Operator N. N.");
    ASSERT_EQ(test::run_program({"run", "own.toml", "-o", "own.run"}, folder.path()).exit_code, 0);
    own_->log_in("Approver N. N.");
    identity = operators_of(RunFile::load(folder / "own.run")).front().register_identity;
  }
  ASSERT_NE(identity, "");
  EXPECT_THAT(test::run_program({"verify", "own.run"}, folder.path()).out,
              HasSubstr("Operator N. N. was logged in to this register, which was told of the run"));
  forge("update event set kind = 'operator logged in', text = 'Operator N. N., register " + identity +
        "' where kind = 'operator stated'");
  store(witnessed());
  expect_refused("logged in to this register, which does not know the run");
  forge("insert into meta values('label.laboratory.calibrations', '[{\"certificate\": \"EX-1\"}]')");
  store(witnessed());
  EXPECT_THAT(verify().out, HasSubstr("the run states EX-1, which the register does not have so"));
}

/// Whoever approves does not choose to do without the witness that has signed the register before.
TEST_F(ForgeryTest, ARegisterThatHasAWitnessIsNotWrittenWithoutIt) {
  store(witnessed());
  ::setenv("ABCAL_SIGNING_KEY", (*register_folder_ / "bench.pem").c_str(), 1);
  const auto issued = issue();
  ::unsetenv("ABCAL_SIGNING_KEY");
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  const std::vector<std::string> again{
      "--replaces", test::number_of(issued.out), "--reason", "why", "--amendment", "technical"};
  ::setenv("ABCAL_WITNESS", "none", 1);
  const auto silenced = issue(again);
  ::unsetenv("ABCAL_WITNESS");
  EXPECT_NE(silenced.exit_code, 0) << silenced.out;
  EXPECT_THAT(silenced.err,
              HasSubstr("ABCAL_WITNESS=none: found a register whose state a witness has signed"));
  // A computer without a witness writes, and says what is not signed.
  const auto elsewhere = issue(again);
  EXPECT_EQ(elsewhere.exit_code, 0) << elsewhere.err;
  EXPECT_THAT(elsewhere.err, HasSubstr("is not witnessed"));
}

TEST_F(ForgeryTest, AKeyOfTheForgersOwnIsRefused) {
  key_ = make_private_key();
  store(witnessed());
  expect_refused("was not signed by a trusted key");
}

TEST_F(ForgeryTest, ARunThatWasWitnessedWithinSecondsIsRefused) {
  store(witnessed(1ms));
  expect_refused("witnessed sooner than their readings can have taken");
}

TEST_F(ForgeryTest, AMissingOrRepeatedOrExchangedStatementIsRefused) {
  const std::vector<WitnessedLine> all = witnessed();
  std::vector<WitnessedLine> changed = all;
  changed.erase(changed.begin() + 5);
  store(changed);
  expect_refused("angle 6 does not follow on the one that was signed before it");
  changed = all;
  std::swap(changed[5], changed[6]);
  store(changed);
  expect_refused("has the counter");
  changed = all;
  changed.pop_back();
  store(changed);
  expect_refused("the end is not witnessed");
}

TEST_F(ForgeryTest, ReplacedResultsAreRefused) {
  store(witnessed());
  SqliteDatabase kept(results(), SqliteDatabase::Mode::kReadWrite);
  std::string json = *kept.value("select result_json from analysis limit 1");
  const std::size_t at = json.find_first_of("123456789", json.find("sensitivity"));
  json[at] = json[at] == '9' ? '8' : '9';
  SqliteStatement first =
      kept.prepare("select id, utc, program_version, estimator from analysis order by id limit 1");
  ASSERT_TRUE(first.step());
  const std::string link =
      next_link("", {first.text("utc"), first.text("program_version"), first.text("estimator"), json});
  kept.execute(fmt::format("delete from analysis where id <> {}", first.integer("id")));
  first.reset();
  kept.prepare("update analysis set result_json = :json, chain = :chain")
      .set("json", json)
      .set("chain", link)
      .run();
  const auto verified = verify();
  EXPECT_EQ(verified.exit_code, 1) << verified.out;
  EXPECT_NE(issue().exit_code, 0);
}

TEST_F(ForgeryTest, ADryRunThatIsMadeToLookRealIsRefused) {
  // A dry run of the forger's, with the bench's own witness: it has signed that the time is simulated.
  test::write_file(folder / "dry.toml", certificate_bench());
  ::setenv("ABCAL_SIGNING_KEY", (*register_folder_ / "bench.pem").c_str(), 1);
  test::TrainingRegister::leave();
  const auto made = test::run_program({"run", "dry.toml", "-o", "dry.run"}, folder.path());
  ::unsetenv("ABCAL_SIGNING_KEY");
  own_->use();
  ASSERT_EQ(made.exit_code, 0) << made.err;
  path = folder / "dry.run";
  EXPECT_EQ(verify({"--require", "signed"}).exit_code, 0) << "as what it is";
  EXPECT_EQ(verify({"--require", "witnessed"}).exit_code, 1);
  const std::vector<WitnessedLine> simulated = RunFile::witnessed(path);
  ASSERT_EQ(simulated.size(), 2U);
  forge(
      "update meta set value = replace(value, char(39) || 'simulated' || char(39), char(39) || "
      "'/dev/ttyUSB0' || "
      "char(39)) where key = 'bench_toml'");
  hash_again();
  // A forger's laboratory file agrees with the simulated clock.
  test::write_file(folder / "lab.toml",
                   replaced(example_laboratory(), "received = 2026-01-05", "received = 1999-12-31"));
  expect_refused("is about another run");
  store({});
  expect_refused("not witnessed");
}

TEST_F(ForgeryTest, AStatementOfTheApproverCertifiesARunThatWasNotWitnessed) {
  store({});
  const auto issued = issue(
      {"--dcc", "a.xml", "--not-witnessed", "A run of version 1.0, whose bench stood in our laboratory"});
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  EXPECT_THAT(
      test::read_file(folder / "a.xml"),
      HasSubstr("The run was not witnessed. Statement of the person who approved: A run of version 1.0"));
  EXPECT_THAT(document_html(certificate_page(test::read_file(folder / "a.xml"))),
              HasSubstr("The run was not witnessed. Statement of the person who approved"));
  // The register names the SHA-256 of the run: from now on nobody can change it.
  EXPECT_EQ(verify().exit_code, 0) << verify().out;
}

/// An interrupted run that a forger edits before it is resumed.
class EditedWhileInterruptedTest : public ForgeryTest {
 protected:
  void SetUp() override {
    ForgeryTest::SetUp();
    lines_ = witnessed();
    change("update meta set value = 'interrupted' where key = 'state'; delete from seal");
    std::filesystem::remove(results());
  }
  std::string resumed() const {
    const auto result = test::run_program({"resume", path.filename().string()}, folder.path());
    EXPECT_NE(result.exit_code, 0) << result.out;
    return result.err;
  }
  std::vector<WitnessedLine> lines_;
};

TEST_F(EditedWhileInterruptedTest, AMeanThatDoesNotFollowFromItsReadingsIsRefusedWithItsAngle) {
  change("update dwell set r_u = r_u * 1.0005 where id = 5");
  EXPECT_THAT(resumed(), AllOf(HasSubstr("dwell 5 (experiment 1, n = 5)"), HasSubstr("It is not continued")));
}

TEST_F(EditedWhileInterruptedTest, ACompleteRunIsNotClosedForAForger) {
  change(
      "update dwell set r_u = r_u * 1.0005 where id = 5; update meta set value = 'complete' where key = "
      "'state'; pragma journal_mode=wal");
  EXPECT_THAT(resumed(), HasSubstr("dwell 5 (experiment 1, n = 5)"));
}

/// Everything that stands before an angle is signed with it: nobody can give the run another operator, other
/// conditions or other events before it is closed.
TEST_F(EditedWhileInterruptedTest, ARebuiltChainContradictsTheWitness) {
  {
    SqliteDatabase run(path, SqliteDatabase::Mode::kReadWrite);
    for (const WitnessedLine& line : lines_)
      run.prepare("insert into witness(line, signature) values(?, ?)")
          .bind(1, std::string_view(line.line))
          .bind_blob(2, line.signature)
          .run();
  }
  for (const char* sql :
       {"update event set who = 'Somebody Else'", "update event set text = 'x' where id = 1",
        "update environment set temperature_degc = 20.0 where id = 1", kLargerU}) {
    const std::filesystem::path kept = folder / "kept";
    std::filesystem::copy_file(path, kept, std::filesystem::copy_options::overwrite_existing);
    rebuild_chain(sql);
    EXPECT_THAT(resumed(), AllOf(HasSubstr("the file is not what was witnessed"), HasSubstr("angle 1 ")))
        << sql;
    std::filesystem::rename(kept, path);
  }
}

}  // namespace
}  // namespace abcal
