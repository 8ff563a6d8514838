// abcal lab as its users call it: charts that block a bench, and bench files that name records.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <nlohmann/json.hpp>

#include "protocol/record/run_file.h"
#include "tests/app/certificate/certificate_fixtures.h"
#include "tests/support/training_register.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

/// The bench of the certificates with a stage of small errors, its own noise, and an offset that may be
/// shifted.
std::string check_bench(int seed, double offset_shift = 0.0) {
  std::string text =
      replaced(certificate_bench(), "noise = 1e-4", "noise = 1e-4\nseed = " + std::to_string(seed));
  for (int axis = 0; axis < 2; ++axis)
    text = replaced(text, "step_error_deg = 0.005", "step_error_deg = 0.0005");
  return replaced(text, "offset = [0.01,", "offset = [" + std::to_string(0.01 + offset_shift) + ",");
}

class ChartCommands : public CertificateTest {
 protected:
  void SetUp() override { test::write_file(folder / "lab.toml", example_laboratory()); }

  void measure_check(const std::string& name, int seed, double offset_shift = 0.0) {
    measure(check_bench(seed, offset_shift), name, folder);
  }
  std::vector<std::string> measure_baseline(int runs) {
    std::vector<std::string> names;
    for (int k = 1; k <= runs; ++k) {
      names.push_back("base-" + std::to_string(k) + ".run");
      measure_check(names.back(), 100 + k);
    }
    return names;
  }
  test::ProgramResult chart(std::vector<std::string> words) {
    words.insert(words.begin(), {"lab", "chart"});
    return abcal(words);
  }
  test::ProgramResult approve(const std::vector<std::string>& runs) {
    std::vector<std::string> words{"approve", "SN-42"};
    words.insert(words.end(), runs.begin(), runs.end());
    return chart(words);
  }
  static void add_item(test::TrainingRegister& registered) {
    registered.lab({"add", "item", "--maker", "Maker", "--model", "M-3", "--serial-number", "SN-42"});
  }
};

TEST_F(ChartCommands, ARunOutsideEndsWith1AndBlocksIssueUntilAPersonLiftsIt) {
  const std::vector<std::string> baseline = measure_baseline(6);
  measure_check("good.run", 1);
  measure_check("bad.run", 2, 1e-3);
  measure_check("again.run", 3);
  test::TrainingRegister registered(folder.path());
  const auto unknown = approve(baseline);
  EXPECT_EQ(unknown.exit_code, 2);
  EXPECT_THAT(unknown.err,
              HasSubstr("item Maker M-3 SN-42: is not in the register; add it: abcal lab add item"));
  add_item(registered);
  const auto approved = approve(baseline);
  ASSERT_EQ(approved.exit_code, 0) << approved.err;
  EXPECT_THAT(approved.out, AllOf(HasSubstr("approved by Approver N. N."), HasSubstr("no points yet"),
                                  HasSubstr("at most one in 200 check runs")));

  // A person who may only measure adds points, but neither approves nor lifts.
  registered.log_in("Operator N. N.");
  const auto good = chart({"add", "SN-42", "good.run"});
  EXPECT_EQ(good.exit_code, 0) << good.err << good.out;
  EXPECT_EQ(chart({"add", "SN-42", "good.run"}).exit_code, 1);
  EXPECT_THAT(chart({"add", "SN-42", "base-2.run"}).err, HasSubstr("is a run of the baseline"));
  const auto bad = chart({"add", "SN-42", "bad.run"});
  EXPECT_EQ(bad.exit_code, 1);
  EXPECT_THAT(bad.out, AllOf(HasSubstr("OUTSIDE: O_u +"), HasSubstr("issue is blocked for this bench")));
  EXPECT_THAT(chart({"lift", "SN-42", "--reason", "fine"}).err, HasSubstr("the right to approve"));
  registered.log_in("Approver N. N.");
  const std::vector<std::string> issue{"issue", own_run(), "--laboratory", "lab.toml"};
  const auto blocked = abcal(issue);
  EXPECT_EQ(blocked.exit_code, 1);
  EXPECT_THAT(blocked.err, AllOf(HasSubstr("bench bench 1"), HasSubstr("is blocked since"),
                                 HasSubstr("chart SN-42: O_u +")));
  const auto shown = chart({"show", "SN-42", "--json"});
  EXPECT_EQ(shown.exit_code, 1);
  const auto json = nlohmann::json::parse(shown.out);
  EXPECT_EQ(json["schema"], "abcal.chart/1");
  EXPECT_TRUE(json["blocked"]);
  EXPECT_EQ(json["points"].size(), 2U);

  ASSERT_EQ(chart({"lift", "SN-42", "--reason", "mount tightened"}).exit_code, 0);
  const auto issued = abcal(issue);
  EXPECT_EQ(issued.exit_code, 0) << issued.err;
  const auto again = chart({"add", "SN-42", "again.run"});
  EXPECT_EQ(again.exit_code, 0) << again.out;
  EXPECT_THAT(again.out,
              AllOf(HasSubstr("average and sums begin anew"), HasSubstr("lifted by Approver N. N. at"),
                    HasSubstr("mount tightened"), HasSubstr("in control")));
  EXPECT_EQ(abcal({"lab", "verify"}).exit_code, 0);
  EXPECT_THAT(registered.lab({"list", "audit"}), HasSubstr("block lifted: mount tightened"));

  const auto history = nlohmann::json::parse(registered.lab({"history", "SN-42", "--json"}))["records"];
  EXPECT_EQ(history["item"].size(), 1U);
  EXPECT_EQ(history["check_standard"].size(), 1U);
  EXPECT_EQ(history["check_point"].size(), 3U);
  EXPECT_EQ(history["certificate"].size(), 1U);
  const auto nobody = abcal({"lab", "history", "N-4"});  // A part of its number is another number.
  EXPECT_EQ(nobody.exit_code, 1);
  EXPECT_THAT(nobody.out, HasSubstr("no record names an item N-4"));
}

TEST_F(ChartCommands, ARunOfTheCheckStandardSaysThatItsChartWaitsForIt) {
  const std::vector<std::string> baseline = measure_baseline(5);
  test::TrainingRegister registered(folder.path());
  add_item(registered);
  ASSERT_EQ(approve(baseline).exit_code, 0);
  EXPECT_THAT(chart({"show", "SN-42"}).out, Not(HasSubstr("waits")));
  registered.log_in("Operator N. N.");
  test::write_file(folder / "today.toml", check_bench(1));
  const auto made = abcal({"run", "today.toml", "-o", "today.run"});
  ASSERT_EQ(made.exit_code, 0) << made.err;
  EXPECT_THAT(made.err,
              HasSubstr("a run of check standard SN-42, whose chart waits for it: abcal lab chart add "
                        "SN-42 today.run"));
  const auto waiting = chart({"show", "SN-42"});
  EXPECT_THAT(waiting.out, AllOf(HasSubstr("waits to be judged"), HasSubstr("measured by Operator N. N."),
                                 HasSubstr((folder / "today.run").string())));
  EXPECT_EQ(nlohmann::json::parse(chart({"show", "SN-42", "--json"}).out)["waiting"].size(), 1U);
  ASSERT_EQ(chart({"add", "SN-42", "today.run"}).exit_code, 0);
  EXPECT_THAT(chart({"show", "SN-42"}).out, Not(HasSubstr("waits")));

  // The chart does not apply to another item.
  test::write_file(folder / "other.toml", replaced(check_bench(2), "\"SN-42\"", "\"SN-43\""));
  EXPECT_THAT(abcal({"run", "other.toml", "-o", "other.run"}).err, Not(HasSubstr("check standard")));
}

TEST_F(ChartCommands, OnlyATrainingRegisterChartsSimulatedRuns) {
  const std::vector<std::string> baseline = measure_baseline(1);
  test::TrainingRegister registered(folder.path(), false);
  add_item(registered);
  const auto refused = approve({baseline[0], baseline[0], baseline[0], baseline[0], baseline[0]});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, HasSubstr("only a training register charts such a run"));
}

// The whole procedure with complete runs: a shift of 1e-4 g from point 8 on.
TEST_F(ChartCommands, LongAShiftAtPoint8Of12IsFlaggedFromThereOn) {
  const std::vector<std::string> baseline = measure_baseline(10);
  for (int k = 1; k <= 12; ++k) measure_check(std::to_string(k) + ".run", 200 + k, k >= 8 ? 1e-4 : 0.0);
  test::TrainingRegister registered(folder.path());
  add_item(registered);
  const auto approved = approve(baseline);
  ASSERT_EQ(approved.exit_code, 0) << approved.err;
  for (int k = 1; k <= 12; ++k) {
    const auto added = chart({"add", "SN-42", std::to_string(k) + ".run"});
    EXPECT_EQ(added.exit_code, k >= 8 ? 1 : 0) << k << added.out << added.err;
  }
  const auto shown = chart({"show", "SN-42", "--plot", "chart.svg"});
  EXPECT_EQ(shown.exit_code, 1);
  EXPECT_THAT(test::read_file(folder / "chart.svg"), HasSubstr("<svg"));
}

class RecordCommands : public CertificateTest {
 protected:
  void SetUp() override {
    registered_ = std::make_unique<test::TrainingRegister>(folder.path());
    for (const auto& [identity, quantity] :
         {std::pair{"STAGE-1", "angle"}, {"SITE-1", "gravity"}, {"VM-1", "voltage"}})
      registered_->lab(
          {"add", "equipment", identity, "--name", identity, "--quantity", quantity, "--serial-number", "1"});
    calibrate("EX-ANGLE-0815", "STAGE-1", "2020-01-01", "2199-01-01", "wobble_urad=3,8,2,urad");
    calibrate("EX-G-7", "SITE-1", "2020-01-01", "2199-01-01", "g_loc_mps2=9.80107,0.00002,2,m/s2");
    calibrate("EX-VOLTMETER-17", "VM-1", "2020-01-01", "2199-01-01", "voltmeter_gain=3e-5,8e-5,2,1");
    calibrate("EX-OLD", "STAGE-1", "2020-01-01", "2021-01-01", "step_deg=0,0.002,2,deg");
    registered_->log_in("Operator N. N.");
  }
  void calibrate(const char* number, const char* equipment, const char* performed, const char* due,
                 const char* value) {
    registered_->lab({"add", "calibration", number, "--equipment", equipment, "--issuer", "Example institute",
                      "--performed", performed, "--due", due, "--value", value});
  }
  void write(const std::string& effects) {
    std::string text = replaced(certificate_bench(),
                                "g_loc_mps2 = 9.80101\ng_loc_expanded_uncertainty_mps2 = 0.00003\ng_loc_k = "
                                "2.0\ng_loc_source = \"survey of 2025, EX-GRAV-7\"\n",
                                "g_loc_mps2 = { from = \"EX-G-7\" }\n");
    test::write_file(folder / "bench.toml", text + "[stage_uncertainty]\n" + effects);
  }
  std::unique_ptr<test::TrainingRegister> registered_;
};

TEST_F(RecordCommands, WhatARecordSaysIsShownUsedAndFrozenIntoTheRun) {
  write(
      "wobble_urad = { from = \"EX-ANGLE-0815\" }\nstep_deg = 0.001\n"
      "[item_uncertainty]\nvoltmeter_gain = { from = \"EX-VOLTMETER-17\" }\n");
  const auto plan = abcal({"plan", "bench.toml", "--full"});
  ASSERT_EQ(plan.exit_code, 0) << plan.err;
  // sqrt(3^2 + (8/2)^2)
  EXPECT_THAT(plan.out,
              AllOf(HasSubstr("wobble_urad: u = 5 urad: calibration EX-ANGLE-0815 of STAGE-1 by Example "
                              "institute, performed 2020-01-01, due 2199-01-01, valid on 20"),
                    HasSubstr("wobble_urad = 3 urad, U = 8 urad, k = 2"),
                    HasSubstr("Local gravity 9.80107 m/s2: calibration EX-G-7 of SITE-1")));
  const auto made = abcal({"run", "bench.toml", "-o", "b.run"});
  ASSERT_EQ(made.exit_code, 0) << made.err;
  // Without the register, the run keeps the data taken from it.
  std::filesystem::remove(folder / "register.db");
  test::TrainingRegister::leave();
  const StoredRun stored = RunFile::load(folder / "b.run");
  EXPECT_EQ(stored.header.tolerances.wobble_urad, 5.0);
  EXPECT_THAT(stored.header.tolerances.sources.at("wobble_urad"), HasSubstr("EX-ANGLE-0815"));
  EXPECT_DOUBLE_EQ(stored.header.tolerances.voltmeter_gain, 5e-5);
  EXPECT_THAT(stored.header.tolerances.sources.at("voltmeter_gain"), HasSubstr("EX-VOLTMETER-17 of VM-1"));
  EXPECT_EQ(stored.header.g_loc.value_mps2, 9.80107);
  EXPECT_EQ(stored.header.g_loc.expanded_uncertainty_mps2, 0.00002);
  EXPECT_THAT(stored.header.g_loc.source, HasSubstr("EX-G-7"));
  EXPECT_THAT(stored.header.bench_toml, Not(HasSubstr("{ from =")));
  EXPECT_EQ(abcal({"verify", "b.run"}).exit_code, 0);
  EXPECT_EQ(abcal({"analyse", "b.run"}).exit_code, 0);
}

TEST_F(RecordCommands, EveryRecordThatCannotBeUsedIsNamedWithItsLineAndDates) {
  write(
      "wobble_urad = { from = \"NONE\" }\nstep_deg = { from = \"EX-OLD\" }\nzero_deg = { from = "
      "\"EX-ANGLE-0815\" }\nalignment_deg = { from = \"EX-ANGLE-0815\", name = \"wobble_urad\" }\n"
      "step_smooth_deg = { from = \"EX-OLD\", value = 1 }\n");
  const auto refused = abcal({"plan", "bench.toml"});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(
      refused.err,
      AllOf(
          HasSubstr("5 problems"),
          testing::ContainsRegex("line [0-9]+, .stage_uncertainty. wobble_urad: found record \"NONE\", which "
                                 "the register does not have; required: one of"),
          HasSubstr(
              "calibration EX-OLD of STAGE-1 by Example institute, performed 2020-01-01, due 2021-01-01; "
              "required: a calibration that holds today, 20"),
          HasSubstr("which has no value \"zero_deg\"; required: name = one of wobble_urad"),
          HasSubstr("alignment_deg: found a value in urad: calibration EX-ANGLE-0815"),
          HasSubstr("required: the unit degree"),
          HasSubstr("[stage_uncertainty.step_smooth_deg] value: found a key of this name")));
  registered_->log_in("Approver N. N.");
  write("[item_uncertainty]\nvoltmeter_gain = { from = \"EX-VOLTMETER-17\" }\n");
  registered_->lab({"withdraw", "calibration", "EX-VOLTMETER-17", "--reason", "wrong range"});
  EXPECT_THAT(
      abcal({"run", "bench.toml"}).err,
      testing::ContainsRegex("EX-VOLTMETER-17 of VM-1 .*withdrawn on 20.* because wrong range; required: a "
                             "calibration that was not withdrawn"));
  registered_->lab({"retire", "equipment", "STAGE-1", "--reason", "sold"});
  write("wobble_urad = { from = \"EX-ANGLE-0815\" }\n");
  EXPECT_THAT(abcal({"run", "bench.toml"}).err, HasSubstr("which is retired since"));
  test::TrainingRegister::leave();
  EXPECT_THAT(abcal({"run", "bench.toml"}).err, HasSubstr("no register is configured"));
}

}  // namespace
}  // namespace abcal
