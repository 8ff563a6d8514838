// A run of several items from its measurement to its certificates, by the program.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/laboratory/certificate/dsi_list.h"
#include "app/system/version.h"
#include "protocol/record/run_file.h"
#include "protocol/record/run_seal.h"
#include "protocol/record/sha256.h"
#include "protocol/record/sqlite.h"
#include "tests/app/bench_text.h"
#include "tests/support/h5py_check.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/test_data.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

constexpr int kItems = 3;

std::string tray_bench(int seed = 11) {
  std::string text = R"([bench]
name = "bench 1"
g_loc_mps2 = 9.80101
g_loc_expanded_uncertainty_mps2 = 0.00003
g_loc_k = 2.0
g_loc_source = "survey of 2025, EX-GRAV-7"
[operator]
name = "Operator N. N."
[stage]
driver = "pi_gcs"
port = "simulated"
[environment]
temperature_degc = 23.0
)" + quick_calibration(fmt::format("seed = {}\n", seed));
  for (int k = 1; k <= kItems; ++k)
    text += fmt::format(
        "[[item]]\nmaker = \"MicroStrain\"\nmodel = \"3DM-GV7-AR\"\nserial_number = \"SN-{0}\"\n"
        "[item.accelerometer]\ndriver = \"microstrain_mip\"\nport = \"simulated\"\nrate_hz = 200.0\n"
        "serial_number = \"SN-{0}\"\n",
        k);
  return text;
}

/// One run for all tests of the suite, each with a copy of its own.
class TrayRunTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    shared_ = new test::TemporaryFolder;
    test::write_file(*shared_ / "bench.toml", tray_bench());
    const test::ProgramResult made =
        test::run_program({"run", "bench.toml", "-o", "a.run", "--json"}, shared_->path());
    ASSERT_EQ(made.exit_code, 0) << made.err;
    told_ = made.out;
  }
  static void TearDownTestSuite() {
    delete shared_;
    shared_ = nullptr;
  }
  void SetUp() override {
    for (const std::string name : {"a.run", "a.run.results"})
      std::filesystem::copy_file(*shared_ / name, folder / name);
  }

  test::ProgramResult abcal(const std::vector<std::string>& arguments) const {
    return test::run_program(arguments, folder.path());
  }
  json json_of(const std::vector<std::string>& arguments) const {
    const test::ProgramResult result = abcal(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return json::parse(result.out);
  }
  /// Output of the run at its end.
  static json told() { return json::parse(told_); }
  /// Results of an item by an estimator in RUN.results.
  std::vector<json> stored(int item, const std::string& estimator) const {
    std::vector<json> found;
    for (const StoredAnalysis& one : stored_analyses(folder / "a.run")) {
      json result = json::parse(one.result_json);
      if (one.estimator == estimator && result.value("item", 0) == item) found.push_back(std::move(result));
    }
    return found;
  }

  test::TemporaryFolder folder;

 private:
  static inline test::TemporaryFolder* shared_ = nullptr;
  static inline std::string told_;
};

TEST_F(TrayRunTest, ResultsFileHoldsWhatWasTold) {
  const json run = told();
  const json analysed = json_of({"analyse", "a.run", "--json"});
  (void)json_of({"analyse", "a.run", "--item", "2", "--json"});
  for (int k = 1; k <= kItems; ++k) {
    std::vector<json> kept = stored(k, "joint");
    ASSERT_EQ(kept.size(), 1U) << "item " << k;  // A repeated result is not stored again.
    kept.front().erase("item");
    const auto at = static_cast<std::size_t>(k - 1);
    EXPECT_EQ(kept.front(), run["items"][at]["result"]) << k;
    EXPECT_EQ(kept.front(), analysed["items"][at]["result"]) << k;
    EXPECT_EQ(stored(k, "abc").size(), 1U) << k;
  }
  const test::ProgramResult verified = abcal({"verify", "a.run"});
  EXPECT_EQ(verified.exit_code, 0) << verified.out;
  EXPECT_THAT(verified.out, HasSubstr("item 2, results: 3 analyses recomputed"));
}

TEST_F(TrayRunTest, VerifyRecomputesTheCommonFit) {
  // The result of item 2 alone differs from the stored one.
  json wrong = stored(2, "joint").at(0);
  wrong["offset"][0]["standard_uncertainty"] = 1.5 * wrong["offset"][0]["standard_uncertainty"].get<double>();
  const std::filesystem::path run = folder / "a.run";
  ResultsFile(run, sha256_of_file(run))
      .add_analysis("2026-03-01T12:00:00.000Z", program_version(), "joint", wrong.dump());
  const test::ProgramResult verified = abcal({"verify", "a.run"});
  EXPECT_EQ(verified.exit_code, 1);
  EXPECT_THAT(verified.out, AllOf(HasSubstr("item 2, results: the analysis joint"),
                                  HasSubstr("item 1, results: 3 analyses recomputed")));
}

TEST_F(TrayRunTest, EachItemHasACertificateOfItsOwn) {
  const test::TrainingRegister registered(folder.path());
  test::write_file(folder / "lab.toml",
                   test::read_file(test::source_folder() / "docs/examples/laboratory.toml"));
  const auto issue = [&](std::vector<std::string> more) {
    more.insert(more.begin(), {"issue", "a.run", "--laboratory", "lab.toml"});
    return abcal(more);
  };
  const test::ProgramResult of_none = issue({});
  EXPECT_EQ(of_none.exit_code, 2);
  EXPECT_THAT(of_none.err, HasSubstr("has 3 items; required: --item 1 to 3"));
  EXPECT_EQ(issue({"--item", "4"}).exit_code, 2);

  const test::ProgramResult second = issue({"--item", "2", "--dcc", "2.xml"});
  ASSERT_EQ(second.exit_code, 0) << second.err;
  EXPECT_THAT(second.out, HasSubstr(", item 2: measured by"));
  const std::string number = test::number_of(second.out);
  EXPECT_THAT(issue({"--item", "2"}).err, HasSubstr("--replaces " + number));
  // The certificate of another item cannot be replaced.
  EXPECT_THAT(
      issue({"--item", "1", "--replaces", number, "--reason", "none", "--amendment", "administrative"}).err,
      HasSubstr("another item of"));
  const test::ProgramResult first = issue({"--item", "1"});
  ASSERT_EQ(first.exit_code, 0) << first.err;
  const test::ProgramResult amended =
      issue({"--item", "2", "--replaces", number, "--reason", "customer's address", "--amendment",
             "administrative", "--dcc", "2b.xml"});
  ASSERT_EQ(amended.exit_code, 0) << amended.err;

  const test::ProgramResult verified = abcal({"verify", "a.run"});
  EXPECT_EQ(verified.exit_code, 0) << verified.out;
  EXPECT_THAT(
      verified.out,
      AllOf(HasSubstr("item 1, certificates: " + test::number_of(first.out)),
            HasSubstr("item 2, certificates: " + number + ", replaced by " + test::number_of(amended.out)),
            HasSubstr("certificate " + number + ": replaced, approved by Approver N. N."),
            Not(HasSubstr("item 3, certificates"))));
  ASSERT_EQ(abcal({"report", "a.run", "--item", "2", "--dcc", "now.xml"}).exit_code, 0);
  EXPECT_EQ(test::read_file(folder / "now.xml"), test::read_file(folder / "2b.xml"));
  EXPECT_THAT(abcal({"report", "a.run", "--item", "3"}).out, HasSubstr("Calibration report"));
  // The owner of an item reads nothing of another item's certificate.
  const std::string of_second = abcal({"report", "a.run", "--item", "2", "--json"}).out;
  EXPECT_THAT(of_second,
              AllOf(HasSubstr("item 2, certificates"), HasSubstr(test::number_of(amended.out)),
                    Not(HasSubstr("item 1, certificates")), Not(HasSubstr(test::number_of(first.out)))));

  SqliteDatabase(folder / "a.run.results", SqliteDatabase::Mode::kReadWrite)
      .execute("update certificate set item = 3 where number = '" + number + "'");
  const test::ProgramResult changed = abcal({"verify", "a.run"});
  EXPECT_EQ(changed.exit_code, 1);
  EXPECT_THAT(changed.out, HasSubstr("entry 1 of the certificate table"));
}

TEST_F(TrayRunTest, AnItemIsAnalysedByTheEstimatorThatTheRunDeclares) {
  std::string bench = tray_bench();
  const std::string section = "[protocol]\n";
  ASSERT_NE(bench.find(section), std::string::npos);
  bench.insert(bench.find(section) + section.size(), "estimator = \"abc\"\n");
  test::write_file(folder / "abc.toml", bench);
  ASSERT_EQ(abcal({"run", "abc.toml", "-o", "abc.run"}).exit_code, 0);
  const json declared = json_of({"analyse", "abc.run", "--item", "2", "--json"});
  EXPECT_EQ(declared["estimator"], "abc");
  EXPECT_EQ(declared, json_of({"analyse", "abc.run", "--item", "2", "--estimator", "abc", "--json"}));
  EXPECT_EQ(declared, json_of({"report", "abc.run", "--item", "2", "--json"})["results"][0]);
  EXPECT_EQ(json_of({"analyse", "abc.run", "--item", "2", "--estimator", "joint", "--json"})["estimator"],
            "joint");
}

TEST_F(TrayRunTest, AnItemIsComparedWithItsSimulatedTruth) {
  test::write_file(folder / "bench.toml", tray_bench());
  const test::ProgramResult third =
      abcal({"analyse", "a.run", "--item", "3", "--truth", "bench.toml", "--full"});
  EXPECT_EQ(third.exit_code, 0) << third.out;
  EXPECT_THAT(third.out, AllOf(HasSubstr("Compared with the simulated truth (joint estimator)"),
                               HasSubstr("Estimators side by side")));
  const test::ProgramResult all = abcal({"analyse", "a.run", "--truth", "bench.toml"});
  EXPECT_EQ(all.exit_code, 2);
  EXPECT_THAT(all.err, HasSubstr("a.run has 3 items; required: --item 1 to 3 as well"));
}

TEST_F(TrayRunTest, CertificateReportAndAnalysisOfAnItemAgree) {
  const json analysed = json_of({"analyse", "a.run", "--item", "2", "--json"});
  const json reported = json_of({"report", "a.run", "--item", "2", "--json"});
  EXPECT_EQ(reported["results"][0]["estimator"], "joint");
  EXPECT_EQ(reported["results"][0], analysed);
  test::write_file(folder / "lab.toml",
                   test::read_file(test::source_folder() / "docs/examples/laboratory.toml"));
  const test::ProgramResult draft =
      abcal({"report", "a.run", "--item", "2", "--draft", "--laboratory", "lab.toml", "--dcc", "draft.xml"});
  ASSERT_EQ(draft.exit_code, 0) << draft.err;
  const std::string xml = test::read_file(folder / "draft.xml");
  EXPECT_THAT(xml, AllOf(HasSubstr("SN-2"), Not(HasSubstr("SN-1")),
                         HasSubstr("Item 2 of 3 that were measured together on one stage"),
                         HasSubstr("estimated once, from the readings of 3 items")));
  std::string values, expanded;
  for (const json& angle : analysed["intrinsic_angle"]) {
    const RoundedValue rounded = rounded_value(angle["value"].get<double>(),
                                               2.0 * angle["standard_uncertainty"].get<double>(), "angle");
    values += (values.empty() ? "" : " ") + rounded.value;
    expanded += (expanded.empty() ? "" : " ") + rounded.expanded;
  }
  EXPECT_THAT(xml, AllOf(HasSubstr(">" + values + "<"), HasSubstr(">" + expanded + "<")));
}

/// Numbers of one column of a CSV with comments.
std::vector<double> column_of(const std::string& csv, const std::string& name) {
  std::istringstream lines(csv);
  std::vector<double> values;
  std::size_t at = std::string::npos;
  for (std::string line; std::getline(lines, line);) {
    if (line.starts_with('#')) continue;
    std::vector<std::string> cells;
    std::istringstream fields(line);
    for (std::string cell; std::getline(fields, cell, ',');) cells.push_back(cell);
    if (at == std::string::npos) {
      at = static_cast<std::size_t>(std::find(cells.begin(), cells.end(), name) - cells.begin());
      if (at == cells.size()) throw std::invalid_argument("no column " + name);
    } else {
      values.push_back(std::stod(cells.at(at)));
    }
  }
  return values;
}

TEST_F(TrayRunTest, ExportsOfAnItemHoldItsReadingsOnly) {
  ASSERT_EQ(abcal({"report", "a.run", "--item", "2", "--csv-raw", "raw.csv", "--hdf5", "a.h5"}).exit_code, 0);
  std::vector<double> of_second;
  RunFile::read_dwells(
      folder / "a.run",
      [&](const StoredDwell& dwell) {
        for (const StoredReading& reading : dwell.readings) of_second.push_back(reading.output[0]);
      },
      2);
  ASSERT_FALSE(of_second.empty());
  EXPECT_EQ(column_of(test::read_file(folder / "raw.csv"), "r_u"), of_second);
  test::write_file(folder / "raw.json", json(of_second).dump());
  test::write_file(folder / "check.py", R"(
import json, sys
try:
    import h5py
except ImportError:
    sys.exit(77)
with h5py.File("a.h5") as file:
    assert list(file["entry/readings/response"][:, 0]) == json.load(open("raw.json"))
    assert file["entry/sample/serial_number"][()].decode() == "SN-2"
print("good")
)");
  test::check_with_h5py(folder.path());
}

TEST_F(TrayRunTest, FilesOfTheWholeTrayHoldEveryItem) {
  const test::ProgramResult written =
      abcal({"report", "a.run", "--csv", "all.csv", "--csv-raw", "raw.csv", "--hdf5", "all.h5"});
  ASSERT_EQ(written.exit_code, 0) << written.err;
  const std::string averaged = test::read_file(folder / "all.csv");
  const std::vector<double> items = column_of(averaged, "item"), u = column_of(averaged, "r_u");
  std::vector<double> means, of_items;
  for (int k = 1; k <= kItems; ++k) {
    for (const DwellRecord& dwell : RunFile::load(folder / "a.run", k).record.dwells) {
      of_items.push_back(k);
      means.push_back(dwell.mean[0]);
    }
  }
  EXPECT_EQ(items, of_items);
  EXPECT_EQ(u, means);
  const std::string raw = test::read_file(folder / "raw.csv");
  std::vector<double> readings, of_readings;
  RunFile::read_dwells(folder / "a.run", [&](const StoredDwell& dwell) {
    for (const StoredReading& reading : dwell.readings) {
      of_readings.push_back(dwell.item);
      readings.push_back(reading.output[0]);
    }
  });
  EXPECT_EQ(column_of(raw, "item"), of_readings);
  EXPECT_EQ(column_of(raw, "r_u"), readings);
  // Readings of several items are no record of one.
  const test::ProgramResult read_again = abcal({"analyse", "all.csv"});
  EXPECT_NE(read_again.exit_code, 0);
  EXPECT_THAT(read_again.err, HasSubstr("one item in the whole file: `abcal report RUN --item K"));

  test::write_file(folder / "tray.json", abcal({"analyse", "a.run", "--json"}).out);
  test::write_file(folder / "check.py", R"(
import json, sys
try:
    import h5py
except ImportError:
    sys.exit(77)
tray = json.load(open("tray.json"))
with h5py.File("all.h5") as file:
    assert sorted(file) == ["item_1", "item_2", "item_3"], list(file)
    assert file.attrs["default"] == "item_1"
    for k, item in enumerate(tray["items"], 1):
        entry = file[f"item_{k}"]
        assert entry.attrs["NX_class"] == "NXentry"
        assert entry["sample/serial_number"][()].decode() == f"SN-{k}"
        assert list(entry["result_joint/offset"]) == [q["value"] for q in item["result"]["offset"]]
        rows = entry["averaged/count"][...].sum()
        assert entry["readings/response"].shape == (rows, 3)
    kept = json.loads(file["item_1/tray/data"][()].decode())
    assert kept["covariance_between_items"] == tray["covariance_between_items"]
)");
  test::check_with_h5py(folder.path());
}

TEST_F(TrayRunTest, AReplayGivesTheAnglesOfEveryItem) {
  // The third falls silent on the way.
  test::write_file(folder / "recorded.toml", tray_bench() +
                                                 "[[fault]]\nkind = \"no-output\"\n"
                                                 "instrument = \"item-3\"\nat_s = 6.0\n");
  (void)abcal({"run", "recorded.toml", "--record", "-o", "c.run"});
  const StoredRun first = RunFile::load(folder / "c.run");
  ASSERT_EQ(first.state, RunState::kComplete);
  ASSERT_TRUE(first.items.at(2).dropped_at);
  EXPECT_GT(first.items.at(2).measured, 0U);
  const test::ProgramResult replay = abcal({"replay", "c.run"});
  std::size_t angles = 0;
  for (int k = 1; k <= kItems; ++k) {
    const StoredRun recorded = RunFile::load(folder / "c.run", k);
    const StoredRun replayed = RunFile::load(folder / "c-replay.run", k);
    angles += recorded.measured.size();
    EXPECT_EQ(recorded.measured, replayed.measured) << k;
    ASSERT_EQ(recorded.dwells.size(), replayed.dwells.size()) << k;
    for (std::size_t i = 0; i < recorded.dwells.size(); ++i) {
      EXPECT_EQ(recorded.dwells[i].mean, replayed.dwells[i].mean) << k << " " << i;
      EXPECT_EQ(recorded.dwells[i].time_s, replayed.dwells[i].time_s) << k << " " << i;
    }
    EXPECT_EQ(recorded.items.at(2).dropped_at, replayed.items.at(2).dropped_at);
  }
  EXPECT_THAT(replay.err,
              HasSubstr(fmt::format("Replay: {0} of {0} angles are exactly as recorded", angles)));
}

TEST_F(TrayRunTest, ItemsOfARunAreComparedWithWhatTheyShare) {
  const json tray = json_of({"analyse", "a.run", "--json"});
  const auto compare = [&](std::vector<std::string> more) {
    more.insert(more.begin(), "compare");
    more.emplace_back("--json");
    const test::ProgramResult result = abcal(more);
    EXPECT_LE(result.exit_code, 1) << result.err;
    return json::parse(result.out);
  };
  const json all = compare({"a.run"});
  ASSERT_EQ(all["pairs"].size(), 2U);  // Each with the first.
  EXPECT_TRUE(all["several"].is_null());
  const json two = compare({"a.run#2", "a.run#3"});
  for (const auto& [pair, items] : {std::pair{all["pairs"][0], json{1, 2}},
                                    {all["pairs"][1], json{1, 3}},
                                    {two["pairs"][0], json{2, 3}}}) {
    EXPECT_EQ(pair["common_fit"], true);
    const auto found = std::ranges::find_if(
        tray["differences"], [&](const json& difference) { return difference["items"] == items; });
    ASSERT_NE(found, tray["differences"].end()) << items;
    for (const json& property : (*found)["properties"]) {
      const json& compared = pair["properties"][property["name"].get<std::string>()];
      const double u = property["standard_uncertainty"].get<double>();
      EXPECT_NEAR(compared["difference"].get<double>(), property["difference"].get<double>(), 1e-9 * u);
      EXPECT_NEAR(compared["standard_uncertainty"].get<double>(), u, 1e-9 * u);
    }
  }
  // Alone they would seem to differ by less than they do: nothing is known of what they share.
  const json abc = compare({"a.run#2", "a.run#3", "--estimator", "abc"});
  EXPECT_EQ(abc["pairs"][0]["common_fit"], false);
  EXPECT_GT(abc["pairs"][0]["properties"]["O_u"]["standard_uncertainty"].get<double>(),
            two["pairs"][0]["properties"]["O_u"]["standard_uncertainty"].get<double>());

  test::write_file(folder / "again.toml", tray_bench(12));
  ASSERT_EQ(abcal({"run", "again.toml", "-o", "b.run"}).exit_code, 0);
  EXPECT_EQ(compare({"a.run#2", "b.run#2"})["pairs"].size(), 1U);
  EXPECT_EQ(compare({"a.run", "b.run", "--item", "2"}), compare({"a.run#2", "b.run#2"}));
  const test::ProgramResult different = abcal({"compare", "a.run#1", "b.run#2"});
  EXPECT_EQ(different.exit_code, 2);
  EXPECT_THAT(different.err, HasSubstr("different items"));
  std::filesystem::copy_file(folder / "a.run", folder / "copy.run");
  for (const auto& [names, reason] :
       {std::pair{std::vector<std::string>{"a.run#2", "a.run#3", "a.run#2"}, "a.run#2 is named twice"},
        {{"a.run#2", "copy.run#2"}, "a.run#2 and copy.run#2 hold the same measurement"},
        {{"a.run#1", "copy.run#2", "--any-item"},
         "a.run#1 and copy.run#2 hold the same run, in two files"}}) {
    std::vector<std::string> arguments = names;
    arguments.insert(arguments.begin(), "compare");
    const test::ProgramResult refused = abcal(arguments);
    EXPECT_EQ(refused.exit_code, 2) << refused.out;
    EXPECT_THAT(refused.err, HasSubstr(reason));
  }
  for (const std::string no_such : {"a.run#4", "a.run#0", "a.run#two"})
    EXPECT_EQ(abcal({"compare", "a.run#1", no_such}).exit_code, 2) << no_such;
  EXPECT_THAT(abcal({"compare", "a.run", "b.run"}).err,
              HasSubstr("a.run: a.run has 3 items; required: a.run#1 to a.run#3, or this run alone"));
}

}  // namespace
}  // namespace abcal
