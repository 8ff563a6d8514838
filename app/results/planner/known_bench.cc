#include "app/results/planner/known_bench.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <utility>
#include <vector>

#include "app/bench_file/stage_record_file.h"
#include "app/results/analysis/load_record.h"
#include "app/system/real_clock.h"
#include "protocol/estimators/circle/abc_estimator.h"

namespace abcal {
namespace {

KnownAxis known_axis(const BenchConfig& config, const StageAxisConfig& axis, const sim::AxisTruth& truth) {
  const StageConfig& stage = config.stage;
  KnownAxis known;
  const bool simulated = stage.port == "simulated";
  if (simulated) {
    known.travel = {truth.travel_min, truth.travel_max};
    known.speed = {truth.speed_deg_per_s, truth.acceleration_deg_per_s2};
  }
  if (axis.travel_min_deg)
    known.travel.min = std::max(known.travel.min, Angle::degrees(*axis.travel_min_deg));
  if (axis.travel_max_deg)
    known.travel.max = std::min(known.travel.max, Angle::degrees(*axis.travel_max_deg));
  if (axis.speed_deg_per_s) known.speed.deg_per_s = *axis.speed_deg_per_s;
  // Who has the stage turn at a rate says that it reaches it.
  const ProtocolConfig& protocol = config.protocol;
  if (!(known.speed.deg_per_s > 0.0) && protocol.is_constant_rate())
    known.speed = {std::ranges::max(protocol.rate_deg_per_s), protocol.acceleration_deg_per_s2};
  known.travel_assumed = !simulated && !(axis.travel_min_deg && axis.travel_max_deg);
  return known;
}

}  // namespace

std::array<KnownAxis, 2> known_axes(const BenchConfig& config) {
  return {known_axis(config, config.stage.x, config.simulation.x),
          known_axis(config, config.stage.z, config.simulation.z)};
}

KnownItem known_item(const RunRecord& record, const CalibrationResult& result) {
  KnownItem item;
  std::vector<double> noise;
  for (std::size_t j = 0; j < 3; ++j) {
    const double s = result.intrinsic_sensitivity[j].value;
    const auto row = static_cast<Eigen::Index>(j);
    for (std::size_t k = 0; k < 3; ++k)
      item.sensitivity_matrix(row, static_cast<Eigen::Index>(k)) =
          result.sensitivity_matrix.value()[j][k].value / s;
    item.offset[row] = result.offset[j].value / s;
    // From the mean's uncertainty: the correlation of the readings is in it.
    for (const DwellRecord& dwell : record.dwells)
      if (dwell.u_mean && dwell.count >= 1)
        noise.push_back((*dwell.u_mean)[row] * std::sqrt(static_cast<double>(dwell.count)) / s);
  }
  if (noise.empty()) {
    throw std::invalid_argument(fmt::format(
        "{}: no mean with its uncertainty and its number of readings; required: a run, or a number",
        record.source));
  }
  const auto middle = noise.begin() + static_cast<std::ptrdiff_t>(noise.size() / 2);
  std::nth_element(noise.begin(), middle, noise.end());
  item.noise = *middle;
  return item;
}

KnownItem item_of_run(const std::filesystem::path& run, int item) {
  const LoadedRecord loaded = load_record(run, item);
  const CalibrationResult result = analyse_abc(loaded.record);
  if (!result.sensitivity_matrix)
    throw std::invalid_argument(fmt::format("{}: {}", run.string(), result.why));
  return known_item(loaded.record, result);
}

std::optional<double> simulated_noise(const BenchConfig& config) {
  const BenchItemConfig& item = config.items.front();
  if (item.accelerometer.port != "simulated" || !(item.simulation.noise > 0.0)) return std::nullopt;
  const Eigen::Vector3d scale = item.simulation.sensitivity_matrix.rowwise().norm();
  return item.simulation.noise / scale.minCoeff();
}

PlanningBench planning_bench(const BenchConfig& config, const KnownItem& item) {
  const auto [x, z] = known_axes(config);
  PlanningBench bench{config, {x.travel, z.travel}, {x.speed, z.speed}, item};
  if (config.stage.record.empty()) return bench;
  StageRecord record = read_stage_record(config.stage.record);
  record.state.mean.setZero();
  const double months = months_between(record.learned_utc(), format_utc(RealClock().utc_now()));
  bench.stage_record = {std::make_shared<const StageRecord>(std::move(record)), months};
  return bench;
}

}  // namespace abcal
