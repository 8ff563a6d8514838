// Lines of a witness: their bytes, and everything that is none.
#include "app/witness/witness_line.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/app/witness/witness_fixtures.h"

namespace abcal {
namespace {

using OrderedJson = nlohmann::ordered_json;
using testing::HasSubstr;

WitnessStatement statement_of(const WitnessRequest& request) {
  WitnessStatement statement;
  static_cast<WitnessRequest&>(statement) = request;
  statement.counter = 7;
  statement.utc = "2026-03-01T12:00:00.000Z";
  statement.boot_id = "2f9c2a3e-0d4b-4f0a-9a56-6a6c7a0f5f11";
  statement.since_boot_ns = 123'456'789'012'345;
  statement.uid = 4'294'967'295;
  statement.before = sha256_of("line 6");
  return statement;
}

std::vector<WitnessStatement> one_of_each() {
  std::vector<WitnessStatement> all;
  for (const WitnessRequest& request :
       {begin_request(), begin_request("läuft \"5\"\\", true), link_request(1), link_request(40),
        close_request(0), close_request(40), head_request(0), head_request(123)})
    all.push_back(statement_of(request));
  all.back().counter = 1;
  all.back().before.clear();
  return all;
}

/// The words with which a line is refused; empty: it is none that is refused.
std::string refusal_of(const std::string& line) {
  try {
    (void)parse_witness_line(line);
  } catch (const std::invalid_argument& problem) {
    return problem.what();
  }
  return {};
}

TEST(WitnessLine, HasTheseBytes) {
  WitnessStatement statement = statement_of(link_request(2));
  EXPECT_EQ(to_line(statement),
            R"({"schema":"abcal.witness/1","counter":7,"utc":"2026-03-01T12:00:00.000Z",)"
            R"("boot_id":"2f9c2a3e-0d4b-4f0a-9a56-6a6c7a0f5f11","since_boot_ns":123456789012345,)"
            R"("uid":4294967295,"do":"link","run":"run-1","k":2,"previous":")" +
                link_of("run-1", 1) + R"(","this":")" + link_of("run-1", 2) + R"(","log":")" +
                sha256_of("line 6") + R"("})");
  const auto members = [](const WitnessRequest& request) {
    std::string names;
    const OrderedJson json = OrderedJson::parse(to_line(statement_of(request)));
    for (const auto& [name, value] : json.items()) names += name + " ";
    return names;
  };
  const std::string before = "schema counter utc boot_id since_boot_ns uid do ";
  EXPECT_EQ(members(begin_request()), before + "run bench person head simulated log ");
  EXPECT_EQ(members(close_request(3)), before + "run k this events log ");
  EXPECT_EQ(members(head_request(3)), before + "register entries head log ");
}

TEST(WitnessLine, ComesThroughAsItIs) {
  for (const WitnessStatement& statement : one_of_each()) {
    const std::string line = to_line(statement);
    EXPECT_EQ(parse_witness_line(line), statement) << line;
    EXPECT_EQ(to_line(parse_witness_line(line)), line);
  }
}

TEST(WitnessLine, IsRefusedWithoutAnyOfItsMembersOrWithOneOfAnotherType) {
  for (const WitnessStatement& statement : one_of_each()) {
    const OrderedJson json = OrderedJson::parse(to_line(statement));
    for (const auto& [name, value] : json.items()) {
      OrderedJson without = json;
      without.erase(name);
      EXPECT_THAT(refusal_of(without.dump()), HasSubstr('"' + name + '"')) << without;
      for (const OrderedJson& other :
           {OrderedJson(nullptr), OrderedJson(1.5), OrderedJson(OrderedJson::array()),
            OrderedJson(OrderedJson::object()), OrderedJson("text"), OrderedJson(-1), OrderedJson(true)}) {
        OrderedJson changed = json;
        changed[name] = other;
        const bool is_text = other.is_string() && (name == "run" || name == "bench" || name == "person" ||
                                                   name == "register" || name == "boot_id");
        if (is_text || (name == "simulated" && other.is_boolean())) continue;
        EXPECT_THAT(refusal_of(changed.dump()), HasSubstr('"' + name + '"')) << changed;
      }
    }
  }
}

TEST(WitnessLine, IsRefusedInAnyOtherForm) {
  const WitnessStatement statement = statement_of(link_request(2));
  const std::string line = to_line(statement);
  ASSERT_EQ(refusal_of(line), "");
  OrderedJson more = OrderedJson::parse(line);
  more["more"] = 1;
  OrderedJson reordered;
  reordered["counter"] = 7;
  reordered.update(OrderedJson::parse(line));
  std::string other_number = line, twice = line, escaped = line;
  other_number.replace(other_number.find("\"k\":2"), 5, "\"k\":2e0");
  twice.insert(1, R"("schema":"abcal.witness/1",)");
  escaped.replace(escaped.find("run-1"), 5, "run\\u002d1");
  for (const std::string& other :
       {more.dump(), reordered.dump(), OrderedJson::parse(line).dump(1), line + "\n", " " + line, line + line,
        "[" + line + "]", line.substr(0, line.size() - 1), other_number, twice, escaped, std::string(),
        std::string("{}"), std::string("null"), std::string("\"text\""), std::string(100'000, '['),
        std::string("\xff\xfe"), std::string(1, '\0')})
    EXPECT_NE(refusal_of(other), "") << other.substr(0, 300);
}

TEST(WitnessLine, IsRefusedWithAValueOutOfItsRange) {
  const auto refused = [](const WitnessRequest& request, const std::string& member,
                          const OrderedJson& value) {
    OrderedJson json = OrderedJson::parse(to_line(statement_of(request)));
    json[member] = value;
    const std::string line = json.dump();
    EXPECT_THAT(refusal_of(line), HasSubstr('"' + member + '"')) << line;
  };
  const WitnessRequest begin = begin_request(), link = link_request(2), close = close_request(2),
                       head = head_request(2);
  refused(begin, "schema", "abcal.witness/2");
  refused(begin, "do", "end");
  for (const std::int64_t number : {std::int64_t{0}, std::numeric_limits<std::int64_t>::min()}) {
    refused(begin, "counter", number);
    refused(link, "k", number);
  }
  refused(begin, "counter", std::numeric_limits<std::uint64_t>::max());
  refused(begin, "uid", 4'294'967'296);
  for (const char* time :
       {"", "2026-03-01T12:00:00Z", "2026-03-01 12:00:00.000Z", "2026-02-30T12:00:00.000Z",
        "2026-13-01T12:00:00.000Z", "2026-03-01T24:00:00.000Z", "2026-03-01T12:60:00.000Z",
        "2026-03-01T12:00:60.000Z", "2026-03-01T12:00:00.00xZ", "2026-03-01T12:00:00.0000Z"})
    refused(begin, "utc", time);
  const std::string good = link_of("run-1", 1);
  std::string large = good;
  for (char& c : large) c = c == 'a' ? 'A' : c;
  ASSERT_NE(large, good);
  for (const std::string& bad : {std::string(), good.substr(1), good + "0", large, std::string(64, 'g')}) {
    refused(begin, "head", bad);
    refused(link, "previous", bad);
    refused(link, "this", bad);
    refused(close, "this", bad);
    refused(close, "events", bad);
    refused(head, "head", bad);
    refused(begin, "log", bad);
  }
  for (const std::string& bad :
       {std::string(201, 'x'), std::string("two\nlines\x01"), std::string("\x1b[0m")}) {
    refused(begin, "run", bad);
    refused(begin, "bench", bad);
    refused(begin, "person", bad);
    refused(begin, "boot_id", bad);
    refused(head, "register", bad);
  }
  refused(begin, "run", "");
  refused(head, "register", "");
  WitnessStatement first = statement_of(begin);
  first.counter = 1;
  EXPECT_THAT(refusal_of(to_line(first)), HasSubstr("\"log\"")) << "no line is before the first";
}

TEST(WitnessLine, TextsHaveAtMost200BytesAndAreUtf8) {
  WitnessRequest request = begin_request();
  request.person = std::string(kLongestWitnessedText, 'x');
  EXPECT_NO_THROW(require_valid(request));
  for (const std::string& bad :
       {std::string(kLongestWitnessedText + 1, 'x'), std::string("A\xc3"), std::string("\xed\xa0\x80")}) {
    request.person = bad;
    EXPECT_THROW(require_valid(request), std::invalid_argument) << bad;
  }
}

TEST(WitnessLine, IsWitnessedByTheOwnerOfTheKeyOnly) {
  const std::string key = make_private_key(), pem = public_key_of(key);
  const std::string line = to_line(statement_of(link_request(1)));
  const WitnessedLine witnessed{line, sign(line, key)};
  EXPECT_TRUE(is_witnessed_by(witnessed, pem));
  EXPECT_FALSE(is_witnessed_by(witnessed, public_key_of(make_private_key())));
  EXPECT_FALSE(is_witnessed_by(witnessed, "no key"));
  EXPECT_FALSE(is_witnessed_by({line, witnessed.signature.substr(1)}, pem));
  EXPECT_FALSE(is_witnessed_by({line, ""}, pem));
  EXPECT_FALSE(is_witnessed_by({line + " ", witnessed.signature}, pem));
}

TEST(WitnessRequests, ComeThroughInAnyOrderOfMembers) {
  for (const WitnessStatement& statement : one_of_each()) {
    const WitnessRequest& request = statement;
    EXPECT_EQ(parse_witness_request(to_json(request)), request);
    EXPECT_EQ(parse_witness_request(nlohmann::json::parse(to_json(request)).dump(2)), request);
    const OrderedJson json = OrderedJson::parse(to_json(request));
    OrderedJson more = json;
    more["utc"] = statement.utc;
    EXPECT_THROW((void)parse_witness_request(more.dump()), std::invalid_argument);
    for (const auto& [name, value] : json.items()) {
      OrderedJson without = json;
      without.erase(name);
      EXPECT_THROW((void)parse_witness_request(without.dump()), std::invalid_argument) << without;
    }
  }
}

}  // namespace
}  // namespace abcal
