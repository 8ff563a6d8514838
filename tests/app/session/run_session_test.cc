#include "app/analysed_run/run_session.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "app/system/helper_program.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/record/verify_run.h"
#include "tests/app/program_fixtures.h"
#include "tests/app/repeatable_run.h"
#include "tests/support/forged_chain.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

/// 5 angles in each of three experiments and closing angles.
constexpr std::size_t kPlanned = 18;

class RunSessionTest : public testing::Test {
 protected:
  static std::string bench(const std::string& more = "") {
    BenchText text = repeatable_bench();
    text.stage_driver = text.accelerometer_driver = "simulated";
    text.protocol =
        "steps = 5\nstep_deg = 72.0\nsettle_s = 0.05\ndwell_readings = 10\npoll_interval_s = 0.05\n" +
        text.protocol.substr(text.protocol.find("approach_deg"));
    return text.text() + more;
  }

  std::unique_ptr<RunSession> session() {
    RunSession::Options options;
    options.open_bench = [this](const BenchConfig& config, BenchStreams streams) {
      ++opened;
      return make_bench(config, std::move(streams));
    };
    options.listener = [this](const SessionEvent& event) {
      kinds.emplace_back(std::visit([](const auto& each) { return each.kName; }, event));
      last = event;
      if (on_event) on_event(event);
    };
    options.stop = stop.get_token();
    options.result_listener = on_result;
    options.free_disk_space = [this](const std::filesystem::path&) { return free_bytes; };
    return std::make_unique<RunSession>(std::move(options));
  }

  StartRequest start(const std::string& name = "a.run") const {
    return {parse_bench(bench_toml, "bench.toml"), (folder / name).string()};
  }

  std::size_t count(const std::string& kind) const {
    return static_cast<std::size_t>(std::count(kinds.begin(), kinds.end(), kind));
  }

  std::vector<std::string> event_texts(const std::string& kind) const {
    std::vector<std::string> texts;
    for (const RunEvent& event : RunFile::load(folder / "a.run").events) {
      if (event.kind == kind) texts.push_back(event.text);
    }
    return texts;
  }

  test::TemporaryFolder folder;
  std::string bench_toml = bench();
  std::optional<std::uintmax_t> free_bytes;
  std::stop_source stop;
  std::function<void(const SessionEvent&)> on_event;
  std::function<void(const RunOutcome&)> on_result;
  std::vector<std::string> kinds;  ///< Kinds of all events, in order.
  std::optional<SessionEvent> last;
  int opened = 0;
};

TEST_F(RunSessionTest, ARunIsToldFromItsBeginningToItsEnd) {
  const RunOutcome outcome = session()->start(start());
  EXPECT_EQ(outcome.stored().state, RunState::kComplete);
  EXPECT_EQ(outcome.stored().measured.size(), kPlanned);
  EXPECT_EQ(outcome.sha256.size(), 64U);
  EXPECT_FALSE(outcome.measured_before);
  ASSERT_FALSE(outcome.items.front().results.empty());
  EXPECT_EQ(kinds.front(), "run_began");
  EXPECT_EQ(count("run_began"), 1U);
  EXPECT_EQ(count("angle_begun"), kPlanned);
  EXPECT_EQ(count("dwell_done"), kPlanned);
  EXPECT_THAT(std::vector<std::string>(kinds.end() - 2, kinds.end()),
              ElementsAre("all_measured", "finished"));
  const auto& finished = std::get<FinishedEvent>(last.value());
  EXPECT_TRUE(finished.complete);
  EXPECT_EQ(finished.measured, kPlanned);
  EXPECT_EQ(finished.planned, kPlanned);
  EXPECT_EQ(finished.reason, outcome.items.front().results.front().why);
}

TEST_F(RunSessionTest, AMessageThatDoesNotArriveIsAWarningOfARunThatIsComplete) {
  set_helper_folder(std::filesystem::path(test::abcal_program()).parent_path());
  bench_toml = bench("[notify]\nwebhook = \"http://127.0.0.1:1/\"\n");
  std::vector<std::string> notices;
  on_event = [&](const SessionEvent& event) {
    if (const auto* notice = std::get_if<NoticeEvent>(&event); notice != nullptr && notice->kind == "notify")
      notices.push_back(notice->text);
  };
  EXPECT_EQ(session()->start(start()).stored().state, RunState::kComplete);
  EXPECT_THAT(notices, ElementsAre(HasSubstr("a message to those in [notify] did not arrive: the webhook")));
}

TEST_F(RunSessionTest, AStopLeavesARunThatIsResumedToTheSameBits) {
  session()->start(start("whole.run"));
  kinds.clear();
  std::unique_ptr<RunSession> first = session();
  on_event = [&](const SessionEvent&) {
    if (count("dwell_done") == 4) first->request_stop();
  };
  EXPECT_THROW(first->start(start()), RunInterrupted);
  const auto& ended = std::get<FinishedEvent>(last.value());
  EXPECT_FALSE(ended.complete);
  EXPECT_EQ(ended.measured, 4U);
  EXPECT_THAT(ended.reason, AllOf(HasSubstr("stopped by the operator"), HasSubstr("the stage is halted")));
  on_event = {};
  first.reset();
  kinds.clear();
  std::size_t known = 0;
  on_event = [&](const SessionEvent& event) {
    if (const auto* began = std::get_if<RunBeganEvent>(&event)) {
      EXPECT_TRUE(began->resumed);
      known = began->measured.size();
    }
  };
  const RunOutcome outcome = session()->resume({(folder / "a.run").string()});
  EXPECT_EQ(known, 4U);
  EXPECT_EQ(count("dwell_done"), kPlanned - 4);
  EXPECT_EQ(outcome.stored().record.continuations, 1);
  EXPECT_EQ(measured_bits(folder / "a.run"), measured_bits(folder / "whole.run"));
}

TEST_F(RunSessionTest, ARunOfTwoFacesIsResumedInTheSecondFaceAndAnalysedByFace) {
  bench_toml.replace(bench_toml.find("steps = 5\nstep_deg = 72.0\n"), 26,
                     "steps = 8\nstep_deg = 45.0\nfaces = 2\n");
  session()->start(start("whole.run"));
  kinds.clear();
  std::unique_ptr<RunSession> first = session();
  on_event = [&](const SessionEvent&) {
    if (count("dwell_done") == 7) first->request_stop();
  };
  EXPECT_THROW(first->start(start()), RunInterrupted);
  EXPECT_THAT(std::get<FinishedEvent>(last.value()).reason, HasSubstr("experiment 1, face 2, alpha = "));
  on_event = {};
  first.reset();
  const RunOutcome outcome = session()->resume({(folder / "a.run").string()});
  EXPECT_EQ(measured_bits(folder / "a.run"), measured_bits(folder / "whole.run"));
  const std::vector<DwellRecord>& dwells = outcome.stored().record.dwells;
  ASSERT_EQ(dwells.size(), 30U);
  for (std::size_t k = 0; k < dwells.size(); ++k) EXPECT_EQ(dwells[k].face, k / 5 % 2 == 0 ? 1 : 2) << k;
  EXPECT_TRUE(has_two_faces(outcome.stored().header.plan));
  for (const IntegrityCheck& check : verify_run(folder / "a.run")) EXPECT_TRUE(check.good) << check.found;
  bool by_face = false;
  for (const CalibrationResult& result : outcome.items.front().results) {
    EXPECT_NE(result.verdict, Verdict::kNotUsable) << result.estimator << ": " << result.why;
    by_face = by_face || result.faces.has_value();
  }
  EXPECT_TRUE(by_face);
  // The face is part of what the links of the dwells protect.
  std::filesystem::copy_file(folder / "a.run", folder / "changed.run");
  SqliteDatabase(folder / "changed.run", SqliteDatabase::Mode::kReadWrite)
      .execute("update dwell set face = 1 where face = 2");
  bool found = false;
  for (const IntegrityCheck& check : verify_run(folder / "changed.run"))
    found = found || (check.what == "dwells" && !check.good);
  EXPECT_TRUE(found);
}

TEST_F(RunSessionTest, AnExternalStopEndsItAsWell) {
  on_event = [&](const SessionEvent&) {
    if (count("dwell_done") == 2) stop.request_stop();
  };
  EXPECT_THROW(session()->start(start()), RunInterrupted);
  EXPECT_EQ(RunFile::load(folder / "a.run").state, RunState::kInterrupted);
}

TEST_F(RunSessionTest, HoldsBetweenTwoAnglesStoresNotesAndGoesOn) {
  std::unique_ptr<RunSession> run = session();
  on_event = [&](const SessionEvent& event) {
    if (std::holds_alternative<DwellDoneEvent>(event) && count("dwell_done") == 3) {
      run->hold();
      EXPECT_TRUE(run->add_note({"door opened", "me"}));
    }
    if (std::holds_alternative<HeldEvent>(event)) run->continue_run();
  };
  run->start(start());
  EXPECT_EQ(count("held"), 1U);
  EXPECT_EQ(count("continued"), 1U);
  EXPECT_EQ(count("note_stored"), 1U);
  EXPECT_THAT(event_texts("held"), ElementsAre(HasSubstr("held before experiment 1")));
  EXPECT_THAT(event_texts("note"), ElementsAre("door opened (me)"));
}

TEST_F(RunSessionTest, MoreNotesThanCanWaitAreRefused) {
  const std::unique_ptr<RunSession> run = session();
  int stored = 0;
  while (stored < 1000 && run->add_note({"a note", "me"})) ++stored;
  EXPECT_EQ(stored, 20);
}

TEST_F(RunSessionTest, TooLittleDiskSpaceIsRefusedBeforeThereIsAFile) {
  free_bytes = 1000;
  try {
    session()->start(start());
    FAIL() << "a run does not fit into 1000 bytes";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("are free on this disk"), HasSubstr("required")));
  }
  EXPECT_FALSE(std::filesystem::exists(folder / "a.run"));
  EXPECT_THAT(kinds, testing::IsEmpty());
}

TEST_F(RunSessionTest, LittleDiskSpaceIsToldAndTheRunGoesOn) {
  free_bytes = 12'000'000;
  on_event = [&](const SessionEvent& event) {
    if (const auto* notice = std::get_if<NoticeEvent>(&event)) {
      EXPECT_EQ(notice->kind, "disk space");
    }
  };
  session()->start(start());
  EXPECT_EQ(count("notice"), 1U);
  EXPECT_EQ(kinds.front(), "notice");
}

TEST_F(RunSessionTest, AFileInTheWayIsRefusedBeforeTheFirstMove) {
  session()->start(start());
  kinds.clear();
  EXPECT_THROW(session()->start(start()), RunFileError);
  EXPECT_THAT(kinds, testing::IsEmpty());
}

TEST_F(RunSessionTest, TheNextRunUsesTheInstrumentsThatAreOpen) {
  const std::unique_ptr<RunSession> run = session();
  run->start(start("a.run"));
  run->start(start("b.run"));
  EXPECT_EQ(opened, 1);
  bench_toml = bench();
  bench_toml.replace(bench_toml.find("dwell_readings = 10"), 19, "dwell_readings = 11");
  run->start(start("c.run"));
  EXPECT_EQ(opened, 2);
}

TEST_F(RunSessionTest, AfterAFailureTheInstrumentsAreOpenedAgain) {
  bench_toml = bench("[[fault]]\nkind = \"no-output\"\nat_s = 2.0\n");
  const std::unique_ptr<RunSession> run = session();
  EXPECT_THROW(run->start(start("a.run")), InstrumentError);
  EXPECT_FALSE(std::get<FinishedEvent>(last.value()).complete);
  EXPECT_THROW(run->start(start("b.run")), InstrumentError);
  EXPECT_EQ(opened, 2);
}

TEST_F(RunSessionTest, APortThatVanishesAndComesBackIsTold) {
  BenchText text = repeatable_bench();
  text.protocol = "replug_timeout_s = 20.0\n" + text.protocol;
  bench_toml =
      text.text() + "[[fault]]\nkind = \"unplug\"\ninstrument = \"accelerometer\"\nat_s = 4.0\nfor_s = 1.0\n";
  std::string lost;
  on_event = [&](const SessionEvent& event) {
    if (const auto* port = std::get_if<PortLostEvent>(&event)) lost = port->text;
  };
  const RunOutcome outcome = session()->start(start());
  EXPECT_EQ(count("port_lost"), 1U);
  EXPECT_EQ(count("port_back"), 1U);
  EXPECT_THAT(lost, AllOf(HasSubstr("the port of accelerometer"), HasSubstr("the stage is halted")));
  EXPECT_EQ(outcome.stored().record.reconnections, 1);
}

TEST_F(RunSessionTest, TheResultIsToldOnceAndBeforeReadersOfTheFileAreWaitedFor) {
  int told = 0;
  std::string sha256;
  std::unique_ptr<SqliteDatabase> reader;
  on_result = [&](const RunOutcome& outcome) {
    ++told;
    sha256 = outcome.sha256;
    EXPECT_FALSE(outcome.items.front().results.empty());
    reader.reset();
  };
  const RunOutcome alone = session()->start(start("alone.run"));
  EXPECT_EQ(told, 1);
  EXPECT_EQ(sha256, alone.sha256);
  EXPECT_EQ(count("notice"), 0U);

  on_event = [&](const SessionEvent& event) {
    if (!std::holds_alternative<AllMeasuredEvent>(event)) return;
    reader = std::make_unique<SqliteDatabase>(folder / "a.run", SqliteDatabase::Mode::kReadOnly);
    reader->value("select count(*) from dwell");
  };
  const RunOutcome outcome = session()->start(start());
  EXPECT_EQ(told, 2);
  EXPECT_EQ(sha256, "") << "not closed yet";
  EXPECT_EQ(outcome.sha256.size(), 64U);
  EXPECT_EQ(count("notice"), 1U);
}

TEST_F(RunSessionTest, ALevellingIsMeasuredAndClosedAsARunButNotAnalysed) {
  const std::unique_ptr<RunSession> run = session();
  EXPECT_FALSE(run->identify_instruments(start()).stage.model.empty());
  const RunOutcome outcome = run->level(start());
  EXPECT_EQ(opened, 1);
  EXPECT_EQ(outcome.stored().state, RunState::kComplete);
  EXPECT_EQ(outcome.stored().measured.size(), 5U + 4U);  // The spin, and the reversal.
  EXPECT_THAT(outcome.items.front().results, testing::IsEmpty());
  EXPECT_EQ(kinds.back(), "finished");
  for (const IntegrityCheck& check : verify_run(folder / "a.run"))
    EXPECT_TRUE(check.good) << check.what << ": " << check.found;
}

TEST_F(RunSessionTest, TheItemIsCalibratedWithItsOwnCorrectionsAndOnlyWithThose) {
  BenchText text = repeatable_bench();
  text.stage_driver = "simulated";
  text.accelerometer_driver = "vectornav";
  text.simulation += "sensitivity_matrix = [[9.81, 0.0, 0.0], [0.0, 9.81, 0.0], [0.0, 0.0, 9.81]]\n";
  bench_toml = text.text();
  std::unique_ptr<RunSession> first = session();
  on_event = [&](const SessionEvent&) {
    if (count("dwell_done") == 2) first->request_stop();
  };
  EXPECT_THROW(first->start(start()), RunInterrupted);
  on_event = {};
  first.reset();
  const StoredRun stored = RunFile::load(folder / "a.run");
  ASSERT_EQ(stored.header.items.size(), 1U);
  EXPECT_EQ(stored.header.items[0].registers.size(), 2U);
  SqliteDatabase(folder / "a.run", SqliteDatabase::Mode::kReadWrite)
      .execute("update item_register set value = '2' where name like 'acceleration%'");
  test::rebuild_chain(folder / "a.run");
  try {
    session()->resume({(folder / "a.run").string()});
    FAIL() << "resumed with other corrections";
  } catch (const InstrumentError& error) {
    EXPECT_THAT(error.what(), HasSubstr("acceleration compensation (25) was 2 when the run began"));
  }
}

TEST_F(RunSessionTest, AnInterruptedLevellingIsResumedAndStaysALevelling) {
  session()->level(start("whole.run"));
  kinds.clear();
  std::unique_ptr<RunSession> first = session();
  on_event = [&](const SessionEvent&) {
    if (count("dwell_done") == 4) first->request_stop();
  };
  EXPECT_THROW(first->level(start()), RunInterrupted);
  on_event = {};
  first.reset();
  const RunOutcome outcome = session()->resume({(folder / "a.run").string()});
  EXPECT_TRUE(outcome.is_levelling());
  EXPECT_THAT(outcome.items.front().results, testing::IsEmpty());
  EXPECT_EQ(outcome.stored().record.dwells.size(), 5U + 4U);
  EXPECT_THAT(outcome.stored().record.check_poses, testing::IsEmpty());
  EXPECT_EQ(measured_bits(folder / "a.run"), measured_bits(folder / "whole.run"));
}

TEST_F(RunSessionTest, AKilledProgramsFirstResultsAreNotSaidToBeMadeAgain) {
  session()->start(start());
  const std::filesystem::path results = ResultsFile::path_beside(folder / "a.run");
  {
    // Killed after the run was closed, before its hash and its analyses were kept.
    SqliteDatabase database(results, SqliteDatabase::Mode::kReadWrite);
    database.execute("delete from run");
    database.execute("delete from analysis");
  }
  const RunOutcome outcome = session()->resume({(folder / "a.run").string()});
  EXPECT_TRUE(outcome.measured_before);
  SqliteDatabase database(results, SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(database.value("select note from run"), "");
  EXPECT_EQ(database.value("select sha256 from run"), outcome.sha256);
}

TEST_F(RunSessionTest, ARunThatIsCompleteButNotAnalysedIsOnlyFinished) {
  session()->start(start());
  std::filesystem::remove(ResultsFile::path_beside(folder / "a.run"));
  kinds.clear();
  const RunOutcome outcome = session()->resume({(folder / "a.run").string()});
  EXPECT_TRUE(outcome.measured_before);
  EXPECT_EQ(opened, 1);
  EXPECT_THAT(kinds, ElementsAre("finished"));
}

}  // namespace
}  // namespace abcal
