// Pages and files of the runs in the console's folder.

#include "app/console/run_library.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <filesystem>
#include <regex>
#include <string>
#include <vector>

#include "app/document/weasyprint.h"
#include "app/system/child_process.h"
#include "protocol/estimators/checks/check_meanings.h"
#include "tests/console/console_fixture.h"
#include "tests/console/tray_bench.h"
#include "tests/support/project_paths.h"
#include "tests/support/training_register.h"

namespace abcal::console {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;
using Json = nlohmann::json;

class RunLibraryTest : public ConsoleTest {
 protected:
  const std::filesystem::path examples = test::source_folder() / "docs/examples";

  test::ProgramResult abcal(const std::vector<std::string>& words) {
    return test::run_program(words, folder.path());
  }
  void measure(const std::string& bench_file, const std::string& name) {
    std::filesystem::create_directories(runs());
    const auto ran = abcal({"run", bench_file, "-o", "runs/" + name});
    ASSERT_EQ(ran.exit_code, 0) << ran.err;
  }
  test::Answer get(const std::string& path) { return test::http_get(port, path); }
  std::vector<std::string> offered(const std::string& run) {
    const Json shown = Json::parse(get("/runs/" + run + "/result").body);
    std::vector<std::string> names;
    for (const Json& download : shown["downloads"]) names.push_back(download["name"]);
    return names;
  }
  static std::string but_for_when(const std::string& text) {
    return std::regex_replace(text, std::regex("# written_utc: .*"), "");
  }
};

TEST_F(RunLibraryTest, HandsOutWhatTheCommandsWrite) {
  measure((examples / "simulated.toml").string(), "a.run");
  open();
  EXPECT_THAT(offered("a.run"), Not(Contains("certificate.xml")));
  const test::Answer none = get("/runs/a.run/certificate.xml");
  EXPECT_EQ(none.status, 422U);
  EXPECT_THAT(none.body, HasSubstr("abcal issue"));

  const test::TrainingRegister registered(folder.path());
  const auto issued = abcal(
      {"issue", "runs/a.run", "--laboratory", (examples / "laboratory.toml").string(), "--dcc", "a.xml"});
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  const std::vector<std::string> names = offered("a.run");
  EXPECT_THAT(names, Contains("certificate.xml"));
  EXPECT_EQ(get("/runs/a.run/certificate.xml").body, test::read_file(folder / "a.xml"));
  const auto reported = abcal({"report", "runs/a.run", "--csv", "a.csv"});
  ASSERT_EQ(reported.exit_code, 0) << reported.err;
  EXPECT_EQ(but_for_when(get("/runs/a.run/readings.csv").body),
            but_for_when(test::read_file(folder / "a.csv")));
  const test::Answer report = get("/runs/a.run/report.html");
  EXPECT_THAT(report.body, HasSubstr(test::number_of(issued.out)));
  // It is kept as a file, never shown as a page of the console.
  EXPECT_EQ(report.headers.at("Content-Disposition"), "attachment");
  EXPECT_THAT(get("/runs/a.run/run.h5").body, StartsWith("\x89HDF"));
  // Its content is tested with the reports, because WeasyPrint is slow.
  EXPECT_EQ(std::count(names.begin(), names.end(), "report.pdf"), is_installed(kWeasyPrint) ? 1 : 0);
}

TEST_F(RunLibraryTest, ShowsAMeasurementOfSeveralRuns) {
  std::filesystem::create_directories(runs());
  std::string text = test::read_file(examples / "simulated.toml");
  const auto set = [&](const std::string& key, const std::string& value) {
    text = std::regex_replace(text, std::regex("\n" + key + " = [0-9.]+"), "\n" + key + " = " + value);
  };
  set("steps", "12");
  set("step_deg", "30.0");
  set("dwell_readings", "100");
  test::write_file(folder / "bench.toml", text);
  const auto made = abcal({"mountings", "bench.toml", "--mountings", "2", "-o", "runs/m"});
  ASSERT_EQ(made.exit_code, 0) << made.err;
  test::write_file(runs() / "broken.measurement", "{}");
  std::filesystem::create_symlink(runs() / "m.measurement", runs() / "link.measurement");
  open();
  const Json stated = Json::parse(abcal({"analyse", "runs/m.measurement", "--json"}).out);
  const Json list = Json::parse(get("/measurements").body);
  ASSERT_EQ(list.size(), 2U);
  EXPECT_EQ(list[0]["name"], "m.measurement");
  EXPECT_EQ(list[0]["runs"], 2);
  EXPECT_EQ(list[0]["verdict"], stated["verdict"]);
  EXPECT_EQ(list[0]["simulated"], "stage, accelerometer");
  EXPECT_EQ(list[1]["name"], "broken.measurement");
  EXPECT_THAT(list[1]["why"].get<std::string>(), HasSubstr("is no complete measurement"));

  const Json shown = Json::parse(get("/measurements/m.measurement/result").body);
  EXPECT_EQ(shown["results"][0]["quantities"], stated["quantities"]);
  ASSERT_EQ(shown["measurement"]["runs"].size(), 2U);
  for (std::size_t k = 0; k < 2; ++k) {
    const Json& run = shown["measurement"]["runs"][k];
    EXPECT_TRUE(run["is_here"]);
    EXPECT_EQ(get("/runs/" + run["name"].get<std::string>() + "/result").status, 200U);
  }
  std::vector<std::string> names;
  for (const Json& download : shown["downloads"]) names.push_back(download["name"]);
  EXPECT_THAT(names, Contains("report.html"));
  EXPECT_THAT(names, Not(Contains("readings.csv")));
  EXPECT_THAT(get("/measurements/m.measurement/report.html").body,
              HasSubstr(list[0]["name"].get<std::string>()));
  for (const char* wrong : {"m.measurement/readings.csv", "m.measurement/angles", "link.measurement/result",
                            "m-1.run/result", "..%2Fm.measurement/result", "m.measurement/items/0/result"})
    EXPECT_EQ(get(std::string("/measurements/") + wrong).status, 404U) << wrong;
  EXPECT_EQ(get("/runs/m.measurement/result").status, 404U);
  EXPECT_EQ(get("/measurements/m.measurement/items/2/result").status, 422U);

  // A run that was changed afterwards is named, though the answer was kept.
  const std::string run = shown["measurement"]["runs"][1]["name"];
  std::filesystem::permissions(runs() / run, std::filesystem::perms::owner_all);
  std::filesystem::resize_file(runs() / run, std::filesystem::file_size(runs() / run) - 1);
  const test::Answer changed = get("/measurements/m.measurement/result");
  EXPECT_EQ(changed.status, 422U);
  EXPECT_THAT(changed.body, HasSubstr(run + " was changed after the measurement was made"));
}

TEST_F(RunLibraryTest, HandsOutTheAnglesAndTheirReadings) {
  measure((examples / "simulated.toml").string(), "a.run");
  open();
  const Json angles = Json::parse(get("/runs/a.run/angles").body);
  const StoredRun run = RunFile::load(runs() / "a.run");
  ASSERT_EQ(angles["position"].size(), run.dwells.size());
  for (const std::size_t i : {std::size_t{0}, run.dwells.size() - 1}) {
    EXPECT_EQ(angles["alpha_deg"][i].get<double>(), run.dwells[i].alpha.deg());
    EXPECT_EQ(angles["mean"][2][i].get<double>(), run.dwells[i].mean[2]);
    EXPECT_EQ(angles["u_mean"][0][i].get<double>(), run.dwells[i].u_mean.value()[0]);
  }
  // All readings of one angle, as they are; their mean is that of the angle.
  const auto position = angles["position"][20].get<std::size_t>();
  const Json one =
      Json::parse(get("/runs/a.run/readings?position=" + std::to_string(position) + "&columns=4000").body);
  EXPECT_EQ(one["thinned"], false);
  EXPECT_EQ(one["readings"], angles["readings"][20]);
  EXPECT_EQ(one["lowest"], one["highest"]);
  double sum = 0.0;
  for (const Json& value : one["lowest"][0]) sum += value.get<double>();
  EXPECT_NEAR(sum / one["readings"].get<double>(), angles["mean"][0][20].get<double>(), 1e-12);
  // The whole run has no more than the columns ask for.
  const Json all = Json::parse(get("/runs/a.run/readings?columns=300").body);
  EXPECT_EQ(all["thinned"], true);
  EXPECT_LE(all["time_s"].size(), 600U);
  EXPECT_GE(all["time_s"].size(), run.dwells.size() / 2);
  for (const char* wrong : {"columns=many", "position=-1", "position=1&angle=2"})
    EXPECT_EQ(get(std::string("/runs/a.run/readings?") + wrong).status, 404U) << wrong;
}

TEST_F(RunLibraryTest, FindsSortsAndCountsRunsForOnePage) {
  measure((examples / "simulated.toml").string(), "b.run");
  for (const char* copy : {"a", "c", "d"})
    for (const char* end : {".run", ".run.results"})
      std::filesystem::copy_file(runs() / (std::string("b") + end), runs() / (std::string(copy) + end));
  open();
  const auto page = [&](const std::string& fields) { return Json::parse(get("/runs?" + fields).body); };
  const auto names = [](const Json& shown) {
    std::vector<std::string> list;
    for (const Json& run : shown["runs"]) list.push_back(run["name"]);
    return list;
  };
  using testing::ElementsAre;
  const Json first = page("sort=name&count=3");
  EXPECT_EQ(first["all"], 4);
  EXPECT_EQ(first["found"], 4);
  EXPECT_THAT(names(first), ElementsAre("a.run", "b.run", "c.run"));
  EXPECT_THAT(names(page("sort=name&from=3")), ElementsAre("d.run"));
  EXPECT_THAT(names(page("sort=name&descending=1&count=1")), ElementsAre("d.run"));
  EXPECT_THAT(names(page("search=C.RUN+complete")), ElementsAre("c.run"));
  EXPECT_EQ(page("state=interrupted")["found"], 0);
  EXPECT_EQ(page("from=9")["runs"].size(), 0U);
  EXPECT_EQ(get("/runs?count=-1").status, 404U);
  EXPECT_EQ(get("/runs?order=name").status, 404U);
}

double largest(const Json& norms, const char* which) {
  double largest = 0.0;
  for (const Json& each : norms[which]) largest = std::max(largest, std::abs(each.get<double>()));
  return largest;
}

TEST_F(RunLibraryTest, TellsTheNormOfEveryAngleBeforeAndAfterTheCorrection) {
  measure((examples / "simulated.toml").string(), "a.run");
  open();
  const Json norms = Json::parse(get("/runs/a.run/result").body)["norms"];
  const Json angles = Json::parse(get("/runs/a.run/angles").body);
  EXPECT_EQ(norms["position"], angles["position"]);
  // At the first angle, by hand: the output is in g.
  const auto read = [&](std::size_t j) { return angles["mean"][j][0].get<double>(); };
  const double norm = std::sqrt(read(0) * read(0) + read(1) * read(1) + read(2) * read(2));
  EXPECT_NEAR(norms["before"][0].get<double>(), 9.80665 * norm - 9.80101, 1e-9);
  // The offset of 24 mg of the example is corrected; its non-linearity of 14 mg is not.
  EXPECT_GT(largest(norms, "before"), 0.2);
  EXPECT_LT(largest(norms, "after"), 0.2);
  EXPECT_GT(largest(norms, "after"), 1e-3);
}

TEST_F(RunLibraryTest, HandsOutEachOfSeveralItems) {
  test::write_file(folder / "tray.toml", test::small_tray());
  measure("tray.toml", "tray.run");
  open();
  const auto result = [&](const std::string& of) {
    return Json::parse(get("/runs/tray.run" + of + "/result").body);
  };
  const Json first = result(""), third = result("/items/3");
  EXPECT_EQ(first["item"], 1);
  EXPECT_EQ(first, result("/items/1"));
  EXPECT_EQ(third["item"], 3);
  EXPECT_EQ(third["run"]["items"].size(), 3U);
  for (const Json& item : third["run"]["items"]) EXPECT_EQ(item["verdict"], "usable");
  EXPECT_FALSE(third["dominates"].empty());
  EXPECT_NE(first["results"][0]["offset"], third["results"][0]["offset"]);
  for (const int k : {1, 3}) {
    const std::string item = std::to_string(k);
    const auto reported = abcal({"report", "runs/tray.run", "--item", item, "--csv", item + ".csv"});
    ASSERT_EQ(reported.exit_code, 0) << reported.err;
    EXPECT_EQ(but_for_when(get("/runs/tray.run/items/" + item + "/readings.csv").body),
              but_for_when(test::read_file(folder / (item + ".csv"))));
  }
  EXPECT_THAT(get("/runs/tray.run/items/3/report.html").body, HasSubstr("6284.000003"));
  // The numbers of the common fit, as every command gives them.
  const auto analysed = abcal({"analyse", "runs/tray.run", "--item", "3", "--json"});
  ASSERT_EQ(analysed.exit_code, 0) << analysed.err;
  const Json same = Json::parse(analysed.out);
  int joint = 0;
  for (const Json& shown : third["results"]) {
    if (shown["estimator"] != same["estimator"]) continue;
    ++joint;
    for (const char* each : {"sensitivity_matrix", "offset"}) EXPECT_EQ(shown[each], same[each]) << each;
  }
  EXPECT_EQ(joint, 1);
  EXPECT_THAT(get("/runs/tray.run/items/3/run.h5").body, StartsWith("\x89HDF"));
  for (const char* none : {"0", "33", "-1", "1x", "", "99999999999999999999"})
    EXPECT_EQ(get("/runs/tray.run/items/" + std::string(none) + "/result").status, 404U) << none;
  EXPECT_EQ(get("/runs/tray.run/items/4/result").status, 422U);
}

TEST_F(RunLibraryTest, HandsOutTheCertificateOfAnItem) {
  test::write_file(folder / "tray.toml", test::small_tray());
  measure("tray.toml", "tray.run");
  open();
  const test::TrainingRegister registered(folder.path());
  const auto issued = abcal({"issue", "runs/tray.run", "--item", "2", "--laboratory",
                             (examples / "laboratory.toml").string(), "--dcc", "second.xml"});
  ASSERT_EQ(issued.exit_code, 0) << issued.err;
  EXPECT_EQ(get("/runs/tray.run/items/2/certificate.xml").body, test::read_file(folder / "second.xml"));
  EXPECT_THAT(get("/runs/tray.run/items/2/report.html").body, HasSubstr(test::number_of(issued.out)));
  for (const char* other : {"1", "3"}) {
    EXPECT_EQ(get("/runs/tray.run/items/" + std::string(other) + "/certificate.xml").status, 422U) << other;
    EXPECT_THAT(get("/runs/tray.run/items/" + std::string(other) + "/result").body,
                Not(HasSubstr("certificate.xml")));
  }
}

TEST_F(RunLibraryTest, ListsVerdictPersonAndDurationAlsoFromWhatIsKept) {
  test::write_file(folder / "bench.toml", bench.text() + "[operator]\nname = \"Operator N. N.\"\n");
  measure("bench.toml", "a.run");
  const auto listed = [&] { return Json(RunLibrary(runs()).list(std::chrono::minutes(1))); };
  const Json first = listed();
  ASSERT_EQ(first.size(), 1U);
  EXPECT_EQ(first[0]["verdict"], "usable") << first;
  EXPECT_EQ(first[0]["operator"], "Operator N. N. (stated, not verified)");
  EXPECT_EQ(first[0]["simulated"], "stage, accelerometer");
  EXPECT_GT(first[0]["duration_s"], 0.0);
  const std::filesystem::path kept = runs() / RunIndex::kFile;
  ASSERT_TRUE(std::filesystem::exists(kept));
  EXPECT_EQ(listed(), first);
  // A database of another format, or a file that is none, is made again.
  SqliteDatabase(kept, SqliteDatabase::Mode::kReadWrite).execute("pragma user_version = 7");
  EXPECT_EQ(listed(), first);
  test::write_file(kept, "no database");
  EXPECT_EQ(listed(), first);
  // Where the folder takes no file, the list is in memory.
  std::filesystem::remove(kept);
  std::filesystem::create_directories(kept / "in the way");
  EXPECT_EQ(listed(), first);
}

// The list says what the files say, whatever happens to them.
TEST_F(RunLibraryTest, ListsWhatTheFilesSayWhateverHappensToThem) {
  test::write_file(folder / "bench.toml", bench.text());
  measure("bench.toml", "a.run");
  const std::filesystem::path file = runs() / "a.run", results = runs() / "a.run.results";
  RunLibrary library(runs());
  const auto listed = [&] { return Json(library.list(std::chrono::minutes(1))); };
  const auto read_anew = [&] {
    std::filesystem::remove(runs() / RunIndex::kFile);
    return Json(RunLibrary(runs()).list(std::chrono::minutes(1)));
  };
  const Json first = listed();
  EXPECT_EQ(first[0]["verdict"], "usable");
  EXPECT_EQ(first[0]["analysed"], true);
  // Its results are removed, and come back.
  std::filesystem::rename(results, folder / "results");
  EXPECT_EQ(listed()[0]["verdict"], "");
  EXPECT_EQ(listed()[0]["analysed"], false);
  std::filesystem::rename(folder / "results", results);
  EXPECT_EQ(listed(), first);
  // Bytes change while size and time stay.
  const auto time = std::filesystem::last_write_time(file);
  const std::string whole = test::read_file(file);
  std::filesystem::permissions(file, std::filesystem::perms::owner_write, std::filesystem::perm_options::add);
  test::write_file(file, std::string(whole.size(), 'x'));
  std::filesystem::last_write_time(file, time);
  EXPECT_EQ(listed()[0]["state"], "unreadable");
  test::write_file(file, whole);
  std::filesystem::last_write_time(file, time);
  EXPECT_EQ(listed(), first);
  // New runs, other runs under their names, and runs that go.
  for (const char* copy : {"b.run", "c.run"}) std::filesystem::copy_file(file, runs() / copy);
  EXPECT_EQ(listed().size(), 3U);
  std::filesystem::remove(runs() / "b.run");
  bench.simulation = "seed = 3\n";
  test::write_file(folder / "bench.toml", bench.text());
  std::filesystem::remove(runs() / "c.run");
  measure("bench.toml", "c.run");
  const Json last = listed();
  ASSERT_EQ(last.size(), 2U);
  EXPECT_EQ(last[0]["name"], "c.run");
  EXPECT_EQ(last, read_anew());
  RunLibrary::PageAsked complete;
  complete.state = "complete";
  complete.search = "C.RUN usable";
  const Json page = library.page(complete);
  EXPECT_EQ(page["found"], 1);
  EXPECT_EQ(page["verdicts"], Json({{"usable", 1}}));
  EXPECT_EQ(page["first_utc"], last[0]["created_utc"]);
}

TEST_F(RunLibraryTest, SaysWhatEachCheckAndFlagMeans) {
  static_assert(std::has_single_bit(kAllFlags + 1U));
  for (std::uint32_t flag = 1; flag <= kAllFlags; flag *= 2)
    EXPECT_NE(meaning_of_flag(describe_flags(flag).english()), "") << describe_flags(flag).english();
  EXPECT_EQ(meaning_of_flag("no such flag"), "");
  EXPECT_EQ(meaning_of_check("no such check"), "");

  // A fault that has checks fail and flags set: the accelerometer reads twice what it should.
  bench.simulation = "sensitivity_matrix = [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]]\n";
  test::write_file(folder / "bench.toml", bench.text());
  measure("bench.toml", "doubled.run");
  open();
  const Json shown = Json::parse(get("/runs/doubled.run/result").body);
  const Json& result = shown["results"][0];
  EXPECT_EQ(result["verdict"], "doubtful");
  std::vector<std::string> failed;
  for (const Json& check : result["diagnostics"]["checks"]) {
    EXPECT_NE(shown["meanings"].value(check["check"].get<std::string>(), ""), "") << check;
    if (!check["passed"].get<bool>()) failed.push_back(check["check"]);
  }
  EXPECT_THAT(failed, Contains("full scale"));
  ASSERT_FALSE(result["diagnostics"]["flags"].empty());
  for (const Json& flag : result["diagnostics"]["flags"])
    EXPECT_NE(shown["meanings"].value(flag["flag"].get<std::string>(), ""), "") << flag;
}

TEST_F(RunLibraryTest, ChartsEveryItemOfARunWithSeveral) {
  test::write_file(folder / "tray.toml", test::small_tray());
  std::filesystem::create_directories(runs());
  const auto ran = test::run_program({"run", "tray.toml", "-o", "runs/tray.run"}, folder.path());
  ASSERT_EQ(ran.exit_code, 0) << ran.err;
  open();
  const Json items = Json::parse(get("/runs").body)[0]["items"];
  ASSERT_EQ(items.size(), 3U);
  for (int k = 1; k <= 3; ++k) {
    const std::string serial = items[static_cast<std::size_t>(k - 1)]["serial_number"];
    const Json points = Json::parse(get("/history/" + serial + "/s_u").body)["runs"];
    ASSERT_EQ(points.size(), 1U) << serial;
    EXPECT_EQ(points[0]["item"], k);
    const Json shown = Json::parse(get("/runs/tray.run/items/" + std::to_string(k) + "/result").body);
    EXPECT_EQ(points[0]["estimator"], shown["results"][0]["estimator"]);
    EXPECT_EQ(points[0]["value"], shown["results"][0]["intrinsic_sensitivity"][0]["value"]);
  }
}

TEST_F(RunLibraryTest, ComparesItemsOfARunWithSeveral) {
  test::write_file(folder / "tray.toml", test::small_tray());
  std::filesystem::create_directories(runs());
  const auto ran = test::run_program({"run", "tray.toml", "-o", "runs/tray.run"}, folder.path());
  ASSERT_EQ(ran.exit_code, 0) << ran.err;
  open();
  const Json compared = Json::parse(get("/compare/tray.run%231/tray.run%233").body);
  EXPECT_EQ(compared["results"][0]["file"], "tray.run#1");
  EXPECT_EQ(compared["results"][1]["file"], "tray.run#3");
  EXPECT_NE(compared["results"][0]["properties"], compared["results"][1]["properties"]);
  EXPECT_THAT(get("/compare/tray.run/tray.run%233").body, HasSubstr("tray.run#1 to"));
  EXPECT_EQ(get("/compare/tray.run%231/none.run%231").status, 404U);
}

// Seen: the page compared by another estimator than the command line, and the chart showed other values than
// the page of the run.
TEST_F(RunLibraryTest, EveryFaceShowsTheResultOfTheEstimatorThatTheRunDeclares) {
  for (const std::string estimator : {"joint", "abc"}) {
    const BenchText plain = bench;
    bench.protocol = "estimator = \"" + estimator + "\"\n" + bench.protocol;
    const std::string first = estimator + "1.run", second = estimator + "2.run";
    for (const std::string& run : {first, second}) {
      bench.simulation = "seed = " + std::to_string(run.size() + (run == first ? 1 : 2)) + "\n";
      test::write_file(folder / "bench.toml", bench.text());
      measure("bench.toml", run);
    }
    open();
    const auto by_program = [&](std::vector<std::string> words) {
      const auto ran = test::run_program(words, runs());
      EXPECT_LE(ran.exit_code, 1) << ran.err;
      return Json::parse(ran.out);
    };
    const Json reported = by_program({"analyse", first, "--json"});
    EXPECT_EQ(reported["estimator"], estimator);
    const Json value = reported["intrinsic_sensitivity"][0]["value"];
    const Json compared = by_program({"compare", first, second, "--any-item", "--json"});
    const Json on_page = Json::parse(get("/compare/" + first + "/" + second).body);
    for (const Json& each : {compared, on_page}) {
      EXPECT_EQ(each["results"][0]["estimator"], estimator);
      EXPECT_EQ(each["results"][0]["properties"]["s_u"]["value"], value);
      EXPECT_EQ(each["pairs"], compared["pairs"]);
    }
    const Json shown = Json::parse(get("/runs/" + first + "/result").body);
    EXPECT_EQ(shown["results"][0]["intrinsic_sensitivity"][0]["value"], value);
    const std::string item = Json::parse(get("/runs").body)[0]["item"];
    const Json points = Json::parse(get("/history/" + item + "/s_u").body)["runs"];
    EXPECT_TRUE(std::ranges::any_of(points, [&](const Json& point) {
      return point["name"] == first && point["value"] == value && point["estimator"] == estimator;
    })) << points;
    close();
    bench = plain;
  }
}

TEST_F(RunLibraryTest, ChartsTheRunsOfOneItemAgainstTheirLimits) {
  for (int i = 1; i <= 4; ++i) {
    bench.simulation = "seed = " + std::to_string(i) + "\n";
    test::write_file(folder / "bench.toml", bench.text());
    measure("bench.toml", std::to_string(i) + ".run");
  }
  open();
  const std::string item = Json::parse(get("/runs").body)[0]["item"];
  const Json history = Json::parse(get("/history/" + item + "/s_u").body);
  ASSERT_EQ(history["runs"].size(), 4U);
  const Json& limits = history["limits"];
  double sum = 0.0;
  for (const Json& run : history["runs"]) sum += run["value"].get<double>();
  EXPECT_NEAR(limits["centre"], sum / 4.0, 1e-12);
  EXPECT_LT(limits["lower"], limits["centre"]);
  EXPECT_GT(limits["upper"], limits["centre"]);
  EXPECT_EQ(Json::parse(get("/history/another/s_u").body)["runs"].size(), 0U);
  EXPECT_EQ(get("/history/" + item + "/mass").status, 404U);

  // Each property equals that of the run's own page, also in the next console, which reads it from the stored
  // summaries.
  const auto charted = [&](const std::string& property) {
    return Json::parse(get("/history/" + item + "/" + property).body)["runs"][3];
  };
  const Json kept = {charted("phi_vw"), charted("O_w")};
  const Json shown = Json::parse(get("/runs/4.run/result").body);
  const Json& reported = shown["results"][0];
  EXPECT_EQ(kept[0]["value"], reported["intrinsic_angle"][1]["value"]) << reported;
  EXPECT_EQ(kept[1]["standard_uncertainty"], reported["offset"][2]["standard_uncertainty"]);
  const auto written = SqliteDatabase(runs() / RunIndex::kFile, SqliteDatabase::Mode::kReadOnly)
                           .value("select charted from chart where name = '4.run'");
  EXPECT_EQ(Json::parse(written.value_or("{}"))["values"][4][0], kept[0]["value"]);
  close();
  open();
  EXPECT_EQ((Json{charted("phi_vw"), charted("O_w")}), kept);
}

}  // namespace
}  // namespace abcal::console
