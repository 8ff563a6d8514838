// Rules by which a witness signs or refuses, and findings in its log.
#include "app/witness/witness_log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <string>
#include <vector>

#include "protocol/record/sqlite.h"
#include "tests/app/witness/witness_fixtures.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr std::uint32_t kUser = 1000;

class WitnessLogTest : public WitnessTest {
 protected:
  WitnessedLine answer(const WitnessRequest& request) { return log->answer(request, kUser); }

  WitnessStatement statement(const WitnessRequest& request) {
    return parse_witness_line(answer(request).line);
  }

  std::string refusal(const WitnessRequest& request) {
    const std::int64_t before = log->size();
    try {
      (void)answer(request);
    } catch (const WitnessRefusal& refused) {
      EXPECT_EQ(log->size(), before) << "nothing is signed";
      return refused.what();
    }
    ADD_FAILURE() << "not refused: " << to_json(request);
    return {};
  }

  /// A run with two dwells.
  void begin_run() {
    answer(begin_request());
    answer(link_request(1));
    answer(link_request(2));
  }

  void change(const std::string& sql) const {
    SqliteDatabase(file, SqliteDatabase::Mode::kReadWrite).execute(sql);
  }

  std::unique_ptr<WitnessLog> log = open_log();
};

TEST_F(WitnessLogTest, SignsARunFromItsBeginningToItsEnd) {
  std::string before;
  std::int64_t counter = 0;
  for (const WitnessRequest& request :
       {begin_request(), link_request(1), link_request(2), close_request(2), head_request(5)}) {
    const WitnessedLine line = answer(request);
    EXPECT_TRUE(is_witnessed_by(line, public_pem));
    const WitnessStatement found = parse_witness_line(line.line);
    EXPECT_EQ(static_cast<const WitnessRequest&>(found), request);
    EXPECT_EQ(found.counter, ++counter);
    EXPECT_EQ(found.before, before);
    EXPECT_EQ(found.uid, kUser);
    EXPECT_EQ(found.boot_id, "boot-1");
    before = sha256_of(line.line);
  }
  EXPECT_THAT(log->verify(), IsEmpty());
  const WitnessStatement last = parse_witness_line(log->fetch("register-1", WitnessAct::kHead, 5)->line);
  EXPECT_EQ(last.utc, "2026-03-01T12:00:05.000Z");
  EXPECT_EQ(last.since_boot_ns, 105'000'000'000);
}

TEST_F(WitnessLogTest, ARepetitionGetsTheStoredLine) {
  std::vector<WitnessedLine> first;
  const std::vector<WitnessRequest> requests{begin_request(), link_request(1), link_request(2),
                                             close_request(2), head_request(5)};
  for (const WitnessRequest& request : requests) first.push_back(answer(request));
  log = open_log();  // A witness that starts again.
  for (std::size_t k = 0; k < requests.size(); ++k) EXPECT_EQ(log->answer(requests[k], 7), first[k]);
  EXPECT_EQ(log->size(), 5);
}

TEST_F(WitnessLogTest, ARunHasOneBenchAndOneKindOfTime) {
  answer(begin_request());
  for (const auto& change : std::vector<std::function<void(WitnessRequest&)>>{
           [](WitnessRequest& begin) { begin.bench = "right"; },
           [](WitnessRequest& begin) { begin.simulated = true; }}) {
    WitnessRequest other = begin_request();
    change(other);
    EXPECT_THAT(refusal(other),
                AllOf(HasSubstr(to_json(other)), HasSubstr("has signed"), HasSubstr("A. B.")));
  }
}

TEST_F(WitnessLogTest, ARunGoesOnBehindAnglesThatWereNotSignedAndItsBeginningsShowThem) {
  begin_run();
  WitnessRequest goes_on = begin_request();
  goes_on.person = "C. D.";
  goes_on.head = sha256_of("the link of an angle that was not signed");
  const WitnessedLine line = answer(goes_on);
  EXPECT_EQ(parse_witness_line(line.line).counter, 4);
  EXPECT_EQ(answer(goes_on), line) << "asked once more";
  EXPECT_THAT(refusal(link_request(3)), HasSubstr("required: " + goes_on.head));
  WitnessRequest next = link_request(3);
  next.previous = goes_on.head;
  answer(next);
  EXPECT_THAT(log->verify(), IsEmpty());
}

TEST_F(WitnessLogTest, ALinkNeedsItsRun) {
  EXPECT_THAT(refusal(link_request(1)), HasSubstr("run-1: found no beginning"));
  answer(begin_request("run-2"));
  EXPECT_THAT(refusal(link_request(1)), HasSubstr("run-1: found no beginning"));
  EXPECT_EQ(statement(link_request(1, "run-2")).k, 1);
}

TEST_F(WitnessLogTest, ALinkFollowsTheOneBefore) {
  answer(begin_request());
  WitnessRequest first = link_request(1);
  first.previous = sha256_of("another head");
  EXPECT_THAT(refusal(first), AllOf(HasSubstr(first.previous), HasSubstr(link_of("run-1", 0))));
  EXPECT_THAT(refusal(link_request(2)), AllOf(HasSubstr("found dwell 2"), HasSubstr("required: dwell 1")));
  answer(link_request(1));
  EXPECT_THAT(refusal(link_request(3)), HasSubstr("required: dwell 2"));
  WitnessRequest second = link_request(2);
  second.previous = sha256_of("another dwell");
  EXPECT_THAT(refusal(second), AllOf(HasSubstr("found the link before " + second.previous),
                                     HasSubstr("required: " + link_of("run-1", 1))));
  EXPECT_EQ(statement(link_request(2)).k, 2);
}

TEST_F(WitnessLogTest, ADwellThatWasSignedIsNotReplaced) {
  begin_run();
  for (const std::int64_t k : {1, 2}) {
    WitnessRequest other = link_request(k);
    other.now = sha256_of("other readings");
    EXPECT_THAT(refusal(other), AllOf(HasSubstr(other.now), HasSubstr(link_of("run-1", k))));
  }
}

TEST_F(WitnessLogTest, ARunEndsOnceWithTheLastLink) {
  EXPECT_THAT(refusal(close_request(2)), HasSubstr("run-1: found no beginning"));
  begin_run();
  WitnessRequest other = close_request(2);
  other.now = sha256_of("other readings");
  EXPECT_THAT(refusal(other), AllOf(HasSubstr(other.now), HasSubstr(link_of("run-1", 2))));
  EXPECT_THAT(refusal(close_request(1)),
              AllOf(HasSubstr("an end with 1 dwells"), HasSubstr("required: 2 dwells")));
  other = close_request(2);
  other.k = 3;
  EXPECT_THAT(refusal(other), HasSubstr("an end with 3 dwells"));
  answer(close_request(2));
  other = close_request(2);
  other.events = sha256_of("other events");
  EXPECT_THAT(refusal(other), AllOf(HasSubstr(other.events), HasSubstr(close_request(2).events)));
  EXPECT_THAT(refusal(link_request(3)),
              AllOf(HasSubstr("found closed at 2026-03-01T12:00:04"), HasSubstr("2 dwells")));
}

TEST_F(WitnessLogTest, ARunWithoutDwellsEndsWithItsHead) {
  answer(begin_request());
  WitnessRequest other = close_request(0);
  other.now = sha256_of("another head");
  EXPECT_THAT(refusal(other), HasSubstr(link_of("run-1", 0)));
  EXPECT_EQ(statement(close_request(0)).k, 0);
}

TEST_F(WitnessLogTest, ASimulatedRunHasABeginningAndAnEndOnly) {
  answer(begin_request("run-1", true));
  EXPECT_THAT(refusal(link_request(1)), HasSubstr("simulated"));
  EXPECT_EQ(statement(close_request(117)).now, link_of("run-1", 117));
}

TEST_F(WitnessLogTest, ARegisterDoesNotLoseEntries) {
  answer(head_request(5));
  EXPECT_THAT(refusal(head_request(5, "rewritten")),
              AllOf(HasSubstr(sha256_of("rewritten")), HasSubstr(head_request(5).head)));
  answer(head_request(9));
  const auto is_put_back = AllOf(HasSubstr("found 5 entries with the head " + head_request(5).head),
                                 HasSubstr("9 entries with the head " + head_request(9).head));
  EXPECT_THAT(refusal(head_request(5)), is_put_back) << "the same head as before, but entries are lost";
  EXPECT_EQ(statement(head_request(2, "", "register-2")).entries, 2) << "another register";
  EXPECT_EQ(parse_witness_line(log->fetch_latest("register-1", WitnessAct::kHead)->line).entries, 9);
  EXPECT_EQ(statement(head_request(10)).entries, 10);
}

TEST_F(WitnessLogTest, AnInvalidRequestIsRefused) {
  WitnessRequest request = begin_request();
  request.head = "no link";
  EXPECT_THAT(refusal(request), HasSubstr("\"head\""));
  request = begin_request(std::string(kLongestWitnessedText + 1, 'x'));
  EXPECT_THAT(refusal(request), HasSubstr("\"run\""));
  request = link_request(1);
  request.k = 0;
  EXPECT_THAT(refusal(request), HasSubstr("\"k\""));
}

TEST_F(WitnessLogTest, FindsStoredLinesOnly) {
  begin_run();
  EXPECT_EQ(parse_witness_line(log->fetch("run-1", WitnessAct::kBegin, 0)->line).bench, "left");
  EXPECT_EQ(parse_witness_line(log->fetch("run-1", WitnessAct::kLink, 1)->line).now, link_of("run-1", 1));
  EXPECT_EQ(parse_witness_line(log->fetch_latest("run-1", WitnessAct::kLink)->line).k, 2);
  EXPECT_FALSE(log->fetch("run-1", WitnessAct::kLink, 3));
  EXPECT_FALSE(log->fetch("run-1", WitnessAct::kClose, 0));
  EXPECT_FALSE(log->fetch("run-2", WitnessAct::kBegin, 0));
  EXPECT_FALSE(log->fetch_latest("run-1", WitnessAct::kHead));
}

TEST_F(WitnessLogTest, BelongsToOneKey) {
  begin_run();
  log = nullptr;
  key = make_private_key();
  try {
    (void)open_log();
    ADD_FAILURE() << "opened";
  } catch (const std::invalid_argument& problem) {
    EXPECT_THAT(problem.what(),
                AllOf(HasSubstr(file.string()), HasSubstr(fingerprint_of(public_key_of(key)))));
  }
  key = "no key";
  EXPECT_THROW((void)open_log(), std::invalid_argument);
}

TEST_F(WitnessLogTest, SeveralObjectsUseOneLog) {
  const std::unique_ptr<WitnessLog> other = open_log();
  answer(begin_request());
  EXPECT_EQ(parse_witness_line(other->answer(link_request(1), kUser).line).counter, 2);
  EXPECT_EQ(statement(link_request(2)).counter, 3);
  EXPECT_THAT(other->verify(), IsEmpty());
}

TEST_F(WitnessLogTest, AClockThatWasSetBackIsFoundAndNotRefused) {
  answer(begin_request());
  now.utc -= 1h;
  EXPECT_EQ(statement(link_request(1)).utc, "2026-03-01T11:00:02.000Z");
  EXPECT_THAT(log->verify(), ElementsAre(AllOf(HasSubstr("line 2"), HasSubstr("the clock was set back"))));
}

TEST_F(WitnessLogTest, TheTimeSinceTheStartOfTheComputerIsCompared) {
  answer(begin_request());
  now.since_boot -= 50s;
  answer(link_request(1));
  now.boot_id = "boot-2";
  now.since_boot = 1s;
  answer(link_request(2));
  EXPECT_THAT(log->verify(), ElementsAre(HasSubstr("line 2: less time has passed")));
}

TEST_F(WitnessLogTest, FindsEveryChange) {
  begin_run();
  answer(close_request(2));
  const auto copy = [&](const char* name) {
    std::filesystem::path other = folder / name;
    change("vacuum into '" + other.string() + "'");
    return other;
  };
  const auto findings = [&](const std::filesystem::path& path, const std::string& sql) {
    SqliteDatabase(path, SqliteDatabase::Mode::kReadWrite).execute(sql);
    return WitnessLog(path, key, [this] { return now; }).verify();
  };
  ASSERT_THAT(findings(copy("whole.db"), "select 1"), IsEmpty());
  EXPECT_THAT(
      findings(copy("line.db"),
               "update answer set line = replace(line, '12:00:02', '12:00:01') where counter = 2"),
      ElementsAre(HasSubstr("line 2: its signature"), HasSubstr("line 3: it does not name the line before")));
  EXPECT_THAT(findings(copy("signature.db"), "update answer set signature = x'00' where counter = 2"),
              ElementsAre(HasSubstr("line 2: its signature")));
  EXPECT_THAT(findings(copy("gap.db"), "delete from answer where counter = 2"),
              ElementsAre(HasSubstr("line 3: line 2 is missing"),
                          HasSubstr("line 3: it does not name the line before")));
  EXPECT_THAT(findings(copy("first.db"), "delete from answer where counter = 1"),
              ElementsAre(HasSubstr("line 2: line 1 is missing"),
                          HasSubstr("line 2: it does not name the line before")));
  EXPECT_THAT(findings(copy("columns.db"), "update answer set run = 'run-2' where counter = 2"),
              ElementsAre(HasSubstr("line 2: it stands under run run-2, link 1")));
  EXPECT_THAT(findings(copy("moved.db"), "update answer set counter = 5 where counter = 4"),
              ElementsAre(HasSubstr("line 5: line 4 is missing"), HasSubstr("line 5: it has the number 4")));
  EXPECT_THAT(findings(copy("text.db"), "update answer set line = 'text' where counter = 2"),
              ElementsAre(HasSubstr("line 2: its signature"), HasSubstr("line 2: found no JSON object"),
                          HasSubstr("line 3: it does not name the line before")));
}

}  // namespace
}  // namespace abcal
