// Analyses a run file or a CSV of averaged readings.   analysis FILE

#include <abcal/abcal.h>

#include <cmath>
#include <cstdio>
#include <exception>

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  try {
    const abcal::Record record = abcal::load(argv[1]);
    const abcal::Result result = abcal::analyse(record, "joint");
    std::printf("%s: %s\n", result.verdict().c_str(), result.why().c_str());
    if (result.usability() == abcal::Usability::kNotUsable) return 1;

    const abcal::Values& s = result.sensitivity_matrix();
    for (Eigen::Index j = 0; j < 3; ++j)
      std::printf("%c: %.9f %.9f %.9f\n", "uvw"[j], s.value(j, 0), s.value(j, 1), s.value(j, 2));

    // Uncertainties are correlated: a reading r = s a + O inverts to a with this covariance.
    const abcal::Covariance& covariance = result.covariance();
    std::printf("u(%s) = %.1e %s\n", covariance.labels[0].c_str(), std::sqrt(covariance.matrix(0, 0)),
                covariance.units[0].c_str());

    const abcal::Values alignment = result.alignment();  // of the joint estimator: Zx, Zy, Xz
    std::printf("Zx = %.1e, u = %.0e\n", alignment.value(0), alignment.u(0));

    const abcal::MonteCarloStudy study = abcal::monte_carlo(record, {.trials = 20'000});
    std::printf("Monte Carlo: %zu outputs\n", study.covariance().labels.size());
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "analysis: %s\n", error.what());
    return 1;
  }
}
