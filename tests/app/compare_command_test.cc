// abcal compare as its users call it, on records whose truth is known.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cctype>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <random>
#include <sstream>

#include "protocol/record/sqlite.h"
#include "tests/app/program_fixtures.h"
#include "tests/support/project_paths.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::json;
using Matrix = std::array<std::array<double, 3>, 3>;

constexpr Matrix kMatrix{{{1.10, 0.02, -0.03}, {0.01, 0.90, 0.04}, {-0.02, 0.03, 1.00}}};

/// Readings on a perfect stage, 12 angles of 30 degrees, with noise that the file states.
std::string readings(const Matrix& s, unsigned seed, const std::string& unit = "V", double scale = 1.0,
                     double noise = 1e-5) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal(0.0, noise);
  std::ostringstream csv;
  csv.precision(17);
  csv << "# response_unit: " << unit << "\nexperiment,n,alpha_deg,r_u,r_v,r_w,u_u,u_v,u_w\n";
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int n = 0; n < 12; ++n) {
      const double alpha = 30.0 * n * std::acos(-1.0) / 180.0;
      const double sine = std::sin(alpha), cosine = std::cos(alpha);
      const std::array<double, 3> a = experiment == 1   ? std::array{0.0, sine, cosine}
                                      : experiment == 2 ? std::array{-sine, 0.0, cosine}
                                                        : std::array{-sine, -cosine, 0.0};
      csv << experiment << ',' << n + 1 << ',' << 30 * n;
      for (std::size_t j = 0; j < 3; ++j) {
        const double offset = 0.1 * static_cast<double>(j + 1);
        csv << ',' << scale * (s[j][0] * a[0] + s[j][1] * a[1] + s[j][2] * a[2] + offset + normal(engine));
      }
      for (int j = 0; j < 3; ++j) csv << ',' << scale * noise;
      csv << "\n";
    }
  }
  return csv.str();
}

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
  EXPECT_THAT(text.out, AllOf(HasSubstr("do NOT agree"), HasSubstr("s_v (E_n +")));
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
    s[0][0] *= 1.0 + 3e-4 * (k % 2);  // from run to run, more than both types explain
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
  // The mean with type B, as its two equations say: no stage is named, so nothing is common.
  const Json& random = s_u["random_effects"];
  const double tau = random["between"];
  double weights = 0.0, weighted = 0.0, chi2 = 0.0;
  const auto weight_of = [&](const Json& result) {
    const double u = result["properties"]["s_u"]["standard_uncertainty"];
    return 1.0 / (u * u + tau * tau);
  };
  for (const Json& result : json["results"]) {
    weights += weight_of(result);
    weighted += weight_of(result) * result["properties"]["s_u"]["value"].get<double>();
  }
  for (const Json& result : json["results"])
    chi2 += weight_of(result) *
            std::pow(result["properties"]["s_u"]["value"].get<double>() - weighted / weights, 2);
  EXPECT_NEAR(random["mean"], weighted / weights, 1e-12);
  EXPECT_NEAR(random["standard_uncertainty"], 1.0 / std::sqrt(weights), 1e-9 / std::sqrt(weights));
  if (tau > 0.0) {
    EXPECT_NEAR(chi2, 4.0, 1e-6);
  } else {
    EXPECT_LE(chi2, 4.0);
  }
  EXPECT_EQ(random["e_n"].size(), 5U);
  EXPECT_EQ(s_u["individuals_chart"]["points"].size(), 5U);
  EXPECT_EQ(s_u["ewma_chart"]["points"].size(), 5U);
  EXPECT_TRUE(s_u["anova"].is_null());
  EXPECT_THAT(compare(files).out, AllOf(HasSubstr("Control charts"), HasSubstr("EWMA")));
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
  ASSERT_EQ(abcal({"run", (examples / "simulated.toml").string(), "-o", "a.run"}).exit_code, 0);
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
  const ProgramResult shared = compare({"a.run", "a.xml", "--shared"});
  EXPECT_EQ(shared.exit_code, 2);
  EXPECT_THAT(shared.err, AllOf(HasSubstr("a.xml"), HasSubstr("does not state which part")));
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
