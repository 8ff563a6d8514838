#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>

#include "protocol/record/dwell_chain.h"
#include "protocol/record/sqlite.h"
#include "protocol/record/verify_run.h"

#include "tests/support/failing_disk.h"
#include "tests/support/sqlite_lock.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::HasSubstr;

ProtocolConfig config_of_12() {
  ProtocolConfig config;
  config.steps = 12;
  config.step = Angle::degrees(30);
  return config;
}

RunHeader header() {
  RunHeader h;
  h.program_version = "test";
  h.created_utc = "2026-03-01T12:00:00.000Z";
  h.bench_toml = "schema = \"abcal.bench/1\"\n";
  h.labels = {{"item.serial_number", "SN \"7\"; drop table dwell"}};
  h.instruments = {{"stage", "PI", "C-884", "118", "1.2", "two axes"}};
  h.response_unit = "g";
  h.g_loc = {9.80101, 3e-5, 2.0, "survey"};
  h.tolerances.step = Angle::degrees(0.0123456789012345);
  h.steps = 12;
  h.step = Angle::degrees(30);
  h.plan = make_rotation_plan(config_of_12(), {});
  return h;
}

DwellRecord dwell(int n) {
  DwellRecord d;
  d.experiment = 1;
  d.n = n;
  d.alpha = Angle::degrees(30.0 * (n - 1));
  d.commanded_x = d.alpha;
  d.encoder_x = Angle::degrees(d.alpha.deg() + 1e-4);
  d.encoder_z = Angle{};
  d.time_s = 10.0 * n;
  d.count = 2;
  d.mean = Eigen::Vector3d(0.1, -1.0 / 3.0, 1e-17);
  d.spread = Eigen::Vector3d(1e-4, 2e-4, 3e-4);
  d.u_mean = Eigen::Vector3d(1e-5, 2e-5, 3e-5);
  d.temperature_degc = 23.25;
  d.flags = kFlagLostReadings | kFlagNotQuiet;
  return d;
}

const std::vector<StoredReading> kReadings{{7, 1.0, {0.1, 0.2, 0.3}, std::nullopt},
                                           {8, 1.01, {0.4, 0.5, 0.6}, 22.0}};

std::string what(const std::function<void()>& action) {
  try {
    action();
  } catch (const RunFileError& error) {
    return error.what();
  }
  ADD_FAILURE() << "nothing was thrown";
  return {};
}

StoredRun alone(const std::filesystem::path& file, const test::TemporaryFolder& folder) {
  const std::filesystem::path copy = folder / "alone" / "copy.run";
  std::filesystem::create_directories(copy.parent_path());
  std::filesystem::copy_file(file, copy, std::filesystem::copy_options::overwrite_existing);
  StoredRun run = RunFile::load(copy);
  std::filesystem::remove_all(copy.parent_path());
  return run;
}

class MovedFileTest : public testing::Test {
 protected:
  MovedFileTest() {
    file.set_state(RunState::kRunning, "t", Message("begins"));
    file.append_dwell(0, dwell(1), kReadings, {});
  }
  /// Writes another angle, and finds both angles and their links in the closed file.
  void expect_goes_on() {
    EXPECT_EQ(file.look_for_file(), RunFile::Place::kInPlace);
    file.append_dwell(1, dwell(2), kReadings, {});
    file.close_complete("t", {});
    EXPECT_EQ(RunFile::load(path).record.dwells.size(), 2U);
    // The readings of this made run do not give its means, and nobody has analysed it.
    for (const IntegrityCheck& check : verify_run(path)) {
      if (check.what == "readings" || check.what == "SHA-256") continue;
      EXPECT_TRUE(check.good) << check.what << check.found;
    }
    EXPECT_FALSE(std::filesystem::exists(path.string() + "-wal"));
  }
  test::TemporaryFolder folder;
  std::filesystem::path path = [this] {
    std::filesystem::create_directory(folder / "runs");
    return folder / "runs" / "a.run";
  }();
  RunFile file = RunFile::create(path, header());
};

TEST_F(MovedFileTest, ARenamedFileIsWholeWithoutItsLogAndGoesOnWhenItIsBack) {
  const std::filesystem::path elsewhere = folder / "b.run";
  EXPECT_EQ(file.look_for_file(), RunFile::Place::kInPlace);
  EXPECT_TRUE(alone(path, folder).record.dwells.empty());  // Its log has the angle.
  std::filesystem::rename(path, elsewhere);
  EXPECT_EQ(file.look_for_file(), RunFile::Place::kMoved);
  EXPECT_EQ(alone(elsewhere, folder).record.dwells.size(), 1U);
  std::ofstream(path) << "another";
  EXPECT_EQ(file.look_for_file(), RunFile::Place::kReplaced);
  std::filesystem::rename(elsewhere, path);
  expect_goes_on();
}

TEST_F(MovedFileTest, ADeletedFileIsWrittenAgain) {
  std::filesystem::remove(path);
  EXPECT_EQ(file.look_for_file(), RunFile::Place::kWrittenAgain);
  EXPECT_EQ(RunFile::load(path).record.dwells.size(), 1U);
  // It is locked as before.
  EXPECT_THAT(what([&] { RunFile::open_for_append(path); }), HasSubstr("another abcal is writing this run"));
  expect_goes_on();
}

TEST_F(MovedFileTest, ARemovedFolderIsWaitedFor) {
  std::filesystem::remove_all(path.parent_path());
  EXPECT_EQ(file.look_for_file(), RunFile::Place::kMoved);
  std::filesystem::create_directory(path.parent_path());
  EXPECT_EQ(file.look_for_file(), RunFile::Place::kWrittenAgain);
  expect_goes_on();
}

TEST_F(MovedFileTest, TheLogIsMergedEachMinute) {
  RunTiming timing;
  timing.moving_s = 59.9;
  file.append_dwell(1, dwell(2), kReadings, timing);
  EXPECT_TRUE(alone(path, folder).record.dwells.empty());
  timing.moving_s = 60.1;
  file.append_dwell(2, dwell(3), kReadings, timing);
  EXPECT_EQ(alone(path, folder).record.dwells.size(), 3U);
}

TEST_F(MovedFileTest, ALostLogIsNamed) {
  file.begin_session({});
  file.append_dwell(1, dwell(2), kReadings, {});
  const std::filesystem::path copy = folder / "c.run";
  std::filesystem::copy_file(path, copy);
  // Not even the head of its session is in the file without the log.
  EXPECT_EQ(RunFile::missing_log(path), std::nullopt);
  RunTiming minute;
  minute.dwelling_s = 61.0;
  file.append_dwell(2, dwell(3), kReadings, minute);
  std::filesystem::copy_file(path, copy, std::filesystem::copy_options::overwrite_existing);
  ASSERT_TRUE(RunFile::missing_log(copy));
  EXPECT_THAT(RunFile::missing_log(copy)->english(), HasSubstr("its log c.run-wal is gone"));
  file.set_state(RunState::kInterrupted, "t", Message("stopped"));
  { const RunFile closed = std::move(file); }
  EXPECT_EQ(RunFile::missing_log(path), std::nullopt);
}

TEST(RunFileTest, ALogWithoutItsFileIsNotTakenForThatOfANewRun) {
  const test::TemporaryFolder folder;
  std::ofstream(folder / "a.run-wal") << "what a run left";
  EXPECT_THAT(what([&] { RunFile::create(folder / "a.run", header()); }),
              HasSubstr("is the log of a run whose own file is gone"));
  EXPECT_FALSE(std::filesystem::exists(folder / "a.run"));
}

TEST(RunFileTest, ANameThatIsNoFilesOrNoTextIsRefused) {
  EXPECT_THAT(what([] { RunFile::create(":memory:", header()); }), HasSubstr("choose another name with -o"));
  const test::TemporaryFolder folder;
  EXPECT_THAT(what([&] { RunFile::create(folder / "caf\xe9.run", header()); }), HasSubstr("is not UTF-8"));
  EXPECT_EQ(std::distance(begin(std::filesystem::directory_iterator(folder.path())),
                          end(std::filesystem::directory_iterator())),
            0);
}

// Without this lock another program that has looked at the run removes the write-ahead log when it leaves,
// and all later angles go into a file without a name.
TEST(RunFileTest, TheProgramThatWritesARunKeepsItsLocksWhileItLooksAtTheFile) {
  const test::TemporaryFolder folder;
  const std::filesystem::path path = folder / "a.run";
  RunFile file = RunFile::create(path, header());
  file.append_dwell(0, dwell(1), kReadings, {1, 2, 3, 4});
  ASSERT_TRUE(test::shared_lock_is_held(path));
  const std::vector<std::pair<const char*, std::function<void()>>> looks{
      {"load", [&] { (void)RunFile::load(path); }},
      {"load_items", [&] { (void)RunFile::load_items(path); }},
      {"count_items", [&] { (void)RunFile::count_items(path); }},
      {"looks_like_run_file", [&] { (void)RunFile::looks_like_run_file(path); }},
      {"is_closed", [&] { (void)RunFile::is_closed(path); }},
      {"witnessed", [&] { (void)RunFile::witnessed(path); }},
      {"transcript", [&] { (void)RunFile::load_transcript(path); }},
      {"last_dwell_link", [&] { (void)last_dwell_link(path); }},
      {"verify_run", [&] { (void)verify_run(path); }},
  };
  for (const auto& [name, look] : looks) {
    look();
    EXPECT_TRUE(test::shared_lock_is_held(path)) << name;
  }
  // A program that opens the run to write, as a shell of SQLite does, and leaves.
  ASSERT_EQ(std::system(("sqlite3 '" + path.string() + "' 'select count(*) from dwell' >/dev/null").c_str()),
            0);
  file.append_dwell(1, dwell(2), kReadings, {1, 2, 3, 4});
  EXPECT_EQ(RunFile::load(path).measured.size(), 2U);
}

TEST(RunFileTest, GivesBackEveryNumberThatWasStoredBitForBit) {
  const test::TemporaryFolder folder;
  {
    RunFile file = RunFile::create(folder / "a.run", header());
    file.append_dwell(0, dwell(1), kReadings, {1, 2, 3, 4});
    file.append_event("2026-03-01T12:00:01.000Z", "note", Message("hello"));
    file.append_environment("2026-03-01T12:00:00.500Z", "start", 22.5, std::nullopt, 1009.25);
  }
  const StoredRun run = RunFile::load(folder / "a.run");
  EXPECT_EQ(run.state, RunState::kRunning);
  EXPECT_EQ(run.header.tolerances.step.deg(), 0.0123456789012345);
  EXPECT_EQ(run.header.labels, header().labels);
  EXPECT_EQ(run.header.plan.size(), header().plan.size());
  EXPECT_EQ(run.header.bench_toml, header().bench_toml);
  EXPECT_EQ(run.header.instruments.at(0).serial_number, "118");
  EXPECT_EQ(run.timing.overhead_s, 4.0);
  ASSERT_EQ(run.record.dwells.size(), 1U);
  const DwellRecord& d = run.record.dwells[0];
  EXPECT_EQ(d.mean, dwell(1).mean);
  EXPECT_EQ(*d.u_mean, *dwell(1).u_mean);
  EXPECT_EQ(d.encoder_x->deg(), dwell(1).encoder_x->deg());
  EXPECT_EQ(d.flags, dwell(1).flags);
  EXPECT_EQ(d.temperature_degc, 23.25);
  EXPECT_EQ(run.events.back().text, "hello");
  ASSERT_EQ(run.environment.size(), 1U);
  EXPECT_EQ(run.environment[0].moment, "start");
  EXPECT_EQ(run.environment[0].temperature_degc, 22.5);
  EXPECT_EQ(run.environment[0].humidity_percent, std::nullopt);
  EXPECT_EQ(run.environment[0].pressure_hpa, 1009.25);
  EXPECT_EQ(run.measured, std::vector<std::size_t>{0});
}

/// A message comes back with its values; what a person wrote has none, whatever it says.
TEST(RunFileTest, EventsKeepTheirMessages) {
  const test::TemporaryFolder folder;
  const std::filesystem::path path = folder / "a.run";
  const Message said("{what}; it is measured again", Message("{angle}: not quiet", 3));
  {
    RunFile file = RunFile::create(path, header());
    file.append_event("2026-03-01T12:00:01.000Z", "repeated", said);
    file.append_event("2026-03-01T12:00:02.000Z", "note", Message::bare(said.english()));
    file.drop_item(1, 4, "2026-03-01T12:00:03.000Z", Message("item {k} is left out", 1));
  }
  const auto events = [&] { return RunFile::load(path).events; };
  ASSERT_EQ(events().size(), 3U);
  EXPECT_EQ(events()[0].text.id(), said.id());
  EXPECT_EQ(events()[0].text, said.english());
  EXPECT_EQ(events()[1].text.id(), "");
  EXPECT_EQ(events()[1].text, said.english());
  EXPECT_EQ(RunFile::load(path).items.front().reason.id(), "item {k} is left out");
  // A row that says something else, or nothing that can be read, is as if it were not there.
  for (const char* forged :
       {R"({"text": "a", "id": "all is well", "values": {}})", R"({"id": 3})", "[", ""}) {
    SqliteDatabase database(path, SqliteDatabase::Mode::kReadWrite);
    database.prepare("update message set message = :forged where event = 1").set("forged", forged).run();
    EXPECT_EQ(events()[0].text.id(), "") << forged;
    EXPECT_EQ(events()[0].text, said.english()) << forged;
  }
}

TEST(RunFileTest, IsReadableWithTheSqliteShell) {
  const test::TemporaryFolder folder;
  {
    RunFile file = RunFile::create(folder / "a.run", header());
    file.append_dwell(0, dwell(1), kReadings, {});
  }
  SqliteDatabase database(folder / "a.run", SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(database.value("select count(*) from reading"), "2");
  EXPECT_EQ(database.value("select flag_words from dwell"), "not quiet, lost readings");
  EXPECT_EQ(database.value("pragma integrity_check"), "ok");
}

TEST(RunFileTest, KeepsBothRowsOfARepeatedAngleAndTheFirstCounts) {
  const test::TemporaryFolder folder;
  RunFile file = RunFile::create(folder / "a.run", header());
  file.append_dwell(0, dwell(1), kReadings, {});
  DwellRecord again = dwell(1);
  again.mean[0] = 42.0;
  file.append_dwell(0, again, kReadings, {});
  const StoredRun run = RunFile::load(folder / "a.run");
  ASSERT_EQ(run.record.dwells.size(), 1U);
  EXPECT_EQ(run.record.dwells[0].mean[0], dwell(1).mean[0]);
  SqliteDatabase database(folder / "a.run", SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(database.value("select count(*) from dwell"), "2");
  std::vector<StoredDwell> all;
  RunFile::read_dwells(folder / "a.run", [&](const StoredDwell& one) { all.push_back(one); });
  ASSERT_EQ(all.size(), 2U);
  EXPECT_FALSE(all[0].repeat);
  EXPECT_TRUE(all[1].repeat);
  ASSERT_EQ(all[1].readings.size(), 2U);
  EXPECT_EQ(all[1].readings[1].sequence, 8U);
  EXPECT_EQ(all[1].readings[1].output, Eigen::Vector3d(0.4, 0.5, 0.6));
  EXPECT_EQ(all[1].readings[0].temperature_degc, std::nullopt);
}

TEST(RunFileTest, ACompleteRunIsOneReadOnlyFileThatCannotBeContinued) {
  const test::TemporaryFolder folder;
  const std::filesystem::path path = folder / "a.run";
  RunFile file = RunFile::create(path, header());
  file.append_dwell(0, dwell(1), kReadings, {});
  const std::string hash = file.close_complete("2026-03-01T13:00:00.000Z", {});
  EXPECT_EQ(hash, sha256_of_file(path));
  EXPECT_FALSE(std::filesystem::exists(path.string() + "-wal"));
  using std::filesystem::perms;
  EXPECT_EQ(std::filesystem::status(path).permissions() & perms::owner_write, perms::none);
  EXPECT_EQ(RunFile::load(path).state, RunState::kComplete);
  EXPECT_EQ(sha256_of_file(path), hash) << "reading a run must not change it";
  EXPECT_THAT(what([&] { RunFile::open_for_append(path); }), HasSubstr("cannot be resumed"));
}

TEST(RunFileTest, ClosingIsFinishedWhereverTheProgramWasKilledInIt) {
  const test::TemporaryFolder folder;
  const std::filesystem::path path = folder / "a.run";
  {
    RunFile file = RunFile::create(path, header());
    file.append_dwell(0, dwell(1), kReadings, {});
    file.set_state(RunState::kComplete, "2026-03-01T13:00:00.000Z", Message("all angles measured"));
    std::filesystem::copy_file(path, folder / "killed.run");
    std::filesystem::copy_file(path.string() + "-wal", folder / "killed.run-wal");
  }
  // Before its log was merged into the file, after that, and when it was read-only already.
  using std::filesystem::perms;
  for (const perms mode :
       {perms::owner_read | perms::owner_write, perms::owner_read | perms::owner_write, perms::owner_read}) {
    std::filesystem::permissions(folder / "killed.run", mode);
    const std::string hash = RunFile::finish_closing(folder / "killed.run");
    EXPECT_EQ(hash, sha256_of_file(folder / "killed.run"));
    EXPECT_FALSE(std::filesystem::exists(folder / "killed.run-wal"));
    EXPECT_EQ(std::filesystem::status(folder / "killed.run").permissions() & perms::owner_write, perms::none);
    EXPECT_EQ(RunFile::load(folder / "killed.run").record.dwells.size(), 1U);
  }
}

TEST(RunFileTest, ClosingWaitsForThoseWhoReadTheRun) {
  const test::TemporaryFolder folder;
  const std::filesystem::path path = folder / "a.run";
  RunFile file = RunFile::create(path, header());
  file.append_dwell(0, dwell(1), kReadings, {});
  // A reader such as `sqlite3 a.run`, or the list of runs in the console, keeps a lock while it is open.
  std::optional<SqliteDatabase> reader;
  reader.emplace(path, SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(reader->value("select count(*) from dwell"), "1");
  int asked = 0;
  const std::string hash = file.close_complete("2026-03-01T13:00:00.000Z", {}, [&](int failures) {
    EXPECT_EQ(failures, ++asked);
    if (failures == 3) reader.reset();
    return true;
  });
  EXPECT_EQ(asked, 3);
  EXPECT_EQ(hash, sha256_of_file(path));
  EXPECT_FALSE(std::filesystem::exists(path.string() + "-wal"));
  EXPECT_EQ(RunFile::load(path).state, RunState::kComplete);
}

TEST(RunFileTest, AReaderThatStaysIsToldAndTheRunCanBeClosedLater) {
  const test::TemporaryFolder folder;
  const std::filesystem::path path = folder / "a.run";
  std::optional<SqliteDatabase> reader;
  {
    RunFile file = RunFile::create(path, header());
    file.append_dwell(0, dwell(1), kReadings, {});
    reader.emplace(path, SqliteDatabase::Mode::kReadOnly);
    EXPECT_EQ(reader->value("select count(*) from dwell"), "1");
    const std::string why =
        what([&] { file.close_complete("2026-03-01T13:00:00.000Z", {}, [](int) { return false; }); });
    EXPECT_THAT(why, HasSubstr("all angles are measured and stored"));
    EXPECT_THAT(why, HasSubstr("abcal resume"));
  }
  EXPECT_EQ(RunFile::load(path).state, RunState::kComplete);
  reader.reset();
  const std::string hash = RunFile::finish_closing(path);
  EXPECT_EQ(hash, sha256_of_file(path));
  EXPECT_EQ(RunFile::load(path).record.dwells.size(), 1U);
}

TEST(RunFileTest, NeverOverwritesAFile) {
  const test::TemporaryFolder folder;
  std::ofstream(folder / "a.run") << "precious";
  EXPECT_THAT(what([&] { RunFile::create(folder / "a.run", header()); }), HasSubstr("never overwritten"));
  std::ifstream file(folder / "a.run");
  std::string word;
  file >> word;
  EXPECT_EQ(word, "precious");
}

TEST(RunFileTest, RefusesASecondWriter) {
  const test::TemporaryFolder folder;
  const RunFile first = RunFile::create(folder / "a.run", header());
  EXPECT_THAT(what([&] { RunFile::open_for_append(folder / "a.run"); }),
              HasSubstr("another abcal is writing"));
}

TEST(RunFileTest, SaysClearlyWhatIsWrongWithAFileThatIsNoRun) {
  const test::TemporaryFolder folder;
  EXPECT_THAT(what([&] { RunFile::load(folder / "none.run"); }), HasSubstr("no such file"));
  std::ofstream(folder / "empty.run").flush();
  EXPECT_THAT(what([&] { RunFile::load(folder / "empty.run"); }), HasSubstr("is empty"));
  std::ofstream(folder / "text.run") << "experiment,n,alpha_deg\n";
  EXPECT_THAT(what([&] { RunFile::load(folder / "text.run"); }), HasSubstr("not a run file"));
  {
    SqliteDatabase(folder / "other.run", SqliteDatabase::Mode::kCreate)
        .execute("create table t(x); pragma application_id=7");
  }
  EXPECT_THAT(what([&] { RunFile::load(folder / "other.run"); }), HasSubstr("another program"));
}

TEST(RunFileTest, RefusesWhatOnlyAnotherProgramPutsIntoAFile) {
  const test::TemporaryFolder folder;
  const auto refusal = [&](const char* name, const char* sql) {
    const auto path = folder / name;
    { RunFile::create(path, header()); }
    EXPECT_NO_THROW(RunFile::load(path));
    { SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite).execute(sql); }
    return what([&] { RunFile::load(path); });
  };
  // An answer from it would never end.
  EXPECT_THAT(
      refusal("view.run",
              "drop table event; create view event as with recursive r(id) as (select 1 union all "
              "select id + 1 from r) select id, 'x' utc, 'x' who, 'x' kind, 'x' text, 'x' chain from r"),
      HasSubstr("has the view \"event\", which no run file has"));
  EXPECT_THAT(refusal("trigger.run", "create trigger more after insert on event begin select 1; end"),
              HasSubstr("has the trigger \"more\""));
  // Exports would show other readings than those that the links cover.
  EXPECT_THAT(
      refusal("readings.run",
              "drop view timed_reading; create view timed_reading as select dwell, k, k as sequence, 0 as "
              "time_ns, 0 as utc_ns, 0.0 as time_s, u * 2 as u, v, w, 23.0 as temperature_degc from reading"),
      HasSubstr("has the view \"timed_reading\", which is not that of a run file"));
  EXPECT_THAT(refusal("column.run", "alter table dwell add column more text"),
              HasSubstr("has the table \"dwell\", which is not that of a run file"));
  EXPECT_THAT(refusal("table.run", "create table more(x)"), HasSubstr("has the table \"more\""));
  EXPECT_THAT(refusal("index.run", "create index more on dwell(item)"), HasSubstr("has the index \"more\""));
  EXPECT_THAT(refusal("less.run", "drop table witness"), HasSubstr("lacks the table \"witness\""));
  EXPECT_THAT(refusal("large.run", "insert into meta values('label.more', zeroblob(70000000))"),
              HasSubstr("larger than any that abcal writes"));
}

TEST(RunFileTest, RefusesANewerFileAndSaysToUpdate) {
  const test::TemporaryFolder folder;
  { RunFile::create(folder / "a.run", header()); }
  { SqliteDatabase(folder / "a.run", SqliteDatabase::Mode::kReadWrite).execute("pragma user_version=99"); }
  EXPECT_THAT(what([&] { RunFile::load(folder / "a.run"); }), HasSubstr("newer abcal"));
}

TEST(RunFileTest, RefusesATruncatedFile) {
  const test::TemporaryFolder folder;
  {
    RunFile file = RunFile::create(folder / "a.run", header());
    for (int n = 1; n <= 12; ++n) file.append_dwell(static_cast<std::size_t>(n - 1), dwell(n), kReadings, {});
    file.close_complete("2026-03-01T13:00:00.000Z", {});
  }
  const std::filesystem::path path = folder / "a.run";
  std::filesystem::permissions(path, std::filesystem::perms::owner_all);
  std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
  EXPECT_THAT(what([&] { RunFile::load(path); }),
              testing::AnyOf(HasSubstr("truncated"), HasSubstr("damaged")));
}

/// Gives rows to a run file as a transcript does.
struct WireSource {
  std::vector<WireRow> rows;
  std::function<std::vector<WireRow>()> take() {
    return [this] { return std::exchange(rows, {}); };
  }
};

const WireRow kWritten{"stage", 5, std::nullopt, '>', "POS?\n"};
const WireRow kReceived{"stage", 2'000'005, 1'999'999, '<', std::string("1=\xB0\0\n", 5)};
const WireRow kEmpty{"accelerometer", 3'000'000'000'000, 3'000'000'000'000, '<', ""};

TEST(RunFileTest, KeepsATranscriptWithEachAngleAndEachChangeOfState) {
  const test::TemporaryFolder folder;
  const auto stored = [&] { return RunFile::load_transcript(folder / "a.run").value().rows; };
  RunFile file = RunFile::create(folder / "a.run", header());
  WireSource source{{kWritten}};
  const Clock::UtcTime start{Clock::Duration(1'772'366'400'123'456'789)};
  file.keep_transcript(start, source.take());
  EXPECT_EQ(stored(), std::vector{kWritten});  // Rows from before the first angle are written at once.
  EXPECT_EQ(RunFile::load_transcript(folder / "a.run")->start, start);
  source.rows = {kReceived};
  file.append_dwell(0, dwell(1), kReadings, {});
  EXPECT_EQ(stored(), (std::vector{kWritten, kReceived}));
  source.rows = {kEmpty};
  file.set_state(RunState::kInterrupted, "2026-03-01T12:00:01.000Z", Message("a fault"));
  EXPECT_EQ(stored(), (std::vector{kWritten, kReceived, kEmpty}));
  EXPECT_EQ(RunFile::load(folder / "a.run").measured.size(), 1U);
}

TEST(RunFileTest, ARunWithoutATranscriptHasNone) {
  const test::TemporaryFolder folder;
  RunFile::create(folder / "a.run", header());
  EXPECT_EQ(RunFile::load_transcript(folder / "a.run"), std::nullopt);
}

TEST(RunFileTest, ATransactionThatFailsLosesNothingOfTheTranscript) {
  const test::TemporaryFolder folder;
  RunFile file = RunFile::create(folder / "a.run", header());
  WireSource source;
  file.keep_transcript({}, source.take());
  source.rows = {kWritten};
  // The commit of an angle fails while a disk takes no row of its table, after the rows were taken.
  SqliteDatabase other(folder / "a.run", SqliteDatabase::Mode::kReadWrite);
  other.execute("create trigger full before insert on wire begin select raise(abort, 'disk is full'); end");
  EXPECT_THROW(file.append_dwell(0, dwell(1), kReadings, {}), RunFileError);
  other.execute("drop trigger full");
  file.set_state(RunState::kInterrupted, "now", Message("a fault"));
  EXPECT_EQ(RunFile::load_transcript(folder / "a.run")->rows, std::vector{kWritten});
}

TEST(RunFileTest, ResultsRefuseARunWhoseBytesHaveChanged) {
  const test::TemporaryFolder folder;
  const std::filesystem::path path = folder / "a.run";
  { ResultsFile(path, "aaaa").add_analysis("", "1", "abc", "{}"); }
  { ResultsFile(path, "aaaa").add_analysis("", "1", "abc", "{}"); }  // the very same one is not stored twice
  { ResultsFile(path, "aaaa").add_analysis("", "1", "abc", "{\"x\":1}"); }
  SqliteDatabase database(ResultsFile::path_beside(path), SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(database.value("select count(*) from analysis"), "2");
  EXPECT_THAT(what([&] { ResultsFile(path, "bbbb"); }), HasSubstr("was changed"));
}

/// A sound file on a disk that fails to read: once is passed over, and more is not called damage.
TEST(RunFileTest, AFileThatCannotBeReadIsNotCalledDamaged) {
  const test::TemporaryFolder folder;
  const std::filesystem::path path = folder / "a.run";
  {
    RunFile file = RunFile::create(path, header());
    for (int n = 1; n <= 12; ++n) file.append_dwell(n - 1, dwell(n), kReadings, {1, 2, 3, 4});
    file.close_complete("2026-03-01T12:00:01.000Z", {});
  }
  test::FailingDisk disk;
  disk.mend();
  EXPECT_TRUE(RunFile::is_closed(path));
  const std::size_t reads = disk.calls(test::FailingDisk::Failure::kRead);
  ASSERT_GT(reads, 10U);
  for (std::size_t at = 1; at < reads; ++at) {  // The last one reads the state.
    disk.fail(test::FailingDisk::Failure::kRead, at, false);
    EXPECT_TRUE(RunFile::is_closed(path)) << "read " << at << " of " << reads;
    ASSERT_TRUE(disk.failed());
    disk.fail(test::FailingDisk::Failure::kRead, at, true);
    const std::string why = what([&] { (void)RunFile::is_closed(path); });
    EXPECT_THAT(why, testing::Not(HasSubstr("damaged"))) << at;
    EXPECT_THAT(why, HasSubstr("check its space and condition, then try again")) << at;
  }
}

}  // namespace
}  // namespace abcal
