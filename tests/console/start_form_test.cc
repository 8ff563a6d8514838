// The start form: its contents before a run, and the run that it starts.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "app/bench_file/stage_record_file.h"
#include "app/console/request.h"
#include "app/console/run_choice.h"
#include "protocol/record/run_file.h"
#include "tests/console/console_fixture.h"
#include "tests/console/tray_bench.h"

namespace abcal::console {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::Not;
using Json = test::PageClient::Json;

class StartFormTest : public ConsoleTest {
 protected:
  Json form(const std::string& query = "") {
    const test::Answer answer = test::http_get(port, "/start-form" + query);
    EXPECT_EQ(answer.status, 200U) << answer.body;
    return Json::parse(answer.body);
  }
  static std::vector<std::string> lines(const Json& list) { return list.get<std::vector<std::string>>(); }
  /// Message that the page sends for a form.
  static Json start_of(const Json& form) {
    Json start = {{"do", "start"},
                  {"confirmed", true},
                  {"form", form["form"]},
                  {"bench_sha256", form["bench_sha256"]},
                  {"steps", form["plan"]["steps"]},
                  {"dwell_readings", form["plan"]["dwell_readings"]},
                  {"estimator", form["plan"]["estimator"]}};
    if (!form["item"]["serial_number"].get<std::string>().empty()) start["item"] = form["item"];
    return start;
  }
};

TEST_F(StartFormTest, ShowsWhatWouldBeStarted) {
  open();
  const Json shown = form();
  EXPECT_EQ(shown["problems"], Json::array());
  EXPECT_EQ(shown["plan"]["steps"], 12);
  EXPECT_GT(shown["duration"]["total_s"].get<double>(), 1.0);
  ASSERT_EQ(shown["predicted"].size(), 4U);
  EXPECT_GT(shown["predicted"][0]["standard_uncertainty"].get<double>(), 0.0);
  EXPECT_GT(shown["disk"]["free_bytes"].get<double>(), shown["disk"]["needed_bytes"].get<double>());
  EXPECT_TRUE(shown["last_check"].is_null());
  EXPECT_THAT(lines(shown["warnings"]), Contains(HasSubstr("has not been checked")));

  auto page = steering_page();
  ASSERT_TRUE(page->ok({{"do", "check"}, {"with_motion", true}, {"confirmed", true}}));
  page->wait_for_type("checks");
  page->wait_for_activity("idle");
  const Json checked = form();
  EXPECT_GT(checked["last_check"]["good"].get<int>(), 3);
  EXPECT_EQ(checked["last_check"]["problems"], 0);
  EXPECT_THAT(lines(checked["warnings"]), Not(Contains(HasSubstr("has not been checked"))));
}

TEST_F(StartFormTest, ShowsTheAgeAndHealthOfTheRecordOfTheStage) {
  StageRecord record;
  record.state.names = {"Zx", "Zy", "Xz"};
  record.state.mean = Eigen::VectorXd::Zero(3);
  record.state.covariance = 1e-8 * Eigen::MatrixXd::Identity(3, 3);
  record.repeatabilities = stated_repeatabilities(record.sizes);
  record.growth = half_normal(0.1);
  record.learnings = {
      {.utc = "2021-03-01T12:00:00Z", .by = "", .runs = {{"a.run", std::string(64, 'a'), "", ""}}}};
  write_stage_record(folder / "old.stage", record);
  bench.protocol += "estimator = \"joint\"\n";
  bench.stage_port += "\"\nrecord = \"" + (folder / "old.stage").string();  // A further key of [stage].
  open();
  const Json shown = form();
  const Json& old = shown["stage_record"];
  EXPECT_EQ(old["learned_utc"], "2021-03-01T12:00:00Z");
  EXPECT_GT(old["age_months"].get<double>(), old["validity_months"].get<double>());
  EXPECT_TRUE(old["last_run"].is_null());
  EXPECT_THAT(lines(shown["warnings"]), Contains(HasSubstr("learn the stage again")));
  auto page = steering_page();
  ASSERT_TRUE(page->ok(start_of(shown)));
  const Json ended = page->wait_for_type("finished");
  ASSERT_TRUE(ended["complete"].get<bool>()) << ended;
  const Json after = form()["stage_record"]["last_run"];
  EXPECT_EQ(after["name"], ended["file"]);
  EXPECT_TRUE(after["agrees"].get<bool>());
}

TEST_F(StartFormTest, PredictsLessUncertaintyOfMoreReadings) {
  open();
  const auto u = [&](const std::string& query) {
    return form(query)["predicted"][0]["standard_uncertainty"].get<double>();
  };
  EXPECT_LT(u("?dwell_readings=10000"), u("?dwell_readings=20"));
}

TEST_F(StartFormTest, ManyRequestsOfOnePersonAreNotAllPredicted) {
  bench.protocol = "steps = 360\nstep_deg = 1.0\nsettle_s = 0.05\ndwell_readings = 10\n";  // Takes a second.
  open();
  std::vector<std::unique_ptr<test::RawConnection>> requests;
  for (int k = 0; k < 10; ++k) {
    requests.push_back(std::make_unique<test::RawConnection>(port));
    requests.back()->send(fmt::format(
        "GET /start-form?dwell_readings={} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\n\r\n", 10 + k, port));
  }
  std::vector<unsigned> statuses;
  for (const auto& request : requests) statuses.push_back(request->answer().status);
  EXPECT_EQ(std::ranges::count(statuses, 200U), 4) << "the one that was being made, and three that waited";
  EXPECT_EQ(std::ranges::count(statuses, 429U), 6);
}

TEST_F(StartFormTest, StartsTheItemAndThePlanThatWereChosen) {
  bench.protocol += "[item]\nmodel = \"TA-3\"\n";
  bench.accelerometer_driver = "simulated";  // It reports no identity, so that any item may be chosen.
  open();
  const Json shown = form(
      "?serial_number=%3Cb%3ESN+7%3C/b%3E&maker=Other&model=TA-9&customer_number=INV-42&steps=16&"
      "estimator=joint");
  EXPECT_THAT(lines(shown["warnings"]), Contains(HasSubstr("TA-9")));
  auto page = steering_page();
  ASSERT_TRUE(page->ok(start_of(shown)));
  const Json ended = page->wait_for_type("finished");
  EXPECT_TRUE(ended["complete"].get<bool>()) << ended;
  const StoredRun run = RunFile::load(runs() / ended["file"].get<std::string>());
  EXPECT_EQ(run.header.labels.at("item.serial_number"), "<b>SN 7</b>");
  EXPECT_EQ(run.header.labels.at("item.model"), "TA-9");
  EXPECT_EQ(run.header.labels.at("item.customer_number"), "INV-42");
  EXPECT_EQ(run.header.steps, 16);
  EXPECT_EQ(run.record.estimator, "joint");
}

TEST_F(StartFormTest, ItemsThatAreNotThereAreLeftOutIfAPersonSaysSo) {
  open();
  std::string tray = test::small_tray();
  const std::size_t port_of_second = tray.find("port = \"simulated\"", tray.find("# item 2"));
  tray.replace(port_of_second, std::string("port = \"simulated\"").size(),
               "port = \"" + (folder / "no-such-port").string() + "\"");
  test::write_file(folder / "bench.toml", tray);
  auto page = steering_page();
  const auto start = [&] {
    const Json shown = form();
    EXPECT_EQ(shown["items"].size(), 3U);
    EXPECT_EQ(shown["items"][1]["serial_number"], "6284.000002");
    return Json{{"do", "start"},
                {"confirmed", true},
                {"form", shown["form"]},
                {"bench_sha256", shown["bench_sha256"]}};
  };
  ASSERT_TRUE(page->ok(start()));
  page->wait_for([](const Json& m) { return m["type"] == "log" && m["line"]["grade"] == "problem"; },
                 "refused");
  page->wait_for_activity("idle");
  EXPECT_EQ(run_files(), 0U);

  Json without = start();
  without["without_missing_items"] = true;
  ASSERT_TRUE(page->ok(without));
  const Json began =
      page->wait_for([](const Json& m) { return m["type"] == "snapshot" && !m["run"].is_null(); }, "a run");
  ASSERT_EQ(began["run"]["items"].size(), 3U);
  EXPECT_NE(began["run"]["items"][1]["missing"], "");
  EXPECT_EQ(began["run"]["items"][2]["missing"], "");
  page->wait_for(
      [](const Json& m) {
        return m["type"] == "dwell_done" && m["items"].size() == 2U && m["items"][1]["k"] == 3;
      },
      "an angle");
  ASSERT_TRUE(page->ok({{"do", "stop"}}));
  page->wait_for_activity("idle");
}

TEST_F(StartFormTest, OneFormStartsOneRun) {
  pace = 20.0;
  open();
  auto page = steering_page();
  const Json start = start_of(form());
  ASSERT_TRUE(page->ok(start));
  EXPECT_FALSE(page->ok(start));  // A double click.
  ASSERT_TRUE(test::wait_for([&] { return run_files() == 1U; }, test::kPatience));
  ASSERT_TRUE(page->ok({{"do", "stop"}}));
  page->wait_for_activity("idle");
  const Json reply = page->ask(start);
  EXPECT_FALSE(reply["ok"].get<bool>());
  EXPECT_THAT(reply["why"].get<std::string>(), HasSubstr("has started a run already"));
  EXPECT_EQ(run_files(), 1U);
}

TEST_F(StartFormTest, AFormOfAnotherBenchFileStartsNothing) {
  open();
  auto page = steering_page();
  const Json start = start_of(form());
  std::ofstream(folder / "bench.toml", std::ios::app) << "# changed meanwhile\n";
  const Json reply = page->ask(start);
  EXPECT_FALSE(reply["ok"].get<bool>());
  EXPECT_THAT(reply["why"].get<std::string>(), HasSubstr("the bench file has changed"));
  EXPECT_EQ(run_files(), 0U);
}

TEST_F(StartFormTest, WhatCannotBeStartedIsSaidBefore) {
  open();
  EXPECT_NE(form("?dwell_readings=20&steps=7")["plan"], Json());
  std::ofstream(folder / "bench.toml", std::ios::app) << "[protocol]\nstips = 3\n";
  EXPECT_THAT(lines(form()["problems"]), Contains(HasSubstr("bench.toml")));
}

TEST_F(StartFormTest, RefusesTextsThatAreNoSerialNumbers) {
  open();
  for (const std::string& query :
       {"?serial_number=" + std::string(kLongestItemText + 1, 'a'), std::string("?serial_number=a%0Ab"),
        std::string("?serial_number=%E2%80%AE"), std::string("?serial_number=%FF"),
        std::string("?steps=many"), std::string("?steps=99999999999999999999"), std::string("?model=TA-3"),
        std::string("?colour=red")})
    EXPECT_EQ(test::http_get(port, "/start-form" + query).status, 422U) << query;
  EXPECT_EQ(test::http_get(port, "/start-form?serial_number=" + std::string(5000, 'a')).status, 422U);
  EXPECT_EQ(test::http_get(port, "/start-form?serial_number=" + std::string(20000, 'a')).status, 431U);
}

TEST(RunChoiceTest, ReadsOnlyWhatItKnows) {
  const auto start = [](const std::string& more) {
    return std::get<StartRun>(parse_request(R"({"do":"start","confirmed":true,)" + more + "}").command)
        .choice;
  };
  const RunChoice choice = start(R"("item":{"serial_number":"SN 1"},"steps":36,"form":"f")");
  EXPECT_EQ(choice.item->serial_number, "SN 1");
  EXPECT_EQ(choice.steps, 36);
  EXPECT_EQ(choice.form, "f");
  EXPECT_THROW(start(R"("item":{"model":"TA-3"})"), RequestError);
  EXPECT_THROW(start(R"("item":{"serial_number":"a","colour":"red"})"), RequestError);
  EXPECT_THROW(start(R"("item":"SN 1")"), RequestError);
  EXPECT_FALSE(choice.without_missing_items);
  EXPECT_TRUE(start(R"("without_missing_items":true)").without_missing_items);
  EXPECT_THROW(start(R"("without_missing_items":1)"), RequestError);
  EXPECT_THROW(start(R"("steps":3)"), RequestError);
  EXPECT_THROW(start(R"("steps":12.5)"), RequestError);
  EXPECT_THROW(start(R"("dwell_readings":3)"), RequestError) << "fewer than a bench file may have";
  EXPECT_THROW(start(R"("item":{"serial_number":"a\nb"})"), RequestError);
}

}  // namespace
}  // namespace abcal::console
