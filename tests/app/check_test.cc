// abcal check, and abcal instruments --probe.

#include <gmock/gmock.h>

#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include "app/measure/session/bench_check.h"
#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::json;

/// Readings of an accelerometer (rows u, v, w along x, y, z) on a stage whose axes turn in these senses.
std::vector<PoseReading> poses(const Eigen::Matrix3d& s, int sign_x, int sign_z) {
  std::vector<PoseReading> all;
  for (const auto& [x, z] : {std::pair{0.0, 0.0}, {30.0, 0.0}, {30.0, 30.0}}) {
    PoseReading pose{Angle::degrees(x), Angle::degrees(z), {}};
    const Eigen::Matrix3d turned =
        Eigen::AngleAxisd(sign_x * pose.x.rad(), Eigen::Vector3d::UnitX()).toRotationMatrix() *
        Eigen::AngleAxisd(sign_z * pose.z.rad(), Eigen::Vector3d::UnitZ()).toRotationMatrix();
    pose.mean = s * turned.transpose() * Eigen::Vector3d::UnitZ() + Eigen::Vector3d(0.1, -0.2, 0.05);
    all.push_back(pose);
  }
  return all;
}

TEST(JudgeSigns, AnAccelerometerThatStandsAskewIsGood) {
  const Eigen::Matrix3d askew =
      9.81 * Eigen::AngleAxisd(0.05, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  EXPECT_EQ(judge_signs(poses(askew, +1, +1)).grade, Finding::Grade::kGood);
}

TEST(JudgeSigns, AReversedStageAxisIsNamed) {
  const Finding x = judge_signs(poses(Eigen::Matrix3d::Identity(), -1, +1));
  EXPECT_EQ(x.grade, Finding::Grade::kProblem);
  EXPECT_THAT(x.advice, HasSubstr("[stage.x] sign"));
  // Gravity alone cannot tell it from an accelerometer turned by half a turn: the advice states both.
  EXPECT_THAT(x.advice, AllOf(HasSubstr("or"), HasSubstr("-x, -y, +z")));
  const Finding z = judge_signs(poses(Eigen::Matrix3d::Identity(), +1, -1));
  EXPECT_THAT(z.advice, AllOf(HasSubstr("[stage.z] sign"), Not(HasSubstr("[stage.x] sign is wrong"))));
}

TEST(JudgeSigns, SwappedAndReversedOutputsAreNamed) {
  Eigen::Matrix3d s;
  s << 0, 1, 0, -1, 0, 0, 0, 0, 1;
  EXPECT_THAT(judge_signs(poses(s, +1, +1)).advice, HasSubstr("+y, -x, +z"));
  const Eigen::Matrix3d upside_down = Eigen::Vector3d(1, 1, -1).asDiagonal();
  EXPECT_THAT(judge_signs(poses(upside_down, +1, +1)).advice, HasSubstr("+x, +y, -z"));
}

TEST(JudgeSigns, AnAccelerometerThatIsNotOnTheStageIsFound) {
  std::vector<PoseReading> same(3, PoseReading{Angle{}, Angle{}, Eigen::Vector3d(0, 0, 1)});
  same[1].x = same[2].x = same[2].z = Angle::degrees(30.0);
  const Finding finding = judge_signs(same);
  EXPECT_EQ(finding.grade, Finding::Grade::kProblem);
  EXPECT_THAT(finding.advice, HasSubstr("fixed to this stage"));
}

class CheckTest : public ProgramTest {
 protected:
  Json check(const std::string& simulation, int expected_exit, const std::string& more = "") {
    write_bench({.simulation = simulation});
    const std::string text = test::read_file(folder / "bench.toml") + more;
    test::write_file(folder / "bench.toml", text);
    const ProgramResult result = abcal({"check", "bench.toml", "--json"});
    EXPECT_EQ(result.exit_code, expected_exit) << result.out << result.err;
    return Json::parse(result.out);
  }
  static std::string advice(const Json& json, const std::string& what) {
    for (const Json& finding : json.at("findings"))
      if (finding.at("what") == what && finding.at("grade") != "good")
        return finding.at("found").get<std::string>() + " | " + finding.at("advice").get<std::string>();
    return "good";
  }
};

TEST_F(CheckTest, AGoodBenchIsFitForARun) {
  const Json json = check("", 0);
  EXPECT_EQ(json["problems"], 0);
  EXPECT_EQ(json["warnings"], 0);
  EXPECT_EQ(json["findings"].back()["what"], "signs and axes");
  EXPECT_EQ(json["findings"].back()["grade"], "good");
}

TEST_F(CheckTest, NothingMovesWithoutMotion) {
  write_bench({});
  const ProgramResult result = abcal({"check", "bench.toml", "--no-motion"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, AllOf(HasSubstr("left out  signs and axes"), HasSubstr("fit for a run")));
}

TEST_F(CheckTest, TellsWhatIsWrong) {
  EXPECT_THAT(advice(check("sensitivity_matrix = [[0, 1, 0], [1, 0, 0], [0, 0, 1]]\n", 1), "signs and axes"),
              HasSubstr("+y, +x, +z"));
  EXPECT_THAT(advice(check("sensitivity_matrix = [[2, 0, 0], [0, 2, 0], [0, 0, 2]]\n", 1), "norm"),
              HasSubstr("full scale"));
  EXPECT_THAT(advice(check("full_scale = 0.9\n", 1), "range"), HasSubstr("clips"));
  EXPECT_THAT(advice(check("", 1, "[[fault]]\nkind = \"silence\"\ninstrument = \"stage\"\n"), "stage"),
              HasSubstr("no reply"));
  EXPECT_THAT(advice(check("", 1, "[[fault]]\nkind = \"no-output\"\n"), "readings at rest"),
              HasSubstr("no reading"));
  EXPECT_THAT(advice(check("", 1, "[[fault]]\nkind = \"refused-move\"\n"), "signs and axes"),
              HasSubstr("refused"));
}

TEST_F(EmulatedBenchTest, ProbingFindsOutWhatIsOnAPort) {
  start_emulator();
  const ProgramResult result =
      abcal({"instruments", "--probe", "--json", "--port", "links/stage", "--port", "links/nothing"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const Json probed = Json::parse(result.out).at("probed");
  ASSERT_EQ(probed.size(), 2U);
  EXPECT_EQ(probed[0]["driver"], "pi_gcs");
  EXPECT_EQ(probed[0]["role"], "stage");
  EXPECT_THAT(probed[1]["failure"].get<std::string>(), HasSubstr("links/nothing"));
}

TEST_F(EmulatedBenchTest, ProbingFindsTheAccelerometerAfterAllStages) {
  start_emulator();
  const ProgramResult result = abcal({"instruments", "--probe", "--json", "--port", "links/accelerometer"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const Json probed = Json::parse(result.out).at("probed");
  EXPECT_EQ(probed[0]["driver"], "microstrain_mip");
  EXPECT_EQ(probed[0]["role"], "accelerometer");
}

}  // namespace
}  // namespace abcal
