// abcal compare as its users call it, on records whose truth is known.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <random>
#include <sstream>

#include "protocol/record/sqlite.h"
#include "tests/app/program_fixtures.h"
#include "tests/app/readings_csv.h"
#include "tests/support/project_paths.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;
using Json = nlohmann::json;
using test::kMatrix;
using test::Matrix;
using test::readings;

/// The accelerometer turned on the platter by `degrees` about z.
Matrix turned_about_z(const Matrix& s, double degrees) {
  const double angle = degrees * std::acos(-1.0) / 180.0;
  Matrix turned = s;
  for (std::size_t j = 0; j < 3; ++j) {
    turned[j][0] = s[j][0] * std::cos(angle) - s[j][1] * std::sin(angle);
    turned[j][1] = s[j][0] * std::sin(angle) + s[j][1] * std::cos(angle);
  }
  return turned;
}

class CompareCommand : public ProgramTest {
 protected:
  void write(const std::string& name, const std::string& text) { test::write_file(folder / name, text); }
  ProgramResult compare(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "compare");
    return abcal(arguments);
  }
  Json json_of(std::vector<std::string> arguments, int exit_code = 0) {
    arguments.emplace_back("--json");
    const ProgramResult result = compare(arguments);
    EXPECT_EQ(result.exit_code, exit_code) << result.err << result.out;
    return Json::parse(result.out);
  }
  /// The JSON for any verdict, as noise alone may take one of nine properties beyond its limit.
  Json json_of_any(std::vector<std::string> arguments) {
    arguments.emplace_back("--json");
    const ProgramResult result = compare(arguments);
    EXPECT_LE(result.exit_code, 1) << result.err;
    return Json::parse(result.out);
  }
};

TEST_F(CompareCommand, TwoRunsOfOneItemAgreeAndTheMountingIsFound) {
  write("a.csv", readings(kMatrix, 1));
  write("b.csv", readings(turned_about_z(kMatrix, 20.0), 2));
  const Json json = json_of({"a.csv", "b.csv"});
  EXPECT_EQ(json["schema"], "abcal.compare/1");
  EXPECT_TRUE(json["agree"]);
  const Json& pair = json["pairs"][0];
  EXPECT_NEAR(pair["rotation"]["angle"]["value"], 20.0, 0.001);
  EXPECT_NEAR(pair["rotation"]["axis"][2], 1.0, 1e-6);
  EXPECT_EQ(pair["degrees_of_freedom"], 9);
  EXPECT_GT(pair["chi2_probability"], 1e-6);
  EXPECT_TRUE(json["several"].is_null());
  const ProgramResult text = compare({"a.csv", "b.csv"});
  EXPECT_EQ(text.exit_code, 0);
  EXPECT_THAT(text.out, AllOf(HasSubstr("1 and 2 agree"), HasSubstr("turned by +20.0"), HasSubstr("phi_uv")));
}

// E_n of one property, from what analyse says of the two files.
TEST_F(CompareCommand, NormalisedErrorsFollowFromTheAnalyses) {
  Matrix other = kMatrix;
  other[1][1] *= 1.0005;
  write("a.csv", readings(kMatrix, 1));
  write("b.csv", readings(other, 2));
  const Json a = Json::parse(abcal({"analyse", "a.csv", "--json"}).out);
  const Json b = Json::parse(abcal({"analyse", "b.csv", "--json"}).out);
  const Json property = json_of({"a.csv", "b.csv"}, 1)["pairs"][0]["properties"]["s_v"];
  const double x_a = a["intrinsic_sensitivity"][1]["value"], x_b = b["intrinsic_sensitivity"][1]["value"];
  const double u_a = a["intrinsic_sensitivity"][1]["standard_uncertainty"];
  const double u_b = b["intrinsic_sensitivity"][1]["standard_uncertainty"];
  EXPECT_DOUBLE_EQ(property["difference"], x_b - x_a);
  const double e_n = (x_b - x_a) / std::sqrt(4.0 * u_a * u_a + 4.0 * u_b * u_b);
  EXPECT_NEAR(property["e_n"], e_n, 1e-9 * std::abs(e_n));
  EXPECT_NEAR(property["zeta"], 2.0 * e_n, 1e-9 * std::abs(e_n));
  EXPECT_GT(e_n, 1.0);
  const ProgramResult text = compare({"a.csv", "b.csv"});
  EXPECT_EQ(text.exit_code, 1);
  EXPECT_THAT(test::unwrapped(text.out),
              AllOf(StartsWith("1 and 2 do NOT agree"), HasSubstr("s_v (E_n +"), HasSubstr("are expected")));
}

TEST_F(CompareCommand, UnitsOfOneKindAreConverted) {
  write("a.csv", readings(kMatrix, 1, "V"));
  write("b.csv", readings(kMatrix, 1, "mV", 1000.0));
  const Json json = json_of({"a.csv", "b.csv"});
  for (const auto& [name, property] : json["pairs"][0]["properties"].items())
    EXPECT_NEAR(property["e_n"], 0.0, 1e-9) << name;
  EXPECT_THAT(json["results"][1]["notes"].dump(), HasSubstr("given in mV, here in V"));
  write("c.csv", readings(kMatrix, 1, "LSB"));
  const ProgramResult refused = compare({"a.csv", "c.csv"});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_EQ(refused.out, "");
  EXPECT_THAT(refused.err, AllOf(HasSubstr("a.csv is in V"), HasSubstr("c.csv in LSB")));
}

TEST_F(CompareCommand, WhatTheStageDoesToBothIsSubtractedOnRequest) {
  write("a.csv", readings(kMatrix, 1));
  write("b.csv", readings(kMatrix, 2));
  const Json independent = json_of_any({"a.csv", "b.csv"});
  const Json shared = json_of_any({"a.csv", "b.csv", "--shared"});
  EXPECT_TRUE(shared["shared_stage_subtracted"]);
  for (const auto& [name, property] : shared["pairs"][0]["properties"].items()) {
    const double u = property["standard_uncertainty"];
    const double u_independent = independent["pairs"][0]["properties"][name]["standard_uncertainty"];
    EXPECT_GT(u, 0.0);
    EXPECT_LE(u, u_independent) << name;
  }
  // Angles between axes know no drift: noise alone remains of their differences.
  const Json a = Json::parse(abcal({"analyse", "a.csv", "--json"}).out);
  const double type_a = a["intrinsic_angle"][0]["type_a"];
  const double u_angle = shared["pairs"][0]["properties"]["phi_uv"]["standard_uncertainty"];
  EXPECT_LT(u_angle, independent["pairs"][0]["properties"]["phi_uv"]["standard_uncertainty"].get<double>());
  EXPECT_GE(u_angle, 0.99 * std::sqrt(2.0) * type_a);
  EXPECT_THAT(shared["notes"].dump(), HasSubstr("taken from --shared"));
}

TEST_F(CompareCommand, RunsOnOneStageSayThatNothingWasSubtracted) {
  write_bench({});
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "a.run"}).exit_code, 0);
  BenchText again;
  again.simulation = "seed = 7\n";
  write_bench(again);
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "b.run"}).exit_code, 0);
  const Json json = json_of_any({"a.run", "b.run"});
  EXPECT_THAT(json["notes"].dump(), HasSubstr("NOT subtracted"));
  EXPECT_EQ(json["results"][0]["kind"], "run");
  EXPECT_NE(json["results"][0]["stage"], "");
  const Json shared = json_of_any({"a.run", "b.run", "--shared"});
  EXPECT_THAT(shared["notes"].dump(), Not(HasSubstr("NOT subtracted")));
}

TEST_F(CompareCommand, OneMeasurementDoesNotCountTwice) {
  write_bench({});
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "a.run"}).exit_code, 0);
  std::filesystem::copy_file(folder / "a.run", folder / "copy.run");
  std::filesystem::copy_file(folder / "a.run", folder / "packed.run");
  SqliteDatabase(folder / "packed.run", SqliteDatabase::Mode::kReadWrite)
      .execute("pragma page_size = 8192; vacuum");
  ASSERT_NE(std::filesystem::file_size(folder / "packed.run"), std::filesystem::file_size(folder / "a.run"));
  ASSERT_EQ(abcal({"report", "a.run", "--csv", "a.csv"}).exit_code, 0);
  write("b.csv", readings(kMatrix, 1));
  for (const char* again : {"copy.run", "packed.run", "a.csv"}) {
    const ProgramResult refused = compare({"a.run", again});
    EXPECT_EQ(refused.exit_code, 2) << again << refused.out;
    EXPECT_THAT(refused.err, HasSubstr(std::string("a.run and ") + again + " hold the same measurement"));
  }
  const ProgramResult refused = compare({"b.csv", "a.run", "copy.run", "b.csv", "--any-item"});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err,
              AllOf(HasSubstr("a.run and copy.run hold the same measurement; b.csv is named twice"),
                    HasSubstr("required: each measurement once")));
}

/// The readings with another offset of output u.
std::string with_offset_of_u(const std::string& csv, double offset) {
  std::istringstream lines(csv);
  std::ostringstream changed;
  changed.precision(17);
  for (std::string line; std::getline(lines, line);) {
    std::size_t from = 0;
    for (int comma = 0; comma < 3 && std::isdigit(line.front()) != 0; ++comma)
      from = line.find(',', from) + 1;
    if (from == 0) {
      changed << line << "\n";
      continue;
    }
    const std::size_t to = line.find(',', from);
    changed << line.substr(0, from) << std::stod(line.substr(from, to - from)) + offset << line.substr(to)
            << "\n";
  }
  return changed.str();
}

TEST_F(CompareCommand, ValuesThatDoNotScatterHaveNoLimits) {
  const std::vector<std::string> files{"0.csv", "1.csv", "2.csv"};
  for (std::size_t k = 0; k < files.size(); ++k)
    write(files[k], with_offset_of_u(readings(kMatrix, 1), 0.001 * static_cast<double>(k)));
  const ProgramResult text = compare(files);
  EXPECT_LE(text.exit_code, 1) << text.err;
  EXPECT_THAT(text.out, HasSubstr("no spread: the limits have no width"));
  EXPECT_THAT(text.out, Not(HasSubstr("OUTSIDE: 1, 2, 3")));
  const Json chart = json_of_any(files)["several"]["properties"]["O_w"]["individuals_chart"];
  EXPECT_FALSE(chart["spread"]);
  EXPECT_TRUE(chart["in_control"]);
  EXPECT_TRUE(chart["points"][0]["inside"]);
}

TEST_F(CompareCommand, DifferentItemsAreRefusedUnlessAskedFor) {
  BenchText bench;
  bench.accelerometer_driver = "simulated";
  write("a.toml", bench.text() + "[item]\nserial_number = \"1\"\n");
  write("b.toml", bench.text() + "[item]\nserial_number = \"2\"\n");
  ASSERT_EQ(abcal({"run", "a.toml", "-o", "a.run"}).exit_code, 0);
  ASSERT_EQ(abcal({"run", "b.toml", "-o", "b.run"}).exit_code, 0);
  const ProgramResult refused = compare({"a.run", "b.run"});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, AllOf(HasSubstr("different items"), HasSubstr("--any-item")));
  EXPECT_EQ(compare({"a.run", "b.run", "--any-item"}).exit_code, 0);
}

TEST_F(CompareCommand, AReversedAxisIsNotTakenForAMounting) {
  write("a.csv", readings({{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}, 1));
  write("b.csv", readings({{{1, 0, 0}, {0, 1, 0}, {0, 0, -1}}}, 2));
  const Json json = json_of({"a.csv", "b.csv"}, 1);
  EXPECT_FALSE(json["pairs"][0]["rotation"]["same_handedness"]);
  EXPECT_THAT(json["pairs"][0]["why"], HasSubstr("handedness"));
}

TEST_F(CompareCommand, SeveralRunsGiveSpreadAndCharts) {
  std::vector<std::string> files;
  for (unsigned k = 0; k < 5; ++k) {
    Matrix s = kMatrix;
    s[0][0] *= 1.0 + 1e-3 * (k % 2);  // from run to run, more than both types explain
    files.push_back(std::to_string(k) + ".csv");
    write(files.back(), readings(s, k + 1));
  }
  const Json json = json_of(files, 1);
  const Json& several = json["several"];
  EXPECT_EQ(several["order"].size(), 5U);
  const Json& s_u = several["properties"]["s_u"];
  // Mean and standard deviation of the five values, computed here.
  double mean = 0.0, squares = 0.0;
  for (const double x : s_u["values"]) mean += x / 5.0;
  for (const double x : s_u["values"]) squares += (x - mean) * (x - mean) / 4.0;
  EXPECT_NEAR(s_u["spread"]["mean"], mean, 1e-12);
  EXPECT_NEAR(s_u["spread"]["standard_deviation"], std::sqrt(squares), 1e-12);
  EXPECT_LT(s_u["spread"]["chi2_probability"], 1e-6);
  EXPECT_NEAR(s_u["spread"]["between_runs"], std::sqrt(squares), 0.1 * std::sqrt(squares));
  EXPECT_GT(several["properties"]["s_v"]["spread"]["chi2_probability"], 1e-6);
  // The mean with type B, as its two equations say: no stage is named, so nothing is common. The results
  // that do not agree with the others are no part of it.
  const Json& consistency = several["consistency"];
  EXPECT_FALSE(consistency["agree"]);
  EXPECT_TRUE(consistency["majority_agrees"]);
  const std::vector<std::string> outliers = consistency["outliers"];
  EXPECT_THAT(outliers, testing::ElementsAre("1.csv", "3.csv"));
  std::vector<Json> kept;
  for (const Json& result : json["results"]) {
    if (std::ranges::find(outliers, result["file"].get<std::string>()) == outliers.end())
      kept.push_back(result);
  }
  const Json& random = s_u["random_effects"];
  const double tau = random["between"];
  double weights = 0.0, weighted = 0.0, chi2 = 0.0;
  const auto weight_of = [&](const Json& result) {
    const double u = result["properties"]["s_u"]["standard_uncertainty"];
    return 1.0 / (u * u + tau * tau);
  };
  for (const Json& result : kept) {
    weights += weight_of(result);
    weighted += weight_of(result) * result["properties"]["s_u"]["value"].get<double>();
  }
  for (const Json& result : kept)
    chi2 += weight_of(result) *
            std::pow(result["properties"]["s_u"]["value"].get<double>() - weighted / weights, 2);
  EXPECT_NEAR(random["mean"], weighted / weights, 1e-12);
  EXPECT_NEAR(random["standard_uncertainty"], 1.0 / std::sqrt(weights), 1e-9 / std::sqrt(weights));
  if (tau > 0.0) {
    EXPECT_NEAR(chi2, 2.0, 1e-6);
  } else {
    EXPECT_LE(chi2, 2.0);
  }
  EXPECT_EQ(random["e_n"].size(), 5U);
  for (const std::size_t sound : {0U, 2U, 4U}) EXPECT_LT(std::abs(random["e_n"][sound].get<double>()), 1.0);
  for (const std::size_t outlier : {1U, 3U}) EXPECT_GT(std::abs(random["e_n"][outlier].get<double>()), 1.0);
  EXPECT_EQ(s_u["individuals_chart"]["points"].size(), 5U);
  EXPECT_EQ(s_u["ewma_chart"]["points"].size(), 5U);
  EXPECT_TRUE(s_u["anova"].is_null());
  EXPECT_THAT(compare(files).out, AllOf(HasSubstr("Control charts"), HasSubstr("EWMA")));
}

// The first of four is the outlier. Against it the three sound ones would all be wrong.
TEST_F(CompareCommand, TheOutlierOfSeveralIsNamedAndTheSoundOnesAreNotCondemned) {
  Matrix other = kMatrix;
  other[1][1] *= 1.01;
  write("a.csv", readings(other, 1));
  const std::vector<std::string> files{"a.csv", "b.csv", "c.csv", "d.csv"};
  for (unsigned k = 1; k < 4; ++k) write(files[k], readings(kMatrix, k + 1));
  const Json json = json_of(files, 1);
  EXPECT_FALSE(json["agree"]);
  EXPECT_EQ(json["several"]["consistency"]["outliers"], Json({"a.csv"}));
  EXPECT_EQ(json["pairs"][0]["first"], "b.csv");
  EXPECT_FALSE(json["pairs"][0]["agrees"]);  // b and a
  for (const std::size_t sound : {1U, 2U}) EXPECT_TRUE(json["pairs"][sound]["agrees"]);
  const Json e_n = json["several"]["properties"]["s_v"]["random_effects"]["e_n"];
  EXPECT_GT(std::abs(e_n[0].get<double>()), 10.0);
  for (const std::size_t sound : {1U, 2U, 3U}) EXPECT_LT(std::abs(e_n[sound].get<double>()), 1.5) << sound;
  const std::string text = test::unwrapped(compare(files).out);
  EXPECT_THAT(text, AllOf(StartsWith("4 results do NOT agree: P = "), HasSubstr("Outlier: 1 (a.csv)."),
                          HasSubstr("the other 3 agree")));
}

TEST_F(CompareCommand, SeveralResultsThatAgreeAreSaidToAgreeInOneVerdict) {
  const std::vector<std::string> files{"a.csv", "b.csv", "c.csv"};
  for (unsigned k = 0; k < 3; ++k) write(files[k], readings(kMatrix, k + 1));
  const ProgramResult text = compare(files);
  EXPECT_EQ(text.exit_code, 0);
  EXPECT_THAT(text.out, AllOf(StartsWith("3 results agree: P = "), Not(HasSubstr("Outlier"))));
  EXPECT_THAT(test::unwrapped(text.out), HasSubstr("cannot be known: a.csv, b.csv, c.csv do not name"));
}

// Three certificates of one stage: what the stage did to all is not averaged down, and a note says so.
TEST_F(CompareCommand, CertificatesOfOneStageAreNotAveragedDown) {
  const std::filesystem::path examples = test::source_folder() / "docs/examples";
  const std::string bench = test::read_file(examples / "simulated.toml");
  const std::string seed = "seed = 20260301";
  std::vector<std::string> files;
  for (const std::string name : {"a", "b", "c"}) {
    std::string own = bench;
    own.replace(own.find(seed), seed.size(), seed + "\nrun = " + std::to_string(1 + files.size()));
    own.replace(own.find("steps = 72"), 10, "steps = 36");
    own.replace(own.find("step_deg = 5.0"), 14, "step_deg = 10.0");
    write(name + ".toml", own);
    ASSERT_EQ(abcal({"run", name + ".toml", "-o", name + ".run"}).exit_code, 0);
    const ProgramResult written = abcal({"report", name + ".run", "--draft", "--laboratory",
                                         (examples / "laboratory.toml").string(), "--dcc", name + ".xml"});
    ASSERT_EQ(written.exit_code, 0) << written.err;
    files.push_back(name + ".xml");
  }
  const Json json = json_of_any(files);
  const std::string serial = json["results"][0]["stage_serial_number"];
  EXPECT_FALSE(serial.empty());
  const Json run = json_of_any({"a.run", "b.run"});
  EXPECT_EQ(json["results"][0]["stage"], run["results"][0]["stage"]) << "the run names the same stage";
  for (const auto& [name, property] : json["several"]["properties"].items()) {
    double least = std::numeric_limits<double>::infinity();
    for (const Json& result : json["results"])
      least = std::min(least, result["properties"][name]["standard_uncertainty"].get<double>());
    EXPECT_GE(property["random_effects"]["standard_uncertainty"], 0.999 * least) << name;
  }
  EXPECT_THAT(json["notes"].dump(),
              AllOf(HasSubstr("a.xml, b.xml, c.xml were measured on the same stage ("), HasSubstr(serial),
                    HasSubstr("not averaged down"), HasSubstr("certificates do not say which part")));
  // Without the stage, nobody knows: the note says so.
  std::string xml = test::read_file(folder / "c.xml");
  for (std::size_t at = xml.find("abc_stage"); at != std::string::npos; at = xml.find("abc_stage"))
    xml.replace(at, 9, "abc_other");
  write("c.xml", xml);
  EXPECT_THAT(json_of_any(files)["notes"].dump(),
              AllOf(HasSubstr("a.xml, b.xml were measured on the same stage"),
                    HasSubstr("whether c.xml was measured on one stage with the others cannot be known")));
}

TEST_F(CompareCommand, GroupsAreJudgedByAnalysisOfVariance) {
  std::vector<std::string> files;
  for (unsigned k = 0; k < 4; ++k) {
    BenchText bench;
    bench.simulation = "seed = " + std::to_string(k + 1) + "\n";
    const std::string name = std::to_string(k);
    write(name + ".toml", bench.text() + "[operator]\nname = \"" + (k < 2 ? "N. N." : "M. M.") + "\"\n");
    ASSERT_EQ(abcal({"run", name + ".toml", "-o", name + ".run"}).exit_code, 0);
    files.push_back(name + ".run");
  }
  std::vector<std::string> grouped = files;
  grouped.insert(grouped.end(), {"--group-by", "operator.name"});
  const Json several = json_of_any(grouped)["several"];
  ASSERT_EQ(several["groups"].size(), 2U);
  EXPECT_EQ(several["groups"][0]["files"].size(), 2U);
  // One stage made all four: its part of the uncertainty is not averaged down, so that the mean is hardly
  // more certain than one result. Independent results would halve it.
  const Json& s_v = several["properties"]["s_v"]["random_effects"];
  EXPECT_GT(
      s_v["standard_uncertainty"].get<double>(),
      0.75 * json_of_any(files)["results"][0]["properties"]["s_v"]["standard_uncertainty"].get<double>());
  const Json& anova = several["properties"]["O_u"]["anova"];
  EXPECT_EQ(anova["between_degrees_of_freedom"], 1);
  EXPECT_EQ(anova["within_degrees_of_freedom"], 2);
  // By hand from the four values, which are in the order of the groups here.
  std::vector<double> x;
  const Json ungrouped = json_of_any(files);
  for (const Json& result : ungrouped["results"]) x.push_back(result["properties"]["O_u"]["value"]);
  const double within = ((x[0] - x[1]) * (x[0] - x[1]) + (x[2] - x[3]) * (x[2] - x[3])) / 2.0;
  EXPECT_NEAR(anova["within_sum_squares"], within, 1e-9 * within);
  const double apart = (x[0] + x[1] - x[2] - x[3]) / 2.0;
  EXPECT_NEAR(anova["between_sum_squares"], apart * apart, 1e-6 * apart * apart);
  EXPECT_EQ(several["properties"]["O_u"]["mean_chart"]["points"].size(), 2U);
  grouped.back() = "item.colour";
  const ProgramResult unknown = compare(grouped);
  EXPECT_EQ(unknown.exit_code, 2);
  EXPECT_THAT(unknown.err, AllOf(HasSubstr("item.colour"), HasSubstr("operator.name")));
}

// The run is per g_loc and in g, its certificate per m/s2 and in m/s2: nothing may get lost on the way but
// what rounding takes. With two digits of U, half of the last one is up to 0.05 U; and U itself is off by as
// much.
TEST_F(CompareCommand, ARunAgreesWithItsOwnCertificate) {
  const std::filesystem::path examples = test::source_folder() / "docs/examples";
  // Where the readings of a run seem to wander, its trials may give a larger U than its fit. On this bench
  // they do not: nothing is drawn.
  std::string bench = test::read_file(examples / "simulated.toml");
  bench.replace(bench.find("draw = \"stated\""), 15, "# ");
  write("bench.toml", bench);
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "a.run"}).exit_code, 0);
  const test::TrainingRegister registered(folder.path());
  const ProgramResult written =
      abcal({"issue", "a.run", "--laboratory", (examples / "laboratory.toml").string(), "--dcc", "a.xml"});
  ASSERT_EQ(written.exit_code, 0) << written.err;
  for (const std::vector<std::string>& files :
       {std::vector<std::string>{"a.run", "a.xml", "--estimator", "joint"},
        std::vector<std::string>{"a.xml", "a.run", "--estimator", "joint"}}) {
    const Json json = json_of(files);
    const Json& pair = json["pairs"][0];
    EXPECT_EQ(pair["degrees_of_freedom"], 9);
    for (const auto& [name, property] : pair["properties"].items()) {
      EXPECT_NEAR(property["e_n"], 0.0, 0.05) << name;
      const double u_run = json["results"][0]["properties"][name]["standard_uncertainty"];
      const double u_certificate = json["results"][1]["properties"][name]["standard_uncertainty"];
      EXPECT_NEAR(u_certificate, u_run, 0.055 * u_run) << name;  // and k has two decimals
    }
    const Json& angle = pair["rotation"]["angle"];
    EXPECT_LT(angle["value"], 0.1 * angle["standard_uncertainty"].get<double>());
    EXPECT_EQ(json["results"][1]["item"], json["results"][0]["item"]);
    EXPECT_TRUE(json["results"][1]["covariances_known"]);
  }
  // The certificate states the line response, and has no number of the published formula.
  const ProgramResult published = compare({"a.run", "a.xml", "--published"});
  EXPECT_EQ(published.exit_code, 2);
  EXPECT_THAT(published.err, AllOf(HasSubstr("a.xml"), HasSubstr("certificate of the line response")));
  EXPECT_THAT(json_of_any({"a.run", "a.xml"})["notes"].dump(), Not(HasSubstr("another program")));
  const ProgramResult shared = compare({"a.run", "a.xml", "--shared"});
  EXPECT_EQ(shared.exit_code, 2);
  EXPECT_THAT(shared.err, AllOf(HasSubstr("a.xml"), HasSubstr("does not state which part")));
}

/// Readings of an item with k3 as a share of S in R/g_loc^3, on the perfect stage of readings().
std::string curved_readings(double k3, unsigned seed) {
  std::istringstream straight(readings(kMatrix, seed));
  std::ostringstream csv;
  csv.precision(17);
  std::string line;
  for (int n = 0; std::getline(straight, line); ++n) {
    if (n < 3) {  // Two comments and the header.
      csv << line << "\n";
      continue;
    }
    std::istringstream cells(line);
    std::string cell;
    for (int c = 0; std::getline(cells, cell, ','); ++c) {
      csv << (c > 0 ? "," : "");
      if (c < 3 || c > 5) {
        csv << cell;
        continue;
      }
      const double response = std::stod(cell) - 0.1 * (c - 2);  // Without the offset.
      csv << std::stod(cell) + k3 * std::pow(response, 3);
    }
    csv << "\n";
  }
  return csv.str();
}

/// A certificate that another laboratory's program wrote: nine properties and U, k = 2.
std::string foreign_certificate(const Json& properties, double g_loc_mps2) {
  const auto list = [](const std::string& labels, const std::string& values, const std::string& unit,
                       const std::string& expanded) {
    return "<si:realListXMLList><si:labelXMLList>" + labels + "</si:labelXMLList><si:valueXMLList>" + values +
           "</si:valueXMLList><si:unitXMLList>" + unit +
           "</si:unitXMLList><si:measurementUncertaintyUnivariateXMLList><si:expandedMUXMLList>"
           "<si:valueExpandedMUXMLList>" +
           expanded +
           "</si:valueExpandedMUXMLList><si:coverageFactorXMLList>2</si:coverageFactorXMLList>"
           "</si:expandedMUXMLList></si:measurementUncertaintyUnivariateXMLList></si:realListXMLList>";
  };
  const auto three = [&](const std::vector<std::string>& labels, const std::string& unit, double factor) {
    std::ostringstream values, expanded, names;
    values.precision(17);
    for (const std::string& label : labels) {
      names << label << " ";
      values << properties.at(label).at("value").get<double>() * factor << " ";
      expanded << 2.0 * properties.at(label).at("standard_uncertainty").get<double>() * factor << " ";
    }
    return list(names.str(), values.str(), unit, expanded.str());
  };
  return "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"
         "<dcc:digitalCalibrationCertificate xmlns:dcc=\"https://ptb.de/dcc\" xmlns:si=\"https://ptb.de/si\">"
         "<dcc:measurementResults><dcc:measurementResult><dcc:results>" +
         three({"s_u", "s_v", "s_w"}, "\\volt\\metre\\tothe{-1}\\second\\tothe{2}", 1.0 / g_loc_mps2) +
         three({"phi_uv", "phi_vw", "phi_wu"}, "\\radian", std::acos(-1.0) / 180.0) +
         three({"O_u", "O_v", "O_w"}, "\\volt", 1.0) +
         "</dcc:results></dcc:measurementResult></dcc:measurementResults>"
         "</dcc:digitalCalibrationCertificate>";
}

// Another laboratory's ABC result is by the published formula: it is compared with the same quantity of ours,
// with the paper's uncertainty, and not with the line response, from which a k3 of 1 % is 1e-3 away.
TEST_F(CompareCommand, AnAbcResultOfAnotherLaboratoryIsComparedByThePublishedFormula) {
  const std::string gravity = "# g_loc.value_mps2: 9.8\n# g_loc.expanded_uncertainty_mps2: 1e-5\n";
  write("a.csv", gravity + curved_readings(1e-2, 1));
  write("b.csv", gravity + curved_readings(1e-2, 2));
  const Json analysed = Json::parse(abcal({"analyse", "b.csv", "--estimator", "abc", "--json"}).out);
  const Json& published = analysed.at("published");
  Json theirs;
  const std::array<const char*, 3> of{"u", "v", "w"}, pairs{"uv", "vw", "wu"};
  for (std::size_t j = 0; j < 3; ++j) {
    theirs["s_" + std::string(of[j])] = published.at("intrinsic_sensitivity").at(j);
    theirs["phi_" + std::string(pairs[j])] = published.at("intrinsic_angle").at(j);
    theirs["O_" + std::string(of[j])] = published.at("offset").at(j);
  }
  write("theirs.xml", foreign_certificate(theirs, 9.8));

  // Two of ours, so that no unit is converted: exactly the published numbers.
  const Json ours = json_of_any({"a.csv", "b.csv", "--published"});
  EXPECT_EQ(ours["results"][1]["formula"], "published");
  EXPECT_EQ(ours["results"][1]["estimator"], "abc");
  for (const auto& [name, property] : theirs.items()) {
    const Json& compared = ours["results"][1]["properties"][name];
    EXPECT_EQ(compared["value"], property["value"]) << name;
    EXPECT_NEAR(compared["standard_uncertainty"].get<double>(),
                property["standard_uncertainty"].get<double>(),
                1e-9 * property["standard_uncertainty"].get<double>())
        << name;
  }
  const Json by_line = json_of_any({"a.csv", "b.csv", "--estimator", "abc"});
  EXPECT_EQ(by_line["results"][1]["formula"], "line response");
  EXPECT_EQ(by_line["results"][1]["properties"]["s_u"]["value"],
            analysed.at("intrinsic_sensitivity").at(0).at("value"));
  EXPECT_GT(std::abs(by_line["results"][1]["properties"]["s_u"]["value"].get<double>() -
                     ours["results"][1]["properties"]["s_u"]["value"].get<double>()),
            1e-4);

  // Their certificate repeats b.csv: no difference by the published formula.
  const Json same = json_of({"b.csv", "theirs.xml", "--published"});
  for (const auto& [name, property] : same["pairs"][0]["properties"].items())
    EXPECT_NEAR(property["e_n"].get<double>(), 0.0, 1e-6) << name;
  EXPECT_TRUE(same["results"][1]["formula"].is_null());
  EXPECT_THAT(same["notes"].dump(), HasSubstr("published formula"));
  const Json other = json_of_any({"b.csv", "theirs.xml", "--estimator", "abc"});
  EXPECT_THAT(other["notes"].dump(),
              AllOf(HasSubstr("theirs.xml is of another program"), HasSubstr("--published")));
  const double e_n = other["pairs"][0]["properties"]["s_u"]["e_n"];
  EXPECT_GT(std::abs(e_n), 0.1);

  const ProgramResult joint = compare({"a.csv", "b.csv", "--published", "--estimator", "joint"});
  EXPECT_EQ(joint.exit_code, 2);
  EXPECT_THAT(joint.err, AllOf(HasSubstr("a.csv"), HasSubstr("b.csv"), HasSubstr("--estimator abc")));
}

// The errors of a shared stage are subtracted as the published formula passes them on: what remains of two
// runs is their type A.
TEST_F(CompareCommand, OfThePublishedFormulaASharedStageLeavesTypeA) {
  write("a.csv", curved_readings(1e-2, 1));
  write("b.csv", curved_readings(1e-2, 2));
  const Json json = json_of_any({"a.csv", "b.csv", "--published", "--shared"});
  const auto type_a = [&](const std::string& file) {
    const Json published =
        Json::parse(abcal({"analyse", file, "--estimator", "abc", "--json"}).out).at("published");
    return std::vector<double>{published.at("intrinsic_sensitivity").at(0).at("type_a"),
                               published.at("intrinsic_angle").at(0).at("type_a"),
                               published.at("offset").at(0).at("type_a")};
  };
  const std::vector<double> a = type_a("a.csv"), b = type_a("b.csv");
  const std::array<const char*, 3> names{"s_u", "phi_uv", "O_u"};
  for (std::size_t i = 0; i < 3; ++i) {
    const double u = json["pairs"][0]["properties"][names[i]]["standard_uncertainty"];
    // The derivatives of both results differ by their noise, 1e-5 of the type B, which is some 20 times type
    // A.
    EXPECT_NEAR(u, std::hypot(a[i], b[i]), 1e-2 * u) << names[i];
  }
}

TEST_F(CompareCommand, BadFilesAreNamed) {
  write("a.csv", readings(kMatrix, 1));
  EXPECT_EQ(compare({"a.csv"}).exit_code, 2);
  const ProgramResult missing = compare({"a.csv", "none.run"});
  EXPECT_EQ(missing.exit_code, 1);
  EXPECT_THAT(missing.err, HasSubstr("none.run: no such file"));
  write("short.csv", "experiment,n,alpha_deg,r_u,r_v,r_w\n1,1,0,0,0,1\n");
  const ProgramResult unusable = compare({"a.csv", "short.csv"});
  EXPECT_EQ(unusable.exit_code, 1);
  EXPECT_EQ(unusable.out, "");
  EXPECT_THAT(unusable.err, HasSubstr("short.csv"));
}

}  // namespace
}  // namespace abcal
