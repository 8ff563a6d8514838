// The queue of items and plans: its order, its storage on the disk, and that nothing begins without a person.

#include "app/console/queue.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <string>
#include <vector>

#include "protocol/record/run_file.h"
#include "tests/console/console_fixture.h"

namespace abcal::console {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using Json = test::PageClient::Json;

RunChoice item(const std::string& serial) {
  RunChoice choice;
  choice.item = ItemChoice{"Example", "TA-3", serial, ""};
  return choice;
}

ItemCheck good(const std::string& reported = "") {
  return {{{Finding::Grade::kGood, Message("identity"), {}, {}}}, reported};
}

class QueueTest : public testing::Test {
 protected:
  static std::vector<std::string> serials(const Queue& queue) {
    std::vector<std::string> serials;
    for (const QueueEntry& entry : queue.entries()) serials.push_back(entry.choice.item->serial_number);
    return serials;
  }
  /// Measures an entry of a queue that goes on.
  static void measure(Queue& queue, std::int64_t number, const std::string& run) {
    queue.checked(number, good());
    EXPECT_EQ(queue.may_start(number), std::nullopt);
    queue.began(number, run);
    EXPECT_TRUE(queue.ended(run, true, {}));
  }

  test::TemporaryFolder folder;
  std::filesystem::path file = folder / ".bench.queue.json";
  Queue queue{file};
};

TEST_F(QueueTest, IsReordered) {
  for (const char* serial : {"a", "b", "c"}) EXPECT_EQ(queue.add(item(serial), 1), std::nullopt);
  EXPECT_EQ(queue.move(3, -2), std::nullopt);
  EXPECT_THAT(serials(queue), ElementsAre("c", "a", "b"));
  EXPECT_EQ(queue.move(3, 99), std::nullopt);
  EXPECT_THAT(serials(queue), ElementsAre("a", "b", "c"));
  EXPECT_EQ(queue.remove(2), std::nullopt);
  EXPECT_THAT(serials(queue), ElementsAre("a", "c"));
  EXPECT_NE(queue.move(2, 1), std::nullopt);
  EXPECT_NE(queue.remove(2), std::nullopt);
}

TEST_F(QueueTest, NothingStartsBeforeItsItemWasChecked) {
  (void)queue.add(item("a"), 1);
  (void)queue.add(item("b"), 1);
  queue.checked(1, good());
  EXPECT_THAT(*queue.may_start(1), HasSubstr("paused"));
  (void)queue.pause(false);
  EXPECT_EQ(queue.may_start(1), std::nullopt);
  EXPECT_THAT(*queue.may_start(2), HasSubstr("not the next"));
  queue.unchecked();
  EXPECT_THAT(*queue.may_start(1), HasSubstr("nobody has checked"));
  queue.checked(1, {{{Finding::Grade::kProblem, Message("mounting"), {}, {}}}, ""});
  EXPECT_THAT(*queue.may_start(1), HasSubstr("found a problem"));
  measure(queue, 1, "a.run");
  EXPECT_EQ(queue.repeats(), nullptr);
  EXPECT_THAT(*queue.may_start(2), HasSubstr("nobody has checked"));  // That check belonged to another item.
}

TEST_F(QueueTest, AnItemThatStaysMountedIsRepeated) {
  (void)queue.add(item("a"), 2);
  (void)queue.add(item("b"), 1);
  (void)queue.pause(false);
  measure(queue, 1, "1.run");
  ASSERT_NE(queue.repeats(), nullptr);
  EXPECT_EQ(queue.repeats()->number, 1);
  queue.began(1, "2.run");
  EXPECT_EQ(queue.repeats(), nullptr);
  (void)queue.ended("2.run", true, {});
  EXPECT_EQ(queue.repeats(), nullptr) << "the next is another item";
  EXPECT_EQ(queue.next()->number, 2);
  EXPECT_EQ(queue.repeat(1), std::nullopt);  // Repeats an entry that is done: a new entry.
  EXPECT_EQ(queue.entries().back().number, 3);
}

TEST_F(QueueTest, PauseAndFailureEndTheRepetition) {
  (void)queue.add(item("a"), 3);
  (void)queue.pause(false);
  measure(queue, 1, "1.run");
  (void)queue.pause(true);
  EXPECT_EQ(queue.repeats(), nullptr);
  (void)queue.pause(false);
  EXPECT_EQ(queue.repeats(), nullptr) << "somebody may have changed the item meanwhile";
  queue.checked(1, good());
  queue.began(1, "2.run");
  EXPECT_TRUE(queue.ended("2.run", false, Message("the stage stalled")));
  EXPECT_TRUE(queue.paused());
  EXPECT_EQ(queue.entries()[0].problem, "the stage stalled");
  EXPECT_FALSE(queue.ended("other.run", true, {}));
  EXPECT_TRUE(queue.ended("2.run", true, {})) << "resumed to its end";
  EXPECT_THAT(queue.entries()[0].made, ElementsAre("1.run", "2.run"));
  EXPECT_EQ(queue.entries()[0].problem, "");
}

TEST_F(QueueTest, OutlivesItsProcessAndIsPausedThen) {
  (void)queue.add(item("<b>a</b>"), 2);
  (void)queue.add(item("b"), 1);
  (void)queue.pause(false);
  queue.checked(1, good("77"));
  queue.began(1, "1.run");
  Queue again(file);
  EXPECT_EQ(again.problem(), "");
  EXPECT_TRUE(again.paused());
  EXPECT_THAT(serials(again), ElementsAre("<b>a</b>", "b"));
  EXPECT_EQ(again.running(), nullptr);
  EXPECT_THAT(again.entries()[0].problem, HasSubstr("1.run, which can be resumed"));
  EXPECT_EQ(again.repeats(), nullptr);
  (void)again.add(item("c"), 1);
  EXPECT_EQ(again.entries().back().number, 3) << "numbers are not used again";
}

TEST_F(QueueTest, AFileThatCannotBeReadIsNotWrittenOver) {
  for (
      const char* text :
      {"", "{", "[]", R"({"schema":"abcal.queue/9","entries":[],"last_number":0})",
       R"({"schema":"abcal.queue/1","entries":[{"number":1}],"last_number":1})",
       R"({"schema":"abcal.queue/1","entries":[{"number":1,"choice":{},"wanted":1,"made":[],"now":"","problem":"","interrupted":""}],"last_number":1})"}) {
    test::write_file(file, text);
    Queue unreadable(file);
    EXPECT_THAT(unreadable.problem(), HasSubstr("cannot be read")) << text;
    EXPECT_NE(unreadable.add(item("a"), 1), std::nullopt);
    EXPECT_NE(unreadable.pause(false), std::nullopt);
    std::ifstream stream(file);
    EXPECT_EQ(std::string(std::istreambuf_iterator<char>(stream), {}), text);
  }
}

TEST_F(QueueTest, HasAnEnd) {
  for (std::size_t n = 0; n < Queue::kMostEntries; ++n) ASSERT_EQ(queue.add(item("a"), 1), std::nullopt);
  EXPECT_THAT(*queue.add(item("a"), 1), HasSubstr("200 entries"));
}

TEST(ItemCheckTest, JudgesIdentity) {
  const ItemBefore before{"SN 1", "111"};
  const auto grade = [&](const std::string& wanted, const std::string& reported, bool simulated = false) {
    return judge_identity(wanted, reported, before, simulated).grade;
  };
  EXPECT_EQ(grade("SN 2", "SN 2"), Finding::Grade::kGood);
  EXPECT_EQ(grade("SN 2", "111"), Finding::Grade::kProblem) << "it has not been changed";
  EXPECT_EQ(grade("SN 1", "111"), Finding::Grade::kProblem) << "the same item again, by another name";
  EXPECT_EQ(grade("SN 2", "222"), Finding::Grade::kProblem);
  EXPECT_EQ(grade("SN 2", ""), Finding::Grade::kLeftOut);
  EXPECT_EQ(grade("SN 2", "111", true), Finding::Grade::kLeftOut);
}

TEST(ItemCheckTest, JudgesMountingByGravity) {
  const auto grade = [](const Eigen::Vector3d& mean, double x_deg, const std::string& mounting) {
    return judge_mounting({Angle::degrees(x_deg), Angle(), mean}, mounting).grade;
  };
  EXPECT_EQ(grade({0.02, -0.03, 1.01}, 0.0, "x y z"), Finding::Grade::kGood);
  EXPECT_EQ(grade({0.1, 0.1, 9.8}, 0.0, "x y z"), Finding::Grade::kGood) << "whatever the unit";
  EXPECT_EQ(grade({0.02, -0.03, -1.01}, 0.0, "x y z"), Finding::Grade::kProblem);
  EXPECT_EQ(grade({1.0, 0.0, 0.0}, 0.0, "x y z"), Finding::Grade::kProblem);
  EXPECT_EQ(grade({1.0, 0.0, 0.0}, 0.0, "z x y"), Finding::Grade::kGood);
  EXPECT_EQ(grade({0.0, 1.0, 0.0}, 90.0, "x y z"), Finding::Grade::kGood);
  EXPECT_EQ(grade({0.0, 0.0, 1.0}, 90.0, "x y z"), Finding::Grade::kProblem);
}

/// The queue at a simulated bench.
class QueueAtBenchTest : public ConsoleTest {
 protected:
  static Json add(const std::string& serial, int runs = 1) {
    return {{"do", "queue_add"}, {"item", {{"serial_number", serial}}}, {"runs", runs}};
  }
  static Json of_entry(const std::string& what, int entry) { return {{"do", what}, {"entry", entry}}; }
  static Json start(int entry) { return {{"do", "queue_start"}, {"entry", entry}, {"confirmed", true}}; }
  /// The queue for which `holds` is true, when the bench is idle again; both are told in any order.
  Json queue_when(test::PageClient& page, const std::function<bool(const Json&)>& holds) {
    Json queue;
    std::string activity;
    page.wait_for(
        [&](const Json& m) {
          if (m["type"] == "queue" && holds(m)) queue = m;
          if (m["type"] == "activity") activity = m["activity"];
          return !queue.is_null() && activity == "idle";
        },
        "the queue");
    return queue;
  }
  void check_item(test::PageClient& page, int entry) {
    ASSERT_TRUE(page.ok(of_entry("queue_mounted", entry)));
    queue_when(page, [](const Json& queue) { return !queue["check"].is_null(); });
  }
};

TEST_F(QueueAtBenchTest, MeasuresOneItemAfterAnotherAndAsksBetweenThem) {
  open();
  auto page = steering_page();
  ASSERT_TRUE(page->ok(add("SN 1", 2)));
  ASSERT_TRUE(page->ok(add("SN 2")));
  EXPECT_FALSE(page->ok(of_entry("queue_mounted", 1))) << "paused";
  ASSERT_TRUE(page->ok({{"do", "queue_pause"}, {"go_on", true}}));
  EXPECT_FALSE(page->ok(start(1))) << "not checked";
  check_item(*page, 1);
  ASSERT_TRUE(page->ok(start(1)));
  EXPECT_FALSE(page->ok(start(1))) << "a double click";
  // The second run of the item that stays mounted begins by itself; then the queue waits.
  const Json done =
      queue_when(*page, [](const Json& queue) { return queue["entries"][0]["made"].size() == 2; });
  EXPECT_EQ(done["next"], 2);
  EXPECT_EQ(run_files(), 2U);
  EXPECT_FALSE(page->ok(start(2))) << "the check was of the other item";
  check_item(*page, 2);
  ASSERT_TRUE(page->ok({{"do", "jog"}, {"axis", "x"}, {"by_deg", 1}, {"confirmed", true}}));
  page->wait_for_activity("idle");
  EXPECT_FALSE(page->ok(start(2))) << "something else was done since";
  check_item(*page, 2);
  ASSERT_TRUE(page->ok(start(2)));
  queue_when(*page, [](const Json& queue) { return queue["next"].is_null(); });
  EXPECT_EQ(run_files(), 3U);
  std::vector<std::string> serials;
  for (const auto& entry : std::filesystem::directory_iterator(runs()))
    if (entry.path().extension() == ".run")
      serials.push_back(RunFile::load(entry.path()).header.labels.at("item.serial_number"));
  EXPECT_THAT(serials, testing::UnorderedElementsAre("SN 1", "SN 1", "SN 2"));
}

TEST_F(QueueAtBenchTest, OutlivesTheServerAndIsPausedThen) {
  open();
  {
    auto page = steering_page();
    ASSERT_TRUE(page->ok(add("SN 1")));
    ASSERT_TRUE(page->ok({{"do", "queue_pause"}, {"go_on", true}}));
    check_item(*page, 1);
  }
  close();
  // The process that held the bench has reported its end, and has ended when its socket is gone.
  ASSERT_TRUE(
      test::wait_for([&] { return !std::filesystem::exists(runs() / ".bench.bench"); }, test::kPatience));
  open();
  test::PageClient page(port);
  const Json snapshot = page.wait_for_type("snapshot");
  EXPECT_EQ(snapshot["queue"]["paused"], true);
  EXPECT_EQ(snapshot["queue"]["next"], 1);
  EXPECT_TRUE(snapshot["queue"]["check"].is_null());
  EXPECT_FALSE(page.ok(add("SN 9"))) << "who watches changes nothing";
  EXPECT_EQ(run_files(), 0U);
}

TEST_F(QueueAtBenchTest, LevelsAndAsksThePorts) {
  open();
  auto page = steering_page();
  EXPECT_FALSE(page->ok({{"do", "level"}})) << "it moves";
  ASSERT_TRUE(page->ok({{"do", "level"}, {"confirmed", true}}));
  const Json levelled = page->wait_for_type("levelling");
  EXPECT_THAT(levelled["words"].get<std::string>(), HasSubstr("tilt of the Z axis"));
  page->wait_for_activity("idle");
  const std::filesystem::path file = runs() / levelled["file"].get<std::string>();
  EXPECT_TRUE(std::filesystem::exists(file)) << file;
  // The command must evaluate these readings equally.
  std::filesystem::path run = file;
  run.replace_extension(".run");
  const auto command =
      test::run_program({"level", "--from", run.string(), "-o", "same.json", "--json"}, folder.path());
  ASSERT_EQ(command.exit_code, 0) << command.err;
  Json printed = Json::parse(command.out), here = levelled["levelling"];
  EXPECT_EQ(printed, here);
  ASSERT_TRUE(page->ok({{"do", "probe"}}));
  EXPECT_TRUE(page->wait_for_type("ports")["ports"].is_array());
}

}  // namespace
}  // namespace abcal::console
