#include <abcal/abcal.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

abcal::SimulatedRecord simulated(int steps = 24) {
  abcal::SimulatedWorld world;
  world.item.sensitivity_matrix << 1.01, 0.002, -0.003, 0.004, 0.99, 0.001, -0.002, 0.003, 1.02;
  world.item.offset << 0.01, -0.02, 0.03;
  world.stage.zx = 1e-4;
  world.steps = steps;
  return abcal::simulate(world);
}

TEST(Library, ASimulatedRunIsAnalysedToItsTruth) {
  const abcal::SimulatedRecord run = simulated(72);
  const abcal::Result result = abcal::analyse(run.record, "joint");
  ASSERT_EQ(result.usability(), abcal::Usability::kUsable) << result.why();
  const abcal::Values& s = result.sensitivity_matrix();
  EXPECT_LT(((s.value - run.true_sensitivity_matrix).array() / s.u.array()).abs().maxCoeff(), 4.0);
  EXPECT_NEAR(std::sqrt(result.covariance().matrix(0, 0)), s.u(0, 0), 1e-12 * s.u(0, 0));
  EXPECT_EQ(result.covariance().labels.at(9), "O_u");
  EXPECT_FALSE(result.effects().empty());
  ASSERT_FALSE(result.quantities().empty());
  for (const abcal::QuantityGroup& group : result.quantities()) {
    EXPECT_NE(result.to_json().find("\"key\": \"" + group.key + "\""), std::string::npos) << group.key;
    EXPECT_EQ(group.values.value.size(), static_cast<Eigen::Index>(group.symbols.size())) << group.key;
  }
  EXPECT_NE(result.to_json().find("\"abcal.result/1\""), std::string::npos);
}

TEST(Library, TheAbcResultHasThePublishedOneBesides) {
  const abcal::Record record = simulated().record;
  const abcal::Result abc = abcal::analyse(record, "abc");
  ASSERT_TRUE(abc.published());
  const abcal::Published& published = *abc.published();
  EXPECT_EQ(published.sensitivity_matrix.value.rows(), 3);
  EXPECT_NEAR(std::sqrt(published.covariance.matrix(0, 0)), published.sensitivity_matrix.u(0, 0),
              1e-12 * published.sensitivity_matrix.u(0, 0));
  EXPECT_EQ(published.covariance_intrinsic.labels.at(3), "phi_uv");
  EXPECT_FALSE(abcal::analyse(record, "joint").published());
}

TEST(Library, ArraysGiveTheRecordTheyWereTakenFrom) {
  const abcal::Record record = simulated().record;
  const std::vector<int> experiment = record.experiment();
  const Eigen::Matrix<double, Eigen::Dynamic, 3> u = record.u();
  const abcal::Rows u_rows(u.data(), u.rows(), 3,
                           {1, u.rows()});  // Columns behind one another: any layout will do.
  const abcal::Record again(
      {.experiment = experiment, .alpha_deg = record.alpha_deg(), .readings = record.readings(), .u = u_rows},
      {.effects = {{"wobble_urad", 3.0}}});
  EXPECT_EQ(again.readings(), record.readings());
  EXPECT_EQ(again.closing(), record.closing());
  EXPECT_EQ(again.effects().at("wobble_urad"), 3.0);
  EXPECT_EQ(abcal::analyse(again, "abc").sensitivity_matrix().value,
            abcal::analyse(record, "abc").sensitivity_matrix().value);
}

TEST(Library, WrongArraysAreRefusedWithEveryProblem) {
  const std::vector<int> experiment{1, 2};
  const std::vector<double> numbers{0.0, std::nan(""), 1.0};
  const abcal::Column alpha(numbers.data(), 3, Eigen::InnerStride<Eigen::Dynamic>(1));
  try {
    const abcal::Record record({.experiment = experiment, .alpha_deg = alpha});
    FAIL() << record.size();
  } catch (const std::invalid_argument& error) {
    const std::string message = error.what();
    EXPECT_NE(message.find("experiment: found 2 rows; required: 3, as alpha_deg has"), std::string::npos)
        << message;
    EXPECT_NE(message.find("readings: found 0 rows"), std::string::npos) << message;
  }
}

TEST(Library, TheForwardModelAgreesWithTheSimulation) {
  abcal::SimulatedWorld world;
  world.item.k2 << 1e-4, 0.0, -2e-4;
  world.noise = 0.0;
  world.steps = 5;
  world.stage.xz = 2e-4;
  world.stage.mean_step_x_deg = 0.01;
  world.stage.initial_turn_z_deg = 0.02;
  const abcal::Record record = abcal::simulate(world).record;
  const std::vector<int> experiment = record.experiment();
  for (std::size_t i = 0; i < record.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(i);
    if (record.alpha_deg()[row] == 0.0 || record.alpha_deg()[row] == 360.0)
      continue;  // Zero has no mean step error.
    const Eigen::Vector3d expected = abcal::response(
        world.item, abcal::specific_force(experiment[i], record.alpha_deg()[row], world.stage));
    EXPECT_LT((record.readings().row(row).transpose() - expected).norm(), 1e-9)
        << experiment[i] << " " << row;
  }
}

TEST(Library, AStudyCanBeStopped) {
  const abcal::MonteCarloStudy study = abcal::monte_carlo(
      simulated(12).record,
      {.trials = 100'000'000, .threads = 1, .progress = [](std::uint64_t, std::uint64_t) { return false; }});
  EXPECT_TRUE(study.interrupted());
  EXPECT_LT(study.trials(), 100'000'000U);
}

TEST(Library, AnUnknownNameIsRefused) {
  EXPECT_THROW(abcal::analyse(simulated().record, "best"), std::invalid_argument);
  EXPECT_THROW(abcal::simulation_set("7"), std::invalid_argument);
  EXPECT_THROW(abcal::load("nothing.run"), std::runtime_error);
  EXPECT_THROW(abcal::Bench("nothing.toml"), std::runtime_error);
}

TEST(Library, ADriverIsAddedOnce) {
  abcal::AccelerometerDriver driver;
  driver.name = "library_test";
  driver.make = [](auto, abcal::Clock&, const abcal::AccelerometerSettings&) { return nullptr; };
  driver.ports = 0;
  abcal::add_accelerometer_driver(driver);
  EXPECT_EQ(abcal::accelerometer_driver_list().back(), "library_test");
  EXPECT_THROW(abcal::add_accelerometer_driver(driver), std::invalid_argument);
}

/// A bench whose instruments are simulated without bytes, in a folder of its own.
class SmallBench : public testing::Test {
 protected:
  void SetUp() override {
    std::filesystem::create_directories(folder);
    std::ofstream(folder / "bench.toml") << R"(schema = "abcal.bench/2"
[bench]
name = "small"
g_loc_mps2 = 9.80665
g_loc_source = "for the test"
[stage]
driver = "simulated"
[accelerometer]
driver = "simulated"
port = "simulated"
rate_hz = 100.0
response_unit = "g"
[protocol]
steps = 12
step_deg = 30.0
dwell_readings = 20
[simulation]
noise = 1e-5
)";
  }
  void TearDown() override { std::filesystem::remove_all(folder); }

  std::filesystem::path folder =
      std::filesystem::path(testing::TempDir()) /
      (std::string("abcal_library_test_") + testing::UnitTest::GetInstance()->current_test_info()->name());
};

TEST_F(SmallBench, ARunIsMeasuredAndAnalysed) {
  abcal::Bench bench(folder / "bench.toml");
  int dwells = 0;
  const abcal::CompleteRun run = bench.run(
      folder / "a.run", [&](const abcal::Event& event) { dwells += event.name == "dwell_done" ? 1 : 0; });
  EXPECT_EQ(dwells, 3 * 13 + 8);
  EXPECT_EQ(run.result.to_json(), abcal::analyse(abcal::load(run.file)).to_json());
  EXPECT_EQ(bench.simulated().size(), 2U);
}

TEST_F(SmallBench, EachOfSeveralItemsIsRead) {
  std::ifstream one(folder / "bench.toml");
  std::string text{std::istreambuf_iterator<char>(one), {}};
  const std::size_t begin = text.find("[accelerometer]"), end = text.find("[protocol]");
  const std::string item = "[[item]]\n[item." + text.substr(begin + 1, end - begin - 1);
  std::ofstream(folder / "two.toml") << text.erase(begin, end - begin) << item << item;
  abcal::Bench bench(folder / "two.toml");
  const abcal::CompleteRun run = bench.run(folder / "a.run", [](const abcal::Event&) {});
  const std::string file = (folder / "a.run").string();
  EXPECT_THROW(abcal::load(file), std::invalid_argument);
  const abcal::Record first = abcal::load(file + "#1"), second = abcal::load(file + "#2");
  EXPECT_EQ(first.size(), second.size());
  EXPECT_NE(first.readings(), second.readings());
  EXPECT_NE(run.result.to_json().find("\"usable\""), std::string::npos);
  EXPECT_NO_THROW(abcal::compare({file + "#1", file + "#2"}, {.any_item = true}));
}

TEST_F(SmallBench, AListenerThatThrowsHaltsTheStageAndTheRunResumes) {
  abcal::Bench bench(folder / "bench.toml");
  int dwells = 0;
  const auto throwing = [&](const abcal::Event& event) {
    if (event.name == "dwell_done" && ++dwells == 5) throw std::domain_error("as the test wants");
  };
  EXPECT_THROW(bench.run(folder / "a.run", throwing), std::domain_error);
  EXPECT_EQ(dwells, 5);
  const abcal::CompleteRun run = bench.resume(folder / "a.run");
  EXPECT_EQ(abcal::load(run.file).size(), 3U * 13U);
}

TEST_F(SmallBench, AHaltFromTheListenerIsTold) {
  abcal::Bench bench(folder / "bench.toml");
  bench.halt();  // Nothing runs.
  EXPECT_THROW(bench.run(folder / "a.run",
                         [&](const abcal::Event& event) {
                           if (event.name == "dwell_done") bench.halt();
                         }),
               abcal::Stopped);
}

}  // namespace
