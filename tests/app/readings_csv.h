#pragma once

#include <array>
#include <cmath>
#include <random>
#include <sstream>
#include <string>

namespace abcal::test {

using Matrix = std::array<std::array<double, 3>, 3>;

inline constexpr Matrix kMatrix{{{1.10, 0.02, -0.03}, {0.01, 0.90, 0.04}, {-0.02, 0.03, 1.00}}};

/// Readings on a perfect stage, 12 angles of 30 degrees, with noise that the file states.
inline std::string readings(const Matrix& s, unsigned seed, const std::string& unit = "V", double scale = 1.0,
                            double noise = 1e-5) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal(0.0, noise);
  std::ostringstream csv;
  csv.precision(17);
  csv << "# protocol.estimator: abc\n# response_unit: " << unit
      << "\nexperiment,n,alpha_deg,r_u,r_v,r_w,u_u,u_v,u_w\n";
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int n = 0; n < 12; ++n) {
      const double alpha = 30.0 * n * std::acos(-1.0) / 180.0;
      const double sine = std::sin(alpha), cosine = std::cos(alpha);
      const std::array<double, 3> a = experiment == 1   ? std::array{0.0, sine, cosine}
                                      : experiment == 2 ? std::array{-sine, 0.0, cosine}
                                                        : std::array{-sine, -cosine, 0.0};
      csv << experiment << ',' << n + 1 << ',' << 30 * n;
      for (std::size_t j = 0; j < 3; ++j) {
        const double offset = 0.1 * static_cast<double>(j + 1);
        csv << ',' << scale * (s[j][0] * a[0] + s[j][1] * a[1] + s[j][2] * a[2] + offset + normal(engine));
      }
      for (int j = 0; j < 3; ++j) csv << ',' << scale * noise;
      csv << "\n";
    }
  }
  return csv.str();
}

}  // namespace abcal::test
