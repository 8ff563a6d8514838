#include "protocol/estimators/joint/step_strategy.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace abcal {
namespace {

/// A step is taken if the cost falls by this share of the fall predicted by the linear model (Ceres'
/// min_relative_decrease).
constexpr double kLeastQuality = 1e-3;
/// Damping begins with the first of these, an addition to a diagonal of 1 that shortens a step only in the
/// directions that the readings determine least, and ends below the second.
constexpr double kFirstDamping = 1e-6;
constexpr double kLeastDamping = 1e-9;

/// The next step would lower the cost by less: a step of 1e-4 standard uncertainties in all unknowns
/// together.
constexpr double kNegligibleFall = 1e-8;
/// The same as a share of the cost, for readings that contradict the model, and for uncertainties far below
/// the last digit of the readings.
constexpr double kNegligibleShare = 1e-10;
/// Where a predicted fall below this (1e-3 standard uncertainties), or below this share of the cost, is not
/// seen in the cost, round-off hides it.
constexpr double kHiddenFall = 1e-6;
constexpr double kHiddenShare = 1e-9;

/// Most fits take less than ten. A product of two unknowns that the readings hardly determine can make steps
/// go to and fro across the minimum, each 0.96 times the one before, or creep along a valley: some hundreds.
constexpr int kMostIterations = 1000;
/// The matrix of the first step serves for the second, and further while each step lowers the cost by less
/// than this share of the one before.
constexpr double kFastConvergence = 0.05;

}  // namespace

bool StepStrategy::accepts(double fall, double predicted) {
  return fall > kLeastQuality * predicted;
}

void StepStrategy::was_taken(double fall, double predicted) {
  const double quality = 2.0 * fall / predicted - 1.0;
  damping_ *= std::max(1.0 / 3.0, 1.0 - quality * quality * quality);
  if (damping_ < kLeastDamping) damping_ = 0.0;
  growth_ = 2.0;
  tries_undamped_ = false;
}

void StepStrategy::was_refused() {
  damping_ = damping_ > 0.0 ? damping_ * growth_ : kFirstDamping;
  growth_ *= 2.0;
}

void StepStrategy::try_undamped() {
  damping_ = 0.0;
  tries_undamped_ = true;
}

Minimum minimise(SumOfSquares& problem) {
  Minimum out;
  StepStrategy strategy;
  double cost = problem.cost();
  out.costs.push_back(cost);
  bool anew = true;
  double last = std::numeric_limits<double>::infinity();
  while (std::isfinite(cost) && out.iterations < kMostIterations) {
    ++out.iterations;
    const double damping = strategy.damping();
    if (damping > 0.0) ++out.damped;
    anew = anew || damping > 0.0;
    const std::optional<double> predicted = problem.solve_step(damping, anew);
    if (!predicted || !std::isfinite(*predicted)) return out;
    if (*predicted < kNegligibleFall + kNegligibleShare * cost) {
      if (damping > 0.0) {
        strategy.try_undamped();
        anew = true;
        continue;
      }
      out.found = true;
      return out;
    }
    problem.move();
    const double after = problem.cost();
    if (StepStrategy::accepts(cost - after, *predicted)) {
      strategy.was_taken(cost - after, *predicted);
      anew = damping > 0.0 || !(*predicted < kFastConvergence * last);
      last = *predicted;
      cost = after;
      out.costs.push_back(cost);
      continue;
    }
    problem.move_back();
    const bool hidden = damping == 0.0 && *predicted < kHiddenFall + kHiddenShare * cost;
    if (hidden || strategy.tries_undamped()) {
      out.found = true;
      return out;
    }
    // A matrix of an earlier point is replaced first.
    if (anew) strategy.was_refused();
    anew = true;
  }
  return out;
}

}  // namespace abcal
