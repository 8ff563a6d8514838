#include "drivers/text/message.h"

#include "drivers/instrument/instrument_error.h"

#include <gtest/gtest.h>

#include <map>
#include <string>

namespace abcal {
namespace {

std::optional<std::string_view> german(std::string_view english) {
  static const std::map<std::string_view, std::string_view> kTable{
      {".", ","},
      {"customer", "beim Auftraggeber"},
      {"source \"{source}\"", "Quelle \"{source}\""},
      {"{found} of {all} angles", "von {all} Winkeln {found}"},
      {"not used: {why}", "nicht verwendet: {why}"}};
  const auto found = kTable.find(english);
  return found == kTable.end() ? std::nullopt : std::optional(found->second);
}

TEST(MessageTest, TheIdIsTheSentenceWithoutFormats) {
  const Message message("{found:.3g} of {all} angles", 3.14159, 4);
  EXPECT_EQ(message.id(), "{found} of {all} angles");
  EXPECT_EQ(message.english(), "3.14 of 4 angles");
  EXPECT_EQ(message, "3.14 of 4 angles");
  ASSERT_EQ(message.values().size(), 2U);
  EXPECT_EQ(message.values()[0].name, "found");
  EXPECT_EQ(std::get<Number>(message.values()[0].value).digits, "3.14");
}

TEST(MessageTest, ATranslationHasThePlacesInItsOwnOrderAndItsDecimalMark) {
  const Rendered made = Message("{found:.3g} of {all} angles", 3.14159, 4).rendered(german);
  EXPECT_EQ(made.text, "von 4 Winkeln 3,14");
  EXPECT_TRUE(made.complete);
}

TEST(MessageTest, WhatAPersonWroteStaysAsItIs) {
  // The catalogue has this word for a place of calibration, and a decimal mark.
  for (const char* text : {"customer", "report 7.25", "{found}"}) {
    const Rendered made = Message("source \"{source}\"", Stated{text}).rendered(german);
    EXPECT_EQ(made.text, fmt::format("Quelle \"{}\"", text));
    EXPECT_TRUE(made.complete);
    EXPECT_EQ(Message("source \"{source}\"", text).rendered(german).text, made.text);
  }
}

TEST(MessageTest, MessagesWithinMessagesAreTranslated) {
  const Message part("{found} of {all} angles", 1, 2);
  EXPECT_EQ(Message("not used: {why}", part).rendered(german).text, "nicht verwendet: von 2 Winkeln 1");
  const Message both = in_sequence({part, Message("{place}: {part}", Term("customer"), part)});
  EXPECT_EQ(both.english(), "1 of 2 angles; customer: 1 of 2 angles");
  const Rendered made = both.rendered(german);
  EXPECT_EQ(made.text, "von 2 Winkeln 1; beim Auftraggeber: von 2 Winkeln 1");
  EXPECT_TRUE(made.complete);
}

TEST(MessageTest, ASentenceThatTheCatalogueLacksStaysEnglish) {
  const Rendered made = Message("not used: {why}", Message("it is {number}", 1.5)).rendered(german);
  EXPECT_EQ(made.text, "nicht verwendet: it is 1,5");
  EXPECT_FALSE(made.complete);
}

TEST(MessageTest, ABareTextIsInNoLanguage) {
  const Message old = Message::bare("customer");
  EXPECT_EQ(old.english(), "customer");
  const Rendered made = old.rendered(german);
  EXPECT_EQ(made.text, "customer");
  EXPECT_FALSE(made.complete);
  EXPECT_TRUE(Message().empty());
  EXPECT_TRUE(Message::bare("").empty());
  EXPECT_EQ(Message().rendered(german).text, "");
}

TEST(MessageTest, AnExceptionHasItsMessage) {
  const InstrumentError error("stage", Fault::kStalled, Message("axis {axis} stands", 'X'));
  EXPECT_STREQ(error.what(), "stage: stalled: axis X stands");
  EXPECT_EQ(message_of(error).id(), "{instrument}: {fault}: {detail}");
  EXPECT_EQ(message_of(error), error.what());
  const InstrumentError of_driver("stage C-884", Fault::kRefused, "error 7");
  EXPECT_STREQ(of_driver.what(), "stage C-884: refused: error 7");
  EXPECT_EQ(of_driver.detail().id(), "") << "what a driver says is in no language";
  EXPECT_STREQ(InstrumentError("stage", Fault::kNoReply, Message()).what(), "stage: no reply");
  const Telling<std::invalid_argument> refusal(Message("{found} is too little", 1.5));
  EXPECT_STREQ(refusal.what(), "1.5 is too little");
  EXPECT_EQ(message_of(refusal).id(), "{found} is too little");
  EXPECT_EQ(message_of(std::runtime_error("a reply")).id(), "");
  EXPECT_EQ(message_of(std::runtime_error("a reply")), "a reply");
}

}  // namespace
}  // namespace abcal
