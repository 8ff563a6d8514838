// Poses whose directions are stated: the norm fit with the matrix.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <cctype>
#include <cmath>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "protocol/estimators/norm/norm_fit.h"
#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/record/import_table.h"

namespace abcal {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

struct Item {
  Eigen::Matrix3d s;
  Eigen::Vector3d o;
};

Item some_item() {
  Item item;
  item.s << 1.05, -0.08, 0.33, 0.11, 0.93, -0.05, -0.32, 0.07, 1.01;
  item.o = {0.05, -0.12, 0.2};
  return item;
}

std::vector<Eigen::Vector3d> faces_of_cube() {
  std::vector<Eigen::Vector3d> ups;
  for (int axis = 0; axis < 3; ++axis)
    for (const double sign : {1.0, -1.0}) ups.emplace_back(sign * Eigen::Vector3d::Unit(axis));
  return ups;
}

/// Errors of a draw.
struct Errors {
  double reading = 0.0, angle = 0.0;  ///< Relative to S; radian.
  bool reading_stated = false, angle_stated = false;
  int repeats = 1;  ///< Poses of each direction, which share the error of its angle.
};

std::vector<Pose> drawn_poses(const Item& item, const std::vector<Eigen::Vector3d>& ups, const Errors& errors,
                              std::mt19937_64& engine) {
  std::normal_distribution<double> normal;
  const auto three = [&] { return Eigen::Vector3d(normal(engine), normal(engine), normal(engine)); };
  std::vector<Pose> poses;
  for (const Eigen::Vector3d& up : ups) {
    const Eigen::Vector3d real = (up + errors.angle * three().cross(up)).normalized();
    for (int k = 0; k < errors.repeats; ++k) {
      Pose pose;
      pose.reading = item.s * real + item.o + errors.reading * three();
      if (errors.reading_stated) pose.u = Eigen::Vector3d::Constant(errors.reading);
      pose.up = up;
      poses.push_back(pose);
    }
  }
  return poses;
}

CalibrationResult analyse(const std::vector<Pose>& poses, const Errors& errors) {
  return analyse_norm(poses, linear_item(),
                      errors.angle_stated ? std::optional(Angle::radians(errors.angle)) : std::nullopt);
}

std::vector<Eigen::Vector3d> some_directions(int count, std::mt19937_64& engine) {
  std::normal_distribution<double> normal;
  std::vector<Eigen::Vector3d> ups;
  for (int i = 0; i < count; ++i)
    ups.push_back(Eigen::Vector3d(normal(engine), normal(engine), normal(engine)).normalized());
  return ups;
}

TEST(NormDirectionsTest, FindsTheMatrixOfExactPoses) {
  std::mt19937_64 engine(1);
  std::vector<std::vector<Eigen::Vector3d>> designs{faces_of_cube(), some_directions(30, engine)};
  designs.front().push_back(Eigen::Vector3d(1.0, 1.0, 1.0).normalized());
  for (const auto& ups : designs)
    for (const double unit : {1.0, -4096.0}) {  // Also with the axes of the other hand.
      Item item = some_item();
      item.s *= unit;
      item.o *= unit;
      const CalibrationResult result = analyse(drawn_poses(item, ups, {}, engine), {});
      ASSERT_TRUE(result.sensitivity_matrix) << result.why.english();
      EXPECT_EQ(result.verdict, Verdict::kUsable) << result.why.english();
      EXPECT_LT((result.sensitivity_values() - item.s).norm(), 1e-11 * std::abs(unit));
      EXPECT_LT((result.offset_values() - item.o).norm(), 1e-11 * std::abs(unit));
      const IntrinsicProperties intrinsic = intrinsic_properties(item.s);
      for (std::size_t j = 0; j < 3; ++j)
        EXPECT_NEAR(result.intrinsic_angle[j].value, intrinsic.angle_deg(static_cast<Eigen::Index>(j)), 1e-9);
    }
}

/// With equal variances in all directions the fit is the linear one, whose covariance is known.
TEST(NormDirectionsTest, HasTheCovarianceOfTheLinearFit) {
  std::mt19937_64 engine(2);
  Item item;
  item.s.setIdentity();
  item.o.setZero();
  const Errors errors{.reading = 1e-5, .angle = 1e-9, .reading_stated = true, .angle_stated = true};
  const auto poses = drawn_poses(item, some_directions(15, engine), errors, engine);
  const CalibrationResult result = analyse(poses, errors);
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
  for (const Pose& pose : poses) {
    Eigen::Vector4d row;
    row << *pose.up, 1.0;
    normal += row * row.transpose();
  }
  const Eigen::Matrix4d cofactor = normal.inverse();
  for (Eigen::Index j = 0; j < 3; ++j) {
    const Eigen::Matrix3d block = result.covariance->block<3, 3>(3 * j, 3 * j) / 1e-10;
    EXPECT_LT((block - cofactor.topLeftCorner<3, 3>()).norm(), 1e-4 * cofactor.norm());
    EXPECT_NEAR((*result.covariance)(9 + j, 9 + j) / 1e-10, cofactor(3, 3), 1e-4 * cofactor(3, 3));
  }
  const Eigen::Matrix<double, 9, 12> by = intrinsic_jacobian(result.sensitivity_values());
  EXPECT_LT((*result.covariance_intrinsic - by * *result.covariance * by.transpose()).norm(),
            1e-6 * result.covariance_intrinsic->norm());
}

struct Case {
  const char* name;
  Errors errors;
  int directions;      ///< 0: the faces of a cube.
  double least, most;  ///< Bounds of the part of the intervals that cover.
};

class NormDirectionsCoverage : public testing::TestWithParam<Case> {};

/// Each output covers the truth as often as it states. 400 draws know 95.45 % to 1.04 %; bounds of four times
/// this.
TEST_P(NormDirectionsCoverage, OfDrawnTruths) {
  constexpr int kDraws = 400;
  const Case& of = GetParam();
  std::array<int, 12> covered{};
  std::mt19937_64 engine(11);
  std::normal_distribution<double> normal;
  for (int draw = 0; draw < kDraws; ++draw) {
    Item item = some_item();
    for (double& each : item.s.reshaped()) each += 0.05 * normal(engine);
    const auto ups = of.directions == 0 ? faces_of_cube() : some_directions(of.directions, engine);
    const CalibrationResult result = analyse(drawn_poses(item, ups, of.errors, engine), of.errors);
    ASSERT_TRUE(result.sensitivity_matrix) << result.why.english();
    for (std::size_t i = 0; i < 12; ++i) {
      const Quantity& found = i < 9 ? (*result.sensitivity_matrix)[i / 3][i % 3] : result.offset[i - 9];
      const auto at = static_cast<Eigen::Index>(i);
      const double truth = i < 9 ? item.s(at / 3, at % 3) : item.o(at - 9);
      covered[i] += std::abs(found.value - truth) <= coverage_factor(found) * found.standard_uncertainty;
    }
  }
  for (std::size_t i = 0; i < 12; ++i) {
    EXPECT_GE(covered[i] / static_cast<double>(kDraws), of.least) << of.name << " output " << i;
    EXPECT_LE(covered[i] / static_cast<double>(kDraws), of.most) << of.name << " output " << i;
  }
}

INSTANTIATE_TEST_SUITE_P(
    Cases, NormDirectionsCoverage,
    testing::Values(Case{"stated", {1e-4, 2e-3, true, true}, 16, 0.913, 0.996},
                    Case{"angles from residuals", {1e-4, 2e-3, true, false}, 16, 0.913, 0.996},
                    Case{"readings from residuals", {1e-4, 2e-3, false, true}, 24, 0.913, 0.996},
                    Case{"both from residuals", {1e-4, 2e-3, false, false}, 24, 0.913, 0.996},
                    Case{"noise of the readings alone", {1e-3, 1e-7, false, false}, 24, 0.913, 0.996},
                    Case{"repeated", {1e-4, 2e-3, false, false, 4}, 12, 0.913, 0.996},
                    // The scatter of the norm is taken as that of the directions: too large for s and O.
                    Case{"cube", {1e-4, 2e-3, false, false}, 0, 0.913, 1.0},
                    Case{"cube, stated", {1e-4, 2e-3, true, true}, 0, 0.913, 0.996}),
    [](const auto& of) {
      std::string name;
      for (const char c : std::string(of.param.name))
        if (std::isalpha(static_cast<unsigned char>(c)) != 0) name += c;
      return name;
    });

TEST(NormDirectionsTest, AStatedDirectionThatIsWrongIsNamed) {
  std::mt19937_64 engine(4);
  const Errors errors{.reading = 1e-4, .angle = 1e-4};
  auto poses = drawn_poses(some_item(), some_directions(30, engine), errors, engine);
  poses[6].up = Eigen::AngleAxisd(0.02, Eigen::Vector3d::UnitX()) * *poses[6].up;
  const CalibrationResult result = analyse(poses, errors);
  EXPECT_EQ(result.verdict, Verdict::kDoubtful);
  EXPECT_THAT(result.why.english(), HasSubstr("the stated direction of pose 7 is off by"));
}

TEST(NormDirectionsTest, TooFewOrFlatDirectionsAreRefused) {
  std::mt19937_64 engine(5);
  EXPECT_THAT(analyse(drawn_poses(some_item(), some_directions(4, engine), {}, engine), {}).why.english(),
              HasSubstr("5 or more are required"));
  std::vector<Eigen::Vector3d> flat;
  for (int i = 0; i < 12; ++i) flat.emplace_back(std::cos(0.5 * i), std::sin(0.5 * i), 0.0);
  EXPECT_EQ(analyse(drawn_poses(some_item(), flat, {}, engine), {}).verdict, Verdict::kNotUsable);
}

RunRecord record_of(const std::string& text) {
  std::istringstream input(text);
  return import_table(input, "a.csv").record;
}

std::string refusal_of(const std::string& text) {
  try {
    record_of(text);
  } catch (const TableError& error) {
    return error.what();
  }
  return "not refused";
}

TEST(NormDirectionsTest, DirectionsAreReadInThreeForms) {
  const double half = std::sqrt(0.5);
  const RunRecord up = record_of("up_x,up_y,up_z,ax,ay,az\n-1,0,0,1,2,3\n0,9.8,0,3,4,5\n");
  ASSERT_EQ(up.dwells.size(), 2U);
  EXPECT_EQ(up.dwells[1].up, Eigen::Vector3d(0.0, 1.0, 0.0));
  EXPECT_THAT(up.read_as.front(), HasSubstr("directions of the poses"));
  std::ostringstream quaternions;
  quaternions.precision(17);
  quaternions << "pose_qw,pose_qx,pose_qy,pose_qz,ax,ay,az\n"
              << half << ",0," << half << ",0,1,2,3\n"
              << half << "," << half << ",0,0,3,4,5\n";
  for (const RunRecord& record :
       {record_of("# pose_uncertainty_deg: 0.05\npose_roll_deg,pose_pitch_deg,pose_yaw_deg,ax,ay,az\n"
                  "0,90,33,1,2,3\n90,0,12,3,4,5\n"),
        record_of(quaternions.str())})
    for (std::size_t i = 0; i < 2; ++i) EXPECT_LT((*record.dwells[i].up - *up.dwells[i].up).norm(), 1e-15);
  EXPECT_NEAR(record_of("# pose_uncertainty_deg: 0.05\nup_x,up_y,up_z,x,y,z\n1,0,0,1,2,3\n").u_up->deg(),
              0.05, 1e-15);
  EXPECT_THAT(refusal_of("up_x,up_y,ax,ay,az\n1,0,1,2,3\n"), HasSubstr("a column up_z"));
  EXPECT_THAT(refusal_of("up_x,up_y,up_z,ax,ay,az\n0,0,0,1,2,3\n1,0,x,1,2,3\n"),
              AllOf(HasSubstr("line 2, up_x: found a direction of no length"), HasSubstr("line 3, up_z")));
  EXPECT_THAT(refusal_of("pose_qw,pose_qx,pose_qy,pose_qz,ax,ay,az\n1,1,0,0,1,2,3\n"),
              HasSubstr("a quaternion of the length 1.41; required: the length 1"));
  EXPECT_THAT(refusal_of("up_x,up_y,up_z,pose_roll_deg,pose_pitch_deg,ax,ay,az\n1,0,0,0,0,1,2,3\n"),
              HasSubstr("directions by up_x and by pose_roll_deg"));
}

}  // namespace
}  // namespace abcal
