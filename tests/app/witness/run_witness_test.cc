// A run file whose angles are witnessed while they are stored, with a real witness behind a socket.
#include "app/measure/session/run_witness.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "app/witness/witness_check.h"
#include "protocol/record/signature.h"
#include "protocol/record/verify_run.h"
#include "tests/app/witness/evidence_fixtures.h"
#include "tests/app/witness/witness_fixtures.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

class RunWitnessTest : public EvidenceTest {
 protected:
  void SetUp() override {
    EvidenceTest::SetUp();
    stored_ = RunFile::load(path);
    change(
        "update meta set value = 'interrupted' where key = 'state'; delete from seal; delete from reading; "
        "delete from dwell");
    std::filesystem::remove(results());
    served_ = std::make_unique<ServedWitness>(
        std::make_unique<WitnessLog>(folder / "witness.db", key_,
                                     [this] {
                                       now_.since_boot += std::chrono::hours(1);
                                       now_.utc += std::chrono::hours(1);
                                       return now_;
                                     }),
        folder / "socket");
  }

  std::unique_ptr<RunWitness> witness(bool answers = true) {
    auto client =
        answers ? std::make_unique<WitnessClient>(folder / "socket", WitnessClient::Limits{}) : nullptr;
    return std::make_unique<RunWitness>(std::move(client),
                                        [this](const std::string& text) { warnings_.push_back(text); });
  }
  /// Measures angles of the plan, from `first` on.
  void append(RunFile& file, std::size_t first, std::size_t count) const {
    for (std::size_t i = first; i < first + count; ++i)
      file.append_dwell(stored_.measured[i], stored_.dwells[i], {}, {});
  }
  WitnessCheck check() const { return check_witness(path, {{{"bench 1", public_key_of(key_)}}, {}}); }

  StoredRun stored_;
  const std::string key_ = make_private_key();
  WitnessMoment now_{.utc = Clock::UtcTime(std::chrono::sys_days{std::chrono::year{2026} / 3 / 1}),
                     .boot_id = "boot",
                     .since_boot = std::chrono::seconds(0)};
  std::unique_ptr<ServedWitness> served_;
  std::vector<std::string> warnings_;
};

TEST_F(RunWitnessTest, EachAngleAndTheEndAreSignedAndStored) {
  {
    RunFile file = RunFile::open_for_append(path);
    const auto run = witness();
    run->begin(file, "bench 1", "Operator N. N.", false);
    append(file, 0, 4);
    run->await_angles();
    file.complete("2026-03-01T12:00:00.000Z", {});
    run->end(file);
  }
  const WitnessCheck found = check();
  EXPECT_TRUE(found.is_witnessed) << found.words;
  EXPECT_THAT(found.words, HasSubstr("4 of 4 angles witnessed by the key of bench 1"));
  EXPECT_THAT(warnings_, IsEmpty());
}

TEST_F(RunWitnessTest, SignaturesThatAKilledProgramHadNotStoredAreFetched) {
  {
    RunFile file = RunFile::open_for_append(path);
    const auto killed = witness();
    killed->begin(file, "bench 1", "Operator N. N.", false);
    append(file, 0, 3);
    killed->await_angles();  // Signed; the program dies before it stores the last one.
  }
  const std::size_t stored = RunFile::witnessed(path).size();
  EXPECT_LT(stored, 4U);
  {
    RunFile file = RunFile::open_for_append(path);
    const auto run = witness();
    run->begin(file, "bench 1", "Operator N. N.", false);
    EXPECT_EQ(RunFile::witnessed(path).size(), 4U) << "the beginning and three angles; no second beginning";
    append(file, 3, 2);
    run->await_angles();
    file.complete("2026-03-01T12:00:00.000Z", {});
  }
  // This program was killed, too: before the end was witnessed.
  EXPECT_FALSE(check().is_witnessed);
  {
    RunFile file = RunFile::open_to_close(path);
    witness()->finish(file);
  }
  EXPECT_TRUE(check().is_witnessed) << check().words;
}

TEST_F(RunWitnessTest, AnglesWithoutAWitnessStaySoAndAreNamed) {
  {
    RunFile file = RunFile::open_for_append(path);
    const auto run = witness();
    run->begin(file, "bench 1", "Operator N. N.", false);
    append(file, 0, 2);
    run->await_angles();
    file.set_state(RunState::kInterrupted, "2026-03-01T12:00:00.000Z", Message("test"));
  }
  {
    RunFile file = RunFile::open_for_append(path);
    witness(false)->begin(file, "bench 1", "Operator N. N.", false);
    EXPECT_THAT(warnings_, testing::ElementsAre(HasSubstr("its next angles are not witnessed")));
    append(file, 2, 1);
  }
  {
    RunFile file = RunFile::open_for_append(path);
    const auto run = witness();
    run->begin(file, "bench 1", "Operator N. N.", false);
    append(file, 3, 1);
    run->await_angles();
    file.complete("2026-03-01T12:00:00.000Z", {});
    run->end(file);
  }
  const WitnessCheck found = check();
  EXPECT_FALSE(found.is_witnessed);
  EXPECT_TRUE(found.is_signed);
  EXPECT_THAT(found.words, HasSubstr("3 of 4 angles witnessed"));
  EXPECT_THAT(found.words, HasSubstr("not witnessed: 3 (experiment"));
}

TEST_F(RunWitnessTest, ARunWithSimulatedTimeHasABeginningAndAnEndOnly) {
  {
    RunFile file = RunFile::open_for_append(path);
    const auto run = witness();
    run->begin(file, "bench 1", "Operator N. N.", true);
    append(file, 0, 4);
    run->await_angles();
    file.complete("2026-03-01T12:00:00.000Z", {});
    run->end(file);
  }
  EXPECT_EQ(RunFile::witnessed(path).size(), 2U);
  EXPECT_TRUE(check().is_signed);
  EXPECT_FALSE(check().is_witnessed);
}

// Runs that were measured before links covered everything stay what they are.
TEST(RunsOfVersion5Test, AreAsTheyWereStoredAndWitnessed) {
  const test::TemporaryFolder folder;
  const std::filesystem::path data = test::source_folder() / "tests/data/version_5";
  const Trust trust{{{"bench 1", test::read_file(data / "witness.pem")}}, {}};
  for (const char* name : {"two_faces.run", "constant_rate.run", "interrupted.run"}) {
    std::filesystem::copy_file(data / name, folder / name);
    EXPECT_NO_THROW(read_as_stored(folder / name)) << name;
    for (const IntegrityCheck& check : check_witness(folder / name, trust).checks)
      EXPECT_TRUE(check.good) << name << ": " << check.found;
  }
  const WitnessCheck found = check_witness(folder / "constant_rate.run", trust);
  EXPECT_TRUE(found.is_witnessed) << found.words;
  EXPECT_THAT(found.words, HasSubstr("48 of 48 angles witnessed by the key of bench 1"));
  // The one that was killed goes on with the links of its version.
  { RunFile::open_for_append(folder / "interrupted.run").append_event("t", "note", Message("a")); }
  SqliteDatabase run(folder / "interrupted.run", SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(run.value("pragma user_version"), "5");
  EXPECT_NO_THROW(require_unchanged(folder / "interrupted.run"));
}

}  // namespace
}  // namespace abcal
