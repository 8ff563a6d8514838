#include "drivers/manual_stage/manual_stage.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <unistd.h>

#include <future>
#include <limits>
#include <sstream>
#include <stdexcept>

#include "drivers/instrument/instrument_error.h"
#include "tests/support/error_of.h"

namespace abcal::manual_stage {
namespace {

using test::error_of;

using ::testing::HasSubstr;

TEST(ManualStageTest, TypedAnglesAreDegreesOrDegreesMinutesSeconds) {
  EXPECT_EQ(parse_typed_angle("89.98")->deg(), 89.98);
  EXPECT_EQ(parse_typed_angle(" 89,98\r")->deg(), 89.98);
  EXPECT_EQ(parse_typed_angle("-12")->deg(), -12.0);
  EXPECT_EQ(parse_typed_angle("89 30")->deg(), 89.5);
  EXPECT_EQ(parse_typed_angle("89 58,8")->deg(), 89.0 + 58.8 / 60.0);
  EXPECT_EQ(parse_typed_angle("-0 30 36")->deg(), -(0.5 + 0.01));
  for (const char* text :
       {"", " ", "x", "1x", "nan", "inf", "1e3", "1 60", "1.5 30", "1 -2", "1 2 3 4", "--1", "1,2,3", "- "})
    EXPECT_FALSE(parse_typed_angle(text).has_value()) << text;
}

TEST(ManualStageTest, AsksConfirmsAndTakesTheAngleReadOff) {
  std::istringstream in("\n\n89.98\n");
  std::ostringstream out;
  ManualStage stage(in, out, {});
  EXPECT_FALSE(stage.identify().axes[0].referenced);
  EXPECT_EQ(out.str(), "") << "identify asks nobody";
  stage.home(StageAxis::kX);
  EXPECT_THAT(out.str(), HasSubstr("X, the outer"));
  EXPECT_EQ(stage.motion_state(StageAxis::kX), MotionState::kStopped);
  EXPECT_EQ(stage.encoder_angle(StageAxis::kX).deg(), 0.0);
  EXPECT_TRUE(stage.identify().axes[0].referenced);
  EXPECT_FALSE(stage.identify().axes[1].referenced);
  stage.move_to(StageAxis::kX, Angle::degrees(45.0));
  EXPECT_THAT(out.str(), HasSubstr("45.0000 deg"));
  EXPECT_EQ(stage.encoder_angle(StageAxis::kX).deg(), 45.0);
  stage.move_to(StageAxis::kX, Angle::degrees(90.0));
  EXPECT_EQ(stage.encoder_angle(StageAxis::kX).deg(), 89.98);
}

TEST(ManualStageTest, ASlipOfTheFingersIsAskedAgain) {
  std::istringstream in("\n9.0\nabc\n90.01\n");
  std::ostringstream out;
  ManualStage stage(in, out, {});
  stage.home(StageAxis::kZ);
  stage.move_to(StageAxis::kZ, Angle::degrees(90.0));
  EXPECT_EQ(stage.encoder_angle(StageAxis::kZ).deg(), 90.01);
  EXPECT_THAT(out.str(), HasSubstr("9 deg differs by more than 1 deg from 90 deg"));
  EXPECT_THAT(out.str(), HasSubstr("\"abc\" is not an angle"));
}

TEST(ManualStageTest, NothingIsKnownBeforeItIsConfirmed) {
  std::istringstream in("\n");
  std::ostringstream out;
  ManualStage stage(in, out, {});
  EXPECT_EQ(error_of([&] { stage.motion_state(StageAxis::kX); }).fault(), Fault::kNotReady);
  EXPECT_EQ(error_of([&] { stage.move_to(StageAxis::kX, Angle::degrees(1.0)); }).fault(), Fault::kNotReady);
  stage.home(StageAxis::kX);
  EXPECT_EQ(error_of([&] { stage.move_to(StageAxis::kX, Angle::degrees(1.0)); }).fault(), Fault::kLinkLost)
      << "the input ends";
  EXPECT_EQ(error_of([&] { stage.motion_state(StageAxis::kX); }).fault(), Fault::kNotReady);
  EXPECT_EQ(error_of([&] { stage.encoder_angle(StageAxis::kX); }).fault(), Fault::kNotReady);
}

TEST(ManualStageTest, ATargetThatIsNoNumberIsNotAskedFor) {
  std::istringstream in("\n\n");
  std::ostringstream out;
  ManualStage stage(in, out, {});
  stage.home(StageAxis::kX);
  EXPECT_EQ(error_of([&] {
              stage.move_to(StageAxis::kX, Angle::degrees(std::numeric_limits<double>::quiet_NaN()));
            }).fault(),
            Fault::kOutOfTravel);
}

TEST(ManualStageTest, HasNoHaltButEndsTheQuestions) {
  std::istringstream in("\n\n\n");
  std::ostringstream out;
  bool woken = false;
  ManualStage stage(in, out, {}, [&] { woken = true; });
  stage.home(StageAxis::kX);
  EXPECT_FALSE(stage.halt());
  EXPECT_TRUE(woken);
  EXPECT_EQ(error_of([&] { stage.move_to(StageAxis::kX, Angle::degrees(1.0)); }).fault(), Fault::kNotReady);
  stage.identify();
  stage.move_to(StageAxis::kX, Angle::degrees(1.0));
}

TEST(ManualStageTest, SettingsThatCannotBeMeantAreRefused) {
  std::istringstream in;
  std::ostringstream out;
  const auto with = [&](const StageSettings& settings) { ManualStage(in, out, settings).identify(); };
  EXPECT_THROW(with({.axis_names = {"", ""}, .speed_deg_per_s = {}, .address = {}}), std::invalid_argument);
  EXPECT_THROW(with({.axis_names = {"1", "2"}, .speed_deg_per_s = {10.0, {}}, .address = {}}),
               std::invalid_argument);
  EXPECT_THROW(with({.axis_names = {"1", "2"}, .speed_deg_per_s = {}, .address = "1"}),
               std::invalid_argument);
  with({.axis_names = {"1", ""}, .speed_deg_per_s = {}, .address = {}});
}

/// Standard input and standard error, replaced for one test.
class Redirected {
 public:
  explicit Redirected(int to) : input_(::dup(STDIN_FILENO)), error_(::dup(STDERR_FILENO)) {
    ::dup2(to, STDIN_FILENO);
    ::dup2(to, STDERR_FILENO);
  }
  ~Redirected() {
    ::dup2(input_, STDIN_FILENO);
    ::dup2(error_, STDERR_FILENO);
    ::close(input_);
    ::close(error_);
  }
  Redirected(const Redirected&) = delete;
  Redirected& operator=(const Redirected&) = delete;

 private:
  int input_;
  int error_;
};

void show(std::string_view text) {
  EXPECT_EQ(::write(STDERR_FILENO, text.data(), text.size()), static_cast<ssize_t>(text.size()));
}

TEST(ManualStageAtTerminalTest, WithoutATerminalItFailsAtOnce) {
  int ends[2];
  ASSERT_EQ(::pipe(ends), 0);
  std::optional<InstrumentError> error;
  {
    const Redirected redirected(ends[1]);
    error.emplace(error_of([] { at_terminal({}, show); }));
  }
  EXPECT_EQ(error->fault(), Fault::kCannotOpen);
  EXPECT_THAT(error->what(), HasSubstr("needs a person at a terminal"));
  ::close(ends[0]);
  ::close(ends[1]);
}

TEST(ManualStageAtTerminalTest, ReadsTheTerminalAndAHaltEndsTheQuestionAtOnce) {
  int person = -1;
  int terminal = -1;
  ASSERT_EQ(::openpty(&person, &terminal, nullptr, nullptr, nullptr), 0);
  std::optional<Angle> angle;
  std::optional<InstrumentError> error;
  {
    const Redirected redirected(terminal);
    const auto stage = at_terminal({}, show);
    ASSERT_EQ(::write(person, "\n12.34\n", 7), 7);
    stage->home(StageAxis::kX);
    stage->move_to(StageAxis::kX, Angle::degrees(12.0));
    angle = stage->encoder_angle(StageAxis::kX);
    auto turning = std::async(std::launch::async, [&] {
      return error_of([&] { stage->move_to(StageAxis::kX, Angle::degrees(13.0)); });
    });
    // The question is on the screen: somebody waits.
    std::string screen;
    while (screen.find("13.0000 deg.") == std::string::npos) {
      char bytes[256];
      const ssize_t count = ::read(person, bytes, sizeof bytes);
      ASSERT_GT(count, 0);
      screen.append(bytes, static_cast<std::size_t>(count));
    }
    EXPECT_FALSE(stage->halt());
    error.emplace(turning.get());
  }
  EXPECT_EQ(angle->deg(), 12.34);
  EXPECT_EQ(error->fault(), Fault::kNotReady);
  ::close(person);
  ::close(terminal);
}

}  // namespace
}  // namespace abcal::manual_stage
