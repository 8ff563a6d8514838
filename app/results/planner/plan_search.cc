#include "app/results/planner/plan_search.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "protocol/plan/faces.h"

namespace abcal {
namespace {

ProtocolConfig with_circles(ProtocolConfig protocol, int steps, int faces) {
  protocol.steps = steps;
  protocol.step = Angle::degrees(360.0 / steps);
  protocol.faces = faces;
  protocol.motion = kMotionNames[0];
  return protocol;
}

/// The plans at a constant rate: up at a rate that both axes reach, down at a third of it, in turn; first
/// those of the bench file.
std::vector<ProtocolConfig> sweeps_to_try(const PlanningBench& bench) {
  const BenchConfig& config = bench.config;
  std::vector<ProtocolConfig> tried;
  // Several items that turn are evaluated each by itself: what one of them says of the stage would be lost.
  if (!config.allows_constant_rate() || config.has_several_items() ||
      config.protocol.estimator != kDefaultEstimator)
    return tried;
  ProtocolConfig protocol = config.protocol;
  const double fastest = std::min(bench.speed[0].deg_per_s, bench.speed[1].deg_per_s);
  if (protocol.is_constant_rate()) tried.push_back(protocol);
  protocol.motion = kMotionNames[1];
  protocol.faces = 1;
  protocol.stops = 0;
  protocol.steps = kStepsOfSweeps;
  protocol.step = Angle::degrees(360.0 / kStepsOfSweeps);
  for (const AxisSpeed& speed : bench.speed)
    if (speed.deg_per_s2 > 0.0)
      protocol.acceleration_deg_per_s2 = std::min(protocol.acceleration_deg_per_s2, speed.deg_per_s2);
  for (const double rate : kTriedRates) {
    if (rate > fastest) continue;
    protocol.rate_deg_per_s = {rate, rate / 3.0};
    for (const int sweeps : kTriedSweeps) {
      protocol.sweeps = sweeps;
      if (std::ranges::find(tried, protocol) == tried.end()) tried.push_back(protocol);
    }
  }
  const double rate_hz = config.items.front().accelerometer.settings.rate_hz;
  std::erase_if(tried, [&](const ProtocolConfig& each) {
    return readings_of_step(each, std::ranges::max(each.rate_deg_per_s), rate_hz) < kLeastReadingsOfStep;
  });
  return tried;
}

/// The reasons why the plan with the longest dwells does not reach the wanted uncertainties.
std::vector<std::string> why_out_of_reach(const PlanPrediction& longest, const WantedValues& wanted) {
  std::vector<std::string> reasons;
  for (std::size_t group = 0; group < kPlannedOutputs; ++group) {
    if (!wanted[group] || longest.u[group] <= *wanted[group]) continue;
    const auto output = static_cast<PlannedOutput>(group);
    const LargestPart& limit = longest.limits[group];
    reasons.push_back(fmt::format(
        "{}: {:.2g} {}is wanted, 3 x {} angles with {} readings each would give {:.2g}, {:.3g} times as "
        "much; {:.0f} % of its variance is {}",
        symbol_of(output), *wanted[group], unit_of(output).empty() ? "" : std::string(unit_of(output)) + " ",
        kTriedSteps.back(), kMostReadings, longest.u[group], longest.u[group] / *wanted[group],
        100.0 * limit.share, limit.name));
  }
  return reasons;
}

}  // namespace

PlanSearch::PlanSearch(PlanningBench bench, Tried tried) : bench_(std::move(bench)) {
  const ProtocolConfig& protocol = bench_.config.protocol;
  for (const int steps : kTriedSteps) tried_.emplace_back(bench_, with_circles(protocol, steps, 1));
  if (bench_.config.allows_two_faces())
    for (const int steps : kTriedInTwoFaces) try_if_possible(with_circles(protocol, steps, 2));
  if (tried == Tried::kSteps) return;
  for (const ProtocolConfig& sweeps : sweeps_to_try(bench_)) try_if_possible(sweeps);
}

void PlanSearch::try_if_possible(const ProtocolConfig& protocol) {
  try {
    tried_.emplace_back(bench_, protocol);
  } catch (const PlanError&) {
    return;  // The travel does not allow it.
  }
}

bool PlanSearch::tried_two_faces() const {
  return std::ranges::any_of(tried_, [](const PlannedCircles& each) { return each.faces() == kFaces; });
}

bool PlanSearch::tried_sweeps() const {
  return !std::ranges::all_of(tried_, &PlannedCircles::has_dwells);
}

std::optional<int> PlanSearch::least_readings(PlannedCircles& circles, const WantedValues& wanted,
                                              const PlannedValues& excess_of_analysis, int most) {
  // Against the logarithm of the readings that of u is nearly a straight line, down to its floor: the
  // Illinois method (false position with halved weights, Dowell & Jarratt 1971) needs few predictions.
  const auto excess = [&](int readings) {
    PlannedValues u = circles.u(readings);
    for (std::size_t group = 0; group < kPlannedOutputs; ++group) u[group] *= excess_of_analysis[group];
    return std::log(worst_ratio(u, wanted));
  };
  int too_few = kLeastReadings, enough = most;
  double excess_of_enough = excess(enough);
  if (excess_of_enough > 0.0) return std::nullopt;
  double excess_of_few = excess(too_few);
  if (excess_of_few <= 0.0) return too_few;
  int moved = 0;  // The end that moved last: -1, 1.
  // To 1 % of the dwell: the uncertainty is not known better.
  while (enough - too_few > 1 + enough / 100) {
    const double part = excess_of_few / (excess_of_few - excess_of_enough);
    const double readings = too_few * std::pow(static_cast<double>(enough) / too_few, part);
    const int middle = std::clamp(static_cast<int>(readings), too_few + 1, enough - 1);
    const double excess_of_middle = excess(middle);
    if (excess_of_middle <= 0.0) {
      enough = middle;
      excess_of_enough = excess_of_middle;
      if (std::exchange(moved, 1) == 1) excess_of_few /= 2.0;
    } else {
      too_few = middle;
      excess_of_few = excess_of_middle;
      if (std::exchange(moved, -1) == -1) excess_of_enough /= 2.0;
    }
  }
  return enough;
}

std::optional<int> PlanSearch::most_readings(PlannedCircles& circles, double duration_s) {
  // Settling and whole periods of the mains depend on the readings too: not solved for, but searched.
  const auto lasts = [&](int readings) { return circles.duration(readings).total_s() <= duration_s; };
  if (!lasts(kLeastReadings)) return std::nullopt;
  int few_enough = kLeastReadings, too_many = kMostReadings + 1;
  while (too_many - few_enough > 1) {
    const int middle = few_enough + (too_many - few_enough) / 2;
    (lasts(middle) ? few_enough : too_many) = middle;
  }
  return few_enough;
}

std::optional<PlanSearch::Choice> PlanSearch::shortest_choice(const WantedValues& wanted,
                                                              const PlannedValues& excess) {
  // The shortest moves are tried first: most other circles then last longer even with the fewest readings.
  std::vector<std::pair<double, PlannedCircles*>> order;
  for (PlannedCircles& circles : tried_)
    order.emplace_back(circles.duration(kLeastReadings).total_s(), &circles);
  std::ranges::stable_sort(order, {}, &std::pair<double, PlannedCircles*>::first);
  std::optional<Choice> found;
  double shortest_s = std::numeric_limits<double>::infinity();
  for (const auto& [least_s, circles] : order) {
    if (least_s >= shortest_s) break;
    const std::optional<int> most = most_readings(*circles, shortest_s);
    const auto readings = most ? least_readings(*circles, wanted, excess, *most) : std::nullopt;
    if (!readings) continue;
    const double duration_s = circles->duration(*readings).total_s();
    if (duration_s >= shortest_s) continue;
    shortest_s = duration_s;
    found = Choice{circles, *readings};
  }
  return found;
}

FoundPlan PlanSearch::shortest(const WantedValues& wanted) {
  FoundPlan found;
  PlannedValues& excess = found.excess;
  excess.fill(1.0);
  // A dwell that is longer than when it was checked by more than this is checked again.
  constexpr double kLonger = 1.2;
  std::map<const PlannedCircles*, std::optional<PlanPrediction>> checks;
  while (const std::optional<Choice> choice = shortest_choice(wanted, excess)) {
    PlannedCircles& circles = *choice->circles;
    const PlannedValues& searched = circles.u(choice->readings);
    const ProtocolConfig protocol = circles.protocol(choice->readings);
    std::optional<PlanPrediction>& check = checks[choice->circles];
    if (!check || protocol.dwell_readings > kLonger * check->protocol.dwell_readings)
      check = predict_plan(bench_, protocol);
    PlanPrediction plan = *check;
    if (protocol != check->protocol) {
      plan.protocol = protocol;
      plan.duration = circles.duration(choice->readings);
      for (std::size_t group = 0; group < kPlannedOutputs; ++group)
        plan.u[group] = excess[group] * searched[group];
    }
    found.readings_checked = check->protocol.dwell_readings;
    if (worst_ratio(plan.u, wanted) <= 1.0) {
      found.plan = plan;
      return found;
    }
    for (std::size_t group = 0; group < kPlannedOutputs; ++group)
      excess[group] = std::max(excess[group], plan.u[group] / searched[group]);
  }
  ProtocolConfig longest = with_circles(bench_.config.protocol, kTriedSteps.back(), 1);
  longest.dwell_readings = kMostReadings;
  found.out_of_reach = why_out_of_reach(predict_plan(bench_, longest), wanted);
  return found;
}

std::optional<PlanPrediction> PlanSearch::best_within(double duration_s, const WantedValues& wanted) {
  std::optional<ProtocolConfig> best;
  double least_ratio = std::numeric_limits<double>::infinity();
  for (PlannedCircles& circles : tried_) {
    const auto readings = most_readings(circles, duration_s);
    if (!readings) continue;
    const double ratio = worst_ratio(circles.u(*readings), wanted);
    if (best && ratio >= least_ratio) continue;
    least_ratio = ratio;
    best = circles.protocol(*readings);
  }
  if (!best) return std::nullopt;
  return predict_plan(bench_, *best);
}

double worst_ratio(const PlannedValues& u, const WantedValues& wanted) {
  double worst = 0.0;
  for (std::size_t group = 0; group < kPlannedOutputs; ++group) {
    if (wanted[group]) worst = std::max(worst, u[group] / *wanted[group]);
  }
  return worst;
}

}  // namespace abcal
