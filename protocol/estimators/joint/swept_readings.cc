#include "protocol/estimators/joint/swept_readings.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstddef>
#include <functional>
#include <optional>
#include <vector>

#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/model/effects.h"
#include "protocol/model/sweep_angle.h"
#include "protocol/plan/sweep_margins.h"

namespace abcal {
namespace {

/// Commanded angle of the axis that turns.
Angle turned_angle(const DwellRecord& dwell) {
  return dwell.experiment == 3 ? dwell.commanded_z : dwell.commanded_x;
}

/// Positions of the readings of each sweep, in the order of the readings.
using Sweeps = std::vector<std::vector<std::size_t>>;

Sweeps sweeps_of(const CollectedReadings& data) {
  Sweeps sweeps(data.sweeps.size());
  for (std::size_t n = 0; n < data.readings.size(); ++n)
    if (const int sweep = data.readings[n].sweep; sweep >= 0)
      sweeps[static_cast<std::size_t>(sweep)].push_back(n);
  return sweeps;
}

void find_mean_rates(CollectedReadings& data, const Sweeps& sweeps) {
  for (const std::vector<std::size_t>& sweep : sweeps) {
    double sum = 0.0;
    for (const std::size_t n : sweep) sum += data.readings[n].rate_radps;
    for (const std::size_t n : sweep)
      data.readings[n].mean_rate_radps = sum / static_cast<double>(sweep.size());
  }
}

void count_from_middle_of_sweeps(CollectedReadings& data, const Sweeps& sweeps) {
  const auto turned_deg = [&](std::size_t n) { return turned_angle(*data.dwells[n]).deg(); };
  for (const std::vector<std::size_t>& sweep : sweeps) {
    if (sweep.empty()) continue;
    const auto [low, high] = std::ranges::minmax_element(sweep, {}, turned_deg);
    const double middle_deg = 0.5 * (turned_deg(*low) + turned_deg(*high));
    for (const std::size_t n : sweep)
      data.readings[n].turned_rad = Angle::degrees(turned_deg(n) - middle_deg).rad();
  }
}

/// The sines that gravity becomes in one sweep.
struct SweepSines {
  std::array<std::complex<double>, 3> of_output{};
  double rate_radps = 0.0;
  int experiment = 0;
  int count = 0;
};

std::vector<SweepSines> sines_of(const CollectedReadings& data, const Sweeps& sweeps) {
  std::vector<SweepSines> out(sweeps.size());
  for (std::size_t k = 0; k < sweeps.size(); ++k) {
    SweepSines& sines = out[k];
    for (const std::size_t n : sweeps[k]) {
      const EffectReading& reading = data.readings[n];
      for (std::size_t j = 0; j < 3; ++j)
        sines.of_output[j] += reading.value(static_cast<Eigen::Index>(j)) *
                              std::complex<double>(reading.cos_alpha, -reading.sin_alpha);
      sines.rate_radps = reading.mean_rate_radps;
      sines.experiment = reading.experiment;
      ++sines.count;
    }
    for (std::complex<double>& sine : sines.of_output) sine /= std::max(1, sines.count);
  }
  return out;
}

/// Calls `with` for each two sweeps of one circle: their difference is free of all that depends on the angle
/// alone.
void for_pairs(const std::vector<SweepSines>& sweeps,
               const std::function<void(const SweepSines&, const SweepSines&)>& with) {
  for (std::size_t a = 0; a < sweeps.size(); ++a)
    for (std::size_t b = a + 1; b < sweeps.size(); ++b)
      if (sweeps[a].experiment == sweeps[b].experiment && sweeps[a].count > 0 && sweeps[b].count > 0)
        with(sweeps[a], sweeps[b]);
}

// Rates, or their squares, that differ by less do not show an effect that grows with them.
constexpr double kLeastApart = 0.05;  // radian/s, or (radian/s)^2

/// The delay shows as a phase of the readings that grows with the rate.
std::array<double, 2> delays_of(const std::vector<SweepSines>& sweeps) {
  std::array<double, 2> sum{}, weight{};
  for_pairs(sweeps, [&](const SweepSines& a, const SweepSines& b) {
    const double apart = a.rate_radps - b.rate_radps;
    std::complex<double> both = 0.0;
    for (std::size_t j = 0; j < 3; ++j) both += a.of_output[j] * std::conj(b.of_output[j]);
    const std::size_t axis = a.experiment == 3 ? 1 : 0;
    sum[axis] -= std::arg(both) * apart;
    weight[axis] += apart * apart;
  });
  for (std::size_t axis = 0; axis < 2; ++axis)
    sum[axis] = weight[axis] > kLeastApart * kLeastApart ? sum[axis] / weight[axis] : 0.0;
  return sum;
}

/// The loss of amplitude at the reference rate, which grows with the square of the rate.
double loss_of(const std::vector<SweepSines>& sweeps) {
  double sum = 0.0, weight = 0.0;
  for_pairs(sweeps, [&](const SweepSines& a, const SweepSines& b) {
    double of_a = 0.0, of_b = 0.0;
    for (std::size_t j = 0; j < 3; ++j) {
      of_a += std::norm(a.of_output[j]);
      of_b += std::norm(b.of_output[j]);
    }
    const double apart = a.rate_radps * a.rate_radps - b.rate_radps * b.rate_radps;
    sum -= 0.5 * std::log(of_a / of_b) * apart;
    weight += apart * apart;
  });
  const double loss = weight > kLeastApart * kLeastApart ? sum / weight : 0.0;
  return std::max(0.0, loss * kReferenceRate * kReferenceRate);
}

double time_s(const DwellRecord& dwell) {
  return dwell.time_s.value_or(0.0);
}

/// The angle of a sweep as the function of time on which the angles of its readings lie, and those between
/// them. Nullopt if they are too few.
std::optional<SweepAngle> turning_of(const CollectedReadings& data, const std::vector<std::size_t>& sweep) {
  std::vector<AngleAtTime> passed;
  for (const std::size_t n : sweep)
    passed.push_back({time_s(*data.dwells[n]), turned_angle(*data.dwells[n]).deg()});
  return fit_sweep_angle(passed);
}

/// Turns the angle of a reading to the one that the item saw, `delay_s` before, with the rate and the
/// acceleration there.
void account_for_delay(EffectReading& reading, const DwellRecord& dwell,
                       const std::optional<SweepAngle>& turned, double delay_s) {
  double behind = delay_s * (reading.rate_radps - 0.5 * delay_s * reading.acceleration_radps2);
  if (turned) {
    const double now = time_s(dwell), then = now - delay_s;
    behind = Angle::degrees(turned->angle_deg(now) - turned->angle_deg(then)).rad();
    reading.rate_radps = Angle::degrees(turned->rate_deg_per_s(then)).rad();
    reading.acceleration_radps2 = Angle::degrees(turned->acceleration_deg_per_s2(then)).rad();
  } else {
    reading.rate_radps -= delay_s * reading.acceleration_radps2;
  }
  const double s = std::sin(behind), c = std::cos(behind);
  const double sin_alpha = reading.sin_alpha * c - reading.cos_alpha * s;
  reading.cos_alpha = reading.cos_alpha * c + reading.sin_alpha * s;
  reading.sin_alpha = sin_alpha;
}

/// Orders of the turn whose loss and phase in the item's filter are taken back.
constexpr int kFilteredOrders = 7;

/// Order m of a sweep as a first-order filter leaves it, over what the fit makes of it: the loss of order 1,
/// and the phase of order 1 as a delay.
/// @param tangent  of the phase of order 1: rate times the filter's time constant, with the sign of the rate
std::complex<double> beyond_first_order(int m, double tangent) {
  const std::complex<double> first = 1.0 / std::complex<double>(1.0, tangent);
  const std::complex<double> here = 1.0 / std::complex<double>(1.0, m * tangent);
  return here / std::polar(std::abs(first), m * std::arg(first));
}

/// Reverses the effect of the item's filter on the harmonics of one sweep: errors of the stage and a ripple
/// of its rate are faster than the turn, and the fit knows the filter at the turn only. The harmonics are
/// those of an even turn, thus of the time: a filter acts in time, not in angle.
void restore_harmonics(CollectedReadings& data, const std::vector<std::size_t>& sweep, double loss) {
  constexpr int kUnknowns = 1 + 2 * kFilteredOrders;
  if (sweep.size() < 2 * static_cast<std::size_t>(kUnknowns)) return;
  const double rate = data.readings[sweep.front()].mean_rate_radps;
  using Basis = Eigen::Matrix<double, kUnknowns, 1>;
  std::vector<Basis> bases;
  Eigen::Matrix<double, kUnknowns, kUnknowns> normal;
  normal.setZero();
  Eigen::Matrix<double, kUnknowns, 3> right;
  right.setZero();
  for (const std::size_t n : sweep) {
    const EffectReading& reading = data.readings[n];
    const std::complex<double> turn = std::polar(1.0, rate * time_s(*data.dwells[n]));
    std::complex<double> power = 1.0;
    Basis& basis = bases.emplace_back();
    basis(0) = 1.0;
    for (int m = 1; m <= kFilteredOrders; ++m) {
      power *= turn;
      basis(2 * m - 1) = power.real();
      basis(2 * m) = power.imag();
    }
    normal += basis * basis.transpose();
    right += basis * reading.value.transpose();
  }
  const auto solver = normal.ldlt();
  const Basis pivots = solver.vectorD();
  if (!(pivots.minCoeff() > 1e-3 * pivots.maxCoeff())) return;
  Eigen::Matrix<double, kUnknowns, 3> change = solver.solve(right);
  change.topRows<3>().setZero();
  const double tangent = std::sqrt(2.0 * loss) * rate / kReferenceRate;
  for (int m = 2; m <= kFilteredOrders; ++m) {
    const std::complex<double> factor = 1.0 / beyond_first_order(m, tangent) - 1.0;
    for (int j = 0; j < 3; ++j) {
      // a cos + b sin is the real part of (a - i b) exp(i m alpha).
      const std::complex<double> order(change(2 * m - 1, j), -change(2 * m, j));
      const std::complex<double> missing = order * factor;
      change(2 * m - 1, j) = missing.real();
      change(2 * m, j) = -missing.imag();
    }
  }
  for (std::size_t i = 0; i < sweep.size(); ++i)
    data.readings[sweep[i]].value += change.transpose() * bases[i];
}

/// Refuses an item whose filter is too slow for the rotation: a low-pass follows a turn that begins with a
/// lag of rate times time constant, which must be gone at the first step.
void require_fast_filter(const CollectedReadings& data) {
  constexpr double kMostLagLeft = 3e-4;  // radian
  constexpr double kFastTimeS = 0.04;    // Leaves less at every rate that a bench file may state.
  double fastest_radps = 0.0;
  for (const EffectReading& reading : data.readings)
    fastest_radps = std::max(fastest_radps, std::abs(reading.mean_rate_radps));
  const double time_s = std::sqrt(2.0 * data.loss) / kReferenceRate;  // A low-pass of first order has it.
  if (!(fastest_radps * time_s * std::exp(-kMarginBeforeS / time_s) > kMostLagLeft)) return;
  throw UnusableData(
      Message("the item's filter is slow for the rotation: at {rate:.0f} degrees/s its response is smaller "
              "by {percent:.2g} %, as behind a low-pass with a time constant of {time:.2g} s, which does not "
              "settle before the first step; required: {required:g} s, or a run in steps",
              Angle::radians(fastest_radps).deg(),
              100.0 * data.loss * std::pow(fastest_radps / kReferenceRate, 2), time_s, kFastTimeS));
}

}  // namespace

void account_for_motion(CollectedReadings& data) {
  const Sweeps sweeps = sweeps_of(data);
  count_from_middle_of_sweeps(data, sweeps);
  find_mean_rates(data, sweeps);
  const std::vector<SweepSines> sines = sines_of(data, sweeps);
  data.delay_s = delays_of(sines);
  for (const std::vector<std::size_t>& sweep : sweeps) {
    const std::optional<SweepAngle> turned = turning_of(data, sweep);
    for (const std::size_t n : sweep) {
      EffectReading& reading = data.readings[n];
      account_for_delay(reading, *data.dwells[n], turned, data.delay_s[reading.experiment == 3 ? 1 : 0]);
    }
  }
  data.loss = loss_of(sines);
  if (!(data.loss > 0.0)) return;
  require_fast_filter(data);
  for (const std::vector<std::size_t>& sweep : sweeps) restore_harmonics(data, sweep, data.loss);
}

}  // namespace abcal
