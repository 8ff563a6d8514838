// The contract of stages and accelerometers on the simulated instruments without bytes, and on each driver of
// the registry over its simulated firmware, in simulated time.

#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/measure/bench/make_bench.h"
#include "drivers/registry.h"
#include "tests/app/stage_variants.h"
#include "tests/contract/instrument_contract.h"

namespace abcal::contract {
namespace {

bool in_mps2(const std::string& driver) {
  return driver == "iio" || driver == "mavlink" || driver == "vectornav" || driver == "xsens_mti";
}

/// @param stage  [stage] and its axes, but for the port
Bench simulated_bench(const std::string& stage, const std::string& accelerometer,
                      const std::string& accelerometer_lines) {
  const std::string matrix =
      in_mps2(accelerometer) ? "sensitivity_matrix = [[9.81, 0.0, 0.0], [0.0, 9.81, 0.0], [0.0, 0.0, 9.81]]\n"
                             : "";
  return make_bench(parse_bench("[bench]\ng_loc_mps2 = 9.81\n[stage]\nport = \"simulated\"\n" + stage +
                                    "[accelerometer]\ndriver = \"" + accelerometer +
                                    "\"\nport = \"simulated\"\n" + accelerometer_lines +
                                    "[simulation]\nnoise = 1e-3\n" + matrix +
                                    "[simulation.x]\ntravel_min_deg = "
                                    "-200.0\ntravel_max_deg = 200.0\n",
                                "contract"));
}

StageCase stage_case(const std::string& name, const std::string& section, bool has_one_state = false) {
  return {name,
          [section] {
            const auto bench =
                std::make_shared<Bench>(simulated_bench(section, "simulated", "rate_hz = 100.0\n"));
            return StageBench{
                {bench, bench->clock.get()}, {bench, bench->stage.get()}, [bench](StageAxis axis) {
                  return bench->world->commanded_angle(axis, bench->clock->now());
                }};
          },
          has_one_state};
}

AccelerometerCase accelerometer_case(const std::string& driver, const std::string& lines) {
  return {driver, [driver, lines] {
            const auto bench =
                std::make_shared<Bench>(simulated_bench("driver = \"simulated\"\n", driver, lines));
            return AccelerometerBench{{bench, bench->clock.get()},
                                      {bench, bench->first().accelerometer.get()},
                                      Eigen::Vector3d(0.0, 0.0, in_mps2(driver) ? 9.81 : 1.0)};
          }};
}

std::vector<StageCase> stage_cases() {
  std::vector<StageCase> cases{stage_case("simulated", "driver = \"simulated\"\n")};
  for (const StageVariant& stage : stage_variants()) {
    const auto description = stage.settings().description;
    cases.push_back(stage_case(stage.name, stage.section(), description && description->status_of_all));
  }
  return cases;
}

std::vector<AccelerometerCase> accelerometer_cases() {
  std::vector<AccelerometerCase> cases{accelerometer_case("simulated", "rate_hz = 100.0\n")};
  for (const AccelerometerDriver& driver : accelerometer_drivers())
    cases.push_back(accelerometer_case(driver.name, driver.example));
  return cases;
}

INSTANTIATE_TEST_SUITE_P(Of, StageContract, testing::ValuesIn(stage_cases()),
                         [](const auto& one) { return one.param.name; });
INSTANTIATE_TEST_SUITE_P(Of, AccelerometerContract, testing::ValuesIn(accelerometer_cases()),
                         [](const auto& one) { return one.param.name; });

}  // namespace
}  // namespace abcal::contract
