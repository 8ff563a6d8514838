// Several items on one stage, from the bench file to the run file: nothing is lost, and what happens to one
// item does not end the run of the others.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "app/analysed_run/run_session.h"
#include "app/bench_file/bench_config.h"
#include "app/results/analysis/analyses.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/limits.h"
#include "protocol/record/verify_run.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

/// 5 angles in each of three experiments and closing angles.
constexpr std::size_t kAnglesOfPlan = 18;

std::string item(const std::string& driver, const std::string& serial_number, const std::string& more = "",
                 const std::string& simulation = "") {
  const bool reports = driver != "simulated" && driver != "witmotion";
  return "[[item]]\nserial_number = \"" + serial_number + "\"\n" + more +
         "[item.accelerometer]\ndriver = \"" + driver + "\"\nport = \"simulated\"\nrate_hz = 200.0\n" +
         (reports ? "serial_number = \"" + serial_number + "\"\n" : "") +
         (driver == "witmotion" ? "baud = 115200\n" : "") +
         (simulation.empty() ? "" : "[item.simulation]\n" + simulation);
}

const std::string kInMetres =
    "sensitivity_matrix = [[9.81, 0.0, 0.0], [0.0, 9.80, 0.0], [0.0, 0.0, 9.82]]\nnoise = 1e-3\n";

class SeveralItemsTest : public testing::Test {
 protected:
  /// All on one stage; `more` are faults and changes.
  static std::string bench(const std::vector<std::string>& items, const std::string& more = "") {
    std::string text =
        "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"simulated\"\nport = \"simulated\"\n[protocol]\n"
        "check_poses = false\nsteps = 5\nstep_deg = 72.0\nsettle_s = 1.0\npoll_interval_s = "
        "0.05\ndwell_readings = 50\n"
        "replug_timeout_s = 5.0\napproach_deg = 0.0\n[simulation]\nnoise = 1e-4\nseed = 7\n"
        "noise_seeded_by_angle = true\noffset = [0.01, 0.02, 0.03]\n";
    for (const char* axis : {"x", "z"})
      text += std::string("[simulation.") + axis +
              "]\nspeed_deg_per_s = 500.0\nacceleration_deg_per_s2 = 25000.0\nstep_error_deg = 0.005\n";
    for (const std::string& each : items) text += each;
    return text + more;
  }
  static std::vector<std::string> three(const std::string& second = "") {
    return {item("simulated", "1"), item("microstrain_mip", "2", second), item("simulated", "3")};
  }

  RunOutcome run(const std::string& toml, bool without_missing_items = false,
                 const std::string& name = "a.run") {
    RunSession session(options());
    started = &session;
    StartRequest request{parse_bench(toml, "bench.toml"), (folder / name).string()};
    request.without_missing_items = without_missing_items;
    return session.start(request);
  }
  RunSession::Options options() {
    RunSession::Options options;
    options.listener = [this](const SessionEvent& event) {
      if (const auto* done = std::get_if<DwellDoneEvent>(&event)) dwells.push_back(*done);
      if (std::holds_alternative<AngleBegunEvent>(event)) ++angles_begun;
      if (on_event) on_event(event);
    };
    return options;
  }
  StoredRun stored(int k, const std::string& name = "a.run") const { return RunFile::load(folder / name, k); }
  std::vector<std::string> events(const std::string& kind) const {
    std::vector<std::string> texts;
    for (const RunEvent& event : stored(1).events)
      if (event.kind == kind) texts.push_back(event.text);
    return texts;
  }
  void expect_sound_file() const {
    for (const IntegrityCheck& check : verify_run(folder / "a.run"))
      EXPECT_TRUE(check.good) << check.what << ": " << check.found;
  }
  static std::string failure_of(const std::function<void()>& call) {
    try {
      call();
    } catch (const InstrumentError& error) {
      return error.what();
    }
    ADD_FAILURE() << "nothing was thrown";
    return {};
  }

  test::TemporaryFolder folder;
  std::function<void(const SessionEvent&)> on_event;
  RunSession* started = nullptr;  ///< By run().
  std::vector<DwellDoneEvent> dwells;
  int angles_begun = 0;
};

TEST_F(SeveralItemsTest, OneStageExplainsTheReadingsOfAllItemsAndTheResultsCoverTheTruth) {
  // All within the default sizes of [stage_uncertainty] and [item_uncertainty].
  std::string text =
      "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"simulated\"\nport = \"simulated\"\n[protocol]\n"
      "estimator = \"joint\"\nsteps = 24\nstep_deg = 15.0\nsettle_s = 0.2\ndwell_readings = 100\n"
      "[simulation]\nnoise = 1e-4\nseed = 7\nzx = 1e-4\nzy = -1e-4\nxz = 5e-5\nspan_s = 600.0\n"
      "drift_1 = [3e-5, -2e-5, 4e-5]\n";
  for (const char* axis : {"x", "z"})
    text += std::string("[simulation.") + axis +
            "]\nspeed_deg_per_s = 500.0\nacceleration_deg_per_s2 = 25000.0\nstep_error_deg = 0.005\n"
            "mean_step_error_deg = 0.004\ninitial_turn_error_deg = -0.004\nsmooth_error_deg = 0.004\n"
            "wobble_urad = 40.0\n";
  text += item("simulated", "1") +
          item("simulated", "2", "mounting = \"y -x z\"\n", "offset = [0.02, 0.0, 0.01]\n") +
          item("simulated", "3", "mounting = \"x -y -z\"\n");
  const RunOutcome outcome = run(text);
  EXPECT_EQ(outcome.joint.verdict, Verdict::kUsable) << outcome.joint.why;
  const BenchConfig truth = parse_bench(text, "bench.toml");
  for (int k = 1; k <= 3; ++k) {
    const TruthComparison comparison =
        compare_with_truth(outcome.joint.items.at(static_cast<std::size_t>(k) - 1).result,
                           outcome.items.at(static_cast<std::size_t>(k) - 1).stored.record, truth, k);
    EXPECT_TRUE(comparison.agrees()) << "item " << k << "\n" << comparison.text;
  }
}

TEST_F(SeveralItemsTest, EightItemsOfFourDriversAreMeasuredInTheTimeOfOne) {
  const std::vector<std::string> mountings{"x y z", "y -x z",  "x -y -z", "z x y",
                                           "x y z", "-x -y z", "y z x"};
  std::vector<std::string> items{item("simulated", "1")};
  const auto mounted = [&](std::size_t k) { return "mounting = \"" + mountings[k] + "\"\n"; };
  items.push_back(item("microstrain_mip", "2", mounted(1)));
  items.push_back(item("microstrain_mip", "3", mounted(2)));
  items.push_back(item("vectornav", "4", mounted(3), kInMetres));
  items.push_back(item("xsens_mti", "03800005", mounted(4), kInMetres));
  items.push_back(item("witmotion", "6", mounted(5), "noise = 2e-3\n"));
  items.push_back(item("simulated", "7", mounted(6)));
  items.push_back(item("simulated", "8", "mounting = \"0.8 0.6 0  -0.6 0.8 0  0 0 1\"\n"));
  const RunOutcome outcome = run(bench(items));
  ASSERT_EQ(outcome.items.size(), 8U);
  for (const AnalysedItem& each : outcome.items) {
    EXPECT_EQ(each.stored.measured.size(), kAnglesOfPlan) << each.stored.item;
    for (const DwellRecord& dwell : each.stored.dwells) {
      EXPECT_EQ(dwell.lost, 0) << each.stored.item;
      EXPECT_EQ(dwell.count, 50) << each.stored.item;
      EXPECT_EQ(dwell.flags & (kFlagLostReadings | kFlagNorm), 0U) << each.stored.item;
    }
    ASSERT_FALSE(each.results.empty()) << each.stored.item;
    const Eigen::Matrix3d s = each.results.front().sensitivity_values();
    const Eigen::Matrix3d mounting = mounting_matrix(each.stored.header.expected.mounting).value();
    const double g = each.stored.record.response_unit == "g" ? 1.0 : 9.81;
    EXPECT_LT((s / g - mounting).norm(), 0.01) << each.stored.item << "\n" << s;
  }
  // Each has noise of its own.
  EXPECT_NE(outcome.items[0].stored.dwells[0].spread, outcome.items[6].stored.dwells[0].spread);
  ASSERT_EQ(dwells.size(), kAnglesOfPlan);
  EXPECT_EQ(dwells[0].dwells.size(), 8U);
  expect_sound_file();
  const double together_s = outcome.stored().timing.total_s();
  // The one that takes longest to start.
  const double alone_s = run(bench({items[5]}), false, "b.run").stored().timing.total_s();
  EXPECT_LT(together_s, 1.02 * alone_s);
}

TEST_F(SeveralItemsTest, ARunRepeatsBitForBit) {
  const std::vector<std::string> items{item("microstrain_mip", "1"), item("vectornav", "2", "", kInMetres)};
  run(bench(items));
  run(bench(items), false, "b.run");
  for (const int k : {1, 2}) {
    const std::vector<DwellRecord> a = stored(k).dwells, b = stored(k, "b.run").dwells;
    ASSERT_EQ(a.size(), b.size());
    for (std::size_t i = 0; i < a.size(); ++i) {
      EXPECT_EQ(a[i].mean, b[i].mean);
      EXPECT_EQ(a[i].time_s, b[i].time_s);
    }
  }
}

TEST_F(SeveralItemsTest, OneThatIsUnpluggedAndComesBackGoesOn) {
  const RunOutcome outcome = run(
      bench(three(), "[[fault]]\nkind = \"unplug\"\ninstrument = \"item-2\"\nat_s = 14.0\nfor_s = 3.0\n"));
  for (const AnalysedItem& each : outcome.items) {
    EXPECT_EQ(each.stored.measured.size(), kAnglesOfPlan);
    EXPECT_FALSE(each.stored.items.at(1).dropped_at);
  }
  ASSERT_EQ(events("lost").size(), 1U);
  EXPECT_THAT(events("lost")[0], HasSubstr("item 2, accelerometer"));
  EXPECT_EQ(events("reconnected").size(), 1U);
  EXPECT_EQ(angles_begun, static_cast<int>(kAnglesOfPlan) + 2)
      << "the angle under way and the one before, again";
  expect_sound_file();
}

TEST_F(SeveralItemsTest, OneThatDoesNotComeBackIsLeftOut) {
  const RunOutcome outcome =
      run(bench(three(), "[[fault]]\nkind = \"unplug\"\ninstrument = \"item-2\"\nat_s = 14.0\n"));
  EXPECT_EQ(outcome.items[0].stored.measured.size(), kAnglesOfPlan);
  EXPECT_EQ(outcome.items[2].stored.measured.size(), kAnglesOfPlan);
  const ItemProgress& second = outcome.stored().items.at(1);
  ASSERT_TRUE(second.dropped_at);
  EXPECT_EQ(second.measured, *second.dropped_at);
  EXPECT_LT(second.measured, kAnglesOfPlan);
  EXPECT_THAT(second.reason, HasSubstr("did not come back within 5 s"));
  EXPECT_TRUE(outcome.items[1].results.empty());
  EXPECT_EQ(events("item dropped").size(), 1U);
  expect_sound_file();
}

TEST_F(SeveralItemsTest, OneThatFallsSilentIsLeftOutWithTheOthersReadingsKept) {
  const RunOutcome outcome =
      run(bench(three(), "[[fault]]\nkind = \"no-output\"\ninstrument = \"item-3\"\nat_s = 14.0\n"));
  const ItemProgress& third = outcome.stored().items.at(2);
  ASSERT_TRUE(third.dropped_at);
  EXPECT_THAT(third.reason, AllOf(HasSubstr("item 3"), HasSubstr("no reading for 2 s")));
  EXPECT_EQ(outcome.items[0].stored.measured.size(), kAnglesOfPlan);
  EXPECT_EQ(angles_begun, static_cast<int>(kAnglesOfPlan)) << "no angle was measured again for it";
  EXPECT_EQ(dwells.back().dwells.size(), 2U);
  expect_sound_file();
}

TEST_F(SeveralItemsTest, TheLastOneThatFallsSilentEndsTheRun) {
  std::string faults;
  for (const char* each : {"item-1", "item-2", "item-3"})
    faults += std::string("[[fault]]\nkind = \"no-output\"\ninstrument = \"") + each + "\"\nat_s = 14.0\n";
  const std::string words = failure_of([&] { run(bench(three(), faults)); });
  EXPECT_THAT(words, HasSubstr("no reading for 2 s"));
  EXPECT_EQ(stored(1).state, RunState::kInterrupted);
  EXPECT_FALSE(stored(1).items.at(0).dropped_at);
}

TEST_F(SeveralItemsTest, OneThatIsDeadFromTheStartIsSaidBeforeTheFirstMove) {
  const std::string toml =
      bench(three(), "[[fault]]\nkind = \"silence\"\ninstrument = \"item-2\"\nat_s = 0.0\n");
  const std::string words = failure_of([&] { run(toml); });
  EXPECT_THAT(words, AllOf(HasSubstr("1 of 3 are not there"), HasSubstr("item 2"),
                           HasSubstr("--without-missing-items")));
  EXPECT_EQ(angles_begun, 0);
  EXPECT_FALSE(std::filesystem::exists(folder / "a.run"));
  const RunOutcome outcome = run(toml, true);
  EXPECT_EQ(outcome.items[0].stored.measured.size(), kAnglesOfPlan);
  EXPECT_EQ(outcome.stored().items.at(1).dropped_at, 0U);
  EXPECT_EQ(outcome.items[1].stored.header.labels.at("item.serial_number"), "2");
  expect_sound_file();
}

TEST_F(SeveralItemsTest, OneThatComesLooseStopsTheRun) {
  const std::string words = failure_of([&] {
    run(bench(three(),
              "[[change]]\nitem = 2\nat_s = 14.0\n"
              "sensitivity_matrix = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]\n"));
  });
  EXPECT_THAT(words, AllOf(HasSubstr("item 2"), HasSubstr("come loose"), HasSubstr("the stage is halted")));
  EXPECT_EQ(stored(1).state, RunState::kInterrupted);
  EXPECT_EQ(stored(1).measured.size(), stored(2).measured.size());
}

TEST_F(SeveralItemsTest, AResumedRunHasTheSameBitsAndWhatWasDroppedStaysDropped) {
  const std::string toml =
      bench(three(), "[[fault]]\nkind = \"no-output\"\ninstrument = \"item-3\"\nat_s = 8.0\n");
  run(toml, false, "whole.run");
  on_event = [&](const SessionEvent& event) {
    const auto* done = std::get_if<DwellDoneEvent>(&event);
    if (done != nullptr && done->position == 9) started->request_stop();
  };
  EXPECT_THROW(run(toml), RunInterrupted);
  on_event = {};
  ASSERT_TRUE(stored(1).items.at(2).dropped_at);
  std::vector<ItemSummary> shown;
  on_event = [&](const SessionEvent& event) {
    if (const auto* began = std::get_if<RunBeganEvent>(&event)) shown = began->items;
  };
  RunSession session(options());
  session.resume({(folder / "a.run").string()});
  ASSERT_EQ(shown.size(), 3U) << "also the one that takes no part any more";
  EXPECT_EQ(shown[1].missing, "");
  EXPECT_EQ(shown[1].measured, 10U);
  EXPECT_EQ(shown[2].name, "3");
  EXPECT_EQ(shown[2].missing, stored(3).items.at(2).reason);
  EXPECT_EQ(shown[2].measured, *stored(3).items.at(2).dropped_at);
  for (const int k : {1, 2}) {
    const StoredRun whole = stored(k, "whole.run"), resumed = stored(k);
    ASSERT_EQ(resumed.dwells.size(), whole.dwells.size());
    for (std::size_t i = 0; i < whole.dwells.size(); ++i)
      EXPECT_EQ(resumed.dwells[i].mean, whole.dwells[i].mean) << k << " " << i;
  }
  EXPECT_LT(stored(3).measured.size(), kAnglesOfPlan);
  expect_sound_file();
}

TEST_F(SeveralItemsTest, EachItemIsJudgedByItsOwnLimits) {
  std::vector<std::string> items = three();
  items[1] += "[item.limits]\ndrift = 0.25\n[item.item_uncertainty]\ndrift = 3e-5\n";
  run(bench(items));
  EXPECT_FALSE(stored(1).record.limits.drift);
  EXPECT_EQ(stored(2).record.limits.drift, 0.25);
  EXPECT_EQ(stored(2).record.tolerances.drift, 3e-5);
  EXPECT_EQ(stored(3).record.tolerances.drift, 1e-4);
}

}  // namespace
}  // namespace abcal
