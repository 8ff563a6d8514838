// Where no guard answers, the log of the guards says what is known of the axes.

#include "app/console/guard_watch.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <functional>
#include <mutex>
#include <string>

#include "app/measure/guard/guard_log.h"
#include "tests/support/temporary_folder.h"

namespace abcal::console {
namespace {

using namespace std::chrono_literals;

class GuardWatchTest : public testing::Test {
 protected:
  GuardWatchTest() { ::setenv("XDG_STATE_HOME", folder.path().c_str(), 1); }

  /// An entry of a guard that has ended.
  void log(std::string_view what) {
    GuardLog log;
    log.open(motion_log());
    log.add(what, std::chrono::system_clock::now(),
            {{"owner", "a jog on bench 1"}, {"axes", nlohmann::json::array({"X"})}});
  }
  bool is_told(const std::function<bool(const GuardWatch::Known&)>& expected) {
    std::unique_lock lock(mutex_);
    return told_.wait_for(lock, 20s, [&] { return expected(known_); });
  }
  void tell(const GuardWatch::Known& known) {
    {
      const std::lock_guard lock(mutex_);
      known_ = known;
    }
    told_.notify_all();
  }

  test::TemporaryFolder folder;

 private:
  std::mutex mutex_;
  std::condition_variable told_;
  GuardWatch::Known known_;
};

TEST_F(GuardWatchTest, NoAnswerOfAGuardIsNotTakenForRest) {
  log(GuardLog::kMoves);
  const GuardWatch watch(
      folder / "bench.lock", [] { return std::string("on bench 1"); },
      [this](const GuardWatch::Known& known) { tell(known); });
  EXPECT_TRUE(is_told([](const auto& known) {
    return !known.message.is_null() && known.message["axes"]["x"]["state"] == axis_state::kUnknown &&
           !known.is_at_rest && !known.has_guard;
  }));
  log(GuardLog::kAtRest);
  EXPECT_TRUE(is_told([](const auto& known) {
    return known.is_at_rest && known.message["axes"]["x"]["state"] == axis_state::kAtRest;
  }));
}

}  // namespace
}  // namespace abcal::console
