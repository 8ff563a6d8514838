#include "protocol/estimators/joint/effect_fit.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <regex>
#include <sstream>
#include <string>
#include <vector>

#include "protocol/estimators/joint/analyse_joint.h"
#include "protocol/estimators/joint/collect_readings.h"
#include "protocol/estimators/joint/noise_search.h"
#include "protocol/estimators/joint/size_evidence.h"
#include "protocol/estimators/joint/white_noise_fit.h"
#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/record/import_table.h"
#include "tests/protocol/estimators/made_record.h"
#include "tests/support/test_data.h"

namespace abcal {
namespace {

/// Numbers of one object of the prototype's output, in their order.
std::vector<double> numbers_after(const std::string& text, const std::string& key) {
  const std::size_t from = text.find('"' + key + '"');
  const std::size_t to = text.find('}', from);
  const std::string part = text.substr(from + key.size() + 2, to - from);
  static const std::regex kNumber(R"([-+]?\d+\.?\d*(?:[eE][-+]?\d+)?)");
  std::vector<double> out;
  for (std::sregex_iterator i(part.begin(), part.end(), kNumber), end; i != end; ++i)
    out.push_back(std::stod(i->str()));
  return out;
}

std::string text_of(const std::filesystem::path& path) {
  std::ifstream in(path);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

class AgainstPrototype : public testing::TestWithParam<const char*> {};

// The prototype has no hysteresis and no noise process; its estimates agree to a tenth of a standard
// uncertainty, its uncertainties to 1 %.
TEST_P(AgainstPrototype, SameEstimatesAndUncertainties) {
  const std::string name = std::string("robust/") + GetParam();
  ABCAL_SHARED_DATA_OR_SKIP(csv, name + ".csv");
  RunRecord record = import_table(csv).record;
  record.tolerances.hysteresis = 0.0;
  JointOptions options;
  options.noise_process = false;
  const CalibrationResult result = analyse_joint(record, options);
  ASSERT_TRUE(result.sensitivity_matrix) << result.why;
  const std::string prototype = text_of(test::shared_data(name + ".prototype.json").value());
  const std::vector<double> value = numbers_after(prototype, "line_response");
  const std::vector<double> u = numbers_after(prototype, "standard_uncertainty");
  ASSERT_EQ(value.size(), 18U);
  ASSERT_EQ(u.size(), 18U);
  std::vector<Quantity> found;
  for (const auto& row : *result.sensitivity_matrix) found.insert(found.end(), row.begin(), row.end());
  for (const auto* triple : {&result.offset, &result.intrinsic_sensitivity, &result.intrinsic_angle})
    found.insert(found.end(), triple->begin(), triple->end());
  for (std::size_t i = 0; i < 18; ++i) {
    EXPECT_NEAR(found[i].value, value[i], 0.1 * u[i]) << i;
    EXPECT_NEAR(found[i].standard_uncertainty, u[i], 0.01 * u[i]) << i;
  }
}

// With all effects, hysteresis and the noise process the intervals hold the truth.
TEST_P(AgainstPrototype, TruthIsInsideTheIntervals) {
  const std::string name = std::string("robust/") + GetParam();
  ABCAL_SHARED_DATA_OR_SKIP(csv, name + ".csv");
  const CalibrationResult result = analyse_joint(import_table(csv).record);
  EXPECT_EQ(result.verdict, Verdict::kUsable) << result.why;
  const std::string text = text_of(test::shared_data(name + ".truth.json").value());
  const std::vector<double> truth = numbers_after(text, "truth");
  ASSERT_EQ(truth.size(), 18U);
  std::vector<Quantity> found;
  for (const auto& row : *result.sensitivity_matrix) found.insert(found.end(), row.begin(), row.end());
  for (const auto* triple : {&result.offset, &result.intrinsic_sensitivity, &result.intrinsic_angle})
    found.insert(found.end(), triple->begin(), triple->end());
  for (std::size_t i = 0; i < 18; ++i)
    EXPECT_NEAR(found[i].value, truth[i], 3.5 * found[i].standard_uncertainty) << i;
}

INSTANTIATE_TEST_SUITE_P(Benches, AgainstPrototype, testing::Values("wobble", "smooth_steps", "third_order"));

std::vector<NoiseAtAngle> some_angles(int count) {
  std::mt19937_64 engine(5);
  std::normal_distribution<double> normal;
  std::vector<NoiseAtAngle> angles;
  for (int n = 0; n < count; ++n) {
    NoiseAtAngle at;
    at.white = Eigen::Vector3d(1.0, 2.0, 0.5) * (1.0 + 0.1 * n);
    at.by_step = {normal(engine), normal(engine), normal(engine)};
    at.distance = 0.5 + std::abs(normal(engine));
    angles.push_back(at);
  }
  return angles;
}

/// V by its definition.
Eigen::MatrixXd dense_covariance(const std::vector<NoiseAtAngle>& angles, double step,
                                 const NoiseProcess& process) {
  const auto count = static_cast<Eigen::Index>(angles.size());
  Eigen::MatrixXd v = Eigen::MatrixXd::Zero(3 * count, 3 * count);
  for (Eigen::Index a = 0; a < count; ++a) {
    const NoiseAtAngle& at = angles[static_cast<std::size_t>(a)];
    v.block<3, 3>(3 * a, 3 * a) += step * step * at.by_step * at.by_step.transpose();
    v.block<3, 3>(3 * a, 3 * a).diagonal() += at.white;
    double distance = 0.0;
    for (Eigen::Index b = a; b < count; ++b) {
      if (b > a) distance += angles[static_cast<std::size_t>(b)].distance;
      for (int j = 0; j < 3; ++j) {
        const double shared = process.tau(j) * process.tau(j) * std::exp(-distance / process.rho);
        v(3 * a + j, 3 * b + j) += shared;
        if (b > a) v(3 * b + j, 3 * a + j) += shared;
      }
    }
  }
  return v;
}

TEST(ReadingKernelsTest, ProductsAreThoseOfTheirDefinition) {
  std::srand(3);
  for (const auto& [rows, inner, columns] :
       {std::array{1, 1, 1}, {7, 5, 3}, {9, 16, 16}, {30, 112, 112}, {33, 40, 12}}) {
    const ReadingRows x = ReadingRows::Random(rows, inner);
    const Eigen::MatrixXd m = Eigen::MatrixXd::Random(inner, columns);
    EXPECT_LT((times(x, m) - x * m).cwiseAbs().maxCoeff(), 1e-13);
    if (inner == columns) {
      const Eigen::MatrixXd upper = m.triangularView<Eigen::Upper>();
      EXPECT_LT((times_upper(x, m) - x * upper).cwiseAbs().maxCoeff(), 1e-13) << "reads below the diagonal";
    }
    EXPECT_LT((products_of_columns(x) - x.transpose() * x).cwiseAbs().maxCoeff(), 1e-12);
  }
}

TEST(NoiseWhitenerTest, IsTheInverseOfTheCovariance) {
  const std::vector<NoiseAtAngle> angles = some_angles(9);
  for (const double tau : {0.0, 1.5}) {
    const NoiseProcess process{Eigen::Vector3d(tau, 0.5 * tau, 2.0 * tau), 3.0};
    const NoiseWhitener whitener(angles, 0.7, process);
    const Eigen::MatrixXd v = dense_covariance(angles, 0.7, process);
    ReadingRows rows = ReadingRows::Identity(27, 27);
    whitener.whiten(rows);
    whitener.whiten_transposed(rows);
    EXPECT_TRUE((v * rows).isApprox(Eigen::MatrixXd::Identity(27, 27), 1e-10)) << tau;
    const Eigen::MatrixXd lower = v.llt().matrixL();
    EXPECT_NEAR(whitener.log_determinant(), 2.0 * lower.diagonal().array().log().sum(), 1e-9);
  }
}

TEST(NoiseWhitenerTest, KnowsTheMeanOfTheProcess) {
  const std::vector<NoiseAtAngle> angles = some_angles(9);
  const NoiseProcess process{Eigen::Vector3d(1.5, 0.5, 2.0), 3.0};
  const NoiseWhitener whitener(angles, 0.7, process);
  std::vector<NoiseAtAngle> quiet = angles;
  for (NoiseAtAngle& at : quiet) at.white.setZero();
  const Eigen::MatrixXd of_process = dense_covariance(quiet, 0.0, process);
  Eigen::MatrixXd mean = Eigen::MatrixXd::Zero(27, 3);
  for (Eigen::Index n = 0; n < 9; ++n) mean.middleRows<3>(3 * n) = Eigen::Matrix3d::Identity() / 9.0;
  EXPECT_TRUE((of_process * mean).isApprox(whitener.covariance_with_mean(), 1e-12));
  EXPECT_TRUE((mean.transpose() * of_process * mean).diagonal().isApprox(whitener.mean_variance(), 1e-12));
}

/// A short run of a linear item on a perfect stage, with white noise.
std::vector<EffectReading> short_run(int steps, double noise) {
  std::mt19937_64 engine(11);
  RunRecord record = test::made_record({}, {}, steps, Angle::degrees(360.0 / steps));
  test::add_noise(record, noise, engine);
  record.axes_order = AxesOrder::kXThenZ;
  record.approach = Angle::degrees(1.0);
  return collect_readings(record).readings;
}

// A gain d before a cubic term k l^3 makes it k (1 + 3 d t) l^3, one after it k (1 + d t) l^3. Which of them
// drifts is not known: the model has the middle of both, and the derivatives belong to it.
TEST(EffectModelTest, HalfOfTheDriftOfTheSensitivityIsBeforeWhatBendsTheResponse) {
  const std::vector<EffectReading> readings = short_run(12, 1e-6);
  EffectModel model(readings, {});
  Eigen::Index drift = -1, cubic = -1;
  for (std::size_t i = 0; i < model.unknowns().size(); ++i) {
    if (model.unknowns()[i].output != 0) continue;
    if (model.unknowns()[i].effect == "sensitivity drift") drift = static_cast<Eigen::Index>(i);
    if (model.unknowns()[i].effect == "k3") cubic = static_cast<Eigen::Index>(i);
  }
  ASSERT_GE(drift, 0);
  ASSERT_GE(cubic, 0);
  const std::vector<double> steps(readings.size(), 0.0);
  const std::vector<Eigen::Vector3d> signs(readings.size(), Eigen::Vector3d::Ones());
  const auto at = [&](double d, double k) {
    Eigen::VectorXd value = model.value();
    value(drift) = d;
    value(cubic) = k;
    return model.readings_at(value, steps, signs);
  };
  constexpr double kD = 1e-3, kK = 0.1;
  const Eigen::VectorXd both = at(kD, kK) - at(kD, 0.0) - at(0.0, kK) + at(0.0, 0.0);
  const Eigen::VectorXd cube = (at(0.0, kK) - at(0.0, 0.0)) / kK;
  for (std::size_t n = 0; n < readings.size(); ++n) {
    const auto row = static_cast<Eigen::Index>(3 * n);
    EXPECT_NEAR(both(row), 2.0 * kD * readings[n].t * kK * cube(row), 1e-3 * kD * kK) << n;
  }
  Eigen::VectorXd value = model.value();
  value(drift) = kD;
  value(cubic) = kK;
  model.move_to(value, steps);
  const Eigen::VectorXd by_drift = (at(kD + 1e-6, kK) - at(kD - 1e-6, kK)) / 2e-6;
  EXPECT_LT((by_drift - model.jacobian().col(drift)).cwiseAbs().maxCoeff(), 1e-4);
}

double log_evidence_of(const std::vector<EffectReading>& readings, const EffectFitOptions& options) {
  EffectModel model(readings, options);
  EXPECT_TRUE(fit_with_white_noise(model).minimum.found);
  return search_noise(model).log_evidence;
}

// By its definition: the fit made with the larger size. The densities of the priors are no part of a
// restricted likelihood: ten times as wide is a tenth as high, for each unknown. The signs for the hysteresis
// stay.
void expect_ratio_of_densities(bool noise_process, double tolerance) {
  const std::vector<EffectReading> readings = short_run(16, 1e-5);
  EffectFitOptions stated;
  stated.noise_process = noise_process;
  stated.signs = EffectModel(readings, stated).signs();
  for (Eigen::Vector3d& sign : stated.signs->mean)
    sign = sign.unaryExpr([](double m) { return m < 0.0 ? -1.0 : 1.0; });
  for (Eigen::Vector3d& variance : stated.signs->variance) variance.setZero();
  EffectModel model(readings, stated);
  ASSERT_TRUE(fit_with_white_noise(model).minimum.found);
  const NoiseSearch search = search_noise(model);
  const std::vector<SizeEvidence> found = size_evidence(model, search);
  const auto ratio_of = [&](const std::string& key) {
    for (const SizeEvidence& one : found) {
      if (one.key == key) return one.log_ratio;
    }
    ADD_FAILURE() << key;
    return 0.0;
  };
  EffectFitOptions larger = stated;
  larger.sizes.hysteresis *= 10.0;
  EXPECT_NEAR(ratio_of("hysteresis"),
              log_evidence_of(readings, larger) - search.log_evidence - 3.0 * std::log(10.0), tolerance);
  larger = stated;
  larger.sizes.wobble_urad *= 10.0;
  EXPECT_NEAR(ratio_of("wobble_urad"),
              log_evidence_of(readings, larger) - search.log_evidence - 24.0 * std::log(10.0), tolerance);
  larger = stated;
  larger.sizes.step = larger.sizes.step * 10.0;
  larger.noise_process = false;
  EXPECT_NEAR(ratio_of("step_deg"), log_evidence_of(readings, larger) - search.log_evidence, 0.02);
  for (const SizeEvidence& one : found) EXPECT_LT(one.log_ratio, 0.0) << one.key;  // nothing is larger here
}

TEST(SizeEvidenceTest, IsTheRatioOfTheDensities) {
  expect_ratio_of_densities(false, 0.01);
}

// The probability of white noise alone is that of the size that fits best, which the larger size changes a
// little.
TEST(SizeEvidenceTest, IsTheRatioOfTheDensitiesAveragedOverTheNoises) {
  expect_ratio_of_densities(true, 0.2);
}

}  // namespace
}  // namespace abcal
