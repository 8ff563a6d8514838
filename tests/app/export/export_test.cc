// The constants of a result, and every format applied to the readings of its run by the rule that its reader
// documents.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <matio.h>

#include <Eigen/LU>
#include <array>
#include <cmath>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "app/results/analysis/analyses.h"
#include "app/results/export/formats.h"
#include "app/results/export/reading_noise.h"
#include "app/system/helper_program.h"
#include "app/system/output_file.h"
#include "protocol/record/planned_dwell.h"
#include "sim/sim_bench.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::HasSubstr;

constexpr double kG = 9.81;

/// An item in `unit`, of which `scale` are one g_loc.
sim::BenchTruth item(double scale) {
  sim::BenchTruth truth;
  truth.sensitivity_matrix << 1.01, 0.004, -0.003,  //
      -0.002, 0.995, 0.005,                         //
      0.006, -0.001, 1.003;
  truth.sensitivity_matrix *= scale;
  truth.offset = scale * Eigen::Vector3d(0.02, -0.01, 0.03);
  return truth;
}

RunRecord run_of(const sim::BenchTruth& truth, const std::string& unit) {
  RunRecord record;
  record.source = "a.run";
  record.response_unit = unit;
  record.g_loc = {kG, 1e-5, 2.0, "test"};
  record.g_loc_known = true;
  record.steps = 12;
  record.step = Angle::degrees(30.0);
  ProtocolConfig protocol;
  protocol.steps = record.steps;
  protocol.step = record.step;
  protocol.check_poses = false;
  sim::SimBench world(truth);
  std::uint64_t i = 0;
  for (const PlannedAngle& angle : make_rotation_plan(protocol, {})) {
    DwellRecord dwell = planned_dwell(angle);
    dwell.time_s = 5.0 * static_cast<double>(i);
    const Clock::Instant t = world.start() + from_seconds(*dwell.time_s);
    world.place(StageAxis::kX, angle.x, t);
    world.place(StageAxis::kZ, angle.z, t);
    dwell.mean = world.output(t, i++).value;
    dwell.u_mean = Eigen::Vector3d::Constant(1e-6 * truth.sensitivity_matrix.row(0).norm());
    record.dwells.push_back(dwell);
  }
  return record;
}

using Rule = std::function<Eigen::Vector3d(const Eigen::Vector3d& raw_mps2)>;

/// Largest | |a| - g_loc | of the corrected readings of a run, m/s2.
double worst_norm_error(const RunRecord& record, double unit_mps2, const Rule& rule) {
  double worst = 0.0;
  for (const DwellRecord& dwell : record.dwells)
    worst = std::max(worst, std::abs(rule(dwell.mean * unit_mps2).norm() - kG));
  return worst;
}

/// "name<separator>value" of each line that is no comment.
std::map<std::string, double> parameters(const std::string& text, char separator, int name_at, int value_at) {
  std::map<std::string, double> found;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    if (line.starts_with('#')) continue;
    std::vector<std::string> words;
    std::istringstream cells(line);
    for (std::string word; std::getline(cells, word, separator);) words.push_back(word);
    found[words.at(static_cast<std::size_t>(name_at))] =
        std::stod(words.at(static_cast<std::size_t>(value_at)));
  }
  return found;
}

class ExportTest : public testing::Test {
 protected:
  CorrectionConstants constants(ExportFrame frame = ExportFrame::kItem) const {
    return constants_of(analyse(record, "joint"), frame);
  }

  /// @return its path
  std::string write_mat(const test::TemporaryFolder& folder) const {
    set_helper_folder(std::filesystem::path(test::abcal_program()).parent_path());
    const std::string path = (folder / "constants.mat").string();
    OutputFile(path).write(export_format("mat").write(constants()));
    return path;
  }

  /// In m/s2, the unit of raw readings for the readers of most formats.
  RunRecord record = run_of(item(kG), "m/s2");
};

TEST_F(ExportTest, TheConstantsTurnReadingsIntoLocalGravity) {
  for (const ExportFrame frame : {ExportFrame::kItem, ExportFrame::kPlatter}) {
    const CorrectionConstants c = constants(frame);
    const double worst = worst_norm_error(
        record, 1.0, [&](const Eigen::Vector3d& r) -> Eigen::Vector3d { return c.M * (r - c.b); });
    EXPECT_LT(worst, 1e-4);  // g_loc times 1e-5, the size of the default uncertainties.
    EXPECT_TRUE((c.u_matrix().array() > 0.0).all() || frame == ExportFrame::kItem);
    EXPECT_TRUE((c.u_matrix().diagonal().array() > 0.0).all());
    EXPECT_TRUE((c.u_b().array() > 0.0).all());
  }
  const CorrectionConstants own = constants();
  EXPECT_NEAR(own.M(0, 1), 0.0, 1e-12) << "x along u";
  EXPECT_NEAR(own.M(0, 2), 0.0, 1e-12);
  EXPECT_NEAR(own.M(1, 2), 0.0, 1e-12) << "y in the plane of u and v";
  const Eigen::Matrix3d truth = kG * item(kG).sensitivity_matrix.inverse();
  EXPECT_TRUE(constants(ExportFrame::kPlatter).M.isApprox(truth, 1e-4));
}

TEST_F(ExportTest, TheSameInGIsTheSameInMetresPerSecondSquared) {
  const RunRecord in_g = run_of(item(kG / 9.80665), "g");
  const CorrectionConstants c = constants_of(analyse(in_g, "joint"), ExportFrame::kItem);
  EXPECT_TRUE(c.matrix_si().isApprox(constants().matrix_si(), 1e-9));
  EXPECT_TRUE(c.bias_si().isApprox(constants().bias_si(), 1e-9));
}

TEST_F(ExportTest, ImuCalibCorrectsByItsOwnRule) {
  const std::string text = export_format("ros").write(constants());
  std::vector<double> numbers;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);)
    if (line.starts_with("  - ")) numbers.push_back(std::stod(line.substr(4)));
  ASSERT_EQ(numbers.size(), 12U);
  const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> SM(numbers.data());
  const Eigen::Map<const Eigen::Vector3d> bias(numbers.data() + 9);
  EXPECT_LT(worst_norm_error(record, 1.0,
                             [&](const Eigen::Vector3d& r) -> Eigen::Vector3d { return SM * r - bias; }),
            1e-4);
}

TEST_F(ExportTest, ImucalCorrectsByItsOwnRule) {
  const auto json = nlohmann::json::parse(export_format("imucal").write(constants()));
  const auto matrix = [&](const char* key) {
    Eigen::Matrix3d m;
    for (Eigen::Index j = 0; j < 3; ++j)
      for (Eigen::Index k = 0; k < 3; ++k)
        m(j, k) = json.at(key)[static_cast<std::size_t>(j)][static_cast<std::size_t>(k)].get<double>();
    return m;
  };
  Eigen::Vector3d b;
  for (Eigen::Index j = 0; j < 3; ++j) b[j] = json.at("b_a")[static_cast<std::size_t>(j)].get<double>();
  EXPECT_TRUE(matrix("K_a").isDiagonal(1e-15));
  EXPECT_EQ(matrix("K_g"), Eigen::Matrix3d::Identity());
  const Eigen::Matrix3d correction = matrix("R_a").inverse() * matrix("K_a").inverse();
  EXPECT_LT(
      worst_norm_error(record, 1.0,
                       [&](const Eigen::Vector3d& r) -> Eigen::Vector3d { return correction * (r - b); }),
      1e-4);
}

TEST_F(ExportTest, FlightControllersScaleAndShiftAndSayWhatTheyLeave) {
  const CorrectionConstants c = constants();
  const auto check = [&](const std::map<std::string, double>& p, const std::string& offset,
                         const std::string& scale) {
    Eigen::Vector3d b, s;
    Eigen::Index j = 0;
    for (const char axis : std::string("XYZ")) {
      const auto named = [&](std::string name) {
        name.replace(name.find('?'), 1, 1, axis);
        return p.at(name);
      };
      b[j] = named(offset);
      s[j++] = named(scale);
    }
    const double worst = worst_norm_error(
        record, 1.0, [&](const Eigen::Vector3d& r) -> Eigen::Vector3d { return (r - b).cwiseProduct(s); });
    EXPECT_GT(worst, 1e-3) << "the angles between the axes of this item are not 90 degrees";
    EXPECT_LT(worst, 1.01 * std::sqrt(2.0) * c.diagonal_remainder_mps2());
  };
  const std::string px4 = export_format("px4").write(c);
  EXPECT_THAT(px4, HasSubstr("At 1 g that leaves up to"));
  check(parameters(px4, '\t', 2, 3), "CAL_ACC0_?OFF", "CAL_ACC0_?SCALE");
  check(parameters(export_format("ardupilot").write(c), ',', 0, 1), "INS_ACCOFFS_?", "INS_ACCSCAL_?");
}

/// Both rules of the header, as it documents them: lines of three readings in, six accelerations out.
constexpr const char* kCorrectByBothRules = R"c(
#include "constants.h"
#include <math.h>
#include <stdio.h>
int main(void) {
  double r[3];
  while (scanf("%lf %lf %lf", &r[0], &r[1], &r[2]) == 3) {
    int32_t R[3];
    for (int k = 0; k < 3; ++k) R[k] = (int32_t)llround(ldexp(r[k], abcal_b_shift));
    for (int j = 0; j < 3; ++j) {
      double a = 0.0;
      for (int k = 0; k < 3; ++k) a += abcal_M[j][k] * (r[k] - abcal_b[k]);
      printf("%.17g ", a);
    }
    for (int j = 0; j < 3; ++j) {
      int64_t a = 0;
      for (int k = 0; k < 3; ++k) a += (int64_t)abcal_M_fixed[j][k] * ((int64_t)R[k] - abcal_b_fixed[k]);
      printf("%.17g\n", ldexp((double)a, -(abcal_M_shift + abcal_b_shift)));
    }
  }
  return 0;
}
)c";

/// Largest difference of the two rules over the readings of a run, m/s2.
double difference_of_rules(const std::string& header, const RunRecord& run) {
  const test::TemporaryFolder folder;
  test::write_file(folder / "constants.h", header);
  test::write_file(folder / "correct.c", kCorrectByBothRules);
  std::string readings;
  for (const DwellRecord& dwell : run.dwells)
    readings += fmt::format("{:.17g} {:.17g} {:.17g}\n", dwell.mean[0], dwell.mean[1], dwell.mean[2]);
  test::write_file(folder / "readings", readings);
  test::Program compiler(
      "/usr/bin/cc",
      {"-std=c99", "-Wall", "-Wextra", "-Werror", "-ftrapv", "correct.c", "-o", "correct", "-lm"},
      folder.path());
  EXPECT_EQ(compiler.wait(), 0) << compiler.err();
  test::Program program("/bin/sh", {"-c", "./correct < readings"}, folder.path());
  EXPECT_EQ(program.wait(), 0);
  std::istringstream numbers(program.out());
  double worst = 0.0;
  std::size_t lines = 0;
  for (std::array<double, 6> a{}; numbers >> a[0] >> a[1] >> a[2] >> a[3] >> a[4] >> a[5]; ++lines)
    for (std::size_t j = 0; j < 3; ++j) worst = std::max(worst, std::abs(a[j] - a[j + 3]));
  EXPECT_EQ(lines, run.dwells.size());
  return worst;
}

TEST_F(ExportTest, IntegersCorrectAsFloatingPointDoesInAnyUnit) {
  if (!std::filesystem::exists("/usr/bin/cc")) GTEST_SKIP() << "no C compiler";
  const std::vector<std::pair<std::string, double>> units{
      {"LSB", 16384.0}, {"LSB", 8388608.0}, {"g", kG / 9.80665}, {"m/s2", kG}, {"V", 0.002}, {"mV", 2000.0}};
  for (const auto& [unit, scale] : units) {
    RunRecord run = run_of(item(scale), unit);
    const CorrectionConstants c = constants_of(analyse(run, "joint"), ExportFrame::kItem);
    const std::string header = export_format("c").write(c);
    ASSERT_THAT(header, HasSubstr("abcal_M_fixed")) << unit;
    EXPECT_EQ(export_format("c").left_out(c), "");
    double least_u = 1.0;
    for (Eigen::Index j = 0; j < 3; ++j) least_u = std::min(least_u, kG * c.u_matrix()(j, j) / c.M(j, j));
    EXPECT_LT(difference_of_rules(header, run), 0.1 * least_u) << unit << " " << scale << "\n" << header;
  }
}

TEST_F(ExportTest, IntegersHoldReadingsUpToTheFullScale) {
  if (!std::filesystem::exists("/usr/bin/cc")) GTEST_SKIP() << "no C compiler";
  const RunRecord in_counts = run_of(item(64.0), "LSB");  // 500 g and more
  CorrectionConstants c = constants_of(analyse(in_counts, "joint"), ExportFrame::kItem);
  c.full_scale = 32768.0;
  RunRecord extremes;
  for (const double u : {-32768.0, 32767.0})
    for (const double v : {-32768.0, 32767.0}) {
      DwellRecord dwell;
      dwell.mean = Eigen::Vector3d(u, v, -u);
      extremes.dwells.push_back(dwell);
    }
  // The matrix is rounded to half of 2^-29 of its largest element.
  EXPECT_LT(difference_of_rules(export_format("c").write(c), extremes), 512.0 * kG * 3.0 * 2e-9 + 1e-3);
}

TEST_F(ExportTest, IntegersThatWouldAddToTheUncertaintyAreLeftOut) {
  CorrectionConstants c = constants();
  const std::string with = export_format("c").write(c);
  EXPECT_THAT(with, HasSubstr("enum { abcal_M_shift = "));
  EXPECT_THAT(with, HasSubstr("Error of a[j] at 1 g against the floating-point rule: at most "));
  c.covariance *= 1e-10;  // Both uncertainties times 1e-5.
  const std::string without = export_format("c").write(c);
  EXPECT_THAT(without, testing::Not(HasSubstr("abcal_M_fixed")));
  EXPECT_THAT(without, HasSubstr("// Not as integers: rounding to 32-bit integers makes an error of "));
  EXPECT_THAT(without, HasSubstr("static const double abcal_M[3][3]"));
  EXPECT_THAT(export_format("c").left_out(c), HasSubstr("the header has no integers: rounding"));
  c = constants();
  c.M *= 1e-9;  // 1e9 counts for 1 m/s2.
  c.b *= 1e9;
  c.covariance.topLeftCorner<9, 9>() *= 1e-18;
  c.covariance.bottomRightCorner<3, 3>() *= 1e18;
  EXPECT_THAT(export_format("c").write(c), HasSubstr("do not fit into 32-bit integers"));
}

TEST_F(ExportTest, JsonHasEverythingWithItsUncertainty) {
  const auto json = nlohmann::json::parse(export_format("json").write(constants(ExportFrame::kPlatter)));
  EXPECT_EQ(json.at("schema"), "abcal.constants/1");
  EXPECT_EQ(json.at("frame"), "platter");
  EXPECT_GT(json.at("M").at("standard_uncertainty")[0][1].get<double>(), 0.0);
  EXPECT_EQ(json.at("response_unit"), "m/s2");
}

/// A variable of a MATLAB file, its columns one after the other.
std::vector<double> numbers_of(mat_t* file, const char* name) {
  const std::unique_ptr<matvar_t, void (*)(matvar_t*)> variable(Mat_VarRead(file, name), Mat_VarFree);
  if (!variable || variable->data_type != MAT_T_DOUBLE) return {};
  const auto* first = static_cast<const double*>(variable->data);
  return {first, first + variable->nbytes / sizeof(double)};
}

constexpr const char* kReadByScipy = R"py(
import sys
try:
    import scipy.io
except ImportError:
    sys.exit(77)
m = scipy.io.loadmat("constants.mat")
assert m["M"].shape == (3, 3) and m["b"].shape == (3, 1)
assert m["rule"][0] == "a = M (r - b)" and m["response_unit"][0] == "m/s2"
assert abs(m["M"][0][1] - float(sys.argv[1])) < 1e-12
)py";

TEST_F(ExportTest, AMatlabFileHoldsTheRuleThatItNames) {
  const test::TemporaryFolder folder;
  const std::string path = write_mat(folder);
  const std::unique_ptr<mat_t, int (*)(mat_t*)> file(Mat_Open(path.c_str(), MAT_ACC_RDONLY), Mat_Close);
  ASSERT_TRUE(file);
  EXPECT_EQ(Mat_GetVersion(file.get()), MAT_FT_MAT5);
  const std::vector<double> M = numbers_of(file.get(), "M"), b = numbers_of(file.get(), "b");
  ASSERT_EQ(M.size(), 9U);
  ASSERT_EQ(b.size(), 3U);
  // Eigen keeps columns one after the other, as MATLAB does.
  const Eigen::Map<const Eigen::Matrix3d> matrix(M.data());
  const Eigen::Map<const Eigen::Vector3d> offset(b.data());
  EXPECT_LT(
      worst_norm_error(record, 1.0,
                       [&](const Eigen::Vector3d& r) -> Eigen::Vector3d { return matrix * (r - offset); }),
      1e-4);
  EXPECT_NE(matrix(0, 1), matrix(1, 0));  // Otherwise a transposed matrix would not be found.
  EXPECT_EQ(numbers_of(file.get(), "g_loc_mps2"), std::vector<double>{kG});
}

TEST_F(ExportTest, ScipyReadsTheMatlabFile) {
  const test::TemporaryFolder folder;
  write_mat(folder);
  const CorrectionConstants c = constants();
  const std::string element = fmt::format("{:.17g}", c.M(0, 1));
  test::Program scipy("/usr/bin/python3", {"-c", kReadByScipy, element}, folder.path());
  const int code = scipy.wait();
  if (code == 77)
    GTEST_SKIP() << "python3-scipy is not installed (Debian 12 cannot have it beside Boost 1.81)";
  EXPECT_EQ(code, 0) << scipy.err();
}

/// A series of an item whose sensitivities, angles and offsets change by polynomials.
class ExportOverTemperatureTest : public testing::Test {
 protected:
  static constexpr double kReference = 23.0;
  static constexpr std::array kTemperatures{-40.0, -10.0, 23.0, 50.0, 85.0};

  static Eigen::Matrix<double, 9, 1> truth(double degc) {
    const double d = degc - kReference;
    Eigen::Matrix<double, 9, 1> x;
    x << 1.01 - 1e-4 * d + 2e-7 * d * d, 0.99 + 5e-5 * d, 1.0, 89.7 + 1e-4 * d, 90.4, 90.1, 0.02 + 3e-5 * d,
        -0.01 - 5e-5 * d + 1e-7 * d * d, 0.03;
    return x;
  }

  static TemperatureConstants constants() {
    std::vector<TemperaturePoint> points;
    for (const double degc : kTemperatures) {
      TemperaturePoint point;
      point.number = static_cast<int>(points.size()) + 1;
      point.set_degc = point.temperature_degc = degc;
      point.value = truth(degc);
      point.own = Covariance9::Identity() * 1e-12;
      point.shared = Covariance9::Zero();
      points.push_back(point);
    }
    TemperatureConstants c = temperature_constants(fit_temperature(points, kReference, "g"), kG);
    c.response_unit = "g";
    c.verdict = "usable";
    return c;
  }

  /// Largest | |a| - g_loc | of the readings of an item at its temperature, m/s2.
  static double worst(const std::function<Eigen::Vector3d(const Eigen::Vector3d& r, double degc)>& rule) {
    double worst = 0.0;
    for (double degc = -40.0; degc <= 85.0; degc += 5.0) {
      const Eigen::Matrix<double, 9, 1> x = truth(degc);
      const Eigen::Matrix3d S = sensitivity_in_own_axes(x.head<3>(), x.segment<3>(3));
      for (const Eigen::Vector3d& f : {Eigen::Vector3d(0.6, 0.0, 0.8), Eigen::Vector3d(-0.48, 0.6, -0.64)})
        worst = std::max(worst, std::abs(rule(S * f + x.tail<3>(), degc).norm() - kG));
    }
    return worst;
  }

  static double polynomial(const std::vector<double>& c, double degc) {
    double value = 0.0;
    for (std::size_t n = 0; n < c.size(); ++n)
      value += c[n] * std::pow(degc - kReference, static_cast<double>(n));
    return value;
  }
};

TEST_F(ExportOverTemperatureTest, TheConstantsTurnReadingsIntoLocalGravityAtEveryTemperature) {
  const TemperatureConstants c = constants();
  EXPECT_LT(c.largest_error, 1e-6);
  EXPECT_GT(c.largest_error, 0.0) << "an inverse is no polynomial";
  EXPECT_LT(worst([&](const Eigen::Vector3d& r, double degc) -> Eigen::Vector3d {
              return c.matrix_at(degc) * (r - c.offset_at(degc));
            }),
            3e-5);  // 3 times the 1e-6 of the points' own uncertainty.
}

TEST_F(ExportOverTemperatureTest, JsonAndCsvHoldTheRuleThatTheyName) {
  const auto json = nlohmann::json::parse(export_format("json").write_over_temperature(constants()));
  EXPECT_EQ(json.at("schema"), "abcal.temperature_constants/1");
  EXPECT_EQ(json.at("T0_degc"), kReference);
  EXPECT_EQ(json.at("outputs").size(), 9U);
  EXPECT_GT(json.at("outputs")[0].at("covariance")[1][1].get<double>(), 0.0);
  const auto from_json = [&](const Eigen::Vector3d& r, double degc) -> Eigen::Vector3d {
    Eigen::Vector3d a = Eigen::Vector3d::Zero();
    for (std::size_t j = 0; j < 3; ++j)
      for (std::size_t k = 0; k < 3; ++k)
        a[static_cast<Eigen::Index>(j)] +=
            polynomial(json.at("M").at("coefficients")[j][k].get<std::vector<double>>(), degc) *
            (r[static_cast<Eigen::Index>(k)] -
             polynomial(json.at("b").at("coefficients")[k].get<std::vector<double>>(), degc));
    return a;
  };
  EXPECT_LT(worst(from_json), 3e-5);

  std::map<std::string, std::vector<double>> rows;
  std::istringstream lines(export_format("csv").write_over_temperature(constants()));
  for (std::string line; std::getline(lines, line);) {
    if (line.starts_with('#') || line.starts_with("name")) continue;
    std::istringstream cells(line);
    std::string name, n, value;
    std::getline(cells, name, ',');
    std::getline(cells, n, ',');
    std::getline(cells, value, ',');
    EXPECT_EQ(std::to_string(rows[name].size()), n);
    rows[name].push_back(std::stod(value));
  }
  const auto from_csv = [&](const Eigen::Vector3d& r, double degc) -> Eigen::Vector3d {
    Eigen::Vector3d a = Eigen::Vector3d::Zero();
    for (std::size_t j = 0; j < 3; ++j)
      for (std::size_t k = 0; k < 3; ++k)
        a[static_cast<Eigen::Index>(j)] +=
            polynomial(rows.at(fmt::format("M_{}{}", "xyz"[j], "uvw"[k])), degc) *
            (r[static_cast<Eigen::Index>(k)] - polynomial(rows.at(fmt::format("b_{}", "uvw"[k])), degc));
    return a;
  };
  EXPECT_LT(worst(from_csv), 3e-5);
  EXPECT_EQ(rows.at("phi_uv").size(), 2U);
}

constexpr const char* kCorrectInC = R"c(
#include "constants.h"
#include <stdio.h>
static double at(const double* c, double degc) {
  double value = 0.0;
  for (int n = abcal_terms; n-- > 0;) value = value * (degc - abcal_T0_degc) + c[n];
  return value;
}
int main(void) {
  double r[3], degc;
  while (scanf("%lf %lf %lf %lf", &degc, &r[0], &r[1], &r[2]) == 4)
    for (int j = 0; j < 3; ++j) {
      double a = 0.0;
      for (int k = 0; k < 3; ++k) a += at(abcal_M[j][k], degc) * (r[k] - at(abcal_b[k], degc));
      printf("%.12g\n", a);
    }
  return abcal_least_degc < abcal_most_degc ? 0 : 1;
}
)c";

TEST_F(ExportOverTemperatureTest, ACompilerTakesTheHeader) {
  if (!std::filesystem::exists("/usr/bin/cc")) GTEST_SKIP() << "no C compiler";
  const test::TemporaryFolder folder;
  test::write_file(folder / "constants.h", export_format("c").write_over_temperature(constants()));
  test::write_file(folder / "correct.c", kCorrectInC);
  test::Program compiler("/usr/bin/cc", {"-std=c99", "-Wall", "-Werror", "correct.c", "-o", "correct"},
                         folder.path());
  ASSERT_EQ(compiler.wait(), 0) << compiler.err();
  const auto by_header = [&](const Eigen::Vector3d& r, double degc) -> Eigen::Vector3d {
    test::write_file(folder / "readings", fmt::format("{} {} {} {}\n", degc, r[0], r[1], r[2]));
    test::Program program("/bin/sh", {"-c", "./correct < readings"}, folder.path());
    EXPECT_EQ(program.wait(), 0);
    std::istringstream numbers(program.out());
    Eigen::Vector3d a;
    numbers >> a[0] >> a[1] >> a[2];
    return a;
  };
  EXPECT_LT(worst(by_header), 3e-5);
}

TEST_F(ExportOverTemperatureTest, AMatlabFileHoldsIt) {
  set_helper_folder(std::filesystem::path(test::abcal_program()).parent_path());
  const test::TemporaryFolder folder;
  const std::string path = (folder / "constants.mat").string();
  OutputFile(path).write(export_format("mat").write_over_temperature(constants()));
  const std::unique_ptr<mat_t, int (*)(mat_t*)> file(Mat_Open(path.c_str(), MAT_ACC_RDONLY), Mat_Close);
  ASSERT_TRUE(file);
  const std::vector<double> M = numbers_of(file.get(), "M"), b = numbers_of(file.get(), "b"),
                            u_s = numbers_of(file.get(), "u_s");
  ASSERT_EQ(M.size() % 9, 0U);
  ASSERT_EQ(b.size() % 3, 0U);
  EXPECT_GT(u_s.at(3), 0.0) << "of the slope of u";
  // Columns one after the other: one for each power.
  const auto from_mat = [&](const Eigen::Vector3d& r, double degc) -> Eigen::Vector3d {
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
    Eigen::Vector3d bias = Eigen::Vector3d::Zero();
    for (std::size_t n = 0; n < M.size() / 9; ++n)
      for (std::size_t k = 0; k < 9; ++k)
        matrix(static_cast<Eigen::Index>(k / 3), static_cast<Eigen::Index>(k % 3)) +=
            M[9 * n + k] * std::pow(degc - kReference, static_cast<double>(n));
    for (std::size_t n = 0; n < b.size() / 3; ++n)
      for (std::size_t k = 0; k < 3; ++k)
        bias[static_cast<Eigen::Index>(k)] +=
            b[3 * n + k] * std::pow(degc - kReference, static_cast<double>(n));
    return matrix * (r - bias);
  };
  EXPECT_LT(worst(from_mat), 3e-5);
}

TEST_F(ExportOverTemperatureTest, FormatsOfOneTemperatureHoldNone) {
  for (const char* name : {"px4", "ardupilot", "ros", "kalibr", "imucal"})
    EXPECT_FALSE(export_format(name).write_over_temperature) << name;
}

TEST_F(ExportTest, WhatDoesNotFitIsRefusedWithTheReason) {
  const auto reason = [](const std::function<void()>& call) -> std::string {
    try {
      call();
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "not refused";
  };
  const RunRecord in_volts = run_of(item(0.5), "V");
  const CorrectionConstants volts = constants_of(analyse(in_volts, "joint"), ExportFrame::kItem);
  EXPECT_THAT(reason([&] { (void)export_format("px4").write(volts); }), HasSubstr("the output is in V"));
  EXPECT_THAT(export_format("json").write(volts), HasSubstr("\"response_unit\": \"V\""));
  EXPECT_THAT(reason([&] { (void)export_format("kalibr").write(constants()); }),
              HasSubstr("noise of single readings"));
  EXPECT_THAT(reason([&] { (void)export_format("matlab"); }), HasSubstr("required: one of json, csv"));
  EXPECT_THAT(reason([&] { (void)constants_of(analyse(record, "norm"), ExportFrame::kPlatter); }),
              HasSubstr("knows no platter"));
  CalibrationResult bad = analyse(record, "joint");
  bad.verdict = Verdict::kNotUsable;
  bad.why = Message("it fell");
  EXPECT_THAT(reason([&] { (void)constants_of(bad, ExportFrame::kItem); }), HasSubstr("it fell"));
}

}  // namespace
}  // namespace abcal
