// Promises of version 3 of the run file: true time, sessions, roles, items, compact readings, chained dwells,
// and results that many programs may write at once.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>

#include <cmath>
#include <fstream>
#include <limits>
#include <map>
#include <random>
#include <thread>

#include "protocol/record/clock_watch.h"
#include "protocol/record/dwell_chain.h"
#include "protocol/record/dwell_rows.h"
#include "protocol/record/reading_statistics.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_schema.h"
#include "protocol/record/sha256.h"
#include "protocol/record/verify_run.h"
#include "tests/support/forged_chain.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;
using testing::Not;

constexpr Clock::UtcTime kMorning = std::chrono::sys_days{std::chrono::November / 22 / 2026} + 8h;
constexpr Clock::Instant kMonotonic{Clock::Duration(5'000'000'000'123)};

RunHeader plan_of_two() {
  RunHeader header;
  header.response_unit = "g";
  header.labels["item.serial_number"] = "77";
  header.plan.push_back({1, 1, false, Angle{}, Angle{}, Angle{}});
  header.plan.push_back({1, 2, true, Angle::degrees(360.0), Angle{}, Angle{}});
  return header;
}

/// A beginning at this time after the first, on a computer that was started once.
SessionStart start_after(Clock::Duration elapsed, const std::string& boot_id = "boot-1",
                         Clock::Duration system_clock_moved = {}) {
  return {kMorning + elapsed + system_clock_moved,
          kMonotonic + elapsed,
          {boot_id, 100s + elapsed, 0.001, 0.02},
          "0.2.0"};
}

/// Readings at 100 Hz that arrive up to 3 ms late, with a temperature in single precision.
std::vector<StoredReading> late_readings(std::size_t count, double begin_s) {
  std::mt19937_64 engine(1);
  std::normal_distribution<double> noise(0.0, 1e-4);
  std::uniform_int_distribution<int> late_ns(0, 3'000'000);
  std::vector<StoredReading> readings;
  for (std::size_t k = 0; k < count; ++k) {
    StoredReading reading;
    reading.sequence = 1'000'000 + k + (k > count / 2 ? 3 : 0);  // Three are lost in the middle.
    const double nanoseconds = std::round(begin_s * 1e9) + 1e7 * static_cast<double>(k) + late_ns(engine);
    reading.time_s = nanoseconds / 1e9;
    reading.output = Eigen::Vector3d(noise(engine), 0.5 + noise(engine), -1.0 + noise(engine));
    reading.temperature_degc = static_cast<double>(static_cast<float>(23.0 + noise(engine)));
    readings.push_back(reading);
  }
  return readings;
}

/// The dwell that these readings make.
DwellRecord dwell_of(const std::vector<StoredReading>& readings, bool closing = false) {
  std::vector<Eigen::Vector3d> outputs;
  for (const StoredReading& reading : readings) outputs.push_back(reading.output);
  const ReadingStatistics statistics = reading_statistics(outputs, 0.0);
  DwellRecord dwell;
  dwell.experiment = 1;
  dwell.n = closing ? 2 : 1;
  dwell.closing = closing;
  dwell.time_s = readings.at(readings.size() / 2).time_s;
  dwell.count = static_cast<std::int64_t>(readings.size());
  dwell.mean = statistics.mean;
  dwell.spread = statistics.spread;
  dwell.u_mean = statistics.u_mean;
  for (std::size_t k = 1; k < readings.size(); ++k)
    dwell.lost += static_cast<std::int64_t>(readings[k].sequence - readings[k - 1].sequence - 1);
  if (dwell.lost > 0) dwell.flags |= kFlagLostReadings;
  return dwell;
}

/// Counts how often SQLite asks the system to flush a file to the disk, while it lives.
class CountedFlushes {
 public:
  CountedFlushes() {
    of_system() = sqlite3_vfs_find(nullptr);
    counted_ = *of_system();
    counted_.zName = "counted";
    counted_.xOpen = [](sqlite3_vfs*, const char* name, sqlite3_file* file, int flags, int* found) {
      const int code = of_system()->xOpen(of_system(), name, file, flags, found);
      if (file->pMethods != nullptr) {
        static std::map<const sqlite3_io_methods*, sqlite3_io_methods> counted;
        flush_of_system() = file->pMethods->xSync;
        sqlite3_io_methods& methods = counted[file->pMethods];
        methods = *file->pMethods;
        methods.xSync = [](sqlite3_file* flushed, int how) {
          ++count();
          return flush_of_system()(flushed, how);
        };
        file->pMethods = &methods;
      }
      return code;
    };
    sqlite3_vfs_register(&counted_, 1);
  }
  CountedFlushes(const CountedFlushes&) = delete;
  CountedFlushes& operator=(const CountedFlushes&) = delete;
  ~CountedFlushes() {
    sqlite3_vfs_register(of_system(), 1);
    sqlite3_vfs_unregister(&counted_);
  }
  static int& count() {
    static int value = 0;
    return value;
  }

 private:
  static sqlite3_vfs*& of_system() {
    static sqlite3_vfs* value = nullptr;
    return value;
  }
  static int (*&flush_of_system())(sqlite3_file*, int) {
    static int (*value)(sqlite3_file*, int) = nullptr;
    return value;
  }
  sqlite3_vfs counted_{};
};

class RunFile3Test : public testing::Test {
 protected:
  void append(RunFile& file, std::size_t position, double time_s, bool closing = false) {
    const std::vector<StoredReading> readings = late_readings(20, time_s);
    file.append_dwell(position, dwell_of(readings, closing), readings, {1.0, 1.0, 1.0, 1.0});
  }
  /// Writes the run again as version 4 would have.
  void as_version_4() const {
    const std::filesystem::path now = folder / "now.run";
    std::filesystem::rename(path, now);
    {
      SqliteDatabase old(path, SqliteDatabase::Mode::kCreate);
      create_run_schema(old, 4);
      old.execute("attach '" + now.string() + "' as now");
      for (const std::string table :
           {"meta", "instrument", "item", "plan", "session", "event", "dwell", "reading"}) {
        const std::string columns = *old.value("select group_concat(name) from pragma_table_info('" + table +
                                               "') where name <> 'skipped'");
        old.execute("insert into main." + table + "(" + columns + ") select " + columns + " from now." +
                    table);
      }
      old.execute(
          "update main.reading set skipped = coalesce((select g.skipped from now.reading_gap g where g.dwell "
          "= "
          "main.reading.dwell and g.k <= main.reading.k order by g.k desc limit 1), 0)");
    }
    test::rebuild_chain(path);
  }
  SqliteDatabase reader() const { return {path, SqliteDatabase::Mode::kReadOnly}; }
  /// The finding of `verify` on a subject.
  IntegrityCheck found(const std::string& what) const { return found(what, path); }
  static IntegrityCheck found(const std::string& what, const std::filesystem::path& run) {
    for (const IntegrityCheck& check : verify_run(run))
      if (check.what == what) return check;
    return {};
  }

  test::TemporaryFolder folder;
  std::filesystem::path path = folder / "a.run";
};

TEST_F(RunFile3Test, NamesItsSchemaAndVersion) {
  { RunFile::create(path, plan_of_two()); }
  EXPECT_EQ(reader().value("select value from meta where key = 'schema'"), "abcal.run/6");
  EXPECT_EQ(reader().value("pragma user_version"), "6");
}

TEST_F(RunFile3Test, APauseIsInTheTimesOfTheRun) {
  {
    RunFile file = RunFile::create(path, plan_of_two());
    file.begin_session(start_after(0s));
    EXPECT_EQ(file.time_s(kMonotonic + 8670ms), 8.67);
    append(file, 0, file.time_s(kMonotonic + 8670ms));
    file.set_state(RunState::kInterrupted, "2026-11-22T08:00:10.000Z", Message("stopped by the operator"));
  }
  {
    RunFile file = RunFile::open_for_append(path);
    file.begin_session(start_after(55s));
    EXPECT_EQ(file.time_s(kMonotonic + 57580ms), 57.58);
    EXPECT_EQ(format_utc(file.utc(kMonotonic + 57580ms)), "2026-11-22T08:00:57.580Z");
    append(file, 1, file.time_s(kMonotonic + 57580ms), true);
  }
  const StoredRun run = RunFile::load(path);
  ASSERT_EQ(run.record.dwells.size(), 2U);
  EXPECT_NEAR(*run.record.dwells[0].time_s, 8.77, 0.01);
  EXPECT_NEAR(*run.record.dwells[1].time_s, 57.68, 0.01);
  ASSERT_EQ(run.sessions.size(), 2U);
  EXPECT_EQ(run.sessions[0].end_reason, "stopped by the operator");
  EXPECT_EQ(run.sessions[1].origin_s, 55.0);
  EXPECT_EQ(run.sessions[1].ended_utc, "") << "it is under way, or its program was killed";
  EXPECT_EQ(run.sessions[1].program_version, "0.2.0");
  // Nanoseconds since the beginning of the session, and UTC, by plain SQL.
  EXPECT_EQ(reader().value("select min(time_ns) / 1000000000 from timed_reading where dwell = 2"), "2");
  EXPECT_THAT(reader().value("select utc from dwell where id = 2").value(),
              testing::StartsWith("2026-11-22T08:00:57.6"));
  EXPECT_EQ(reader().value("select count(*) from event where kind = 'clock step'"), "0");
}

TEST_F(RunFile3Test, AClockThatWasMovedInAPauseIsAnEventAndTheTimesStayTrue) {
  for (const Clock::Duration moved : {Clock::Duration(-1h), Clock::Duration(1h)}) {
    std::filesystem::remove(path);
    {
      RunFile file = RunFile::create(path, plan_of_two());
      file.begin_session(start_after(0s));
      append(file, 0, 10.0);
    }
    RunFile file = RunFile::open_for_append(path);
    file.begin_session(start_after(60s, "boot-1", moved));
    EXPECT_EQ(file.time_s(kMonotonic + 60s), 60.0);
    EXPECT_GT(file.utc(kMonotonic + 60s), kMorning) << "completed must not be before started";
    EXPECT_EQ(reader().value("select count(*) from event where kind = 'clock step'"), "1");
    EXPECT_THAT(reader().value("select text from event where kind = 'clock step'").value(),
                HasSubstr(moved < 0s ? "-3600" : "+3600"));
  }
}

TEST_F(RunFile3Test, AfterTheComputerWasStartedAgainUtcTellsThePause) {
  {
    RunFile file = RunFile::create(path, plan_of_two());
    file.begin_session(start_after(0s));
    append(file, 0, 10.0);
  }
  RunFile file = RunFile::open_for_append(path);
  SessionStart again = start_after(7200s, "boot-2");
  again.host.since_boot = 30s;
  file.begin_session(again);
  EXPECT_EQ(file.time_s(*again.monotonic), 7200.0);
  EXPECT_EQ(reader().value("select count(*) from event where kind = 'clock step'"), "0");
}

TEST(ClockWatchTest, FindsAStepAndNothingInASlewOrALongWait) {
  ClockPair now{kMorning, 0s};
  ClockWatch watch(now);
  const auto go_on = [&](Clock::Duration monotonic, Clock::Duration utc) {
    now.monotonic += monotonic;
    now.utc += utc;
    return watch.find_step(now);
  };
  EXPECT_EQ(go_on(60s, 60s), std::nullopt);
  EXPECT_EQ(go_on(60s, 60s + 30ms), std::nullopt) << "500 parts in a million";
  EXPECT_EQ(go_on(24h, 24h + 43s), std::nullopt);
  EXPECT_THAT(go_on(60s, 60s + 1h).value(), HasSubstr("+3600.000 s"));
  EXPECT_EQ(go_on(60s, 60s), std::nullopt) << "one step is told once";
  EXPECT_THAT(go_on(60s, 60s - 1h).value(), HasSubstr("-3600.000 s"));
}

TEST_F(RunFile3Test, GivesBackEveryReadingBitForBit) {
  std::vector<StoredReading> readings = late_readings(500, 3000.0);
  readings[7].temperature_degc.reset();
  readings[9].output[1] = std::nan("");
  readings[11].temperature_degc = 22.123456789012345;  // More digits than the others.
  readings[12].temperature_degc = -0.1;
  {
    RunFile file = RunFile::create(path, plan_of_two());
    file.begin_session(start_after(0s));
    file.append_dwell(0, dwell_of(late_readings(500, 3000.0)), readings, {});
  }
  std::size_t dwells = 0;
  RunFile::read_dwells(path, [&](const StoredDwell& dwell) {
    ++dwells;
    ASSERT_EQ(dwell.readings.size(), readings.size());
    for (std::size_t k = 0; k < readings.size(); ++k) {
      EXPECT_EQ(dwell.readings[k].sequence, readings[k].sequence) << k;
      EXPECT_EQ(dwell.readings[k].time_s, readings[k].time_s) << k;
      EXPECT_EQ(dwell.readings[k].temperature_degc, readings[k].temperature_degc) << k;
      for (int j = 0; j < 3; ++j) {
        if (std::isnan(readings[k].output[j])) {
          EXPECT_TRUE(std::isnan(dwell.readings[k].output[j])) << k;
        } else {
          EXPECT_EQ(dwell.readings[k].output[j], readings[k].output[j]) << k;
        }
      }
    }
  });
  EXPECT_EQ(dwells, 1U);
}

TEST_F(RunFile3Test, TheLinkOfADwellIsThatOfWhatIsStored) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  RunFile file = RunFile::create(path, plan_of_two());
  std::vector<std::vector<StoredReading>> dwells{{}};
  for (const std::size_t count : {1, 49, 50, 51, 123}) dwells.push_back(late_readings(count, 5.0));
  std::vector<StoredReading>& odd = dwells.back();
  odd[3].output = {-0.0, 2.0, -3.0};  // Whole numbers, which SQLite keeps in fewer bytes.
  odd[4].output = {std::numeric_limits<double>::quiet_NaN(), kInfinity, -kInfinity};
  odd[5].output = {1e300, -5e-324, 9007199254740993.0};
  odd[6].temperature_degc = std::nullopt;
  odd[7].temperature_degc = kInfinity;
  dwells.push_back(odd);
  dwells.back()[8].temperature_degc = 1e-300;  // No step fits all.
  dwells.back()[9].temperature_degc = -0.0;
  for (const std::vector<StoredReading>& readings : dwells)
    file.append_dwell(0, readings.empty() ? DwellRecord() : dwell_of(readings), readings, {});
  SqliteDatabase run = reader();
  std::string link = head_link(run);
  SqliteStatement rows = run.prepare("select id, chain from dwell order by id");
  for (std::size_t k = 0; k < dwells.size(); ++k) {
    ASSERT_TRUE(rows.step());
    link = dwell_link(run, rows.integer("id"), link);
    EXPECT_EQ(rows.text("chain"), link) << dwells[k].size() << " readings";
  }
}

/// Everything that the links of a run cover, as one text.
std::string all_links(const std::filesystem::path& path) {
  SqliteDatabase run(path, SqliteDatabase::Mode::kReadOnly);
  std::string links = head_link(run), link = links;
  SqliteStatement rows = run.prepare("select id from dwell order by id");
  while (rows.step()) links += link = dwell_link(run, rows.integer(0), link);
  return links + closing_link(run);
}

// The links name no column to protect: they cover what is there.
TEST_F(RunFile3Test, EachColumnOfEachTableIsInALink) {
  RunHeader header = plan_of_two();
  header.plan[1].sweep = 1;
  header.instruments.push_back({"stage", "Maker", "M", "1", "2", "details"});
  {
    RunFile file = RunFile::create(path, header);
    file.begin_session(start_after(0s));
    file.keep_transcript(kMorning, [] { return std::vector<WireRow>{{"stage", 1, 2, '<', "bytes"}}; });
    file.append_event("2026-11-22T08:00:00.000Z", "started", Message("measured by {who}", "A. B."));
    file.append_environment("2026-11-22T08:00:00.000Z", "start", 23.0, 45.0, 1013.0);
    append(file, 0, 1.0);
    const std::vector<StoredReading> readings = late_readings(20, 2.0);
    DwellRecord passed = dwell_of(readings);
    passed.motion = DwellMotion{1, 60.0, 200.0, 1e-3};
    file.append_sweep(std::vector<PassedAngle>{{1, {{1, passed, readings, {{2.0, 0.1}}}}}}, {});
    file.drop_item(1, 2, "2026-11-22T08:00:10.000Z", Message("unplugged"));
    file.close_complete("2026-11-22T08:01:00.000Z", {});
  }
  std::filesystem::permissions(path, std::filesystem::perms::owner_write, std::filesystem::perm_options::add);
  {
    SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite)
        .execute("insert into item_register values(1, 'bias', '1')");
  }
  const std::string before = all_links(path);
  const std::filesystem::path changed = folder / "changed.run";
  std::size_t columns = 0;
  SqliteDatabase run = reader();
  SqliteStatement rows = run.prepare(
      "select m.name, c.name from sqlite_master m join pragma_table_info(m.name) c where m.type = 'table' "
      "and m.name "
      "<> 'witness'");
  while (rows.step()) {
    const std::string table = rows.text(0), column = rows.text(1);
    if (table == "dwell" && column == "chain") continue;  // It is the link.
    if (table == "encoder_sample" || table == "reading_gap" || table == "seal") ++columns;
    EXPECT_NE(run.value("select count(*) from " + table), "0") << table << " has no row to be changed";
    std::filesystem::copy_file(path, changed, std::filesystem::copy_options::overwrite_existing);
    SqliteDatabase(changed, SqliteDatabase::Mode::kReadWrite)
        .execute(fmt::format(
            "update {0} set {1} = case typeof({1}) when 'integer' then {1} + 1000 when 'real' then {1} "
            "+ 1.0 when 'blob' then x'00' else coalesce({1}, '') || '1' end",
            table, column));
    EXPECT_NE(all_links(changed), before) << table << "." << column;
  }
  EXPECT_EQ(columns, 4U + 3U + 8U) << "the tables were there";
}

TEST_F(RunFile3Test, ARowOfNothingIsFound) {
  {
    RunFile file = RunFile::create(path, plan_of_two());
    append(file, 0, 1.0);
  }
  EXPECT_TRUE(found("references").good);
  SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite)
      .execute("insert into reading values(77, 0, 1, 2, 3, 0, null)");
  EXPECT_THAT(found("references").found, HasSubstr("reading of no dwell"));
}

TEST_F(RunFile3Test, AnAngleWaitsForTheDiskUnlessItCanBeMadeAgain) {
  const CountedFlushes counted;
  for (const bool repeatable : {false, true}) {
    path = folder / (repeatable ? "repeatable.run" : "real.run");
    RunFile file = RunFile::create(path, plan_of_two());
    SessionStart start = start_after(0s);
    start.repeatable = repeatable;
    file.begin_session(start);
    int before = CountedFlushes::count();
    append(file, 0, 5.0);
    EXPECT_EQ(CountedFlushes::count() > before, !repeatable);
    EXPECT_EQ(reader().value("select count(*) from reading"), "20") << "another program sees it";
    before = CountedFlushes::count();
    file.append_event("2026-11-22T08:00:10.000Z", "note", Message("a person has seen it"));
    EXPECT_GT(CountedFlushes::count(), before) << "what was done by a person is not made again";
  }
}

TEST(TemperatureScaleTest, FitsEveryValueOrSaysThatNoneDoes) {
  const auto scale = [](std::vector<std::optional<double>> values) {
    std::vector<StoredReading> readings(values.size());
    for (std::size_t k = 0; k < values.size(); ++k) readings[k].temperature_degc = values[k];
    return temperature_scale(readings);
  };
  EXPECT_FALSE(scale({}).has_value());
  EXPECT_FALSE(scale({std::nullopt, std::nan("")}).has_value());
  EXPECT_EQ(scale({23.0625, 23.125})->step_degc, 0.0625);
  EXPECT_EQ(scale({0.0, 0.0})->step_degc, 1.0);
  EXPECT_TRUE(scale({22.1, 22.3})->whole);
  EXPECT_FALSE(scale({22.3, -40.7})->whole) << "more steps than a double has digits";
  EXPECT_FALSE(scale({1e-300, 25.0})->whole);
}

TEST_F(RunFile3Test, AReadingTakesAtMostFiftyBytesOnTheDisk) {
  constexpr std::size_t kManyReadings = 200'000;
  const auto size = [&](std::size_t readings) {
    std::filesystem::remove(path);
    std::filesystem::remove(ResultsFile::path_beside(path));
    RunFile file = RunFile::create(path, plan_of_two());
    file.begin_session(start_after(0s));
    const std::vector<StoredReading> all = late_readings(readings, 1.0);
    // In dwells of 1000, as in a run, whose ids need two bytes.
    for (std::size_t begin = 0; begin < readings; begin += 1000) {
      const std::vector<StoredReading> some(all.begin() + static_cast<std::ptrdiff_t>(begin),
                                            all.begin() + static_cast<std::ptrdiff_t>(begin + 1000));
      file.append_dwell(0, dwell_of(some), some, {});
    }
    file.close_complete("2026-11-22T09:00:00.000Z", {});
    return static_cast<double>(std::filesystem::file_size(path));
  };
  const double without_readings = size(1000);
  const double bytes = (size(kManyReadings) - without_readings) / static_cast<double>(kManyReadings - 1000);
  RecordProperty("bytes_per_reading", std::to_string(bytes));
  EXPECT_LE(bytes, 50.0);
  EXPECT_GT(bytes, 24.0) << "three numbers of eight bytes";
}

TEST_F(RunFile3Test, SaysWhyAnAngleWasMeasured) {
  RunFile file = RunFile::create(path, plan_of_two());
  append(file, 0, 1.0);
  append(file, 1, 2.0, true);
  append(file, 1, 3.0, true);  // Measured again after an interruption.
  DwellRecord back = dwell_of(late_readings(20, 4.0));
  back.role = DwellRole::kReturn;
  file.append_dwell(0, back, late_readings(20, 4.0), {});
  EXPECT_EQ(reader().value("select group_concat(role) from (select role from dwell order by id)"),
            "plan,closing,check,return");
  const StoredRun run = RunFile::load(path);
  ASSERT_EQ(run.record.dwells.size(), 2U) << "the first dwell of an angle counts";
  EXPECT_EQ(run.record.dwells[0].role, DwellRole::kPlan);
  EXPECT_EQ(run.record.dwells[1].role, DwellRole::kClosing);
}

TEST_F(RunFile3Test, KeepsTheItemAndItsCorrectionRegisters) {
  RunHeader header = plan_of_two();
  RunItem item;
  item.model = "VN-100";
  item.driver = "vectornav";
  item.port = "usb:0403:6001:FT1";
  item.mounting = "on the plate, connector up";
  item.resolution = 1e-5;
  item.registers = {{"23 accelerometer compensation", "1,0,0,0,1,0,0,0,1,0,0,0"}};
  header.items = {item};
  { RunFile::create(path, header); }
  const StoredRun run = RunFile::load(path);
  ASSERT_EQ(run.header.items.size(), 1U);
  EXPECT_EQ(run.header.items[0].model, "VN-100");
  EXPECT_EQ(run.header.items[0].resolution, 1e-5);
  EXPECT_EQ(run.header.items[0].full_scale, std::nullopt);
  EXPECT_EQ(run.header.items[0].registers, item.registers);
  EXPECT_EQ(reader().value("select mounting from item where k = 1"), "on the plate, connector up");
}

TEST_F(RunFile3Test, AChangedReadingDwellSessionOrPlanBreaksTheChain) {
  {
    RunFile file = RunFile::create(path, plan_of_two());
    file.begin_session(start_after(0s));
    append(file, 0, 1.0);
    file.append_event("2026-11-22T08:00:00.000Z", "note", Message("before the second angle"));
    file.append_environment("2026-11-22T08:00:00.000Z", "start", 23.0, 45.0, std::nullopt);
    append(file, 1, 2.0, true);
  }
  EXPECT_TRUE(found("dwells").good) << found("dwells").found;
  for (const char* sql :
       {"update event set chain = 'x'", "delete from event", "update environment set humidity_percent = 50",
        "delete from environment", "update dwell set u_angle_deg = 0 where id = 1",
        "update plan set rate_deg_per_s = 1 where position = 0",
        "update reading set u = u + 1e-9 where dwell = 1 and k = 3",
        "delete from reading where dwell = 1 and k = 19", "update reading_gap set skipped = 4",
        "delete from reading_gap", "update dwell set r_u = r_u + 1e-9 where id = 1",
        "update session set begun_utc_ns = begun_utc_ns + 1",
        "update plan set alpha_deg = 1.0 where position = 0", "update item set serial_number = '78'",
        "update meta set value = '9.9' where key = 'g_loc.value_mps2'",
        "insert into item_register values(1, 'bias', '0.1')", "delete from dwell where id = 1"}) {
    SCOPED_TRACE(sql);
    const std::filesystem::path changed = folder / "changed.run";
    std::filesystem::copy_file(path, changed, std::filesystem::copy_options::overwrite_existing);
    {
      SqliteDatabase database(changed, SqliteDatabase::Mode::kReadWrite);
      database.execute("pragma journal_mode=delete");
      database.execute(sql);
    }
    EXPECT_FALSE(found("dwells", changed).good);
  }
}

// Files of version 4 lack the columns `face`, and have the losses in a column of `reading`. Face 1 adds
// nothing to the links, and a loss the same as before, so that they stay valid.
TEST_F(RunFile3Test, AFileOfVersion4IsReadAsItIsAndGoesOnInOneFace) {
  const std::vector<StoredReading> readings = late_readings(20, 1.0);
  {
    RunFile file = RunFile::create(path, plan_of_two());
    file.begin_session(start_after(0s));
    append(file, 0, 1.0);
  }
  EXPECT_EQ(reader().value("select group_concat(k || ' ' || skipped) from reading_gap"), "11 3");
  as_version_4();
  const auto expect_one_face = [&](std::size_t dwells) {
    const StoredRun run = RunFile::load(path);
    ASSERT_EQ(run.record.dwells.size(), dwells);
    for (const DwellRecord& dwell : run.record.dwells) EXPECT_EQ(dwell.face, 1);
    for (const PlannedAngle& angle : run.header.plan) EXPECT_EQ(angle.face, 1);
    EXPECT_TRUE(found("dwells").good) << found("dwells").found;
    bool first = true;
    RunFile::read_dwells(path, [&](const StoredDwell& dwell) {
      if (!std::exchange(first, false)) return;
      for (std::size_t k = 0; k < 20; ++k) EXPECT_EQ(dwell.readings[k].sequence, readings[k].sequence) << k;
    });
  };
  expect_one_face(1);
  EXPECT_EQ(reader().value("pragma user_version"), "4");
  {
    RunFile file = RunFile::open_for_append(path);
    file.begin_session(start_after(60s));
    append(file, 1, 2.0, true);
  }
  EXPECT_EQ(reader().value("pragma user_version"), "5");
  expect_one_face(2);
}

TEST_F(RunFile3Test, ResultsOfAnotherRunAreRefusedBeforeTheFirstMove) {
  std::ofstream(path.string() + ".results") << "precious";
  const auto refusal = [](const std::function<void()>& action) {
    try {
      action();
    } catch (const RunFileError& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_THAT(refusal([&] { RunFile::create(path, plan_of_two()); }),
              testing::AllOf(HasSubstr("a.run.results"), HasSubstr("another run"), HasSubstr("-o")));
  EXPECT_FALSE(std::filesystem::exists(path));
  std::filesystem::rename(path.string() + ".results", folder / "away");
  { RunFile::create(path, plan_of_two()); }
  std::filesystem::rename(folder / "away", path.string() + ".results");
  EXPECT_THAT(refusal([&] { RunFile::open_for_append(path); }), HasSubstr("another run"));
}

TEST_F(RunFile3Test, ACompleteRunCanBeAnalysedBeforeItIsClosed) {
  RunFile file = RunFile::create(path, plan_of_two());
  append(file, 0, 1.0);
  file.complete("2026-11-22T09:00:00.000Z", {});
  {
    SqliteDatabase other = reader();
    EXPECT_EQ(other.value("select count(*) from dwell"), "1");
    EXPECT_EQ(RunFile::load(path).state, RunState::kComplete);
    EXPECT_EQ(file.close([](int) { return false; }), std::nullopt);
  }
  EXPECT_FALSE(RunFile::is_closed(path));
  EXPECT_EQ(file.close()->size(), 64U);
  EXPECT_TRUE(RunFile::is_closed(path));
  // A writable copy counts as closed as well, and closing it changes no byte.
  using std::filesystem::perms;
  std::filesystem::copy_file(path, folder / "copy.run");
  std::filesystem::permissions(folder / "copy.run", perms::owner_read | perms::owner_write);
  EXPECT_EQ(RunFile::finish_closing(folder / "copy.run"), sha256_of_file(path));
  EXPECT_TRUE(found("dwells").good) << found("dwells").found;
  EXPECT_THAT(found("dwells").found, HasSubstr("sealed"));
}

TEST_F(RunFile3Test, VerifyComputesAgainWhatDwellsState) {
  const std::vector<StoredReading> readings = late_readings(200, 1.0);
  const auto verdict = [&](const std::function<void(DwellRecord&)>& falsify) {
    std::filesystem::remove(path);
    RunFile file = RunFile::create(path, plan_of_two());
    DwellRecord dwell = dwell_of(readings);
    falsify(dwell);
    file.append_dwell(0, dwell, readings, {});
    EXPECT_TRUE(found("dwells").good);  // The chain cannot know: it was written so.
    return found("readings");
  };
  EXPECT_TRUE(verdict([](DwellRecord&) {}).good);
  EXPECT_THAT(verdict([](DwellRecord&) {}).found, HasSubstr("200 readings"));
  EXPECT_THAT(verdict([](DwellRecord& d) { d.mean[1] += 1e-10; }).found, HasSubstr("its mean"));
  EXPECT_THAT(verdict([](DwellRecord& d) { d.spread[2] *= 1.0001; }).found, HasSubstr("its spread"));
  EXPECT_THAT(verdict([](DwellRecord& d) { (*d.u_mean)[0] *= 0.99; }).found,
              HasSubstr("standard uncertainty"));
  EXPECT_THAT(verdict([](DwellRecord& d) { d.count -= 1; }).found, HasSubstr("number of readings"));
  EXPECT_THAT(verdict([](DwellRecord& d) { d.flags = 0; }).found, HasSubstr("lost readings"));
  EXPECT_FALSE(verdict([](DwellRecord& d) { d.flags |= kFlagNotFinite; }).good);
}

TEST_F(RunFile3Test, ResultsThatWereLostAreMadeAgainAndSaySo) {
  std::string hash;
  {
    RunFile file = RunFile::create(path, plan_of_two());
    append(file, 0, 1.0);
    hash = file.close_complete("2026-11-22T09:00:00.000Z", {});
    EXPECT_FALSE(ResultsFile(path, hash).made_again());
  }
  EXPECT_THAT(found("results file").found, Not(HasSubstr("again")));
  std::filesystem::remove(ResultsFile::path_beside(path));
  EXPECT_THAT(found("SHA-256").found, HasSubstr("missing"));
  EXPECT_TRUE(ResultsFile(path, hash).made_again());
  EXPECT_FALSE(ResultsFile(path, hash).made_again()) << "told once";
  EXPECT_TRUE(found("results file").good);
  EXPECT_THAT(found("results file").found, HasSubstr("made again"));
  EXPECT_THAT(attested_by(path), HasSubstr("neither a signature nor a time stamp"));
}

TEST_F(RunFile3Test, AnalysesOfManyProgramsAtOnceKeepOneChain) {
  std::string hash;
  {
    RunFile file = RunFile::create(path, plan_of_two());
    append(file, 0, 1.0);
    hash = file.close_complete("2026-11-22T09:00:00.000Z", {});
  }
  for (int round = 0; round < 40; ++round) {
    std::filesystem::remove(ResultsFile::path_beside(path));
    std::vector<std::jthread> programs;
    for (int program = 0; program < 4; ++program) {
      programs.emplace_back([&, program] {
        ResultsFile(path, hash)
            .add_analysis("2026-11-22T09:00:00.000Z", "0.2", "abc", std::to_string(program));
      });
    }
    programs.clear();
    const IntegrityCheck chain = found("analyses");
    ASSERT_TRUE(chain.good) << "round " << round << ": " << chain.found;
    ASSERT_THAT(chain.found, HasSubstr("4 entries"));
  }
}

}  // namespace
}  // namespace abcal
