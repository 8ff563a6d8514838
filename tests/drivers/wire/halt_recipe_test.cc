#include "drivers/wire/halt_recipe.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "tests/drivers/endless_stream.h"
#include "tests/drivers/wire/steady_clock.h"
#include "tests/support/fake_clock.h"
#include "tests/support/scripted_line.h"

namespace abcal::wire {
namespace {

using namespace std::chrono_literals;
using namespace std::string_literals;

constexpr std::chrono::seconds kHaltTime{20};

/// The recipe for a controller that says "id N" and, asked whether it stands, "1" or "0".
HaltRecipe recipe_of_lines(const std::string& reply_end = {}) {
  return {.driver = "test",
          .axes = {true, true},
          .end_partial = "!\r",
          .stop = "ST\r",
          .questions =
              {{.bytes = "ID?\r", .reply = {pattern::literal("id "), pattern::number(0, 9)}, .standing = {}},
               {.bytes = "MD?\r", .reply = {pattern::run("01", 1, 1)}, .standing = {pattern::literal("1")}}},
          .reply_end = reply_end};
}

/// The recipe for a controller that says A5, a byte that is 0 if it stands, and 5A.
HaltRecipe binary_recipe() {
  const ReplyPart begin = pattern::literal("\xa5"s), end = pattern::literal("\x5a"s);
  return {.driver = "test",
          .axes = {true, true},
          .end_partial = {},
          .stop = "ST\r",
          .questions = {{.bytes = "MD?\r",
                         .reply = {begin, pattern::any_bytes(1), end},
                         .standing = {begin, pattern::literal("\0"s), end}}},
          .binary = true};
}

class HaltRecipeTest : public testing::Test {
 protected:
  bool carried_out(const HaltRecipe& recipe, Clock::Duration time = kHaltTime) {
    return carry_out(recipe, line_, clock_, clock_.now() + time);
  }
  std::string answer(const std::string& command) {
    if (command == "ST") return "";
    if (command == "ID?") return "id 7" + end_;
    if (command == "MD?") return (moving_polls_-- > 0 ? "0" : "1") + end_;
    return "E" + end_;
  }

  int moving_polls_ = 0;
  std::string end_ = "\r\n";
  test::FakeClock clock_;
  test::ScriptedLine line_{clock_, '\r', [this](const std::string& command) { return answer(command); }};
};

TEST_F(HaltRecipeTest, StopsUntilTheControllerSaysThatItStands) {
  moving_polls_ = 3;
  const Clock::Instant begin = clock_.now();
  EXPECT_TRUE(carried_out(recipe_of_lines()));
  EXPECT_EQ(clock_.now() - begin, 3 * 20ms + 8 * test::kReplyTime) << "between the rounds";
  EXPECT_EQ(line_.count("ST"), 5U) << "one at once, and one in each of four rounds";
  EXPECT_EQ(line_.commands().front(), "!");
}

TEST_F(HaltRecipeTest, RepliesComeInPiecesOfAnySize) {
  line_.byte_by_byte = true;
  EXPECT_TRUE(carried_out(recipe_of_lines()));
  end_ = ",EndOfAPI";
  EXPECT_TRUE(carried_out(recipe_of_lines(",EndOfAPI")));
}

TEST_F(HaltRecipeTest, SilenceIsNoAcknowledgement) {
  line_.silent = true;
  const Clock::Instant begin = clock_.now();
  EXPECT_FALSE(carried_out(recipe_of_lines()));
  EXPECT_EQ(clock_.now() - begin, kHaltTime);
  EXPECT_GE(line_.count("ST"), 18U) << "again after each second";
}

TEST_F(HaltRecipeTest, AReplyIsWaitedForASecond) {
  line_.mishaps["ID?"] = {{.instead = ""}};
  const Clock::Instant begin = clock_.now();
  EXPECT_TRUE(carried_out(recipe_of_lines()));
  EXPECT_EQ(clock_.now() - begin, 1s + 20ms + 2 * test::kReplyTime);
  EXPECT_EQ(line_.count("ID?"), 2U);
}

TEST_F(HaltRecipeTest, WithoutAQuestionNothingIsAcknowledged) {
  HaltRecipe recipe = recipe_of_lines();
  recipe.questions.clear();
  EXPECT_FALSE(carried_out(recipe, 1s));
}

TEST_F(HaltRecipeTest, EachOfSeveralDevicesMustSayThatItStands) {
  HaltRecipe recipe = recipe_of_lines();
  recipe.questions.back().listen = 100ms;
  line_.mishaps["MD?"] = {
      {.instead = "1\r\n0\r\n1\r\n"}, {.instead = "1\r\n1\r\n0\r\n"}, {.instead = "1\r\n1\r\n"}};
  const Clock::Instant begin = clock_.now();
  EXPECT_TRUE(carried_out(recipe));
  EXPECT_EQ(line_.count("MD?"), 3U);
  EXPECT_EQ(clock_.now() - begin, 20ms + 20ms + 100ms + 6 * test::kReplyTime)
      << "two rounds at once, and nobody else in the third";
}

TEST_F(HaltRecipeTest, ALineWithoutAnEndIsPassedOver) {
  for (const std::size_t length : {257U, 300U, 40'000U, 1'000'000U}) {
    for (const std::string& end : {""s, ",EndOfAPI"s}) {
      SCOPED_TRACE(length);
      end_ = end.empty() ? "\r\n" : end;
      // The reply that ends the line belongs to it; the next one is the first that counts.
      line_.mishaps["ID?"] = {{.before = std::string(length, 'x')}};
      const std::size_t asked = line_.count("ID?");
      EXPECT_TRUE(carried_out(recipe_of_lines(end)));
      EXPECT_EQ(line_.count("ID?"), asked + 2);
      // The reply comes at once after the end of the line.
      line_.mishaps["MD?"] = {{.before = std::string(length, '1') + end_}};
      const std::size_t stops = line_.count("ST");
      EXPECT_TRUE(carried_out(recipe_of_lines(end)));
      EXPECT_EQ(line_.count("ST"), stops + 2) << "in the first round";
    }
  }
}

TEST_F(HaltRecipeTest, TheEndOfALongLineIsNoReply) {
  // The last bytes of the line look like a reply: none of them is taken for one, however long the line is.
  for (std::size_t length = 250; length < 1100; ++length) {
    for (const std::string& end : {""s, ",EndOfAPI"s}) {
      end_ = end.empty() ? "\r" : end;
      line_.mishaps["MD?"] = {{.instead = std::string(length, 'x') + "1" + end_}};
      const std::size_t asked = line_.count("MD?");
      ASSERT_TRUE(carried_out(recipe_of_lines(end)));
      ASSERT_EQ(line_.count("MD?"), asked + 2) << length;
    }
  }
}

TEST_F(HaltRecipeTest, TheLongestReplyCounts) {
  HaltRecipe recipe = recipe_of_lines();
  recipe.questions = {{.bytes = "MD?\r", .reply = {pattern::run("x1")}, .standing = {}}};
  for (const std::string& end : {""s, ",EndOfAPI"s}) {
    end_ = end.empty() ? "\n" : end;
    recipe.reply_end = end;
    for (const std::size_t length : {255U, 256U, 257U}) {
      const std::size_t asked = line_.count("MD?");
      line_.mishaps["MD?"] = {{.instead = std::string(length, 'x') + end_}};
      EXPECT_TRUE(carried_out(recipe));
      EXPECT_EQ(line_.count("MD?"), asked + (length <= 256 ? 1 : 2)) << length;
    }
  }
}

TEST_F(HaltRecipeTest, APartOfATerminatorIsNone) {
  end_ = ",EndOfAPI";
  line_.mishaps["MD?"] = {
      {.instead = "1,EndOfAP,EndOfAPI"}, {.instead = "1,,EndOfAPI"}, {.instead = "1,EndOfAPI"}};
  EXPECT_TRUE(carried_out(recipe_of_lines(end_)));
  EXPECT_EQ(line_.count("MD?"), 3U);
}

TEST_F(HaltRecipeTest, OfABinaryStreamTheNewest256BytesCount) {
  const HaltRecipe recipe = binary_recipe();
  const std::string standing = "\xa5\0\x5a"s, moving = "\xa5\x01\x5a"s;
  for (const bool byte_by_byte : {false, true}) {
    line_.byte_by_byte = byte_by_byte;
    line_.mishaps["MD?"] = {{.instead = moving}, {.instead = std::string(4'000, 'x') + standing}};
    const std::size_t asked = line_.count("MD?");
    EXPECT_TRUE(carried_out(recipe));
    EXPECT_EQ(line_.count("MD?"), asked + 2);
  }
  line_.byte_by_byte = false;
  line_.mishaps["MD?"] = {{.instead = standing + std::string(253, 'x')}};
  EXPECT_TRUE(carried_out(recipe, 1s));
  line_.mishaps["MD?"] = {{.instead = standing + std::string(254, 'x')}};
  EXPECT_FALSE(carried_out(recipe, 1s)) << "it has been pushed out";
}

/// Streams that never pause: at each read there is more, also after the deadline.
TEST(HaltRecipeBabbleTest, ANeverPausingStreamEndsAtTheDeadline) {
  const std::vector<std::string> pieces{"x",
                                        "0",
                                        "x\r\n",
                                        "0\r\n",
                                        "\r\n",
                                        "1,EndOfAP",
                                        "x,EndOfAPI",
                                        std::string(64, 'x'),
                                        std::string(64, '\0'),
                                        std::string(300, 'x') + "\r\n",
                                        std::string(512, '\n'),
                                        "\xa5\x01\x5a"s};
  for (HaltRecipe recipe : {recipe_of_lines(), recipe_of_lines(",EndOfAPI"), binary_recipe()}) {
    for (const Clock::Duration listen : {0ms, 100ms}) {
      recipe.questions.back().listen = std::chrono::duration_cast<std::chrono::milliseconds>(listen);
      for (const std::string& piece : pieces) {
        SCOPED_TRACE(piece.substr(0, 8));
        test::FakeClock clock;
        test::EndlessStream stream(clock, piece);
        const Clock::Instant deadline = clock.now() + kHaltTime;
        EXPECT_FALSE(carry_out(recipe, stream, clock, deadline));
        EXPECT_GE(clock.now(), deadline);
        EXPECT_LE(clock.now(), deadline + 2ms) << "a read takes 1 ms";
      }
    }
  }
}

TEST(HaltRecipeBabbleTest, AMegabyteInSmallPiecesEndsAtTheDeadline) {
  test::FakeClock clock;
  test::EndlessStream stream(clock, "nothing that answers a question, and no end of a line ");
  const Clock::Instant deadline = clock.now() + kHaltTime;
  EXPECT_FALSE(carry_out(recipe_of_lines(), stream, clock, deadline));
  EXPECT_LE(clock.now(), deadline + 2ms);
  EXPECT_GE(stream.given(), 1'000'000U);
}

TEST(HaltRecipeBabbleTest, ADeviceThatStandsAndNeverPausesHasSaidSo) {
  HaltRecipe recipe = recipe_of_lines();
  recipe.questions.erase(recipe.questions.begin());
  recipe.questions.back().listen = 100ms;
  test::FakeClock clock;
  test::EndlessStream stream(clock, "1\r\n");
  const Clock::Instant deadline = clock.now() + 2s;
  EXPECT_TRUE(carry_out(recipe, stream, clock, deadline));
  EXPECT_LE(clock.now(), deadline + 2ms);
}

TEST(HaltRecipeBabbleTest, ADescriptorThatIsAlwaysReadableHoldsNobody) {
  test::SteadyClock clock;
  const int zeros = ::open("/dev/zero", O_RDWR | O_CLOEXEC);
  ASSERT_GE(zeros, 0);
  DescriptorStream stream(zeros, "zeros", clock);
  for (const HaltRecipe& recipe : {recipe_of_lines(), binary_recipe()}) {
    const Clock::Instant begin = clock.now();
    EXPECT_FALSE(carry_out(recipe, stream, clock, begin + 300ms));
    EXPECT_LT(clock.now() - begin, 10s) << "long enough for a busy machine";
  }
  ::close(zeros);
}

}  // namespace
}  // namespace abcal::wire
