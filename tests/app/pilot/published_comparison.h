#pragma once

#include <cmath>
#include <vector>

#include "app/laboratory/pilot/key_comparison.h"

namespace abcal::test {

/// Independent results of one quantity.
inline ParticipantResults univariate_results(const std::vector<double>& values, const std::vector<double>& u,
                                             double k = 2.0) {
  ParticipantResults results{
      .quantities = 1,
      .values = Eigen::VectorXd::Map(values.data(), static_cast<Eigen::Index>(values.size())),
      .covariance = {},
      .coverage_factors = std::vector<double>(values.size(), k)};
  results.covariance = Eigen::VectorXd::Map(u.data(), static_cast<Eigen::Index>(u.size()))
                           .cwiseAbs2()
                           .asDiagonal()
                           .toDenseMatrix();
  return results;
}

/// A published comparison of acceleration: CCAUV.V-K1, charge sensitivity of a back-to-back accelerometer at
/// 40 Hz, twelve institutes (BIPM key comparison database; degrees of equivalence and U, k = 2, in 1e-4
/// pC/(m/s2)).
struct PublishedLine {
  const char* institute;
  double difference, expanded;
};
inline constexpr PublishedLine kVibration[] = {
    {"PTB", 0.6, 0.8},       {"BNM-CESTA", 1.2, 6.3}, {"CSIRO-NML", 1.2, 5.0}, {"CMI", -0.9, 5.7},
    {"CSIR-NML", 9.2, 11.4}, {"CENAM", -1.7, 6.2},    {"NRC", -1.1, 3.7},      {"KRISS", -1.1, 4.5},
    {"NMIJ", -2.9, 5.2},     {"VNIIM", -5.4, 5.0},    {"NIST", 1.2, 3.7},      {"NMi-VSL", -0.9, 3.1}};

/// The database gives D_i and U_i and not u_i: U_i^2 / 4 = u_i^2 - u_ref^2 with 1 / u_ref^2 the sum of
/// 1 / u_i^2, which one u_ref solves.
inline double published_u_ref() {
  double low = 0.01, high = 10.0;
  for (int k = 0; k < 200; ++k) {
    const double middle = std::sqrt(low * high);
    double sum = 0.0;
    for (const PublishedLine& line : kVibration)
      sum += 1.0 / (line.expanded * line.expanded / 4.0 + middle * middle);
    (sum * middle * middle > 1.0 ? high : low) = middle;
  }
  return low;
}

inline ParticipantResults published_comparison() {
  const double u_ref = published_u_ref();
  std::vector<double> values, u;
  for (const PublishedLine& line : kVibration) {
    values.push_back(line.difference);
    u.push_back(std::sqrt(line.expanded * line.expanded / 4.0 + u_ref * u_ref));
  }
  return univariate_results(values, u);
}

}  // namespace abcal::test
