#include "abcal/plan.h"

#include <fmt/format.h>

#include <cmath>
#include <stdexcept>

#include "app/bench_file/bench_records.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/results/planner/known_bench.h"
#include "app/results/planner/plan_search.h"

namespace abcal::v1 {
namespace {

PredictedPlan public_plan(const ::abcal::PlanPrediction& prediction) {
  PredictedPlan plan;
  plan.steps = prediction.protocol.steps;
  plan.step_deg = prediction.protocol.step.deg();
  plan.dwell_readings = prediction.protocol.dwell_readings;
  plan.estimator = prediction.protocol.estimator;
  plan.moving_s = prediction.duration.moving_s;
  plan.settling_s = prediction.duration.settling_s;
  plan.dwelling_s = prediction.duration.dwelling_s;
  for (std::size_t group = 0; group < ::abcal::kPlannedOutputs; ++group) {
    const std::string symbol(::abcal::symbol_of(static_cast<::abcal::PlannedOutput>(group)));
    plan.u[symbol] = prediction.u[group];
    plan.largest_part[symbol] = prediction.limits[group].name;
  }
  if (prediction.protocol.is_constant_rate()) {
    plan.rate_deg_per_s = prediction.protocol.rate_deg_per_s;
    plan.sweeps = prediction.protocol.sweeps;
  }
  return plan;
}

::abcal::KnownItem item_of(const PlanQuestion& question, const ::abcal::BenchConfig& config) {
  if (!question.noise_of.empty()) return ::abcal::item_of_run(question.noise_of);
  if (question.noise) {
    if (*question.noise > 0.0 && *question.noise <= 1.0) return {.noise = *question.noise};
    throw std::invalid_argument(
        fmt::format("noise: found {:g}; required: above 0 and at most 1 (g_loc)", *question.noise));
  }
  if (const auto simulated = ::abcal::simulated_noise(config)) return {.noise = *simulated};
  throw std::invalid_argument(
      "the noise of a reading is not known; required: noise (standard deviation of one reading in g_loc) or "
      "noise_of (an earlier run of such an item)");
}

::abcal::PlanningBench bench_of(const std::filesystem::path& file, const PlanQuestion& question) {
  ::abcal::BenchConfig config = ::abcal::read_bench(file, ::abcal::register_records());
  if (!question.estimator.empty()) {
    if (question.estimator != "abc" && question.estimator != "joint")
      throw std::invalid_argument(
          fmt::format("estimator: found \"{}\"; required: abc or joint", question.estimator));
    config.protocol.estimator = question.estimator;
  }
  return ::abcal::planning_bench(config, item_of(question, config));
}

}  // namespace

PlanAnswer plan(const std::filesystem::path& bench_file, const PlanQuestion& question) {
  const ::abcal::WantedValues wanted =
      question.reach.empty() ? ::abcal::published_wanted() : ::abcal::parse_wanted(question.reach);
  if (!(question.within_s >= 0.0 && question.within_s < 1e6))
    throw std::invalid_argument(
        fmt::format("within_s: found {:g}; required: a time above 0 and below 1e6 s", question.within_s));
  ::abcal::PlanSearch search(bench_of(bench_file, question));
  PlanAnswer answer;
  if (question.within_s > 0.0) {
    if (const auto found = search.best_within(question.within_s, wanted)) {
      answer.plan = public_plan(*found);
    } else {
      answer.out_of_reach.push_back(
          fmt::format("{:g} s: moves and settling alone last longer", question.within_s));
    }
    return answer;
  }
  ::abcal::FoundPlan found = search.shortest(wanted);
  if (found.plan) answer.plan = public_plan(*found.plan);
  answer.out_of_reach = std::move(found.out_of_reach);
  return answer;
}

PredictedPlan predict(const std::filesystem::path& bench_file, int steps, int dwell_readings,
                      const PlanQuestion& question) {
  if (steps < 3 || steps > 3600)
    throw std::invalid_argument(fmt::format("steps: found {}; required: 3 to 3600", steps));
  if (dwell_readings < ::abcal::kLeastReadings || dwell_readings > ::abcal::kMostReadings)
    throw std::invalid_argument(fmt::format("dwell_readings: found {}; required: {} to {}", dwell_readings,
                                            ::abcal::kLeastReadings, ::abcal::kMostReadings));
  const ::abcal::PlanningBench bench = bench_of(bench_file, question);
  ::abcal::ProtocolConfig protocol = bench.config.protocol;
  protocol.motion = ::abcal::kMotionNames[0];
  protocol.steps = steps;
  protocol.step = ::abcal::Angle::degrees(360.0 / steps);
  protocol.dwell_readings = dwell_readings;
  return public_plan(::abcal::predict_plan(bench, protocol));
}

}  // namespace abcal::v1
