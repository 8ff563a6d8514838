#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>
#include <string>

#include "drivers/described/codec.h"
#include "drivers/instrument/stage_description.h"
#include "drivers/wire/reply_match.h"

namespace abcal {
namespace {

using testing::ElementsAre;
using testing::Pair;

TEST(ReplyFormTest, GivesTheValuesOfItsFields) {
  const ReplyForm form("+ {model} sn={serial} fw={firmware}");
  const auto values = form.match("+ RT-2 B sn=00412 fw=3.07");
  ASSERT_TRUE(values);
  EXPECT_THAT(*values,
              ElementsAre(Pair("firmware", "3.07"), Pair("model", "RT-2 B"), Pair("serial", "00412")));
  EXPECT_FALSE(form.match("+ RT-2"));
  EXPECT_FALSE(form.match("- RT-2 sn=1 fw=2"));
  EXPECT_EQ(ReplyForm("+   {angle}").match("+ -12.5e0")->at("angle"), "-12.5e0");
  EXPECT_FALSE(ReplyForm("+ {angle}").match("+ 12.5.1"));
  EXPECT_FALSE(ReplyForm("+ {angle}").match("+ nan"));
}

TEST(ReplyFormTest, BitsOfANumberAreSetOrNot) {
  const ReplyForm some("+ {hex4 some 0102}"), none("+ {hex4 none 0102}");
  for (const char* reply : {"+ 0002", "+ 0100", "+ ff0f", "+ 0307"}) {
    EXPECT_TRUE(some.match(reply)) << reply;
    EXPECT_FALSE(none.match(reply)) << reply;
  }
  for (const char* reply : {"+ 0000", "+ FC0D", "+ 0001"}) {
    EXPECT_TRUE(none.match(reply)) << reply;
    EXPECT_FALSE(some.match(reply)) << reply;
  }
  for (const char* reply : {"+ 02", "+ 00002", "+ 000G", "+"}) {
    EXPECT_FALSE(some.match(reply)) << reply;
    EXPECT_FALSE(none.match(reply)) << reply;
  }
  EXPECT_FALSE(common_reply(some.pattern(), none.pattern()));
}

TEST(ReplyFormTest, AGuardSeesTheSame) {
  for (const char* text : {"+ {hex4 some 0102}", "+ {hex none 10}", "@{digits2} {1..9} OK {word} F{word} 0",
                           "{0..39},{digits}", "- {text}", "a {{b}}"}) {
    const ReplyForm form(text);
    EXPECT_TRUE(form.match(form.reply({}))) << form.reply({});
    for (const char* reply : {"+ 0102", "+ 10", "+ 00", "@01 2 OK IDLE FS 0", "@01 0 OK IDLE FS 0", "39,1",
                              "40,1", "039,1", "- anything  else", "-", "a {b}", "a  {b}", ""})
      EXPECT_EQ(form.match(reply).has_value(), wire::matches(form.pattern(), reply))
          << text << " and " << reply;
  }
}

TEST(ReplyFormTest, AReplyThatFitsTwoFormsIsFound) {
  const auto both = [](const char* one, const char* other) {
    return common_reply(ReplyForm(one).pattern(), ReplyForm(other).pattern());
  };
  EXPECT_FALSE(both("+", "+ {angle}"));
  EXPECT_FALSE(both("- {digits2} {text}", "+{text}"));
  EXPECT_FALSE(both("{0..9}", "{10..39}"));
  ASSERT_TRUE(both("+ {text}", "+ {hex4}"));
  EXPECT_TRUE(ReplyForm("+ {hex4}").match(*both("+ {text}", "+ {hex4}")));
  EXPECT_TRUE(both("{word} {word}", "OK  {text}"));
  EXPECT_TRUE(both("{0..39}", "{39..50}"));
}

TEST(ReplyFormTest, RefusesWhatCannotBeMeant) {
  for (const char* text : {"{angel}", "{hex4 some}", "{hex4 some 0}", "{hex2 none 0102}", "{hex9}", "{9..1}",
                           "{angle", "angle}", "{angle}{speed}", "{text}{word}", "{}"})
    EXPECT_THROW(ReplyForm{text}, std::invalid_argument) << text;
  for (const char* text :
       {"GO {axis} {angle}", "GO {axis} {angle:4f}", "GO {axes}", "GO {position:.3f}", "{axis"})
    EXPECT_THROW(CommandForm{text}, std::invalid_argument) << text;
}

TEST(CommandFormTest, WritesItsNumbersAndReadsThem) {
  const CommandForm form("GO {axis} {angle:.3f}");
  EXPECT_EQ(form.with({{"axis", "O"}}, {{"angle", -12.34567}}), "GO O -12.346");
  EXPECT_EQ(form.with({{"axis", "O"}}, {{"angle", -0.0001}}), "GO O 0.000");
  const auto values = form.match("GO I 7.5", {{"axis", {"O", "I"}}});
  ASSERT_TRUE(values);
  EXPECT_EQ(values->at("axis"), "I");
  EXPECT_EQ(values->at("angle"), "7.5");
  EXPECT_FALSE(form.match("GO X 7.5", {{"axis", {"O", "I"}}}));
  EXPECT_FALSE(form.match("GO O", {{"axis", {"O", "I"}}}));
  EXPECT_DOUBLE_EQ(form.half_place("angle"), 0.0005);
}

TEST(LineFilterTest, RemovesEchoesAndLinesThatAnswerNothing) {
  StageDescription description;
  description.echoes = true;
  description.ignored = {ReplyForm("!{text}")};
  described::LineFilter filter(description);
  filter.sent("GO O 1\r");
  EXPECT_EQ(filter.pass("GO O 1\r\n! hot\r\n+ 1"), "\n\n");
  EXPECT_EQ(filter.pass("2\r\nGO O 1\r\n"), "+ 12\r\nGO O 1\r\n") << "an echo comes once";
}

}  // namespace
}  // namespace abcal
