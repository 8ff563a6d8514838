#include "protocol/uncertainty/monte_carlo.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <numbers>

#include "protocol/uncertainty/gum_validation.h"
#include "protocol/uncertainty/random_stream.h"

namespace abcal {
namespace {

// A study of one output made from a function of a trial's stream.
template <class Model>
TrialBlock study_of(Model model) {
  return [model](std::uint64_t first, std::size_t count, double* out) {
    for (std::size_t i = 0; i < count; ++i) {
      RandomStream stream(20, StreamPurpose::kTest, first + i);
      out[i] = model(stream);
    }
  };
}

double rectangular(RandomStream& stream, double u) {
  return u * std::sqrt(3.0) * (2.0 * stream.uniform() - 1.0);
}

MonteCarloResult run(const TrialBlock& block, std::uint64_t trials) {
  MonteCarloOptions options;
  options.trials = trials;
  options.coverage_probability = 0.95;  // that of the references
  return run_monte_carlo(1, block, options);
}

// JCGM 101:2008, 9.2.2: the sum of four standard normals.
TEST(MonteCarloTest, SumOfFourNormals) {
  const MonteCarloResult result = run(
      study_of([](RandomStream& s) { return s.normal() + s.normal() + s.normal() + s.normal(); }), 200'000);
  // Tolerances: 5 standard deviations of a mean, a standard deviation and a 97.5 % quantile of 2e5 trials.
  EXPECT_NEAR(result.mean(0), 0.0, 5.0 * 2.0 / std::sqrt(2e5));
  EXPECT_NEAR(result.standard_deviation(0), 2.0, 5.0 * 2.0 / std::sqrt(4e5));
  EXPECT_NEAR(result.coverage[0].symmetric.low, -3.92, 0.06);
  EXPECT_NEAR(result.coverage[0].symmetric.high, 3.92, 0.06);
  EXPECT_TRUE(validate_gum({0.0, 2.0}, {result.coverage[0].symmetric, 2e5, 0.95}, 1).validated);
}

// 9.2.3: four rectangular distributions of standard deviation 1.
TEST(MonteCarloTest, SumOfFourRectangulars) {
  const MonteCarloResult result =
      run(study_of([](RandomStream& s) {
            return rectangular(s, 1.0) + rectangular(s, 1.0) + rectangular(s, 1.0) + rectangular(s, 1.0);
          }),
          200'000);
  EXPECT_NEAR(result.standard_deviation(0), 2.0, 5.0 * 2.0 / std::sqrt(4e5));
  EXPECT_NEAR(result.coverage[0].symmetric.high, 3.88, 0.05);
  EXPECT_NEAR(result.coverage[0].symmetric.low, -3.88, 0.05);
}

// 9.2.4: one of them ten times as wide: the GUM framework fails.
TEST(MonteCarloTest, ADominantRectangularIsNotValidated) {
  const MonteCarloResult result =
      run(study_of([](RandomStream& s) {
            return rectangular(s, 1.0) + rectangular(s, 1.0) + rectangular(s, 1.0) + rectangular(s, 10.0);
          }),
          200'000);
  const double u = std::sqrt(103.0);
  EXPECT_NEAR(result.standard_deviation(0), 10.1, 0.1);
  EXPECT_NEAR(result.coverage[0].symmetric.high, 17.0, 0.1);
  EXPECT_NEAR(result.coverage[0].symmetric.low, -17.0, 0.1);
  const GumValidation validation = validate_gum({0.0, u}, {result.coverage[0].symmetric, 2e5, 0.95}, 2);
  EXPECT_NEAR(validation.expanded_uncertainty, 19.9, 0.05);
  EXPECT_FALSE(validation.validated);
}

// 9.3: calibration of a mass, in mg about the nominal value; the GUM's first order gives 0.0539.
TEST(MonteCarloTest, MassCalibration) {
  const TrialBlock mass = study_of([](RandomStream& s) {
    const double m_rc = 100'000.0 + 0.050 * s.normal();
    const double dm_rc = 1.234 + 0.020 * s.normal();
    const double a = 1.10 + 0.20 * (s.uniform() - 0.5);  // kg/m3, 1.10 to 1.30 about 1.20
    const double rho_a = a + 0.10;
    const double rho_w = 8000.0 + 2000.0 * (s.uniform() - 0.5);  // 7000 to 9000
    const double rho_r = 8000.0 + 100.0 * (s.uniform() - 0.5);   // 7950 to 8050
    const double a0 = 1.2;
    return (m_rc + dm_rc) * (1.0 + (rho_a - a0) * (1.0 / rho_w - 1.0 / rho_r)) - 100'000.0;
  });
  const MonteCarloResult result = run(mass, 200'000);
  EXPECT_NEAR(result.mean(0), 1.234, 0.001);
  EXPECT_NEAR(result.standard_deviation(0), 0.0754, 0.0006);
  EXPECT_NEAR(result.coverage[0].shortest.low, 1.084, 0.006);
  EXPECT_NEAR(result.coverage[0].shortest.high, 1.384, 0.006);
  EXPECT_FALSE(validate_gum({1.234, 0.0539}, {result.coverage[0].symmetric, 2e5, 0.95}, 1).validated);
}

TEST(MonteCarloTest, AnAdaptiveRunStopsWhenTheDigitsAreReached) {
  MonteCarloOptions options;
  options.trials.reset();
  options.digits = 1;
  const TrialBlock block = study_of([](RandomStream& s) { return 3.0 * s.normal(); });
  const MonteCarloResult one = run_monte_carlo(1, block, options);
  EXPECT_TRUE(one.converged);
  EXPECT_TRUE(one.adaptive);
  EXPECT_GE(one.trials, 20'000U);
  EXPECT_LE(one.reached(0), 1.0);
  options.digits = 2;
  const MonteCarloResult two = run_monte_carlo(1, block, options);
  EXPECT_TRUE(two.converged);
  EXPECT_GT(two.trials, one.trials);
  EXPECT_NEAR(two.standard_deviation(0), 3.0, 0.05);  // u = 3.0: half a unit of the second digit
  options.most_trials = 20'000;
  const MonteCarloResult cut = run_monte_carlo(1, block, options);
  EXPECT_FALSE(cut.converged);
  EXPECT_NE(cut.note.find("not reached"), std::string::npos) << cut.note;
}

TEST(MonteCarloTest, ToleranceIsHalfAUnitOfTheLastDigitOfU) {
  EXPECT_DOUBLE_EQ(numerical_tolerance(0.00035, 2), 0.5e-5);
  EXPECT_DOUBLE_EQ(numerical_tolerance(0.00035, 1), 0.5e-4);
  EXPECT_DOUBLE_EQ(numerical_tolerance(2.03, 2), 0.05);
  EXPECT_DOUBLE_EQ(numerical_tolerance(0.0996, 2), 0.5e-2);  // rounds to 0.10
  EXPECT_EQ(numerical_tolerance(0.0, 2), 0.0);
}

TEST(MonteCarloTest, BeyondAMillionTrialsTheIntervalsComeFromAHistogramAndItSaysSo) {
  const TrialBlock cheap = [](std::uint64_t first, std::size_t count, double* out) {
    // A sweep over the unit interval in golden steps: uniform, known in closed form.
    for (std::size_t i = 0; i < count; ++i) {
      double whole = 0.0;
      out[i] = std::modf(static_cast<double>(first + i) * std::numbers::phi, &whole);
    }
  };
  const MonteCarloResult exact = run(cheap, 1'000'000);
  EXPECT_EQ(exact.interval_method, IntervalMethod::kExact);
  EXPECT_TRUE(exact.note.empty()) << exact.note;
  const MonteCarloResult histogram = run(cheap, 1'000'001);
  EXPECT_EQ(histogram.interval_method, IntervalMethod::kHistogram);
  EXPECT_NE(histogram.note.find("histogram"), std::string::npos);
  EXPECT_EQ(histogram.trials, 1'000'001U);
  const double bin = 1e-3 / std::sqrt(12.0);
  EXPECT_NEAR(histogram.coverage[0].symmetric.low, 0.025, 2.0 * bin);
  EXPECT_NEAR(histogram.coverage[0].symmetric.high, 0.975, 2.0 * bin);
  EXPECT_NEAR(exact.coverage[0].symmetric.low, 0.025, 1e-5);
}

TEST(MonteCarloTest, TheNumberOfThreadsChangesNoBit) {
  const TrialBlock block = [](std::uint64_t first, std::size_t count, double* out) {
    for (std::size_t i = 0; i < count; ++i) {
      RandomStream stream(8, StreamPurpose::kTest, first + i);
      const double a = stream.normal();
      out[i] = a;
      out[count + i] = std::exp(a) + stream.normal();
    }
  };
  MonteCarloOptions options;
  options.trials = 23'456;
  options.threads = 1;
  const MonteCarloResult one = run_monte_carlo(2, block, options);
  for (const unsigned threads : {2U, 3U, 5U}) {
    options.threads = threads;
    const MonteCarloResult many = run_monte_carlo(2, block, options);
    EXPECT_EQ(many.trials, one.trials);
    EXPECT_EQ(many.mean, one.mean) << threads;
    EXPECT_EQ(many.covariance, one.covariance) << threads;
    for (std::size_t k = 0; k < 2; ++k) {
      EXPECT_EQ(many.coverage[k].symmetric.low, one.coverage[k].symmetric.low);
      EXPECT_EQ(many.coverage[k].shortest.high, one.coverage[k].shortest.high);
    }
  }
  options.trials.reset();
  options.digits = 1;
  options.threads = 1;
  const MonteCarloResult adaptive = run_monte_carlo(2, block, options);
  options.threads = 5;
  const MonteCarloResult many = run_monte_carlo(2, block, options);
  EXPECT_EQ(many.trials, adaptive.trials);
  EXPECT_EQ(many.covariance, adaptive.covariance);
}

TEST(MonteCarloTest, InterruptedItReportsWhatItHasAndSaysSo) {
  std::stop_source stop;
  MonteCarloOptions options;
  options.trials = 1'000'000;
  options.threads = 2;
  options.stop = stop.get_token();
  options.progress = [&](std::uint64_t done, std::uint64_t planned) {
    EXPECT_EQ(planned, 1'000'000U);
    if (done >= 5000) stop.request_stop();
  };
  const MonteCarloResult result =
      run_monte_carlo(1, study_of([](RandomStream& s) { return s.normal(); }), options);
  EXPECT_TRUE(result.interrupted);
  EXPECT_FALSE(result.converged);
  EXPECT_GE(result.trials, 5000U);
  EXPECT_LT(result.trials, 1'000'000U);
  EXPECT_NEAR(result.standard_deviation(0), 1.0, 5.0 / std::sqrt(2.0 * 5000.0));
  EXPECT_NE(result.note.find("Interrupted"), std::string::npos);
  // The result equals that of a run of exactly this number of trials.
  MonteCarloOptions whole;
  whole.trials = result.trials;
  const MonteCarloResult again =
      run_monte_carlo(1, study_of([](RandomStream& s) { return s.normal(); }), whole);
  EXPECT_EQ(again.mean, result.mean);
  EXPECT_EQ(again.covariance, result.covariance);
}

TEST(MonteCarloTest, StoppedBeforeTheFirstBlockItHasNothing) {
  std::stop_source stop;
  stop.request_stop();
  MonteCarloOptions options;
  options.stop = stop.get_token();
  const MonteCarloResult result =
      run_monte_carlo(1, study_of([](RandomStream& s) { return s.normal(); }), options);
  EXPECT_EQ(result.trials, 0U);
  EXPECT_TRUE(result.interrupted);
  EXPECT_TRUE(std::isnan(result.mean(0)));
  EXPECT_TRUE(std::isnan(result.standard_deviation(0)));
}

TEST(MonteCarloTest, AFailureInAWorkerReachesTheCaller) {
  MonteCarloOptions options;
  options.trials = 50'000;
  options.threads = 3;
  const TrialBlock broken = [](std::uint64_t first, std::size_t count, double* out) {
    for (std::size_t i = 0; i < count; ++i) out[i] = first + i == 31'416 ? std::nan("") : 1.0;
  };
  try {
    run_monte_carlo(1, broken, options);
    FAIL() << "a trial that is not finite must not pass";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("31416"), std::string::npos) << error.what();
  }
}

TEST(MonteCarloTest, RefusesBadOptions) {
  const TrialBlock block = study_of([](RandomStream& s) { return s.normal(); });
  MonteCarloOptions options;
  for (const std::uint64_t trials : {0U, 1U}) {
    options.trials = trials;
    EXPECT_THROW(run_monte_carlo(1, block, options), std::invalid_argument);
  }
  options.trials.reset();
  options.digits = 3;
  EXPECT_THROW(run_monte_carlo(1, block, options), std::invalid_argument);
  options.digits = 1;
  options.coverage_probability = std::nan("");
  EXPECT_THROW(run_monte_carlo(1, block, options), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
