#include "protocol/record/message_json.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>

namespace abcal {
namespace {

using Json = nlohmann::ordered_json;

TEST(MessageJson, HasTheTextTheSentenceAndItsValues) {
  const Message message("{effect} of {output}: {found:.3g} by {source}", Message("wobble"), 'u', 1.25,
                        std::string("customer"));
  EXPECT_EQ(message_json(message),
            (Json{{"text", "wobble of u: 1.25 by customer"},
                  {"id", "{effect} of {output}: {found} by {source}"},
                  {"values",
                   {{"effect", {{"text", "wobble"}, {"id", "wobble"}, {"values", Json::object()}}},
                    {"output", "u"},
                    {"found", {{"number", "1.25"}}},
                    {"source", "customer"}}}}));
}

TEST(MessageJson, HasSeveralAsAListWithTheirSeparator) {
  const Json json = message_json(in_sequence({Message("one"), Message("two")}));
  EXPECT_EQ(json["text"], "one; two");
  EXPECT_EQ(json["values"]["all"]["separator"], "; ");
  EXPECT_EQ(json["values"]["all"]["messages"].size(), 2U);
}

TEST(MessageJson, HasNoSentenceWhereOnlyTheTextIsKnown) {
  EXPECT_EQ(message_json(Message::bare("the reply of a server")), (Json{{"text", "the reply of a server"}}));
}

TEST(MessageJson, ListsEachMessageWithASentenceOnce) {
  const Json list = messages_json({Message("one"), Message(), Message::bare("other"), Message("one")});
  ASSERT_EQ(list.size(), 1U);
  EXPECT_EQ(list.front()["id"], "one");
}

TEST(MessageJson, IsReadAgain) {
  const Message whole("{found:.3g} {unit}: {all}", 1.25, "g",
                      std::vector<Message>{Message("one"), Message::bare("two"), Message("{n} more", 3)});
  const Message again = message_from_json(message_json(whole));
  EXPECT_EQ(again.id(), whole.id());
  EXPECT_EQ(again.english(), "1.25 g: one; two; 3 more");
  EXPECT_EQ(message_json(again), message_json(whole));
  EXPECT_EQ(message_from_json(message_json(Message::bare("a reply"))), Message::bare("a reply"));
  EXPECT_THROW((void)message_from_json(Json{{"id", "no text"}}), Json::exception);
}

TEST(MessageJson, IsReadToALimitedDepth) {
  Json json = {{"text", "x"}, {"id", "{a}"}, {"values", {{"a", "x"}}}};
  for (int n = 0; n < 100'000; ++n) {
    Json outer = {{"text", "x"}, {"id", "{a}"}, {"values", Json::object()}};
    outer["values"]["a"] = std::move(json);
    json = std::move(outer);
  }
  EXPECT_NE(message_from_json(json).english(), "x");
}

}  // namespace
}  // namespace abcal
