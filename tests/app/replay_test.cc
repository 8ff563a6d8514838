// abcal run --record and abcal replay as their users call them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pty.h>

#include <array>
#include <nlohmann/json.hpp>

#include "protocol/record/run_file.h"
#include "tests/app/program_fixtures.h"
#include "tests/support/program.h"

namespace abcal {
namespace {

using test::Program;
using test::ProgramResult;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::json;
using namespace std::chrono_literals;

void expect_same_dwells(const StoredRun& a, const StoredRun& b) {
  EXPECT_EQ(a.measured, b.measured);
  ASSERT_EQ(a.record.dwells.size(), b.record.dwells.size());
  for (std::size_t k = 0; k < a.record.dwells.size(); ++k) {
    const DwellRecord& x = a.record.dwells[k];
    const DwellRecord& y = b.record.dwells[k];
    EXPECT_EQ(x.mean, y.mean) << k;
    EXPECT_EQ(x.spread, y.spread) << k;
    EXPECT_EQ(x.count, y.count) << k;
    EXPECT_EQ(x.lost, y.lost) << k;
    EXPECT_EQ(x.encoder_x, y.encoder_x) << k;
    EXPECT_EQ(x.encoder_z, y.encoder_z) << k;
    EXPECT_EQ(x.flags, y.flags) << k;
  }
}

/// The message with which the program ended.
std::string last_words(const std::string& err) {
  const std::size_t begin = err.rfind("abcal: ");
  return begin == std::string::npos ? "" : err.substr(begin);
}

std::string all_rows(const std::filesystem::path& run, const std::string& table) {
  SqliteDatabase database(run, SqliteDatabase::Mode::kReadOnly);
  const std::string columns = table == "dwell" ? "id||'|'||time_s||'|'||settle_s||'|'||r_u||'|'||u_w"
                                               : "dwell||'|'||k||'|'||sequence||'|'||time_s||'|'||u||'|'||w";
  SqliteStatement rows =
      database.prepare("select " + columns + " from " + (table == "dwell" ? "dwell" : "timed_reading"));
  std::string all;
  while (rows.step()) all += rows.text(0) + "\n";
  return all;
}

TEST_F(ProgramTest, AReplayOfADryRunGivesExactlyItsAngles) {
  write_bench({});
  const ProgramResult run = abcal({"run", "bench.toml", "--record", "-o", "a.run", "--json"});
  ASSERT_EQ(run.exit_code, 0) << run.err;
  const ProgramResult replay = abcal({"replay", "a.run", "--json"});
  ASSERT_EQ(replay.exit_code, 0) << replay.err;
  EXPECT_THAT(replay.err, HasSubstr("Replay: 39 of 39 angles are exactly as recorded; it ended as the "
                                    "recorded run did"));
  const StoredRun recorded = RunFile::load(folder / "a.run");
  const StoredRun replayed = RunFile::load(folder / "a-replay.run");
  EXPECT_EQ(recorded.record.dwells.size(), 39U);
  expect_same_dwells(recorded, replayed);
  // The time too, to the nanosecond, of each reading.
  for (const char* table : {"dwell", "reading"}) {
    EXPECT_EQ(all_rows(folder / "a.run", table), all_rows(folder / "a-replay.run", table));
  }
  EXPECT_GT(all_rows(folder / "a.run", "reading").size(), 39U * 10U * 10U);
  EXPECT_EQ(replayed.header.created_utc, recorded.header.created_utc);
  EXPECT_EQ(replayed.header.labels.at("replay.of"), "a.run");
  EXPECT_EQ(Json::parse(run.out)["sensitivity_matrix"], Json::parse(replay.out)["sensitivity_matrix"]);
}

TEST_F(ProgramTest, RecordingChangesNothingOfARun) {
  write_bench({});
  ASSERT_EQ(abcal({"run", "bench.toml", "--record", "-o", "a.run"}).exit_code, 0);
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "b.run"}).exit_code, 0);
  expect_same_dwells(RunFile::load(folder / "a.run"), RunFile::load(folder / "b.run"));
  EXPECT_EQ(all_rows(folder / "a.run", "reading"), all_rows(folder / "b.run", "reading"));
}

TEST_F(ProgramTest, AReplayNeverOverwritesAndNeedsARecording) {
  write_bench({});
  ASSERT_EQ(abcal({"run", "bench.toml", "--record", "-o", "a.run"}).exit_code, 0);
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "plain.run"}).exit_code, 0);
  ASSERT_EQ(abcal({"replay", "a.run"}).exit_code, 0);
  ASSERT_EQ(abcal({"replay", "a.run"}).exit_code, 0);
  EXPECT_TRUE(std::filesystem::exists(folder / "a-replay-2.run"));
  const ProgramResult onto_itself = abcal({"replay", "a.run", "-o", "a.run"});
  EXPECT_EQ(onto_itself.exit_code, 1);
  EXPECT_THAT(onto_itself.err, HasSubstr("never overwritten"));
  const ProgramResult plain = abcal({"replay", "plain.run"});
  EXPECT_EQ(plain.exit_code, 1);
  EXPECT_THAT(plain.err, AllOf(HasSubstr("plain.run"), HasSubstr("without a recording"),
                               HasSubstr("abcal run BENCH --record")));
  EXPECT_FALSE(std::filesystem::exists(folder / "plain-replay.run"));
  const ProgramResult twice = abcal({"replay", "a-replay.run"});
  EXPECT_EQ(twice.exit_code, 1);
  EXPECT_THAT(twice.err, HasSubstr("without a recording"));
}

TEST_F(ProgramTest, ABenchWithoutBytesCannotBeRecorded) {
  test::write_file(folder / "bench.toml",
                   "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"simulated\"\nport = \"simulated\"\n"
                   "[accelerometer]\ndriver = \"simulated\"\nport = \"simulated\"\nrate_hz = 200.0\n");
  const ProgramResult result = abcal({"run", "bench.toml", "--record", "-o", "a.run"});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, AllOf(HasSubstr("--record"), HasSubstr("no")));
  EXPECT_FALSE(std::filesystem::exists(folder / "a.run"));
}

TEST_F(ProgramTest, AReplayThatLeavesItsRecordingSaysWhere) {
  write_bench({});
  ASSERT_EQ(abcal({"run", "bench.toml", "--record", "-o", "a.run"}).exit_code, 0);
  std::filesystem::permissions(folder / "a.run", std::filesystem::perms::owner_all);
  {  // Changes the recording as if the driver had asked for another angle.
    SqliteDatabase database(folder / "a.run", SqliteDatabase::Mode::kReadWrite);
    database.execute(
        "update wire set bytes = cast(replace(cast(bytes as text), 'MOV 1 90', 'MOV 1 91') as blob) "
        "where role = 'stage' and kind = '>'");
  }
  const ProgramResult replay = abcal({"replay", "a.run"});
  EXPECT_EQ(replay.exit_code, 3);
  EXPECT_THAT(replay.err, AllOf(HasSubstr("the replay leaves the recording"), HasSubstr("MOV 1 90"),
                                HasSubstr("MOV 1 91"), HasSubstr("did not end as the recorded run did"),
                                Not(HasSubstr("continue with"))));
  EXPECT_EQ(RunFile::load(folder / "a-replay.run").state, RunState::kAbandoned);
  EXPECT_NE(abcal({"resume", "a-replay.run"}).exit_code, 0);  // It would turn the real stage.
}

TEST_F(EmulatedBenchTest, AReplayOfARunInRealTimeGivesExactlyItsAngles) {
  start_emulator();
  const ProgramResult run = abcal({"run", "bench.toml", "--record", "-o", "a.run"});
  ASSERT_EQ(run.exit_code, 0) << run.err;
  emulator->signal(SIGKILL);
  emulator->wait();
  const ProgramResult replay = abcal({"replay", "a.run", "-o", "b.run"});
  ASSERT_EQ(replay.exit_code, 0) << replay.err;
  EXPECT_THAT(replay.err, HasSubstr("39 of 39 angles are exactly as recorded"));
  expect_same_dwells(RunFile::load(folder / "a.run"), RunFile::load(folder / "b.run"));
}

TEST_F(EmulatedBenchTest, AReplayEndsWithTheFaultOfTheRecordedRun) {
  bench.protocol += "replug_timeout_s = 1.0\n";
  start_emulator();
  Program run({"run", "bench.toml", "--record", "-o", "a.run"}, folder.path());
  ASSERT_TRUE(test::wait_for([&] { return measured("a.run") >= 3; }, 60s)) << run.err();
  emulator->signal(SIGKILL);  // both ports vanish
  emulator->wait();
  EXPECT_EQ(run.wait(), 3) << run.err();
  EXPECT_THAT(last_words(run.err()), AllOf(HasSubstr("link lost"), HasSubstr("experiment")));
  const ProgramResult replay = abcal({"replay", "a.run"});
  EXPECT_EQ(replay.exit_code, 3);
  EXPECT_EQ(last_words(replay.err), last_words(run.err()));
  EXPECT_THAT(replay.err, HasSubstr("it ended as the recorded run did"));
  const StoredRun recorded = RunFile::load(folder / "a.run");
  EXPECT_GE(recorded.measured.size(), 3U);
  expect_same_dwells(recorded, RunFile::load(folder / "a-replay.run"));
}

TEST_F(EmulatedBenchTest, ARunThatItsOperatorStoppedIsReplayedUpToThere) {
  start_emulator();
  Program run({"run", "bench.toml", "--record", "-o", "a.run"}, folder.path());
  ASSERT_TRUE(test::wait_for([&] { return measured("a.run") >= 3; }, 60s)) << run.err();
  run.signal(SIGINT);
  EXPECT_EQ(run.wait(), 130) << run.err();
  const ProgramResult replay = abcal({"replay", "a.run"});
  EXPECT_EQ(replay.exit_code, 130) << replay.err;
  // An angle whose last reply was under way when the signal came may be in the recorded run only.
  const std::size_t replayed = measured("a-replay.run");
  EXPECT_GE(replayed + 1, measured("a.run"));
  EXPECT_THAT(replay.err, AllOf(HasSubstr("stopped by its operator"),
                                HasSubstr("Replay: " + std::to_string(replayed) + " of " +
                                          std::to_string(replayed) + " angles are exactly as recorded")));
}

TEST_F(EmulatedBenchTest, ARunThatWasKilledIsReplayedAsFarAsItReached) {
  start_emulator();
  Program run({"run", "bench.toml", "--record", "-o", "a.run"}, folder.path());
  ASSERT_TRUE(test::wait_for([&] { return measured("a.run") >= 3; }, 60s)) << run.err();
  run.signal(SIGKILL);
  run.wait();
  const ProgramResult replay = abcal({"replay", "a.run"});
  EXPECT_EQ(replay.exit_code, 3) << replay.err;
  EXPECT_THAT(replay.err, AllOf(HasSubstr("the recording ends here"), HasSubstr("without a message")));
  expect_same_dwells(RunFile::load(folder / "a.run"), RunFile::load(folder / "a-replay.run"));
}

TEST_F(ProgramTest, AFaultBeforeTheFirstAngleIsRecordedAndReplayed) {
  std::array<char, 128> name{};
  int controller = -1, terminal = -1;
  ASSERT_EQ(::openpty(&controller, &terminal, name.data(), nullptr, nullptr), 0);
  BenchText bench;
  bench.stage_port = name.data();
  write_bench(bench);
  const ProgramResult run = abcal({"run", "bench.toml", "--record", "-o", "a.run"});
  ::close(controller);
  ::close(terminal);
  EXPECT_EQ(run.exit_code, 3);
  EXPECT_THAT(run.err, AllOf(HasSubstr("no reply"), HasSubstr("the recording is kept in a.run")));
  const ProgramResult replay = abcal({"replay", "a.run"});
  EXPECT_EQ(replay.exit_code, 3);
  EXPECT_EQ(last_words(replay.err), last_words(run.err));
  EXPECT_FALSE(std::filesystem::exists(folder / "a-replay.run"));
  EXPECT_NE(abcal({"resume", "a.run"}).exit_code, 0);
  EXPECT_NE(abcal({"analyse", "a.run"}).exit_code, 0);
}

}  // namespace
}  // namespace abcal
