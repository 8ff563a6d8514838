// Run files of version 2 stay readable: tests/data/version_2 has files of abcal 0.1.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "protocol/record/run_file.h"
#include "protocol/record/run_schema.h"
#include "protocol/record/sha256.h"
#include "protocol/record/verify_run.h"
#include "tests/support/project_paths.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::HasSubstr;

class Version2Test : public testing::Test {
 protected:
  /// A copy, closed as the file was.
  std::filesystem::path copy(const std::string& name, bool closed = true) {
    using std::filesystem::perms;
    const std::filesystem::path from = test::source_folder() / "tests/data/version_2" / name;
    const std::filesystem::path to = folder / name;
    std::filesystem::copy_file(from, to);
    std::filesystem::permissions(to, closed ? perms::owner_read : perms::owner_read | perms::owner_write);
    const std::filesystem::path results = ResultsFile::path_beside(from);
    if (std::filesystem::exists(results)) {
      std::filesystem::copy_file(results, ResultsFile::path_beside(to));
      std::filesystem::permissions(ResultsFile::path_beside(to), perms::owner_read | perms::owner_write);
    }
    return to;
  }

  test::TemporaryFolder folder;
};

TEST_F(Version2Test, ACompleteRunIsReadAndVerifiedAsItIs) {
  for (const auto& [name, dwells, readings] : {std::tuple{"complete.run", 39U, 39U * 20U},
                                               {"resumed.run", 39U, 40U * 20U},
                                               {"recorded.run", 21U, 21U * 12U}}) {
    SCOPED_TRACE(name);
    const std::filesystem::path path = copy(name);
    const std::string before = sha256_of_file(path);
    const StoredRun run = RunFile::load(path);
    EXPECT_EQ(run.state, RunState::kComplete);
    EXPECT_EQ(run.record.dwells.size(), dwells);
    EXPECT_TRUE(run.sessions.empty());
    ASSERT_EQ(run.header.items.size(), 1U);
    EXPECT_EQ(run.header.items[0].serial_number, "6284.123456");
    std::size_t found = 0;
    RunFile::read_dwells(path, [&](const StoredDwell& dwell) { found += dwell.readings.size(); });
    EXPECT_EQ(found, readings);
    for (const IntegrityCheck& check : verify_run(path)) EXPECT_TRUE(check.good) << check.what << check.found;
    EXPECT_THAT(attested_by(path), HasSubstr("version 2"));
    EXPECT_EQ(sha256_of_file(path), before) << "reading a run must not change it";
  }
}

TEST_F(Version2Test, ThePauseIsNotInItsTimesAndItsCheckDoesNotCount) {
  const StoredRun run = RunFile::load(copy("resumed.run"));
  // The last angle before the interruption and the first after it, 24 s later by the clock on the wall.
  EXPECT_DOUBLE_EQ(*run.record.dwells.at(15).time_s, 12.92369307);
  EXPECT_DOUBLE_EQ(*run.record.dwells.at(16).time_s, 17.223635742);
  EXPECT_EQ(run.record.continuations, 1);
  int repeats = 0;
  RunFile::read_dwells(folder / "resumed.run",
                       [&](const StoredDwell& dwell) { repeats += dwell.repeat ? 1 : 0; });
  EXPECT_EQ(repeats, 1);
}

TEST_F(Version2Test, ItsTranscriptIsRead) {
  EXPECT_EQ(RunFile::load_transcript(copy("recorded.run"))->rows.size(), 2669U);
  EXPECT_EQ(RunFile::load_transcript(copy("complete.run")), std::nullopt);
}

TEST_F(Version2Test, AChangedReadingContradictsItsDwell) {
  const std::filesystem::path path = copy("complete.run", false);
  SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite)
      .execute("update reading set u = u + 1e-7 where dwell = 5 and k = 3");
  for (const IntegrityCheck& check : verify_run(path)) {
    if (check.what == "readings") {
      EXPECT_THAT(check.found, HasSubstr("dwell 5 (experiment 1, n = 5): its mean"));
    }
    EXPECT_EQ(check.good, check.what != "readings" && check.what != "SHA-256") << check.what;
  }
}

TEST_F(Version2Test, AnInterruptedRunGoesOnAsVersion3WithEveryNumberKept) {
  const std::filesystem::path path = copy("interrupted.run", false);
  const StoredRun before = RunFile::load(path);
  std::vector<StoredDwell> readings_before;
  RunFile::read_dwells(path, [&](const StoredDwell& dwell) { readings_before.push_back(dwell); });
  { RunFile::open_for_append(path); }
  const StoredRun after = RunFile::load(path);
  {
    SqliteDatabase database(path, SqliteDatabase::Mode::kReadOnly);
    EXPECT_EQ(run_file_version(database), 5);
    EXPECT_EQ(database.value("select value from meta where key = 'schema'"), "abcal.run/3");
    EXPECT_EQ(database.value("select count(*) from sqlite_master where name like '%_2'"), "0");
    EXPECT_EQ(database.value("select group_concat(distinct role) from dwell"), "plan");
  }
  ASSERT_EQ(after.record.dwells.size(), before.record.dwells.size());
  for (std::size_t k = 0; k < after.record.dwells.size(); ++k) {
    EXPECT_EQ(after.record.dwells[k].mean, before.record.dwells[k].mean);
    EXPECT_EQ(after.record.dwells[k].u_mean, before.record.dwells[k].u_mean);
    EXPECT_EQ(after.record.dwells[k].time_s, before.record.dwells[k].time_s);
    EXPECT_EQ(after.record.dwells[k].encoder_x->deg(), before.record.dwells[k].encoder_x->deg());
  }
  std::size_t dwell = 0;
  RunFile::read_dwells(path, [&](const StoredDwell& now) {
    const StoredDwell& then = readings_before.at(dwell++);
    ASSERT_EQ(now.readings.size(), then.readings.size());
    for (std::size_t k = 0; k < now.readings.size(); ++k) {
      EXPECT_EQ(now.readings[k].output, then.readings[k].output);
      EXPECT_EQ(now.readings[k].sequence, then.readings[k].sequence);
      EXPECT_NEAR(now.readings[k].time_s, then.readings[k].time_s, 1e-9);
      EXPECT_EQ(now.readings[k].temperature_degc, then.readings[k].temperature_degc);
    }
  });
  EXPECT_EQ(dwell, readings_before.size());
  for (const IntegrityCheck& check : verify_run(path)) {
    EXPECT_EQ(check.good, check.what != "state") << check.what << ": " << check.found;
  }
  // It goes on: new angles belong to the session that begins now.
  RunFile file = RunFile::open_for_append(path);
  file.begin_session({});
  EXPECT_EQ(RunFile::load(path).sessions.size(), 2U);
}

TEST_F(Version2Test, ASecondUpgradeAndAnUnknownVersionChangeNothing) {
  const std::filesystem::path path = copy("interrupted.run", false);
  { RunFile::open_for_append(path); }
  const std::string hash = sha256_of_file(path);
  { RunFile::open_for_append(path); }
  EXPECT_EQ(sha256_of_file(path), hash);
  { SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite).execute("pragma user_version = 1"); }
  EXPECT_THROW(RunFile::open_for_append(path), RunFileError);
}

}  // namespace
}  // namespace abcal
