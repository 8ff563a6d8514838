#include "app/measure/session/disk_space.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>

#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

DiskNeed usual_need() {
  DiskNeed need;
  need.angles = 219;
  need.readings_per_angle = 1000;
  need.duration_s = 3600.0;
  need.rate_hz = 100.0;
  return need;
}

TEST(DiskSpaceTest, AUsualRunNeedsSomeTenMegabytesAndARecordingMore) {
  const std::uintmax_t plain = estimated_run_bytes(usual_need());
  EXPECT_GT(plain, 219U * 1000U * 50U);
  EXPECT_LT(plain, 40'000'000U);
  DiskNeed recorded = usual_need();
  recorded.with_recording = true;
  EXPECT_GT(estimated_run_bytes(recorded), plain + 3600U * 100U * 100U);
}

TEST(DiskSpaceTest, RefusesWhatDoesNotFitWithFoundAndRequired) {
  try {
    (void)check_disk_space("a.run", usual_need(), 1'000'000U);
    FAIL() << "1 MB is not enough";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("a.run: 1.0 MB are free"), HasSubstr("required: about 2"),
                      HasSubstr("219 angles of 1000 readings"), HasSubstr("choose another disk with -o")));
  }
}

TEST(DiskSpaceTest, WarnsWhereItIsNarrowAndIsSilentWhereItIsAmpleOrNotKnown) {
  const std::uintmax_t required = estimated_run_bytes(usual_need());
  EXPECT_THROW((void)check_disk_space("a.run", usual_need(), required - 1), std::runtime_error);
  const auto warning = check_disk_space("a.run", usual_need(), required);
  ASSERT_TRUE(warning);
  EXPECT_THAT(*warning, AllOf(HasSubstr("are free"), HasSubstr("required")));
  EXPECT_TRUE(check_disk_space("a.run", usual_need(), 3 * required - 1));
  EXPECT_FALSE(check_disk_space("a.run", usual_need(), 3 * required));
  EXPECT_FALSE(check_disk_space("a.run", usual_need(), std::nullopt));
}

TEST(DiskSpaceTest, TheFreeSpaceIsThatOfTheFolder) {
  const test::TemporaryFolder folder;
  const auto found = free_disk_space(folder / "a.run");
  ASSERT_TRUE(found);
  EXPECT_GT(*found, 0U);
  EXPECT_TRUE(free_disk_space("a.run"));
  EXPECT_FALSE(free_disk_space(folder / "no such folder" / "a.run"));
}

}  // namespace
}  // namespace abcal
