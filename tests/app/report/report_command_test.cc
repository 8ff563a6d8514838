// abcal report: its contents for runs of every kind, its files, and those that it refuses to overwrite.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "app/document/weasyprint.h"
#include "app/results/report/record_hdf5.h"
#include "protocol/record/results_file.h"
#include "protocol/record/run_record.h"
#include "protocol/record/sha256.h"
#include "tests/app/program_fixtures.h"
#include "tests/support/h5py_check.h"
#include "tests/support/typed_program.h"

namespace abcal {
namespace {

using test::ProgramResult;
using ::testing::AllOf;
using ::testing::Each;
using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::StartsWith;

const Tool kPython{"python3", "the test needs", "python3"};
const Tool kPdfText{"pdftotext", "the test needs", "poppler-utils"};

/// Sets PATH during its lifetime.
class PathOf {
 public:
  explicit PathOf(const std::string& value) : before_(std::getenv("PATH")) {
    ::setenv("PATH", value.c_str(), 1);
  }
  PathOf(const PathOf&) = delete;
  PathOf& operator=(const PathOf&) = delete;
  ~PathOf() { ::setenv("PATH", before_.c_str(), 1); }

 private:
  std::string before_;
};

class ReportTest : public ProgramTest {
 protected:
  static std::string hdf5_helper() {
    return std::filesystem::path(test::abcal_program()).replace_filename("abcal-hdf5").string();
  }

  /// A run with an item, an operator and a room, whose tolerances are not the defaults.
  static std::string bench_text(const std::string& more = {}) {
    BenchText bench;
    bench.accelerometer_driver = "simulated";  // It reports no identity of its own.
    return bench.text() +
           "[item]\nmaker = \"<b>Maker</b> & Söhne\"\nmodel = \"</title><script>alert(1)</script>\"\n"
           "serial_number = \"SN-4711\"\nrange = \"2 g\"\n[operator]\nname = \"N. N.\"\n"
           "[environment]\ntemperature_degc = 22.75\nhumidity_percent = 41.5\npressure_hpa = 1009.25\n"
           "[tolerances]\nalignment_deg = 0.003\nstep_deg = 0.006\ninitial_turn_deg = 0.007\nzero_deg = "
           "0.002\n"
           "drift = 3e-5\n" +
           more;
  }
  ProgramResult run(const std::string& more = {}) {
    test::write_file(folder / "bench.toml", bench_text(more));
    return abcal({"run", "bench.toml", "-o", "a.run"});
  }
  /// A run that ended after some angles, as if the disk were full.
  void interrupted_run(rlim_t bytes) {
    test::write_file(folder / "bench.toml", bench_text());
    std::filesystem::remove(folder / "a.run");
    test::Program program({"run", "bench.toml", "-o", "a.run"}, folder.path(), {bytes});
    ASSERT_EQ(program.wait(), 1);
  }
  nlohmann::json json(const std::vector<std::string>& arguments) {
    const ProgramResult result = abcal(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return nlohmann::json::parse(result.out);
  }
  std::vector<std::string> names() const {
    std::vector<std::string> list;
    for (const auto& entry : std::filesystem::directory_iterator(folder.path())) {
      const std::string name = entry.path().filename().string();
      if (!name.starts_with("program-")) list.push_back(name);
    }
    std::sort(list.begin(), list.end());
    return list;
  }
};

TEST_F(ReportTest, TheTextHoldsWhatTheRunKnows) {
  ASSERT_EQ(run().exit_code, 0);
  const ProgramResult report = abcal({"report", "a.run"});
  ASSERT_EQ(report.exit_code, 0) << report.err;
  for (const char* part : {"<b>Maker</b> & Söhne",
                           "SN-4711",
                           "N. N.",
                           "22.75",
                           "41.5",
                           "1009.25",
                           "start",
                           "end",
                           "coverage factor k",
                           "95.45 %",
                           "s_ux",
                           "phi_vw",
                           "O_w",
                           "A1+B3",
                           "harmonic 5",
                           "abc (",
                           "joint (",
                           "norm (",
                           "drift, 9 unknowns",
                           "Not covered",
                           "No angle is flagged",
                           "9.81 m/s²",
                           "Simulated: the stage and the accelerometer were not real",
                           "each rotation step 0.006 degree",
                           "12 angles 30 degrees apart"}) {
    EXPECT_THAT(test::unwrapped(report.out), HasSubstr(part));
  }
  EXPECT_THAT(report.out, HasSubstr(sha256_of_file(folder / "a.run")));
  EXPECT_THAT(report.out, Not(HasSubstr("Not complete")));
}

TEST_F(ReportTest, TheJsonIsOneObjectWithTheResultsOfTheAnalysis) {
  ASSERT_EQ(run().exit_code, 0);
  const nlohmann::json report = json({"report", "a.run", "--json", "--csv", "a.csv"});
  EXPECT_EQ(report.at("schema"), "abcal.report/1");
  EXPECT_EQ(report.at("sha256"), sha256_of_file(folder / "a.run"));
  EXPECT_EQ(report.at("item").at("serial_number"), "SN-4711");
  EXPECT_EQ(report.at("item").at("filter"), nullptr);
  EXPECT_EQ(report.at("run").at("environment").at(1).at("pressure_hpa"), 1009.25);
  EXPECT_EQ(report.at("tolerances").at("step_deg"), 0.006);
  for (const auto& [place, estimator] : {std::pair{0, "joint"}, {1, "abc"}, {2, "norm"}}) {
    EXPECT_EQ(report.at("results").at(static_cast<std::size_t>(place)),
              json({"analyse", "a.run", "--json", "--estimator", estimator}));
  }
  // Every line's contributions make up the combined uncertainty.
  double squares = 0.0;
  for (const auto& line : report.at("budget").at("lines"))
    squares += std::pow(line.at("contribution").at("s_wx").get<double>(), 2);
  EXPECT_NEAR(std::sqrt(squares) / report.at("budget").at("combined").at("s_wx").get<double>(), 1.0, 1e-12);
}

TEST_F(ReportTest, TheAveragedReadingsAreReadBackToTheSameNumbers) {
  // An output that clips for a while is flagged, and makes the verdict doubtful: that is in the copy too.
  ASSERT_EQ(run("[[fault]]\nkind = \"clipped-output\"\nvalue = 0.9\nat_s = 4\nfor_s = 1\n").exit_code, 0);
  ASSERT_EQ(abcal({"report", "a.run", "--csv", "a.csv"}).exit_code, 0);
  EXPECT_THAT(test::read_file(folder / "a.csv"),
              HasSubstr(fmt::format("{} norm not that of gravity", +kFlagNorm)));
  for (const char* estimator : {"abc", "joint", "norm"}) {
    nlohmann::json of_run = json({"analyse", "a.run", "--json", "--estimator", estimator});
    nlohmann::json of_csv = json({"analyse", "a.csv", "--json", "--estimator", estimator});
    EXPECT_GT(of_run.at("diagnostics").at("angles_flagged"), 0);
    of_run.erase("source");
    of_csv.erase("source");
    EXPECT_EQ(of_run, of_csv) << estimator;
  }
}

TEST_F(ReportTest, TheSingleReadingsAverageToTheMeansOfTheRun) {
  ASSERT_EQ(run().exit_code, 0);
  ASSERT_EQ(abcal({"report", "a.run", "--csv-raw", "raw.csv"}).exit_code, 0);
  std::istringstream file(test::read_file(folder / "raw.csv"));
  std::map<std::string, std::pair<double, int>> sums;  // of U; by experiment, n, closing
  std::size_t rows = 0;
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with('#') || line.starts_with("experiment")) continue;
    std::vector<std::string> cells;
    std::istringstream fields(line);
    for (std::string cell; std::getline(fields, cell, ',');) cells.push_back(cell);
    ASSERT_GE(cells.size(), 10U) << line;
    auto& [sum, count] = sums[cells[0] + "," + cells[1] + "," + cells[2]];
    sum += std::stod(cells[7]);
    ++count;
    ++rows;
  }
  const StoredRun stored = RunFile::load(folder / "a.run");
  ASSERT_EQ(sums.size(), stored.record.dwells.size());
  for (const DwellRecord& dwell : stored.record.dwells) {
    const auto& [sum, count] =
        sums.at(fmt::format("{},{},{}", dwell.experiment, dwell.n, dwell.closing ? 1 : 0));
    EXPECT_EQ(count, dwell.count);
    EXPECT_NEAR(sum / count, dwell.mean[0], 1e-15 * count);  // rounding of the sum
  }
  EXPECT_EQ(rows, 10U * stored.record.dwells.size());
}

TEST_F(ReportTest, Hdf5IsReadByH5pyWithUnitsEverywhere) {
  if (!is_installed(kPython)) GTEST_SKIP() << "python3 is not installed";
  test::write_file(folder / "check.py", R"(
import json, subprocess, sys
try:
    import h5py, numpy
except ImportError:
    sys.exit(77)
result = json.load(open("result.json"))
with h5py.File("a.h5") as file:
    found = []
    def look(name, thing):
        if not isinstance(thing, h5py.Dataset): 
            assert "NX_class" in thing.attrs, name
            return
        if thing.dtype.kind in "iuf":
            found.append(name)
            assert thing.attrs["units"], name
    file.visititems(look)
    assert len(found) > 40, found
    assert file.attrs["file_name"] == "a.h5"
    entry = file[file.attrs["default"]]
    assert entry.attrs["NX_class"] == "NXentry"
    data = entry[entry.attrs["default"]]
    assert data.attrs["signal"] == "response" and list(data.attrs["axes"]) == ["alpha", "."]
    for key in ("sensitivity_matrix", "intrinsic_sensitivity", "intrinsic_angle", "offset"):
        group = entry["result_abc"]
        value = numpy.vectorize(lambda q: q["value"])(numpy.array(result[key]))
        u = numpy.vectorize(lambda q: q["standard_uncertainty"])(numpy.array(result[key]))
        assert (group[key][...] == value).all(), key
        assert (group[key + "_errors"][...] == u).all(), key
        unit = numpy.array(result[key]).flat[0]["unit"]
        assert group[key].attrs.get("unit", group[key].attrs["units"]) == unit, key
    assert (entry["result_abc/covariance"][...] == numpy.array(result["covariance"])).all()
    assert "sensitivity_matrix" not in entry["result_norm"]
    # UDUNITS: "g" is the gram.
    assert data["response"].attrs["units"] == "gravity" and data["response"].attrs["unit"] == "g"
    assert entry["result_abc/sensitivity_matrix"].attrs["units"] == "gravity"
    assert int(data.attrs["alpha_indices"]) == 0 and data.attrs["alpha_indices"].dtype.kind == "i"
    assert entry["definition"][()].decode() == "NXabc_calibration"
    readings = entry["readings"]
    assert readings["response"].chunks == (4096, 3) and readings["response"].maxshape == (None, 3)
    for name in readings:
        assert readings[name].compression == "gzip" and readings[name].shuffle, name
    for k in range(data["alpha"].shape[0]):
        mine = (readings["experiment"][...] == data["experiment"][k]) & (readings["n"][...] == data["n"][k]) \
            & (readings["closing"][...] == data["closing"][k])
        assert mine.sum() == data["count"][k]
        assert abs(readings["response"][...][mine].mean(axis=0) - data["response"][k]).max() < 1e-14
    assert entry["sample/serial_number"][()].decode() == "SN-4711"
    assert entry["sample/maker"][()].decode() == "<b>Maker</b> & Söhne"
    assert entry["user/name"][()].decode() == "N. N."
    assert list(entry["environment/relative_humidity"]) == [41.5, 41.5]
    assert entry["environment/pressure"].attrs["units"] == "hPa"
    assert entry["start_time"][()].decode().endswith("Z")
    assert "step_deg" in entry["bench_file/data"][()].decode()
print("good")
)");
  ASSERT_EQ(run().exit_code, 0);
  ASSERT_EQ(abcal({"report", "a.run", "--hdf5", "a.h5"}).exit_code, 0);
  test::write_file(folder / "result.json", abcal({"analyse", "a.run", "--estimator", "abc", "--json"}).out);
  test::check_with_h5py(folder.path());
}

// Every output states which sizes of effects are defaults.
TEST_F(ReportTest, PlanRunAnalyseAndReportSayWhichSizesAreDefaults) {
  const ProgramResult measured = run("[stage_uncertainty]\nwobble_urad = 12\n");
  ASSERT_EQ(measured.exit_code, 0) << measured.err;
  for (const std::vector<std::string>& command : {std::vector<std::string>{"plan", "bench.toml", "--full"},
                                                  {"analyse", "a.run", "--full"},
                                                  {"report", "a.run"}}) {
    const std::string text = test::unwrapped(abcal(command).out);
    EXPECT_THAT(text, AllOf(HasSubstr("not stated, so default sizes are used: smooth step errors"),
                            HasSubstr("hysteresis"), Not(HasSubstr("wobble of the axes"))))
        << command.front();
  }
  const nlohmann::json effects = json({"analyse", "a.run", "--json"}).at("default_effects");
  EXPECT_EQ(effects, json({"plan", "bench.toml", "--json"}).at("default_effects"));
  EXPECT_EQ(effects.at(0), "smooth step errors, each coefficient to 6/rev");
}

// The results of the check poses, in every form of the report.
TEST_F(ReportTest, TheCheckPosesAreInTheReportTheJsonTheCsvAndTheHdf5) {
  BenchText bench;
  bench.check_poses = true;
  test::write_file(folder / "bench.toml", bench.text());
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "a.run"}).exit_code, 0);
  const nlohmann::json report = json({"report", "a.run", "--csv", "a.csv", "--hdf5", "a.h5", "--json"});
  const nlohmann::json& poses = report.at("check_poses");
  EXPECT_EQ(poses.at("visits"), 4);
  ASSERT_EQ(poses.at("differences").size(), 6U);  // two poses at three later visits
  EXPECT_EQ(poses.at("differences").at(0).at("visit"), 2);
  EXPECT_EQ(poses.at("differences").at(0).at("value").size(), 3U);
  for (const auto& gain : poses.at("change_of_gain"))
    EXPECT_LT(std::abs(gain.at("value").get<double>()), gain.at("smallest_found").get<double>());
  // They contribute nothing, so that they are a note of the budget and no line.
  for (const auto& line : report.at("budget").at("lines"))
    EXPECT_THAT(line.at("input").get<std::string>(), Not(HasSubstr("check poses")));
  EXPECT_THAT(
      report.at("budget").at("notes").dump(),
      AllOf(HasSubstr("Check poses, of S"), HasSubstr("change of a gain"), HasSubstr("No change was found")));
  const std::string csv = test::read_file(folder / "a.csv");
  EXPECT_THAT(csv, AllOf(HasSubstr("# check_poses.change_of_gain_u: "),
                         HasSubstr("# check_poses.change_of_offset_w.standard_uncertainty: ")));
  EXPECT_EQ(json({"report", "a.csv", "--json"}).at("check_poses").at("change_of_gain"),
            poses.at("change_of_gain"))
      << "the copy says the same";
  EXPECT_THAT(test::unwrapped(abcal({"report", "a.run"}).out),
              AllOf(HasSubstr("Check poses measured again, minus their first readings"),
                    HasSubstr("change of a gain"), HasSubstr("Model equation at zero")));
  test::write_file(folder / "check.py", R"(
import sys
try:
    import h5py
except ImportError:
    sys.exit(77)
with h5py.File("a.h5") as file:
    poses = file["entry/check_poses"]
    assert poses["response"].shape == (8, 3) and poses["difference"].shape == (6, 3)
    pose, response = list(poses["pose"][...]), poses["response"][...]
    assert all(sorted(pose[k:k + 2]) == [1, 2] for k in range(0, 8, 2))  # Either order: the way of least travel.
    for k in range(2, 8):
        assert (poses["difference"][k - 2] == response[k] - response[pose.index(pose[k])]).all()
    assert (poses["change_of_gain_smallest_found"][...] > 0).all()
    assert file["entry/conditions/wobble_urad"][()] == 50.0
    assert file["entry/conditions/wobble_urad_source"][()] == b"default"
)");
  test::check_with_h5py(folder.path());
}

// An assessor asks a budget for its degrees of freedom, the source of every input, what g_loc adds, what is
// not covered; and the check of U by |a|.
TEST_F(ReportTest, TheBudgetHasSourcesGravityAndTheCheckByTheMagnitude) {
  std::string bench = BenchText().text();
  const std::string gravity = "g_loc_mps2 = 9.81\n";
  bench.replace(bench.find(gravity), gravity.size(),
                gravity + "g_loc_expanded_uncertainty_mps2 = 1e-3\ng_loc_source = \"survey\"\n");
  test::write_file(folder / "bench.toml", bench);
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "a.run"}).exit_code, 0);
  const nlohmann::json report = json({"report", "a.run", "--json"});
  for (const auto& line : report.at("budget").at("lines")) {
    EXPECT_TRUE(line.at("source").is_string()) << line.at("input");
    double contributed = 0.0;
    for (const char* of : {"contribution", "contribution_per_mps2"})
      for (const auto& [symbol, value] : line.at(of).items())
        if (value.is_number()) contributed += value.get<double>();
    EXPECT_GT(contributed, 0.0) << line.at("input");
  }
  const nlohmann::json& norm = report.at("held_out_norm");
  EXPECT_EQ(norm.at("folds"), 4);
  EXPECT_GT(norm.at("rms").get<double>(), 0.0);
  const std::string page = test::unwrapped(abcal({"report", "a.run"}).out);
  EXPECT_THAT(page, AllOf(HasSubstr("Source: the readings of this run"), HasSubstr("Source: survey"),
                          HasSubstr("of its variance from g_loc"), HasSubstr("torque of the mounting screws"),
                          HasSubstr("Check of U by |a| on")));
}

TEST_F(ReportTest, ThePageLoadsNothingAndANameWithMarkupIsAName) {
  ASSERT_EQ(run().exit_code, 0);
  const ProgramResult result = abcal({"report", "a.run", "--html", "a.html"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, AllOf(StartsWith("html written: "), HasSubstr((folder / "a.html").string())));
  EXPECT_THAT(result.err, HasSubstr("caution: Simulated"));
  const std::string html = test::read_file(folder / "a.html");
  EXPECT_THAT(html, AllOf(HasSubstr("&lt;script&gt;alert(1)&lt;/script&gt;"), Not(HasSubstr("<script"))));
  EXPECT_THAT(html, AllOf(HasSubstr("&lt;b&gt;Maker&lt;/b&gt; &amp; S"), Not(HasSubstr("<b>"))));
  for (const char* outside : {"src=", "href=\"http", "@import", "<link", "<iframe", "<object"})
    EXPECT_THAT(html, Not(HasSubstr(outside)));
  EXPECT_THAT(html, AllOf(HasSubstr("@page"), HasSubstr("counter(pages)"), HasSubstr("SN-4711")));
  std::size_t pictures = 0;
  for (std::size_t at = html.find("<svg"); at != std::string::npos; at = html.find("<svg", at + 1))
    ++pictures;
  // Deviation from an ideal accelerometer, mounting, and five figures of the run.
  EXPECT_EQ(pictures, 7U);
}

TEST_F(ReportTest, ThePdfOfACertificateShowsAtATerminalHowMuchTimeIsLeft) {
  if (!is_installed(kWeasyPrint)) GTEST_SKIP() << "weasyprint is not installed";
  ASSERT_EQ(run().exit_code, 0);
  const test::Typed typed =
      test::type_at_terminal({"report", "a.run", "--draft", "--pdf", "a.pdf", "--laboratory",
                              (test::source_folder() / "docs/examples/laboratory.toml").string()},
                             folder.path(), [](const std::string&) { return std::nullopt; });
  EXPECT_EQ(typed.exit_code, 0);
  EXPECT_THAT(typed.shown, testing::ContainsRegex("Printing \\[[#.]+\\] +[0-9]+ %  [0-9]+ s left"));
}

TEST_F(ReportTest, ThePdfNamesTheRunAndThePageOnEveryPageAndHoldsTheAttachment) {
  if (!is_installed(kPdfText)) GTEST_SKIP() << "poppler-utils is not installed";
  ASSERT_EQ(run().exit_code, 0);
  test::write_file(folder / "a certificate.xml", "<certificate/>");
  const ProgramResult result = abcal({"report", "a.run", "--pdf", "a.pdf", "--attach", "a certificate.xml"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto tool = [&](const std::vector<std::string>& arguments) {
    test::Program program("/usr/bin/env", arguments, folder.path());
    EXPECT_EQ(program.wait(), 0) << program.err();
    return program.out();
  };
  std::istringstream text(tool({"pdftotext", "-layout", "a.pdf", "-"}));
  std::vector<std::string> pages;
  for (std::string page; std::getline(text, page, '\f');) pages.push_back(page);
  ASSERT_GT(pages.size(), 2U);
  for (std::size_t k = 0; k < pages.size(); ++k) {
    EXPECT_THAT(pages[k], AllOf(HasSubstr("a.run"), HasSubstr("SIMULATED"),
                                HasSubstr("serial number SN-4711 (stated, not read) · "),
                                HasSubstr(fmt::format("page {} of {}", k + 1, pages.size()))));
  }
  EXPECT_THAT(tool({"pdfdetach", "-list", "a.pdf"}), HasSubstr("a certificate.xml"));
  tool({"pdfdetach", "-save", "1", "-o", "out.xml", "a.pdf"});
  EXPECT_EQ(test::read_file(folder / "out.xml"), "<certificate/>");
}

TEST_F(ReportTest, WithoutWeasyprintNothingOfACertificateIsWritten) {
  ASSERT_EQ(run().exit_code, 0);
  const std::vector<std::string> before = names();
  const PathOf path((folder / "empty").string());
  const ProgramResult result = abcal({"report", "a.run", "--draft", "--html", "a.html", "--pdf", "a.pdf"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, AllOf(HasSubstr("weasyprint, which is not installed"), HasSubstr("apt install")));
  EXPECT_EQ(names(), before);
}

TEST_F(ReportTest, NeedsNoOtherProgramForItsPages) {
  ASSERT_EQ(run().exit_code, 0);
  const PathOf path((folder / "empty").string());
  const ProgramResult result = abcal({"report", "a.run", "--html", "a.html", "--pdf", "a.pdf"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(test::read_file(folder / "a.html"), HasSubstr("<svg"));
  EXPECT_THAT(test::read_file(folder / "a.pdf"), StartsWith("%PDF-"));
}

// The disk may have room for the angles but none for the reason of the end: both cases must occur.
TEST_F(ReportTest, AnInterruptedRunSaysSoOnTop) {
  std::set<RunState> seen;
  for (rlim_t bytes = 200'000; seen.size() < 2 && bytes < 300'000; bytes += 8192) {
    interrupted_run(bytes);
    const StoredRun stored = RunFile::load(folder / "a.run");
    if (!seen.insert(stored.state).second) continue;
    const ProgramResult result = abcal({"report", "a.run", "--html", "a.html"});
    const std::string caution = fmt::format(
        "Not complete: this run is {}, {} of {} angles are measured",
        stored.state == RunState::kRunning ? "running, or ended without storing a reason" : "interrupted",
        stored.measured.size(), stored.header.plan.size());
    EXPECT_THAT(result.err, HasSubstr(caution));
    const std::string html = test::read_file(folder / "a.html");
    EXPECT_THAT(
        html, AllOf(HasSubstr("<p class=\"caution\">" + caution), HasSubstr("none: only a closed run has")));
    std::filesystem::remove(folder / "a.html");
    const std::string text = test::unwrapped(abcal({"report", "a.run"}).out);
    EXPECT_LT(text.find("!!! " + caution), text.find("Item")) << text;

    ASSERT_EQ(abcal({"resume", "a.run"}).exit_code, 0);
    const ProgramResult resumed = abcal({"report", "a.run"});
    EXPECT_THAT(resumed.out, AllOf(HasSubstr("continued once"), Not(HasSubstr("Not complete"))));
    std::filesystem::remove(ResultsFile::path_beside(folder / "a.run"));
  }
  EXPECT_EQ(seen, (std::set<RunState>{RunState::kRunning, RunState::kInterrupted}));
}

TEST_F(ReportTest, AVerdictThatIsNotUsableHasNoNumbersAndExitsWith1) {
  interrupted_run(80'000);  // not even the first experiment
  const ProgramResult result = abcal({"report", "a.run", "--html", "a.html", "--json"});
  EXPECT_EQ(result.exit_code, 1);
  const nlohmann::json report = nlohmann::json::parse(result.out);
  EXPECT_EQ(report.at("results").at(0).at("verdict"), "not_usable");
  EXPECT_EQ(report.at("budget"), nullptr);
  EXPECT_THAT(report.at("cautions").dump(), HasSubstr("Not usable: "));
  const std::string html = test::read_file(folder / "a.html");
  EXPECT_THAT(html, AllOf(HasSubstr("<p class=\"caution\">Not usable: "), Not(HasSubstr("phi_uv")),
                          HasSubstr("No numbers are given, because the result is not usable")));
  // The mounting is drawn, no result is.
  EXPECT_THAT(html, HasSubstr("Stated mounting"));
  EXPECT_EQ(html.find("<svg"), html.rfind("<svg"));
}

TEST_F(ReportTest, ARunThatWasChangedIsNotReported) {
  ASSERT_EQ(run().exit_code, 0);
  const std::filesystem::path file = folder / "a.run";
  std::filesystem::permissions(file, std::filesystem::perms::owner_write, std::filesystem::perm_options::add);
  std::string bytes = test::read_file(file);
  const std::size_t at = bytes.find("SN-4711");
  ASSERT_NE(at, std::string::npos);
  bytes[at + 3] = '5';
  test::write_file(file, bytes);
  const ProgramResult result = abcal({"report", "a.run"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, AllOf(HasSubstr("SHA-256: the run has "), HasSubstr("It gives no result")));
}

TEST_F(ReportTest, ACsvIsReportedAsFarAsItGoes) {
  ASSERT_EQ(run().exit_code, 0);
  ASSERT_EQ(abcal({"report", "a.run", "--csv", "a.csv"}).exit_code, 0);
  const ProgramResult result =
      abcal({"report", "a.csv", "--html", "b.html", "--csv", "b.csv", "--hdf5", "b.h5", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const nlohmann::json report = nlohmann::json::parse(result.out);
  EXPECT_EQ(report.at("run"), nullptr);
  EXPECT_EQ(report.at("sha256"), sha256_of_file(folder / "a.csv"));
  EXPECT_THAT(test::read_file(folder / "b.html"), HasSubstr("a table without a run file"));
  const ProgramResult raw = abcal({"report", "a.csv", "--csv-raw", "raw.csv", "--html", "c.html"});
  EXPECT_EQ(raw.exit_code, 2);
  EXPECT_THAT(raw.err, HasSubstr("has no single readings"));
  EXPECT_FALSE(std::filesystem::exists(folder / "c.html"));
}

TEST_F(ReportTest, NothingIsOverwrittenWithoutForceAndTheRunNever) {
  ASSERT_EQ(run().exit_code, 0);
  const std::string sha256 = sha256_of_file(folder / "a.run");
  test::write_file(folder / "old.csv", "precious");
  const std::vector<std::string> before = names();
  const ProgramResult result = abcal({"report", "a.run", "--csv", "old.csv", "--html", "absent/a.html",
                                      "--hdf5", "./x.h5", "--csv-raw", "x.h5", "--pdf", "."});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, AllOf(HasSubstr("old.csv: exists already"), HasSubstr("--force"),
                                HasSubstr("its folder absent does not exist"),
                                HasSubstr("x.h5: is named twice"), HasSubstr("--pdf .: is a folder")));
  for (const char* input : {"a.run", "./a.run", "a.run.results"}) {
    const ProgramResult refused = abcal({"report", "a.run", "--csv", input, "--force"});
    EXPECT_EQ(refused.exit_code, 2);
    EXPECT_THAT(refused.err, HasSubstr("never overwritten"));
  }
  EXPECT_EQ(names(), before);
  EXPECT_EQ(test::read_file(folder / "old.csv"), "precious");
  EXPECT_EQ(sha256_of_file(folder / "a.run"), sha256);
  ASSERT_EQ(abcal({"report", "a.run", "--csv", "old.csv", "--force"}).exit_code, 0);
  EXPECT_THAT(test::read_file(folder / "old.csv"), HasSubstr("experiment,n"));
}

TEST_F(ReportTest, AFullDiskLeavesNothingHalfWritten) {
  ASSERT_EQ(run().exit_code, 0);
  test::write_file(folder / "a.csv", "precious");
  const std::vector<std::string> before = names();
  for (const char* option : {"--csv", "--csv-raw", "--hdf5", "--html"}) {
    test::Program program({"report", "a.run", option, "a.csv", "--force"}, folder.path(), {2'000});
    EXPECT_NE(program.wait(), 0) << option;
    EXPECT_THAT(program.err(), Not(IsEmpty())) << option;
    EXPECT_EQ(names(), before) << option;
    EXPECT_EQ(test::read_file(folder / "a.csv"), "precious") << option;
  }
  // By an exit code, not by a crash.
  std::ofstream tree(folder / "a.tree", std::ios::binary);
  write_hdf5_tree(gather_items(folder / "a.run", Clock::UtcTime{}), "b.h5", tree);
  tree.close();
  test::Program helper(hdf5_helper(), {"write", "a.tree", "b.h5"}, folder.path(), {2'000});
  EXPECT_EQ(helper.wait(), 1);
  EXPECT_THAT(helper.err(), AllOf(HasSubstr("b.h5: HDF5: "), HasSubstr("is the disk full?")));
}

TEST_F(ReportTest, TheHdf5HelperWritesNothingButGroupsAndDatasets) {
  test::write_file(folder / "a.csv", "a,b\n1,2\n");
  test::write_file(folder / "empty", "");
  for (const auto& [arguments, words] :
       {std::pair{std::vector<std::string>{"write", "a.csv", "b.h5"}, "cannot be read to their end"},
        {{"write", "absent", "b.h5"}, "absent cannot be read"},
        {{"write", "empty", "absent/b.h5"}, "absent/b.h5: HDF5: "}}) {
    test::Program helper(hdf5_helper(), arguments, folder.path());
    EXPECT_NE(helper.wait(), 0) << words;
    EXPECT_THAT(helper.err(), HasSubstr(words));
  }
}

TEST_F(ReportTest, WhatIsNoRecordIsRefused) {
  EXPECT_EQ(abcal({"report", "absent.run"}).exit_code, 1);
  test::write_file(folder / "b.csv", "a,b\n1,2\n");
  const ProgramResult result = abcal({"report", "b.csv", "--html", "b.html"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, HasSubstr("a header \"experiment,n,alpha_deg"));
  EXPECT_FALSE(std::filesystem::exists(folder / "b.html"));
}

}  // namespace
}  // namespace abcal
