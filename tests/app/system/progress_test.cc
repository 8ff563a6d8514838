#include "app/system/progress.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/fake_clock.h"

namespace abcal {
namespace {

using test::FakeClock;
using testing::AllOf;
using testing::HasSubstr;
using testing::internal::CaptureStderr;
using testing::internal::GetCapturedStderr;

// Standard error of these tests is a file: progress is a line each 30 s.

TEST(ProgressBarTest, AFileGetsALineEach30SecondsWithTheTimeThatIsLeft) {
  FakeClock clock;
  CaptureStderr();
  ProgressBar bar("Predicting", clock);
  for (int second = 0; second <= 60; ++second) {
    bar.show(second, 120.0);
    clock.advance(std::chrono::seconds(1));
  }
  EXPECT_EQ(GetCapturedStderr(), "Predicting: 25 %, 1 min 30 s left\nPredicting: 50 %, 1 min 00 s left\n");
}

TEST(UsualDurationBarTest, GoesByTheTimeAndStopsShortOfItsEnd) {
  FakeClock clock;
  CaptureStderr();
  UsualDurationBar bar("Printing", 60.0, clock);
  for (int second = 0; second <= 90; ++second) {
    bar.show();
    clock.advance(std::chrono::seconds(1));
  }
  EXPECT_THAT(GetCapturedStderr(),
              AllOf(HasSubstr("Printing: 50 %, 30 s left\n"), HasSubstr("Printing: 97 %, ")));
}

TEST(UsualDurationBarTest, AShortJobHasNone) {
  FakeClock clock;
  CaptureStderr();
  UsualDurationBar bar("Printing", 0.9, clock);
  for (int second = 0; second <= 90; ++second) {
    bar.show();
    clock.advance(std::chrono::seconds(1));
  }
  EXPECT_EQ(GetCapturedStderr(), "");
}

}  // namespace
}  // namespace abcal
