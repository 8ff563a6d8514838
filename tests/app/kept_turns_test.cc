#include "app/measure/bench/kept_turns.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <string>

#include "app/system/state_folder.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

class KeptTurnsTest : public testing::Test {
 protected:
  KeptTurnsTest() { ::setenv("XDG_STATE_HOME", folder_.path().c_str(), 1); }
  ~KeptTurnsTest() override { ::unsetenv("XDG_STATE_HOME"); }

  static StageInfo stage(const std::string& serial_number) {
    StageInfo info;
    info.maker = "RT";
    info.model = "RT-2";
    info.serial_number = serial_number;
    return info;
  }
  static std::shared_ptr<CountedTurns> turns_of(const std::string& serial_number) {
    auto turns = make_kept_turns();
    turns->recall(stage(serial_number));
    return turns;
  }
  std::filesystem::path kept() const {
    const std::filesystem::directory_iterator files(state_folder() / "stage-turns");
    return files->path();
  }

  const test::TemporaryFolder folder_;
};

TEST_F(KeptTurnsTest, AnotherProgramKnowsHowFarTheCableOfAStageIsWound) {
  const auto turns = turns_of("412");
  EXPECT_FALSE(turns->target(StageAxis::kX));
  turns->set_target(StageAxis::kX, Angle::degrees(-340.0));
  const auto later = turns_of("412");
  EXPECT_EQ(later->target(StageAxis::kX), Angle::degrees(-340.0));
  EXPECT_FALSE(later->target(StageAxis::kZ));
  EXPECT_FALSE(turns_of("413")->target(StageAxis::kX)) << "another stage";
  EXPECT_THAT(later->remedy(), testing::HasSubstr(kept().string()));
  std::filesystem::remove(kept());
  EXPECT_FALSE(turns_of("412")->target(StageAxis::kX));
}

TEST_F(KeptTurnsTest, AFileThatCannotBeReadIsNotTakenForUnwound) {
  turns_of("412")->set_target(StageAxis::kZ, Angle::degrees(300.0));
  test::write_file(kept(), "{");
  try {
    turns_of("412");
    FAIL() << "a damaged file says nothing";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), testing::AllOf(testing::HasSubstr(kept().string()),
                                             testing::HasSubstr("are not wound, then remove")));
  }
}

}  // namespace
}  // namespace abcal
