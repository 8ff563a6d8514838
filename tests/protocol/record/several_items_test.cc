// A run file with several items: each is loaded as if it were alone, and an angle is there for all or none.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>

#include "protocol/record/reading_statistics.h"
#include "protocol/record/run_file.h"
#include "protocol/record/verify_run.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::HasSubstr;

/// Three angles, two items: one in g, one in m/s2 with its own limits.
RunHeader two_items() {
  RunHeader header;
  header.response_unit = "g";
  header.labels = {{"bench.name", "a"}, {"item.serial_number", "77"}, {"item.range", "2 g"}};
  header.instruments = {{"item-1", "A", "one", "77", "", ""},
                        {"item-2", "B", "two", "78", "", ""},
                        {"stage", "C", "three", "79", "", ""}};
  header.items.resize(2);
  header.items[0].serial_number = "77";
  header.items[1].k = 2;
  header.items[1].serial_number = "78";
  header.items[1].full_scale = 20.0;
  ItemFacts second;
  second.labels = {{"item.serial_number", "78"}};
  second.response_unit = "m/s2";
  second.tolerances.drift = 3e-5;
  second.limits.drift = 0.25;
  second.expected.mounting = "-x -y z";
  header.further_items = {second};
  for (int n = 1; n <= 3; ++n)
    header.plan.push_back({1, n, false, Angle::degrees(5.0 * (n - 1)), Angle{}, Angle{}});
  return header;
}

/// Dwell of an item at an angle: ten readings about its number.
ItemDwell dwell_of(int item, int n) {
  ItemDwell each{item, {}, {}};
  std::vector<Eigen::Vector3d> outputs;
  for (int k = 0; k < 10; ++k) {
    StoredReading reading;
    reading.sequence = static_cast<std::uint64_t>(k);
    reading.time_s = n + 0.01 * k;
    reading.output = Eigen::Vector3d(item, n, 0.001 * (k % 3));
    outputs.push_back(reading.output);
    each.readings.push_back(reading);
  }
  const ReadingStatistics statistics = reading_statistics(outputs, 0.0);
  each.dwell.experiment = 1;
  each.dwell.n = n;
  each.dwell.time_s = n;
  each.dwell.count = 10;
  each.dwell.mean = statistics.mean;
  each.dwell.spread = statistics.spread;
  each.dwell.u_mean = statistics.u_mean;
  return each;
}

class SeveralItemsFileTest : public testing::Test {
 protected:
  static void append(RunFile& file, std::size_t position, std::vector<int> items = {1, 2}) {
    std::vector<ItemDwell> dwells;
    for (const int item : items) dwells.push_back(dwell_of(item, static_cast<int>(position) + 1));
    file.append_dwells(position, dwells, {});
  }
  IntegrityCheck items_check() const {
    for (const IntegrityCheck& check : verify_run(path))
      if (check.what == "items") return check;
    return {};
  }
  void change(const std::string& sql) const {
    SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite).execute(sql);
  }

  test::TemporaryFolder folder;
  std::filesystem::path path = folder / "a.run";
};

TEST_F(SeveralItemsFileTest, LoadsEachItemAsIfItWereAlone) {
  {
    RunFile file = RunFile::create(path, two_items());
    append(file, 0);
    append(file, 1);
  }
  const StoredRun first = RunFile::load(path);
  EXPECT_EQ(first.record.response_unit, "g");
  EXPECT_EQ(first.header.labels.at("item.range"), "2 g");
  EXPECT_EQ(first.record.tolerances.drift, two_items().tolerances.drift);
  ASSERT_EQ(first.record.dwells.size(), 2U);
  EXPECT_EQ(first.record.dwells[1].mean[0], 1.0);
  const StoredRun second = RunFile::load(path, 2);
  EXPECT_EQ(second.item, 2);
  EXPECT_EQ(second.record.response_unit, "m/s2");
  EXPECT_EQ(second.header.labels,
            (std::map<std::string, std::string>{{"bench.name", "a"}, {"item.serial_number", "78"}}));
  EXPECT_EQ(second.record.tolerances.drift, 3e-5);
  EXPECT_EQ(second.record.limits.drift, 0.25);
  EXPECT_EQ(second.record.expected.mounting, "-x -y z");
  ASSERT_EQ(second.record.dwells.size(), 2U);
  EXPECT_EQ(second.record.dwells[1].mean[0], 2.0);
  EXPECT_EQ(second.record.dwells[1].role, DwellRole::kPlan) << "item 1 at this angle is no first measurement";
  ASSERT_EQ(second.header.instruments.size(), 2U);
  EXPECT_EQ(second.header.instruments[0].role, "accelerometer");
  EXPECT_EQ(second.header.instruments[0].model, "two");
  EXPECT_EQ(second.header.items.size(), 2U);
  for (const int none : {0, 3, -1}) EXPECT_THROW(RunFile::load(path, none), RunFileError);
}

TEST_F(SeveralItemsFileTest, SaysHowFarEachItemWasMeasured) {
  {
    RunFile file = RunFile::create(path, two_items());
    append(file, 0);
    append(file, 1);
    file.drop_item(2, 2, "2026-11-22T08:00:10.000Z", Message("item 2: no reading for 5 s"));
    append(file, 2, {1});
    file.close_complete("2026-11-22T08:01:00.000Z", {});
  }
  const StoredRun run = RunFile::load(path);
  ASSERT_EQ(run.items.size(), 2U);
  EXPECT_EQ(run.items[0].measured, 3U);
  EXPECT_FALSE(run.items[0].dropped_at);
  EXPECT_EQ(run.items[1].k, 2);
  EXPECT_EQ(run.items[1].measured, 2U);
  EXPECT_EQ(run.items[1].dropped_at, 2U);
  EXPECT_EQ(run.items[1].reason, "item 2: no reading for 5 s");
  for (const IntegrityCheck& check : verify_run(path)) {
    if (check.what == "SHA-256" || check.what == "analyses" || check.what == "results file") continue;
    EXPECT_TRUE(check.good) << check.what << ": " << check.found;
  }
  EXPECT_THAT(items_check().found, HasSubstr("2, of which 1 dropped"));
}

TEST_F(SeveralItemsFileTest, VerifyNoticesAnItemThatIsMissing) {
  {
    RunFile file = RunFile::create(path, two_items());
    append(file, 0);
    append(file, 1, {1});
  }
  EXPECT_FALSE(items_check().good);
  EXPECT_THAT(items_check().found, HasSubstr("item 2 has no readings at 1 of the angles"));
}

TEST_F(SeveralItemsFileTest, VerifyNoticesAChangedStatementOfAnEnd) {
  {
    RunFile file = RunFile::create(path, two_items());
    append(file, 0);
    file.drop_item(2, 1, "2026-11-22T08:00:10.000Z", Message("item 2: unplugged"));
    append(file, 1, {1});
  }
  EXPECT_TRUE(items_check().good) << items_check().found;
  change("update item_drop set position = 0");
  EXPECT_THAT(items_check().found, HasSubstr("after it was dropped"));
  change("update item_drop set position = 1");
  change("insert into item_drop values(1, 2, 1)");
  EXPECT_THAT(items_check().found, HasSubstr("2 items are stated to be dropped, the events state 1"));
}

TEST_F(SeveralItemsFileTest, AnAngleIsThereForAllItemsOrForNone) {
  {
    RunFile file = RunFile::create(path, two_items());
    append(file, 0);
    // Simulates a disk that fails between two items.
    change(
        "create trigger full before insert on dwell when new.item = 2 and new.position = 1"
        " begin select raise(abort, 'disk is full'); end");
    EXPECT_THROW(append(file, 1), RunFileError);
    change("drop trigger full");
    append(file, 1);
  }
  const StoredRun run = RunFile::load(path);
  EXPECT_EQ(run.items[0].measured, 2U);
  EXPECT_EQ(run.items[1].measured, 2U);
  EXPECT_EQ(run.record.dwells.size(), 2U);
  EXPECT_TRUE(items_check().good) << items_check().found;
}

TEST_F(SeveralItemsFileTest, OneItemIsStoredAsBefore) {
  const auto chain = [&](const char* name, const auto& write) {
    RunHeader header;
    header.plan = two_items().plan;
    {
      RunFile file = RunFile::create(folder / name, header);
      write(file);
    }
    SqliteDatabase database(folder / name, SqliteDatabase::Mode::kReadOnly);
    EXPECT_EQ(database.value("select count(*) from sqlite_master where name = 'item_drop'"), "0");
    return database.value("select chain from dwell order by id desc limit 1").value_or("none");
  };
  const ItemDwell one = dwell_of(1, 1);
  EXPECT_EQ(chain("single.run", [&](RunFile& file) { file.append_dwell(0, one.dwell, one.readings, {}); }),
            chain("list.run", [&](RunFile& file) { file.append_dwells(0, std::array{one}, {}); }));
}

}  // namespace
}  // namespace abcal
