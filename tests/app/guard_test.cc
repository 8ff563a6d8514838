// The guard's packets and its log; its work on a stage is tested in tests/survival/hang.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <string>

#include "app/operate/bench/guard_log.h"
#include "app/operate/bench/guard_packets.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::HasSubstr;

const Clock::UtcTime kNoon{std::chrono::sys_days{std::chrono::year{2026} / 3 / 1} + 12h};

class GuardLogTest : public testing::Test {
 protected:
  /// Entries of one guard, written when this object ends.
  struct Session {
    Session(const std::filesystem::path& file, std::string owner) : owner_(std::move(owner)) {
      log_.open(file);
      add(GuardLog::kBegan);
    }
    void add(std::string_view what, const std::string& text = {}) {
      log_.add(what, kNoon, {{"owner", owner_}, {"text", text}});
    }
    std::string owner_;
    GuardLog log_;
  };

  test::TemporaryFolder folder;
  std::filesystem::path file = folder / "state/motion.log";
};

TEST_F(GuardLogTest, TellsHowTheLatestSessionOfABenchEnded) {
  {
    Session run(file, "a run by A. B. on the bench \"left\"");
    run.add(GuardLog::kDied, "it has died");
    run.add(GuardLog::kHalted, "stage: axis X: halted");
  }
  const std::string words = last_incident(file, "on the bench \"left\"").value_or("");
  EXPECT_THAT(words, AllOf(HasSubstr("a run by A. B."), HasSubstr("2026-03-01T12:00:00"),
                           HasSubstr("it has died"), HasSubstr("axis X: halted")));
  EXPECT_FALSE(last_incident(file, "on the bench \"right\"")) << "another bench";
}

TEST_F(GuardLogTest, ASessionThatEndedInOrderIsNoIncident) {
  { Session(file, "bench 1").add(GuardLog::kDied, "it has died"); }
  EXPECT_TRUE(last_incident(file, "bench 1"));
  { Session(file, "bench 1").add(GuardLog::kEnded); }
  EXPECT_FALSE(last_incident(file, "bench 1"));
}

TEST_F(GuardLogTest, AnAxisThatMovedWhenProgramAndGuardEndedTogetherIsNamed) {
  const auto move = [&](std::string_view what, const char* axis) {
    Session run(file, "bench 1");
    run.log_.add(GuardLog::kMoves, kNoon, {{"axis", "Z"}});
    run.log_.add(what, kNoon, {{"axis", axis}});
  };
  move(GuardLog::kAtRest, "X");
  EXPECT_THAT(last_incident(file, "bench 1").value_or(""),
              AllOf(HasSubstr("bench 1 did not end in order"),
                    HasSubstr("axis Z was moving since 2026-03-01T12:00:00")));
  move(GuardLog::kAtRest, "Z");
  EXPECT_FALSE(last_incident(file, "bench 1")) << "it was at rest";
}

TEST_F(GuardLogTest, ALineThatWasCutOffIsPassedOver) {
  { Session(file, "bench 1").add(GuardLog::kHalted, "axis X: halted"); }
  test::write_file(file, test::read_file(file) + "{\"what\":\"en");
  EXPECT_THAT(last_incident(file, "bench 1").value_or(""), HasSubstr("axis X: halted"));
}

TEST_F(GuardLogTest, WithoutALogThereIsNoIncident) {
  EXPECT_FALSE(last_incident(folder / "none.log", ""));
}

TEST(GuardPackets, ARecipeComesThroughAsItIs) {
  HaltRecipe recipe;
  recipe.driver = "example";
  recipe.axes = {true, false};
  recipe.end_partial = std::string("\0\xff", 2);
  recipe.stop = "ST\n";
  recipe.reply_time = 6s;
  recipe.reply_end = ",EndOfAPI";
  recipe.binary = true;
  std::array<int, 2> ends{};
  ASSERT_EQ(::socketpair(AF_UNIX, SOCK_SEQPACKET, 0, ends.data()), 0);
  ASSERT_TRUE(send_guard_packet(ends[0], to_json(recipe), {ends[0]}));
  const auto packet = receive_guard_packet(ends[1]);
  ASSERT_TRUE(packet);
  EXPECT_EQ(halt_recipe_from(packet->json), recipe);
  ASSERT_EQ(packet->descriptors.size(), 1U);
  ::close(packet->descriptors[0]);
  ::close(ends[0]);
  EXPECT_FALSE(receive_guard_packet(ends[1])) << "the end of the connection";
  ::close(ends[1]);
}

TEST(GuardPackets, AFullQueueIsReportedAndNeverWaitedFor) {
  std::array<int, 2> ends{};
  ASSERT_EQ(::socketpair(AF_UNIX, SOCK_SEQPACKET, 0, ends.data()), 0);
  int sent = 0;
  while (send_guard_packet(ends[0], to_json(OwnerBeat{{true, false}, false, "bytes from the stage"})) &&
         sent < 100'000)
    ++sent;
  EXPECT_LT(sent, 100'000);
  ::close(ends[0]);
  ::close(ends[1]);
}

}  // namespace
}  // namespace abcal
