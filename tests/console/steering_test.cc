// Actions of the console at a simulated bench equal those of the commands.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "app/console/interrupted_run.h"
#include "app/console/other_benches.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/result_json.h"
#include "protocol/record/run_file.h"
#include "tests/console/console_fixture.h"
#include "tests/console/tray_bench.h"

namespace abcal::console {
namespace {

using testing::HasSubstr;
using Json = test::PageClient::Json;

const Json kStart = {{"do", "start"}, {"confirmed", true}};

class SteeringTest : public ConsoleTest {
 protected:
  /// A plan of 12 angles each and closing angles.
  static constexpr std::size_t kPlanned = 39;

  std::string wait_for_end(test::PageClient& page) {
    const Json ended = page.wait_for_type("finished");
    EXPECT_TRUE(ended["complete"].get<bool>()) << ended;
    page.wait_for_activity("idle");
    return ended["file"];
  }
  std::vector<std::string> event_kinds(const std::string& run) {
    std::vector<std::string> kinds;
    for (const RunEvent& event : RunFile::load(runs() / run).events) kinds.push_back(event.kind);
    return kinds;
  }
};

TEST_F(SteeringTest, ARunIsTheSameAsThatOfTheCommandLine) {
  open();
  auto page = steering_page();
  ASSERT_TRUE(page->ok(kStart));
  std::set<std::size_t> seen;
  std::string file;
  page->wait_for(
      [&](const Json& message) {
        if (message["type"] == "dwell_done") seen.insert(message["position"].get<std::size_t>());
        if (message["type"] == "finished") file = message["file"];
        return message["type"] == "finished";
      },
      "the end of the run");
  EXPECT_EQ(seen.size(), kPlanned);
  const StoredRun watched = RunFile::load(runs() / file);
  EXPECT_EQ(watched.state, RunState::kComplete);

  const test::ProgramResult command =
      test::run_program({"run", "bench.toml", "-o", "alone.run", "--json"}, folder.path());
  ASSERT_EQ(command.exit_code, 0) << command.err;
  const StoredRun alone = RunFile::load(folder / "alone.run");
  ASSERT_EQ(watched.record.dwells.size(), alone.record.dwells.size());
  for (std::size_t i = 0; i < alone.record.dwells.size(); ++i) {
    EXPECT_EQ(watched.record.dwells[i].mean, alone.record.dwells[i].mean) << i;  // Bit for bit.
    EXPECT_EQ(watched.record.dwells[i].time_s, alone.record.dwells[i].time_s) << i;
  }

  // The page shows the same results as the commands.
  const test::Answer answer = test::http_get(port, "/runs/" + file + "/result");
  ASSERT_EQ(answer.status, 200U);
  const Json shown = Json::parse(answer.body);
  ASSERT_EQ(shown["results"].size(), 3U);
  for (const Json& result : shown["results"]) {
    const std::string estimator = result["estimator"];
    const test::ProgramResult analysed =
        test::run_program({"analyse", "runs/" + file, "--estimator", estimator, "--json"}, folder.path());
    Json printed = Json::parse(analysed.out), here = result;
    printed.erase("source");  // A path, which depends on the current folder.
    here.erase("source");
    EXPECT_EQ(here, printed) << estimator;
  }
}

TEST_F(SteeringTest, HoldsAfterAnAngleAndGoesOn) {
  pace = 20.0;
  open();
  auto page = steering_page();
  ASSERT_TRUE(page->ok(kStart));
  EXPECT_FALSE(page->ok({{"do", "continue"}, {"confirmed", true}}));
  page->wait_for_type("dwell_done");
  ASSERT_TRUE(page->ok({{"do", "hold"}}));
  page->wait_for([](const Json& m) { return m["type"] == "phase" && m["phase"] == "held"; }, "the hold");
  ASSERT_TRUE(page->ok({{"do", "note"}, {"text", "door opened; 23 °C"}}));
  page->wait_for(
      [](const Json& m) {
        return m.contains("line") &&
               m["line"]["text"].get<std::string>().find("door opened") != std::string::npos;
      },
      "the note");
  // Held: no angle is measured.
  const auto a_while = std::chrono::steady_clock::now() + std::chrono::milliseconds(300);
  while (const auto message = page->next(a_while)) EXPECT_NE((*message)["type"], "dwell_done");
  test::PageClient late(port);
  EXPECT_EQ(late.wait_for_type("snapshot")["phase"]["phase"], "held");
  ASSERT_TRUE(page->ok({{"do", "continue"}, {"confirmed", true}}));
  const std::string file = wait_for_end(*page);
  const std::vector<std::string> kinds = event_kinds(file);
  for (const char* kind : {"held", "note", "continued", "complete"})
    EXPECT_THAT(kinds, testing::Contains(kind));
  const StoredRun run = RunFile::load(runs() / file);
  EXPECT_EQ(run.measured.size(), kPlanned);
  const auto note =
      std::find_if(run.events.begin(), run.events.end(), [](const RunEvent& e) { return e.kind == "note"; });
  ASSERT_NE(note, run.events.end());
  EXPECT_THAT(note->text, HasSubstr("door opened; 23 °C (page"));
}

TEST_F(SteeringTest, StopsAtOnceAndResumes) {
  pace = 20.0;
  open();
  auto page = steering_page();
  ASSERT_TRUE(page->ok(kStart));
  for (int i = 0; i < 3; ++i) page->wait_for_type("dwell_done");
  const auto asked = std::chrono::steady_clock::now();
  ASSERT_TRUE(page->ok({{"do", "stop"}}));
  const Json ended = page->wait_for_type("finished");
  EXPECT_LT(std::chrono::steady_clock::now() - asked, std::chrono::seconds(1));
  EXPECT_FALSE(ended["complete"].get<bool>());
  EXPECT_THAT(ended["reason"].get<std::string>(), HasSubstr("the stage is halted"));
  page->wait_for_activity("idle");
  const std::string file = ended["file"];
  const std::size_t kept = RunFile::load(runs() / file).measured.size();
  EXPECT_GE(kept, 3U);
  EXPECT_LT(kept, kPlanned);

  const Json list = Json::parse(test::http_get(port, "/runs").body);
  ASSERT_EQ(list.size(), 1U);
  EXPECT_EQ(list[0]["state"], "interrupted");
  EXPECT_EQ(list[0]["measured"], kept);
  // The person who asked for it is stored after the reason.
  const std::optional<InterruptedRun> found = find_interrupted_run(runs());
  ASSERT_TRUE(found);
  EXPECT_EQ(found->words, ended["reason"].get<std::string>());
  // A person takes note of it; the run says who, and a new interruption is a new one to take note of.
  EXPECT_EQ(found->acknowledged_by, "");
  ASSERT_TRUE(page->ok({{"do", "acknowledge"}, {"run", file}}));
  EXPECT_THAT(find_interrupted_run(runs())->acknowledged_by, HasSubstr("page "));
  const Json told = page->wait_for_type("acknowledged");
  EXPECT_EQ(told["interrupted"]["acknowledged_by"], find_interrupted_run(runs())->acknowledged_by);
  EXPECT_FALSE(page->ok({{"do", "acknowledge"}, {"run", "another.run"}}));
  ASSERT_TRUE(page->ok({{"do", "resume"}, {"run", file}, {"confirmed", true}}));
  const Json began =
      page->wait_for([](const Json& m) { return m["type"] == "snapshot"; }, "the run's beginning");
  EXPECT_EQ(began["run"]["measured"].size(), kept);
  EXPECT_EQ(wait_for_end(*page), file);
  EXPECT_EQ(RunFile::load(runs() / file).record.continuations, 1);
  // Closed now.
  ASSERT_TRUE(page->ok({{"do", "resume"}, {"run", file}, {"confirmed", true}}));
  const Json line = page->wait_for(
      [](const Json& m) { return m["type"] == "log" && m["line"]["grade"] == "problem"; }, "why not");
  EXPECT_THAT(line["line"]["text"].get<std::string>(), HasSubstr(file));
}

TEST_F(SteeringTest, ThoseWhoReadTheListOfRunsDoNotKeepARunFromBeingClosed) {
  open();
  auto page = steering_page();
  std::atomic<bool> over = false;
  std::vector<std::jthread> readers;
  for (int i = 0; i < 4; ++i)
    readers.emplace_back([&] {
      while (!over) EXPECT_EQ(test::http_get(port, "/runs").status, 200U);
    });
  EXPECT_TRUE(page->ok(kStart));
  wait_for_end(*page);
  over = true;
}

TEST_F(SteeringTest, ARunWhoseProgramEndedAfterTheLastAngleIsClosedAndAnalysed) {
  open();
  auto page = steering_page();
  ASSERT_TRUE(page->ok(kStart));
  const std::string file = wait_for_end(*page);
  const auto closed = [&] {
    return (std::filesystem::status(runs() / file).permissions() & std::filesystem::perms::owner_write) ==
           std::filesystem::perms::none;
  };
  const auto analysed = [&] {
    return Json::parse(test::http_get(port, "/runs").body)[0]["analysed"].get<bool>();
  };
  EXPECT_TRUE(closed());
  EXPECT_TRUE(analysed());
  // State after a kill: complete, but neither closed nor analysed.
  std::filesystem::remove(ResultsFile::path_beside(runs() / file));
  std::filesystem::permissions(runs() / file, std::filesystem::perms::owner_write,
                               std::filesystem::perm_options::add);
  EXPECT_FALSE(analysed());
  ASSERT_TRUE(page->ok({{"do", "resume"}, {"run", file}, {"confirmed", true}}));
  bool moved = false;
  const Json line = page->wait_for(
      [&](const Json& m) {
        moved = moved || m["type"] == "stage" || m["type"] == "phase";
        return m.contains("line");
      },
      "what was done");
  EXPECT_THAT(line["line"]["text"].get<std::string>(), HasSubstr("closed and analysed now: "));
  page->wait_for_activity("idle");
  EXPECT_FALSE(moved);
  EXPECT_TRUE(closed());
  EXPECT_TRUE(analysed());
}

TEST_F(SteeringTest, ChecksTheBench) {
  pace = 20.0;
  open();
  auto page = steering_page();
  ASSERT_TRUE(page->ok({{"do", "check"}, {"with_motion", true}, {"confirmed", true}}));
  EXPECT_FALSE(page->ok(kStart)) << "one thing at a time";
  EXPECT_EQ(page->wait_for_type("strip")["group"]["unit"], "g");
  const Json findings = page->wait_for_type("checks")["findings"];
  const auto has = [&](const std::string& what) {
    return std::any_of(findings.begin(), findings.end(),
                       [&](const Json& f) { return f["what"] == what && f["grade"] == "good"; });
  };
  for (const char* what : {"stage", "accelerometer", "travel", "signs and axes"})
    EXPECT_TRUE(has(what)) << findings;
  page->wait_for_activity("idle");
  EXPECT_EQ(run_files(), 0U);
}

TEST_F(SteeringTest, JogsAnAxisWhenNoRunIsOn) {
  open();
  auto page = steering_page();
  const auto jog = [&](const char* axis, double by) {
    EXPECT_TRUE(page->ok({{"do", "jog"}, {"axis", axis}, {"by_deg", by}, {"confirmed", true}}));
    return page->wait_for([](const Json& m) { return m["type"] == "log"; }, "where it stands")["line"]["text"]
        .get<std::string>();
  };
  EXPECT_THAT(jog("x", 10.0), HasSubstr("Axis X is at 10.00"));
  page->wait_for_activity("idle");
  EXPECT_THAT(jog("x", -2.5), HasSubstr("Axis X is at 7.50"));
  page->wait_for_activity("idle");
  EXPECT_THAT(jog("z", 350.0), HasSubstr("Axis Z is at 350.00"));
  page->wait_for_activity("idle");
  EXPECT_THAT(jog("z", 350.0), HasSubstr("travel"));  // It ends at 360 degrees.
  page->wait_for_activity("idle");
  ASSERT_TRUE(page->ok(kStart));
  EXPECT_FALSE(page->ok({{"do", "jog"}, {"axis", "x"}, {"by_deg", 1.0}, {"confirmed", true}}));
}

TEST_F(SteeringTest, ABenchIsShownAsATileWithoutBeingSteered) {
  pace = 20.0;
  options.tile_folders = {runs()};
  open();
  auto page = steering_page();
  ASSERT_TRUE(page->ok(kStart));
  page->wait_for_type("dwell_done");
  const auto tiles = Json::parse(test::http_get(port, "/benches").body);
  ASSERT_EQ(tiles["benches"].size(), 1U) << tiles;
  const Json& tile = tiles["benches"][0];
  EXPECT_EQ(tile["bench"], "bench");
  EXPECT_EQ(tile["state"], "answers");
  EXPECT_EQ(tile["activity"]["activity"], "running");
  EXPECT_GE(tile["progress"]["measured"], 1);
  page->wait_for_type("dwell_done");  // It goes on.
  // A folder without a bench.
  EXPECT_TRUE(other_benches({folder.path()}, std::chrono::milliseconds(500)).empty());
}

TEST_F(SteeringTest, TurnsAnAxisAsLongAsAButtonIsHeld) {
  pace = 1.0;
  open();
  auto page = steering_page();
  const auto told = [&] {
    return page
        ->wait_for([](const Json& m) { return m["type"] == "log"; }, "what became of it")["line"]["text"]
        .get<std::string>();
  };
  const Json up = {{"do", "jog"}, {"axis", "x"}, {"while_held", "up"}, {"confirmed", true}};
  ASSERT_TRUE(page->ok(up));
  EXPECT_THAT(told(), HasSubstr("axis X is not homed"));
  page->wait_for_activity("idle");
  ASSERT_TRUE(page->ok({{"do", "jog"}, {"axis", "x"}, {"to_deg", 10.0}, {"confirmed", true}}));
  EXPECT_THAT(told(), HasSubstr("Axis X is at 10.00"));
  page->wait_for_activity("idle");
  // Without a sign of life it halts by itself; the stage turns for 300 ms.
  ASSERT_TRUE(page->ok(up));
  const std::string text = told();
  EXPECT_THAT(text, HasSubstr("Axis X is at"));
  const double angle = std::stod(text.substr(text.find("at ") + 3));
  EXPECT_GT(angle, 11.0);
  EXPECT_LT(angle, 359.0);
  page->wait_for_activity("idle");
}

TEST_F(SteeringTest, EachOfSeveralItemsIsShownAndOneThatFallsSilentIsLeftOut) {
  pace = 50.0;
  open();
  test::write_file(
      folder / "bench.toml",
      test::small_tray() + "[[fault]]\nkind = \"no-output\"\ninstrument = \"item-3\"\nat_s = 60.0\n");
  auto page = steering_page();
  ASSERT_TRUE(page->ok(kStart));
  std::set<int> shown;
  bool faulted = false;
  std::map<int, int> measured;  // Angles of each item.
  const auto count = [&](const Json& message) {
    if (message["type"] != "dwell_done") return;
    for (const Json& item : message["items"]) ++measured[item["k"].get<int>()];
  };
  const Json dropped = page->wait_for(
      [&](const Json& message) {
        count(message);
        if (message["type"] == "strip") shown.insert(message["group"]["item"].get<int>());
        faulted = faulted || message["type"] == "fault";
        return message["type"] == "notice" && message["kind"] == "item dropped";
      },
      "an item that is left out");
  EXPECT_EQ(shown, (std::set<int>{1, 2, 3}));
  EXPECT_EQ(dropped["item"], 3);
  EXPECT_THAT(dropped["text"].get<std::string>(), HasSubstr("item 3, accelerometer"));
  EXPECT_FALSE(faulted);
  const int remaining = measured[3];
  page->wait_for(
      [&](const Json& message) {
        count(message);
        return measured[1] > remaining + 1;
      },
      "the others go on");
  EXPECT_EQ(measured[3], remaining);
  ASSERT_TRUE(page->ok({{"do", "stop"}}));
  const Json ended = page->wait_for_type("finished");
  EXPECT_EQ(ended["interrupted"]["items"], 2);
  // It goes on without that item, which is still named.
  page->wait_for_activity("idle");
  ASSERT_TRUE(page->ok({{"do", "resume"}, {"run", ended["file"]}, {"confirmed", true}}));
  const Json again =
      page->wait_for([](const Json& m) { return m["type"] == "snapshot"; }, "the run's beginning")["run"];
  ASSERT_EQ(again["items"].size(), 3U);
  EXPECT_EQ(again["items"][0]["missing"], "");
  EXPECT_EQ(again["items"][2]["missing"], dropped["text"]);
  EXPECT_EQ(again["items"][2]["measured"], remaining);
  ASSERT_TRUE(page->ok({{"do", "stop"}}));
  page->wait_for_activity("idle");
}

TEST_F(SteeringTest, AFaultEndsTheRunAndIsTold) {
  bench.simulation = "[[fault]]\nkind = \"silence\"\ninstrument = \"stage\"\nat_s = 3.0\n";
  open();
  auto page = steering_page();
  ASSERT_TRUE(page->ok(kStart));
  const Json ended = page->wait_for_type("finished");
  EXPECT_FALSE(ended["complete"].get<bool>());
  EXPECT_THAT(ended["reason"].get<std::string>(), HasSubstr("stage"));
  page->wait_for_activity("idle");
}

TEST_F(SteeringTest, AMistakeInTheBenchFileIsTold) {
  open();
  test::write_file(folder / "bench.toml", "[bench]\n");
  auto page = steering_page();
  ASSERT_TRUE(page->ok(kStart));
  const Json line = page->wait_for_type("log")["line"];
  EXPECT_EQ(line["grade"], "problem");
  EXPECT_THAT(line["text"].get<std::string>(), HasSubstr("bench.toml"));
  page->wait_for_activity("idle");
  EXPECT_EQ(run_files(), 0U);
}

TEST_F(SteeringTest, ThePageThatSteeredMayVanish) {
  open();
  auto page = steering_page();
  ASSERT_TRUE(page->ok(kStart));
  page.reset();
  test::PageClient other(port);
  other.wait_for(
      [](const Json& m) {
        return m["type"] == "finished" ||
               (m["type"] == "snapshot" && m["run"].is_object() && m["run"]["ended"].is_object());
      },
      "the end of the run");
  EXPECT_EQ(run_files(), 1U);
}

TEST_F(SteeringTest, APageThatDoesNotReadHoldsUpNobodyAndCatchesUp) {
  // Enough messages to fill the buffers of a page: its queue, and the system's buffers.
  bench.protocol = "steps = 90\nstep_deg = 4.0\nsettle_s = 0.0\ndwell_readings = 10\nclosing_angle = false\n";
  pace = 5000.0;
  options.longest_queue = 64;
  open();
  test::PageClient deaf(port, {}, "/live", 4096);
  auto page = steering_page();
  ASSERT_TRUE(page->ok(kStart));
  const auto complete = [&] {
    return test::http_get(port, "/runs").body.find("\"complete\"") != std::string::npos;
  };
  ASSERT_TRUE(test::wait_for(complete, test::kPatience));
  // It sends more requests than replies may wait.
  constexpr int kAsked = 100;
  for (int id = 1; id <= kAsked; ++id) deaf.send(Json{{"do", "stop"}, {"id", id}}.dump());
  // It reads now: no reply was dropped; a snapshot with all angles replaces the dropped messages.
  int answered = 0;
  bool all_angles = false;
  Json ended;
  while (answered < kAsked || !all_angles || ended.is_null()) {
    const auto message = deaf.next(std::chrono::steady_clock::now() + test::kPatience);
    ASSERT_TRUE(message) << answered << " replies, " << all_angles << ended;
    const std::string type = (*message)["type"];
    if (type == "reply") {
      EXPECT_EQ((*message)["id"], ++answered);
    } else if (type == "snapshot" && (*message)["run"].is_object()) {
      all_angles = (*message)["run"]["measured"].size() == 270;
      ended = (*message)["run"]["ended"];
    } else if (type == "finished") {
      ended = *message;
    }
  }
  EXPECT_TRUE(ended["complete"].get<bool>());
}

TEST_F(SteeringTest, TheEndOfTheProgramHaltsARunAndLeavesItResumable) {
  pace = 20.0;
  open();
  auto page = steering_page();
  ASSERT_TRUE(page->ok(kStart));
  page->wait_for_type("dwell_done");
  close();
  EXPECT_TRUE(something_was_on);
  ASSERT_EQ(run_files(), 1U);
  for (const auto& entry : std::filesystem::directory_iterator(runs())) {
    if (entry.path().extension() != ".run") continue;
    EXPECT_EQ(RunFile::load(entry.path()).state, RunState::kInterrupted);
  }
}

}  // namespace
}  // namespace abcal::console
