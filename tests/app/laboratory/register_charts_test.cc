// Check standards, blocks and the scope in the register, on both databases.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "app/laboratory/register/register.h"
#include "app/laboratory/register/register_schema.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"
#include "tests/app/laboratory/register_fixtures.h"

namespace abcal::lab {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class RegisterChartsTest : public OnDatabase {
 protected:
  /// A chart "A" of an item, approved.
  Register with_chart() {
    Register made = with_people();
    made.add_item(login(made, "Operator N. N."), {"", "Maker", "M-3", "SN-42", "", {}}, at(3));
    made.add_check_standard(login(made, "Approver N. N."), {"A", "Maker M-3 SN-42", "{}", {}, {}, {}}, at(4));
    return made;
  }
  static CheckPoint point(const std::string& run, bool outside) {
    CheckPoint made;
    made.check_standard = "A";
    made.run_sha256 = sha256_of(run);
    made.date = "2026-03-01T00:00:00Z";
    made.values_json = "{}";
    made.outside = outside;
    made.found = outside ? "O_u +12.0 standard deviations" : "";
    return made;
  }
  static BenchBlock bench() {
    BenchBlock block;
    block.stage = "Stage 118001234";
    block.bench = "bench 1";
    return block;
  }
  static NumberRequest request(const std::string& run, const std::string& stage, const std::string& name) {
    return {sha256_of(run), "Maker M-3 SN-7", "Operator N. N.", {}, {}, stage, name};
  }
};
ABCAL_ON_BOTH_DATABASES(RegisterChartsTest);

TEST_P(RegisterChartsTest, ABaselineNeedsTheRightToApproveAndAnItem) {
  Register made = with_people();
  const LoggedIn approver = login(made, "Approver N. N."), operator_ = login(made, "Operator N. N.");
  const CheckStandard standard{"A", "Maker M-3 SN-42", "{}", {}, {}, {}};
  EXPECT_THAT(refusal([&] { made.add_check_standard(operator_, standard, at(3)); }),
              HasSubstr("the right to approve"));
  EXPECT_THAT(refusal([&] { made.add_check_standard(approver, standard, at(3)); }),
              AllOf(HasSubstr("Maker M-3 SN-42: is not in the register"), HasSubstr("abcal lab add item")));
  made.add_item(operator_, {"", "Maker", "M-3", "SN-42", "", {}}, at(3));
  made.add_check_standard(approver, standard, at(4));
  EXPECT_EQ(made.check_standard("A").approved_by, "Approver N. N.");
  EXPECT_EQ(made.check_standard("A").approved_utc, format_utc(at(4)));
  // It is frozen: no other takes its name, also where it is retired.
  made.retire_check_standard(approver, "A", "new sensor", at(5));
  EXPECT_THAT(refusal([&] { made.add_check_standard(approver, standard, at(6)); }), HasSubstr("already"));
  EXPECT_THAT(refusal([&] { made.check_standard("B"); }), HasSubstr("which has A"));
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterChartsTest, APointOutsideBlocksItsBenchUntilItIsLifted) {
  Register made = with_chart();
  const LoggedIn approver = login(made, "Approver N. N."), operator_ = login(made, "Operator N. N.");
  EXPECT_EQ(made.add_check_point(operator_, point("1", false), 0, bench(), at(5)).identity, "A/1");
  EXPECT_EQ(made.reserve_number(approver, request("x", "Stage 118001234", "bench 1"), at(6)).number,
            "EX-2026-0001");
  EXPECT_EQ(made.add_check_point(operator_, point("2", true), 1, bench(), at(7)).identity, "A/2");
  made.add_check_point(operator_, point("3", true), 2, bench(), at(8));
  ASSERT_EQ(made.blocks().size(), 1U);  // One block a chart, by the first point.
  EXPECT_EQ(made.blocks()[0].identity, "A/2");

  // Stage or name is enough; the number that was given before is not issued either; other benches go on.
  for (const auto& [stage, name] : {std::pair{"Stage 118001234", "another name"},
                                    {"Stage 9", "bench 1"},
                                    {"Stage 118001234", "bench 1"}}) {
    EXPECT_THAT(
        refusal([&, s = stage, n = name] { made.reserve_number(approver, request("y", s, n), at(9)); }),
        AllOf(HasSubstr("is blocked since"), HasSubstr("chart A: O_u +12.0 standard deviations"),
              HasSubstr("abcal lab chart lift A --reason TEXT")));
  }
  EXPECT_THAT(refusal([&] { made.reserve_number(approver, request("x", "Stage 118001234", ""), at(9)); }),
              HasSubstr("is blocked"));
  EXPECT_EQ(made.reserve_number(approver, request("z", "Stage 9", "bench 2"), at(9)).number, "EX-2026-0002");

  EXPECT_THAT(refusal([&] { made.lift_block(operator_, "A", "fine again", at(10)); }),
              HasSubstr("the right to approve"));
  EXPECT_THAT(refusal([&] { made.lift_block(approver, "A", " ", at(10)); }), HasSubstr("no reason"));
  made.lift_block(approver, "A", "mount tightened", at(10));
  EXPECT_THAT(refusal([&] { made.lift_block(approver, "A", "again", at(11)); }),
              HasSubstr("blocks no bench"));
  EXPECT_EQ(made.reserve_number(approver, request("y", "Stage 118001234", "bench 1"), at(11)).number,
            "EX-2026-0003");
  EXPECT_EQ(made.blocks()[0].lifted_by, "Approver N. N.");

  std::string audit;
  for (const AuditEntry& entry : made.audit()) audit += entry.who + ": " + entry.what + "\n";
  EXPECT_THAT(
      audit, AllOf(HasSubstr("Approver N. N.: baseline approved"),
                   HasSubstr("Operator N. N.: check run outside"), HasSubstr("Operator N. N.: bench blocked"),
                   HasSubstr("Approver N. N.: block lifted: mount tightened")));
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterChartsTest, ARunIsOnePointAndNothingComesBetween) {
  Register made = with_chart();
  const LoggedIn operator_ = login(made, "Operator N. N.");
  made.add_check_point(operator_, point("1", false), 0, bench(), at(5));
  EXPECT_THAT(refusal([&] { made.add_check_point(operator_, point("1", false), 1, bench(), at(6)); }),
              HasSubstr("is its point A/1 already"));
  EXPECT_THAT(refusal([&] { made.add_check_point(operator_, point("2", false), 0, bench(), at(6)); }),
              HasSubstr("meanwhile"));
  for (int k = 2; k <= 11; ++k)
    made.add_check_point(operator_, point(std::to_string(k), false), static_cast<std::size_t>(k - 1), bench(),
                         at(6));
  EXPECT_EQ(made.check_points("A").back().identity, "A/11");  // In the order in which they came.
  made.retire_check_standard(login(made, "Approver N. N."), "A", "replaced", at(7));
  EXPECT_THAT(refusal([&] { made.add_check_point(operator_, point("x", false), 11, bench(), at(8)); }),
              HasSubstr("is retired"));
}

TEST_P(RegisterChartsTest, WhatIsChangedBehindItsBackIsFound) {
  Register made = with_chart();
  made.add_check_point(login(made, "Operator N. N."), point("1", true), 0, bench(), at(5));
  ASSERT_EQ(bad(made), "");
  const std::string kept = made.backup();
  const std::pair<const char*, const char*> changes[] = {
      {"delete from bench_block", "bench_block/A/1 is missing"},
      {"update bench_block set lifted_utc = '2026-03-01T12:00:09Z'", "bench_block/A/1 is not as"},
      {"update check_point set state = 'inside'", "check_point/A/1 is not as"},
      {"update check_standard set baseline_json = '{\"centre\":1}'", "check_standard/A is not as"},
  };
  for (const auto& [sql, words] : changes) {
    Register copy = Register::restore(new_location(), kept, at(6));
    ASSERT_EQ(bad(copy), "");
    Database(copy.location()).execute(sql);
    EXPECT_THAT(bad(copy), HasSubstr(words)) << sql;
  }
}

TEST_P(RegisterChartsTest, TheScopeIsKeptWithEveryDigit) {
  Register made = with_people();
  const LoggedIn approver = login(made, "Approver N. N.");
  EXPECT_THAT(refusal([&] {
                made.add_scope(approver, {"S", "mass", "", 2.0, 1.0, 0.0, false, {}, {}}, at(3));
              }),
              AllOf(HasSubstr("sensitivity, angle, offset"), HasSubstr("no unit"), HasSubstr("from 2 to 1"),
                    HasSubstr("CMC 0")));
  EXPECT_THAT(refusal([&] {
                made.add_scope(login(made, "Operator N. N."),
                               {"S", "offset", "g", -1, 1, 1e-4, false, {}, {}}, at(3));
              }),
              HasSubstr("the right to approve"));
  made.add_scope(approver, {"S", "sensitivity", "V/g_loc", 0.1, 1.0 / 3.0, 2.3e-5, true, {}, {}}, at(3));
  ASSERT_EQ(made.scope().size(), 1U);
  EXPECT_EQ(made.scope()[0].to, 1.0 / 3.0);
  EXPECT_EQ(made.scope()[0].cmc, 2.3e-5);
  EXPECT_TRUE(made.scope()[0].relative);
  made.retire_scope(approver, "S", "reassessed", at(4));
  EXPECT_EQ(made.scope()[0].retired, format_utc(at(4)));
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterChartsTest, ARunThatTheRegisterWasToldOfWaitsUntilItIsJudged) {
  Register made = with_chart();
  const LoggedIn operator_ = login(made, "Operator N. N.");
  CheckRunNotice told;
  told.check_standard = "A";
  told.run_sha256 = sha256_of("r1");
  told.file = "/data/r1.run";
  told.date = "2026-03-01T00:00:00Z";
  made.tell_check_run(operator_, told, at(5));
  made.tell_check_run(operator_, told, at(6));  // Once.
  ASSERT_EQ(made.waiting_check_runs("A").size(), 1U);
  EXPECT_EQ(made.waiting_check_runs("A")[0].told_by, "Operator N. N.");
  EXPECT_EQ(made.waiting_check_runs("A")[0].utc, format_utc(at(5)));
  EXPECT_TRUE(made.waiting_check_runs("B").empty());
  made.add_check_point(operator_, point("r1", false), 0, bench(), at(7));
  EXPECT_TRUE(made.waiting_check_runs("A").empty());
  EXPECT_EQ(bad(made), "");
}

TEST_P(RegisterChartsTest, ARegisterOfTheFirstStepIsBroughtToTheNewest) {
  Register made = with_people();
  nlohmann::json backup = nlohmann::json::parse(made.backup());
  // State as written by the program of the first step.
  backup["step"] = 1;
  auto& steps = backup["tables"]["schema_step"];
  while (steps.size() > 1) steps.erase(steps.size() - 1);
  const std::vector<std::string> later{"check_point",    "bench_block", "scope",     "check_run",
                                       "witnessed_head", "used_source", "known_run", "certified_run",
                                       "addressee",      "withdrawal",  "retention"};
  for (const std::string& table : later) backup["tables"].erase(table);
  Register restored = Register::restore(new_location(), backup.dump(), at(5));
  EXPECT_EQ(bad(restored), "");
  EXPECT_TRUE(restored.scope().empty());
  EXPECT_EQ(nlohmann::json::parse(restored.backup())["step"], kNewestSchemaStep);

  const std::string old = new_location();
  {
    Register one = Register::restore(old, backup.dump(), at(5));
    Database database(old);
    for (const std::string& table : later) database.execute("drop table " + table);
    for (const char* index : {"calibration_of_equipment", "certificate_by_replaced"})
      database.execute(std::string("drop index ") + index);
    database.execute("delete from schema_step where step > 1");
  }
  Register opened = Register::open(old, at(6));
  EXPECT_TRUE(opened.blocks().empty());
  EXPECT_EQ(bad(opened), "");
  backup["step"] = kNewestSchemaStep + 1;
  EXPECT_THAT(refusal([&] { Register::restore(new_location(), backup.dump(), at(5)); }),
              HasSubstr("this program restores 1 to"));
}

}  // namespace
}  // namespace abcal::lab
