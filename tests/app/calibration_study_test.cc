#include "app/studies/calibration/calibration_study.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <utility>

#include "app/bench_file/bench_config.h"

namespace abcal {
namespace {

CalibrationStudy study_of(std::vector<std::string> kinds, int benches, int threads) {
  CalibrationOptions options;
  options.benches = benches;
  options.kinds = std::move(kinds);
  options.threads = threads;
  return run_calibration_study(options);
}

// With signs of the hysteresis that were taken from the reading before, 60 of 100 such benches were doubtful.
TEST(CalibrationStudyTest, SoundBenchesOfAGoodItemAreUsableAndTheirIntervalsHold) {
  const CalibrationStudy study = study_of({"24-noise-1e-5", "24-play"}, 12, 2);
  for (const KindOutcome& kind : study.kinds) {
    EXPECT_EQ(kind.benches, 12);
    EXPECT_LE(kind.doubtful, 1) << calibration_text(study);
    for (const GroupScores& group : kind.all) EXPECT_LT(group.low, kMostZ) << calibration_text(study);
  }
  EXPECT_TRUE(study.passed()) << calibration_text(study);
}

TEST(CalibrationStudyTest, IsTheSameForAnyNumberOfThreads) {
  const auto json = [](int threads) {
    return calibration_json(study_of({"24-10", "norm"}, 6, threads)).dump();
  };
  EXPECT_EQ(json(1), json(3));
}

TEST(CalibrationStudyTest, EveryKindAndReasonIsNamedOnce) {
  std::set<std::string_view> names;
  for (const CalibrationKind& kind : calibration_kinds())
    EXPECT_TRUE(names.insert(kind.name).second) << kind.name;
  for (const KnownWide& known : known_wide()) {
    EXPECT_TRUE(known.kind == "*" || names.contains(known.kind)) << known.kind;
    EXPECT_GT(known.reason.size(), 10U);
  }
}

TEST(CalibrationStudyTest, RefusesAKindThatItDoesNotHave) {
  EXPECT_THROW(study_of({"24-nonsense"}, 4, 1), std::invalid_argument);
  EXPECT_THROW(study_of({"norm"}, 1, 1), std::invalid_argument);
}

CalibrationOptions of_file(const std::string& text) {
  CalibrationOptions options;
  options.benches = 6;
  options.threads = 2;
  options.bench_file = {"bench", text};
  return options;
}
const std::string kBench =
    "schema = \"abcal.bench/2\"\n[bench]\ng_loc_mps2 = 9.8\n[stage]\ndriver = "
    "\"simulated\"\n[accelerometer]\ndriver = \"simulated\"\n"
    "rate_hz = 100.0\n[protocol]\nsteps = 12\nstep_deg = 30.0\ndwell_readings = 100\nsettle_s = 1.0\n"
    "[simulation]\nnoise = 1e-4\n";

TEST(CalibrationStudyTest, TheMeasurementOfABenchFileIsItsOnlyKind) {
  const CalibrationStudy study = run_calibration_study(of_file(kBench));
  ASSERT_EQ(study.kinds.size(), 1U);
  EXPECT_EQ(study.kinds[0].kind.name, "bench");
  EXPECT_EQ(study.kinds[0].all[0].count, 18U) << "the diagonal elements of six benches";
  EXPECT_EQ(study.kinds[0].no_result, 0);
  EXPECT_TRUE(study.passed()) << calibration_text(study);
  EXPECT_THROW(run_calibration_study(of_file(kBench + "noice = 1\n")), BenchError);
}

// Wobble of ten times its stated size is noticed by most runs; an offset that comes and goes by 1e-6 by none.
TEST(CalibrationStudyTest, PowerIsTheShareOfRunsThatWarn) {
  CalibrationOptions options;
  options.benches = 4;
  options.kinds = {"12-1000"};
  options.threads = 2;
  const PowerStudy study = run_power_study(options);
  const auto row = [&](std::string_view key, double drawn) {
    for (const PowerRow& one : study.rows)
      if (one.key == key && std::abs(one.drawn - drawn) < 1e-9 * drawn) return one;
    ADD_FAILURE() << key << " " << drawn;
    return PowerRow{};
  };
  EXPECT_EQ(row("hysteresis", 1e-4).stated, 1e-5);
  EXPECT_GE(row("wobble_urad", 500.0).doubtful, 3);
  EXPECT_EQ(row("cyclic_drift", 1e-6).doubtful, 0);
  EXPECT_GT(row("cyclic_drift", 1e-6).usable[0].count, 0U);
  for (const PowerRow& one : study.rows)
    EXPECT_NE(one.key, "orthogonality_deg") << "the simulator draws none";
  EXPECT_NE(power_text(study).find("cyclic_drift"), std::string::npos);
}

}  // namespace
}  // namespace abcal
