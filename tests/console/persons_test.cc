// Persons of the register at the console: their rights, and that a run records who did what.

#include "app/console/persons.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "app/console/login_throttle.h"
#include "app/laboratory/compare/check_chart.h"
#include "app/laboratory/register/register.h"
#include "app/system/real_clock.h"
#include "protocol/record/run_operator.h"
#include "tests/console/console_fixture.h"

namespace abcal::console {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::Not;
using Json = test::PageClient::Json;

constexpr const char* kPassword = "correct horse 7";
const Json kStartRun = {{"do", "start"}, {"confirmed", true}};

/// A console with a register of an administrator, two operators and one who may only watch.
class PersonsTest : public ConsoleTest {
 protected:
  PersonsTest() {
    constexpr auto kCost = lab::PasswordCost::kForTests;
    const Clock::UtcTime now = RealClock().utc_now();
    options.register_location = (folder / "register.db").string();
    lab::Register made = lab::Register::create(
        options.register_location, {"Example laboratory", true, "", "Admin N. N.", kPassword, kCost}, now);
    const lab::LoggedIn admin =
        made.who(made.log_in("Admin N. N.", kPassword, now, std::chrono::hours(1)), now);
    for (const char* name : {"Operator N. N.", "Other N. N."})
      made.add_person(admin, {name, "technician", "", {lab::Right::kMeasure}, {}, {}}, kPassword, now, kCost);
    made.add_person(admin,
                    {"Approver N. N.", "head", "", {lab::Right::kApprove, lab::Right::kMeasure}, {}, {}},
                    kPassword, now, kCost);
    made.add_person(admin, {"Watcher N. N.", "guest", "", {}, {}, {}}, kPassword, now, kCost);
    identity = made.facts().identity;
    // The process that holds the bench asks the same register.
    ::setenv("ABCAL_REGISTER", options.register_location.c_str(), 1);
    ::setenv("XDG_STATE_HOME", (folder / "state").c_str(), 1);
  }
  ~PersonsTest() override {
    close();
    ::unsetenv("ABCAL_REGISTER");
    ::unsetenv("XDG_STATE_HOME");
  }

  test::Answer try_to_log_in(std::string name, const std::string& password = kPassword) {
    std::replace(name.begin(), name.end(), ' ', '+');
    std::string escaped = password;
    std::replace(escaped.begin(), escaped.end(), ' ', '+');
    return test::http_post(port, "/login", "name=" + name + "&password=" + escaped);
  }
  /// The cookie of someone who has logged in.
  test::Headers logged_in(const std::string& name) {
    const test::Answer answer = try_to_log_in(name);
    EXPECT_EQ(answer.status, 303U) << answer.body;
    const auto cookie = answer.headers.find("Set-Cookie");
    if (cookie == answer.headers.end()) return {};
    return {{"Cookie", cookie->second.substr(0, cookie->second.find(';'))}};
  }
  unsigned status_of(const char* path, const test::Headers& headers = {}) {
    return test::http_get(port, path, headers).status;
  }
  StoredRun only_run() {
    for (const auto& entry : std::filesystem::directory_iterator(runs()))
      if (entry.path().extension() == ".run") return RunFile::load(entry.path());
    return {};
  }
  static std::vector<std::string> events_of(const StoredRun& run, const std::string& kind) {
    std::vector<std::string> texts;
    for (const RunEvent& event : run.events)
      if (event.kind == kind) texts.push_back(event.text);
    return texts;
  }

  std::string identity;  ///< Identity of the register.
};

TEST_F(PersonsTest, NothingIsShownUntilAPersonHasLoggedIn) {
  open();
  for (const char* path : {"/", "/app.js", "/runs", "/who"}) EXPECT_EQ(status_of(path), 401U) << path;
  EXPECT_THAT(test::http_get(port, "/").body, HasSubstr("name=\"password\""));
  EXPECT_EQ(try_to_log_in("Operator N. N.", "another horse 7").status, 401U);
  EXPECT_EQ(try_to_log_in("Nobody").status, 401U);
  EXPECT_EQ(
      status_of("/runs", {{"Cookie", "abcal_login_" + std::to_string(port) + "=" + std::string(64, 'a')}}),
      401U);
  const test::Answer welcome = try_to_log_in("Operator N. N.");
  ASSERT_EQ(welcome.status, 303U) << welcome.body;
  EXPECT_THAT(welcome.headers.at("Set-Cookie"),
              testing::MatchesRegex(
                  "abcal_login_[0-9]+=[0-9a-f]{64}; HttpOnly; SameSite=Strict; Path=/; Max-Age=28800"));
  const test::Headers person = logged_in("Operator N. N.");
  EXPECT_EQ(status_of("/runs", person), 200U);
  const Json who = Json::parse(test::http_get(port, "/who", person).body);
  EXPECT_EQ(who["person"], "Operator N. N.");
  EXPECT_EQ(who["may_steer"], true);
  EXPECT_THAT(logged(), Not(HasSubstr("horse")));
}

TEST_F(PersonsTest, TheRunSaysWhoOperatedAndWhoDidWhat) {
  pace = 20.0;
  open();
  auto page = steering_page(logged_in("Operator N. N."));
  ASSERT_TRUE(page->ok(kStartRun));
  page->wait_for_type("dwell_done");
  ASSERT_TRUE(page->ok({{"do", "hold"}}));
  ASSERT_TRUE(page->ok({{"do", "note"}, {"text", "door opened"}}));
  page->wait_for([](const Json& m) { return m["type"] == "phase" && m["phase"] == "held"; }, "the hold");
  // Another takes over, and is an operator of this run from then on.
  auto other = std::make_unique<test::PageClient>(port, logged_in("Other N. N."));
  ASSERT_TRUE(other->ok({{"do", "control"}, {"from_another", true}}));
  page->wait_for(
      [](const Json& m) {
        return m["type"] == "control" && m.value("who", "").starts_with("Other N. N., page");
      },
      "who has it now");
  // A person who may not measure steers nothing, but may stop it.
  test::PageClient watcher(port, logged_in("Watcher N. N."));
  EXPECT_EQ(watcher.wait_for_type("you")["may_steer"], false);
  EXPECT_THAT(watcher.ask({{"do", "control"}, {"from_another", true}})["why"].get<std::string>(),
              HasSubstr("required: a person with the right to measure"));
  EXPECT_FALSE(watcher.ok({{"do", "continue"}, {"confirmed", true}}));
  ASSERT_TRUE(watcher.ok({{"do", "stop"}}));
  EXPECT_FALSE(other->wait_for_type("finished")["complete"].get<bool>());

  const StoredRun run = only_run();
  const std::vector<RunOperator> operators{{"Operator N. N.", identity}, {"Other N. N.", identity}};
  EXPECT_EQ(operators_of(run), operators);
  const auto says = [&](const char* kind, const std::string& who) {
    EXPECT_THAT(events_of(run, kind), Contains(HasSubstr(who + ", register " + identity + ", page ")))
        << kind;
  };
  says("hold asked for", "Operator N. N.");
  says("note", "Operator N. N.");
  says("control taken", "Other N. N.");
  says("stop asked for", "Watcher N. N.");
}

TEST_F(PersonsTest, ACompleteRunIsWholeAndItsOperatorVerified) {
  open();
  auto page = steering_page(logged_in("Operator N. N."));
  ASSERT_TRUE(page->ok(kStartRun));
  const Json ended = page->wait_for_type("finished");
  ASSERT_TRUE(ended["complete"].get<bool>()) << ended;
  page->wait_for_activity("idle");
  EXPECT_EQ(describe(operators_of(only_run())), "Operator N. N.");
  const test::ProgramResult verified =
      test::run_program({"verify", "runs/" + ended["file"].get<std::string>()}, folder.path());
  EXPECT_EQ(verified.exit_code, 0) << verified.out << verified.err;
}

/// A chart in the register of the item and bench of this run, with a baseline that was approved.
void add_chart_of(const StoredRun& run, const std::string& location, const std::string& approver) {
  std::vector<CheckRun> baseline(5);
  for (std::size_t k = 0; k < baseline.size(); ++k) {
    static_cast<ChartSubject&>(baseline[k]) = subject_of(run);
    baseline[k].sha256 = std::to_string(k);
    for (Eigen::Index i = 0; i < 9; ++i)
      baseline[k].values(i) = std::sin(static_cast<double>(k) + 10.0 * static_cast<double>(i));
  }
  const Clock::UtcTime now = RealClock().utc_now();
  lab::Register opened = lab::Register::open(location, now);
  const lab::LoggedIn by = opened.who(opened.log_in(approver, kPassword, now, std::chrono::hours(1)), now);
  opened.add_item(by, {"Item", "", "", "", "", {}}, now);
  opened.add_check_standard(
      by, {"CHECK", "Item", baseline_json(make_baseline(baseline, kUsualRunLength)), {}, {}, {}}, now);
}

// The console behaves like `abcal run`: the page shows it, and the register knows who measured.
TEST_F(PersonsTest, ARunOfACheckStandardIsToldToItsChart) {
  open();
  auto page = steering_page(logged_in("Operator N. N."));
  ASSERT_TRUE(page->ok(kStartRun));
  ASSERT_TRUE(page->wait_for_type("finished")["complete"].get<bool>());
  page->wait_for_activity("idle");
  add_chart_of(only_run(), options.register_location, "Approver N. N.");
  ASSERT_TRUE(page->ok(kStartRun));
  const Json line = page->wait_for(
      [](const Json& m) {
        return m.contains("line") &&
               m["line"]["text"].get<std::string>().find("check standard") != std::string::npos;
      },
      "that a chart waits for it");
  EXPECT_THAT(
      line["line"]["text"].get<std::string>(),
      HasSubstr(
          "This is a run of check standard CHECK, whose chart waits for it: abcal lab chart add CHECK"));
  page->wait_for_activity("idle");
  lab::Register opened = lab::Register::open(options.register_location, RealClock().utc_now());
  const std::vector<lab::CheckRunNotice> waiting = opened.waiting_check_runs("CHECK");
  ASSERT_EQ(waiting.size(), 1U);
  EXPECT_EQ(waiting.front().told_by, "Operator N. N.");
}

TEST_F(PersonsTest, ABenchFileThatNamesAnotherPersonIsRefused) {
  open();
  test::write_file(folder / "bench.toml", bench.text() + "[operator]\nname = \"Other N. N.\"\n");
  auto page = steering_page(logged_in("Operator N. N."));
  ASSERT_TRUE(page->ok(kStartRun));
  const Json line = page->wait_for(
      [](const Json& m) { return m["type"] == "log" && m["line"]["grade"] == "problem"; }, "why not");
  EXPECT_THAT(line["line"]["text"].get<std::string>(), HasSubstr("Operator N. N. is logged in"));
  EXPECT_EQ(run_files(), 0U);
}

TEST_F(PersonsTest, AfterFiveFailuresEvenTheRightPasswordHasToWait) {
  open();
  for (int i = 0; i < LoginThrottle::kFree; ++i)
    EXPECT_EQ(try_to_log_in("Operator N. N.", "another horse 7").status, 401U) << i;
  const test::Answer slowed = try_to_log_in("Operator N. N.");
  EXPECT_EQ(slowed.status, 429U);
  EXPECT_EQ(slowed.headers.at("Retry-After"), "1");
  EXPECT_TRUE(test::wait_for([&] { return try_to_log_in("Operator N. N.").status == 303; }, test::kPatience));
}

TEST_F(PersonsTest, GuessesAtTheSameTimeHaveToWaitToo) {
  open();
  std::vector<std::string> forms(18, "name=Operator+N.+N.&password=another+horse+7");
  forms.push_back("name=Operator+N.+N.&password=correct+horse+7");
  const std::vector<unsigned> statuses = test::post_at_once(port, "/login", forms);
  EXPECT_LE(std::ranges::count(statuses, 401U), LoginThrottle::kFree + 1);
  EXPECT_EQ(statuses.back(), 429U) << "the right guess, too";
}

TEST_F(PersonsTest, WhoLogsOutIsOutEverywhere) {
  open();
  const test::Headers person = logged_in("Operator N. N."), other = logged_in("Other N. N.");
  test::PageClient page(port, person), another(port, other);
  page.wait_for_type("snapshot");
  const test::Answer bye = test::http_post(port, "/logout", "", person);
  EXPECT_EQ(bye.status, 303U);
  EXPECT_THAT(bye.headers.at("Set-Cookie"), HasSubstr("Max-Age=0"));
  EXPECT_TRUE(page.wait_for_end());
  EXPECT_TRUE(test::wait_for([&] { return status_of("/runs", person) == 401; }, test::kPatience))
      << "the register knows it as well";
  EXPECT_EQ(status_of("/runs", other), 200U);
  another.wait_for_type("snapshot");
}

TEST(Persons, AreForgottenWhenTheirLoginEnds) {
  const Clock::UtcTime now = RealClock().utc_now();
  Persons persons;
  persons.remember(
      {{"Operator N. N.", "a register"}, true, "a login", format_utc(now + std::chrono::hours(8))});
  EXPECT_EQ(persons.find("a logi", now), nullptr);
  ASSERT_NE(persons.find("a login", now + std::chrono::hours(7)), nullptr);
  EXPECT_EQ(persons.find("a login", now + std::chrono::hours(8)), nullptr);
  EXPECT_TRUE(persons.logins().empty());
}

TEST_F(PersonsTest, ALoginOutlivesTheConsoleAndServesPrograms) {
  open();
  const std::string cookie = logged_in("Operator N. N.").at("Cookie");
  const test::Headers bearer{{"Authorization", "Bearer " + cookie.substr(cookie.find('=') + 1)}};
  EXPECT_EQ(status_of("/runs", bearer), 200U);
  close();
  open();
  EXPECT_EQ(status_of("/runs", bearer), 200U);
  auto page = steering_page(bearer);
}

TEST_F(PersonsTest, TheTokenLetsADisplayWatchAndStop) {
  options.access.token = "0123456789abcdef";
  open();
  const test::Headers display{{"Authorization", "Bearer 0123456789abcdef"}};
  EXPECT_EQ(status_of("/runs", display), 200U);
  test::PageClient page(port, display);
  page.wait_for_type("snapshot");
  EXPECT_THAT(page.ask({{"do", "control"}})["why"].get<std::string>(), HasSubstr("may watch and stop"));
  EXPECT_THAT(page.ask({{"do", "stop"}})["why"].get<std::string>(), HasSubstr("nothing is in progress"));
}

TEST_F(PersonsTest, ARegisterThatIsLostEndsNoLogin) {
  open();
  const test::Headers person = logged_in("Operator N. N.");
  std::filesystem::rename(folder / "register.db", folder / "elsewhere.db");
  EXPECT_EQ(status_of("/runs", person), 200U);
  const test::Answer refused = try_to_log_in("Other N. N.");
  EXPECT_EQ(refused.status, 503U);
  EXPECT_THAT(refused.body, HasSubstr("The register cannot be read"));
}

TEST_F(PersonsTest, WhomTheRegisterRetiresIsKnownToHaveEnded) {
  const Clock::UtcTime now = RealClock().utc_now();
  lab::Register opened = lab::Register::open(options.register_location, now);
  const auto log_in = [&](const char* name) {
    return register_of_persons::log_in(options.register_location, name, kPassword, now, std::chrono::hours(1))
        .login;
  };
  const std::string operators = log_in("Operator N. N."), others = log_in("Other N. N.");
  opened.retire_person(opened.who(log_in("Admin N. N."), now), "Other N. N.", "has left", now);
  EXPECT_EQ(register_of_persons::ended(options.register_location, {operators, others}, now),
            std::vector<std::string>{others});
  EXPECT_THROW((void)register_of_persons::look_up(options.register_location, others, now), LoginRefused);
}

}  // namespace
}  // namespace abcal::console
