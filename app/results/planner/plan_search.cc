#include "app/results/planner/plan_search.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

namespace abcal {

PlanSearch::PlanSearch(PlanningBench bench, std::function<void(double)> progress)
    : bench_(std::move(bench)), progress_(std::move(progress)) {}

void PlanSearch::begin_circles(std::size_t tried, std::size_t count, int predictions) {
  part_ = static_cast<double>(tried) / static_cast<double>(count);
  end_of_circles_ = static_cast<double>(tried + 1) / static_cast<double>(count);
  part_of_prediction_ = 1.0 / predictions;
}

ProtocolConfig PlanSearch::protocol(Circles circles, int readings) const {
  ProtocolConfig protocol = bench_.config.protocol;
  protocol.steps = circles.steps;
  protocol.step = Angle::degrees(360.0 / circles.steps);
  protocol.faces = circles.faces;
  protocol.dwell_readings = readings;
  return protocol;
}

std::vector<PlanSearch::Circles> PlanSearch::tried() const {
  std::vector<Circles> circles;
  for (const int steps : kTriedSteps) circles.push_back({steps, 1});
  if (!bench_.config.allows_two_faces()) return circles;
  try {
    static_cast<void>(duration({kTriedInTwoFaces.back(), 2}, kLeastReadings));
  } catch (const PlanError&) {
    return circles;  // The travel does not allow it.
  }
  for (const int steps : kTriedInTwoFaces) circles.push_back({steps, 2});
  return circles;
}

PlanDuration PlanSearch::duration(Circles circles, int readings) const {
  const ProtocolConfig planned = protocol(circles, readings);
  return estimate_duration(make_rotation_plan(planned, bench_.travel), planned, bench_.speed,
                           bench_.config.items.front().accelerometer.settings.rate_hz);
}

const PlanPrediction& PlanSearch::predicted(Circles circles, int readings) {
  const auto [place, is_new] = predicted_.try_emplace({circles, readings});
  if (is_new) {
    place->second = predict_plan(bench_, protocol(circles, readings));
    part_ = std::min(part_ + part_of_prediction_, end_of_circles_);
    if (progress_) progress_(part_);
  }
  return place->second;
}

std::optional<int> PlanSearch::least_readings(Circles circles, const WantedValues& wanted) {
  // Against the logarithm of the readings that of u is nearly a straight line, down to its floor: the
  // Illinois method (false position with halved weights, Dowell & Jarratt 1971) needs few predictions.
  const auto excess = [&](int readings) {
    return std::log(worst_ratio(predicted(circles, readings).u, wanted));
  };
  int too_few = kLeastReadings, enough = kMostReadings;
  double excess_of_few = excess(too_few), excess_of_enough = excess(enough);
  if (excess_of_enough > 0.0) return std::nullopt;
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

std::optional<int> PlanSearch::most_readings(Circles circles, double duration_s) const {
  // Settling and whole periods of the mains depend on the readings too: not solved for, but searched.
  const auto lasts = [&](int readings) { return duration(circles, readings).total_s() <= duration_s; };
  if (!lasts(kLeastReadings)) return std::nullopt;
  int few_enough = kLeastReadings, too_many = kMostReadings + 1;
  while (too_many - few_enough > 1) {
    const int middle = few_enough + (too_many - few_enough) / 2;
    (lasts(middle) ? few_enough : too_many) = middle;
  }
  return few_enough;
}

FoundPlan PlanSearch::shortest(const WantedValues& wanted) {
  FoundPlan found;
  const std::vector<Circles> all = tried();
  for (std::size_t i = 0; i < all.size(); ++i) {
    const Circles circles = all[i];
    begin_circles(i, all.size(), kPredictionsOfShortest);
    // Longer than the best one even with the fewest readings: not worth a prediction.
    if (found.plan && duration(circles, kLeastReadings).total_s() >= found.plan->duration.total_s()) continue;
    const auto readings = least_readings(circles, wanted);
    if (!readings) continue;
    const PlanPrediction& plan = predicted(circles, *readings);
    if (!found.plan || plan.duration.total_s() < found.plan->duration.total_s()) found.plan = plan;
  }
  if (progress_) progress_(1.0);
  if (found.plan) return found;
  const PlanPrediction& longest = predicted({kTriedSteps.back(), 1}, kMostReadings);
  for (std::size_t group = 0; group < kPlannedOutputs; ++group) {
    if (!wanted[group] || longest.u[group] <= *wanted[group]) continue;
    const auto output = static_cast<PlannedOutput>(group);
    const LargestPart& limit = longest.limits[group];
    found.out_of_reach.push_back(fmt::format(
        "{}: {:.2g} {}is wanted, 3 x {} angles with {} readings each would give {:.2g}, {:.3g} times as "
        "much; {:.0f} % of its variance is {}",
        symbol_of(output), *wanted[group], unit_of(output).empty() ? "" : std::string(unit_of(output)) + " ",
        kTriedSteps.back(), kMostReadings, longest.u[group], longest.u[group] / *wanted[group],
        100.0 * limit.share, limit.name));
  }
  return found;
}

std::optional<PlanPrediction> PlanSearch::best_within(double duration_s, const WantedValues& wanted) {
  std::optional<PlanPrediction> best;
  const std::vector<Circles> all = tried();
  for (std::size_t i = 0; i < all.size(); ++i) {
    const Circles circles = all[i];
    begin_circles(i, all.size(), kPredictionsOfBestWithin);
    const auto readings = most_readings(circles, duration_s);
    if (!readings) continue;
    const PlanPrediction& plan = predicted(circles, *readings);
    if (!best || worst_ratio(plan.u, wanted) < worst_ratio(best->u, wanted)) best = plan;
  }
  if (progress_) progress_(1.0);
  return best;
}

double worst_ratio(const PlannedValues& u, const WantedValues& wanted) {
  double worst = 0.0;
  for (std::size_t group = 0; group < kPlannedOutputs; ++group) {
    if (wanted[group]) worst = std::max(worst, u[group] / *wanted[group]);
  }
  return worst;
}

}  // namespace abcal
