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

TEST(ReplyFormTest, ANumberIsBelowALimitOrNot) {
  const ReplyForm below("{number below 0.01}"), not_below("{number not below 0.01}");
  for (const char* number : {"0", "-0.0", "+0.00", "0.", "0.0099999", "-.009", "00.001"}) {
    EXPECT_TRUE(below.match(number)) << number;
    EXPECT_TRUE(wire::matches(below.pattern(), number)) << number;
    EXPECT_FALSE(not_below.match(number)) << number;
    EXPECT_FALSE(wire::matches(not_below.pattern(), number)) << number;
  }
  for (const char* number : {"0.01", "-0.010", ".1", "0.99", "1", "-20.5", "007.000"}) {
    EXPECT_FALSE(below.match(number)) << number;
    EXPECT_FALSE(wire::matches(below.pattern(), number)) << number;
    EXPECT_TRUE(not_below.match(number)) << number;
    EXPECT_TRUE(wire::matches(not_below.pattern(), number)) << number;
  }
  // An exponent moves the digits: such a number is neither, so that it is never rest.
  for (const char* number : {"1e-3", "1E9", "nan", "", "."}) {
    EXPECT_FALSE(below.match(number)) << number;
    EXPECT_FALSE(not_below.match(number)) << number;
  }
  EXPECT_FALSE(common_reply(below.pattern(), not_below.pattern()));
  EXPECT_TRUE(common_reply(ReplyForm("{number below 0.1}").pattern(), not_below.pattern()));
}

TEST(ReplyFormTest, AVersionIsNoNumber) {
  const ReplyForm version("%{digits}.{digits}.{digits}"), number("%{angle}");
  EXPECT_FALSE(common_reply(version.pattern(), number.pattern()));
  for (const char* reply : {"%1", "%-1.5", "%+.5e-3", "%5.", "%1E5"}) {
    EXPECT_TRUE(number.match(reply)) << reply;
    EXPECT_TRUE(wire::matches(number.pattern(), reply)) << reply;
  }
}

TEST(ReplyFormTest, OtherAxesHaveNumbersWhereThisOneHas) {
  const ReplyForm all("{before blank}{angle}{after blank}");
  EXPECT_EQ(all.at(2).match("1.5 -2 3e1")->at("angle"), "-2");
  EXPECT_FALSE(all.at(2).match("Corvus 1 462"));
  EXPECT_FALSE(all.at(1).match("1 Corvus"));
  for (const std::size_t place : {1U, 2U, 3U})
    EXPECT_FALSE(common_reply(all.at(place).pattern(), ReplyForm("Corvus {model}").pattern())) << place;
}

TEST(ReplyFormTest, AWordIsOneOfAList) {
  const ReplyForm rest("{1..31}TS{hex4}{one of 32 33 3C}"), motion("{1..31}TS{hex4}{one of 1E 28}");
  EXPECT_TRUE(rest.match("1TS00003C"));
  EXPECT_FALSE(rest.match("1TS00001E"));
  EXPECT_TRUE(motion.match("31TS002028"));
  EXPECT_FALSE(motion.match("32TS000028"));
  EXPECT_FALSE(common_reply(rest.pattern(), motion.pattern()));
  EXPECT_EQ(rest.reply({}), "1TS000032");
}

TEST(ReplyFormTest, ADecimalNumberHasBits) {
  const ReplyForm some("{decimal some bits 0 31}"), none("{decimal none bits 0 31}"), any("{decimal}");
  for (const char* number : {"1", "-1", "+3", "-2147483648", "4294967295", "0000000007"}) {
    EXPECT_TRUE(some.match(number)) << number;
    EXPECT_FALSE(none.match(number)) << number;
    EXPECT_TRUE(any.match(number)) << number;
  }
  for (const char* number : {"0", "2", "-0", "2147483646"}) {
    EXPECT_FALSE(some.match(number)) << number;
    EXPECT_TRUE(none.match(number)) << number;
  }
  for (const char* text :
       {"", "-", "--1", "+-1", "1.0", "0x1", "4294967296", "-2147483649", "00000000001", " 1"}) {
    EXPECT_FALSE(some.match(text)) << text;
    EXPECT_FALSE(any.match(text)) << text;
  }
  // Bits of the same number tell two replies apart; those of two numbers do not.
  EXPECT_FALSE(common_reply(some.pattern(), none.pattern()));
  const auto both = common_reply(some.pattern(), ReplyForm("{decimal none bits 0}").pattern());
  ASSERT_TRUE(both);
  EXPECT_TRUE(some.match(*both)) << *both;
  EXPECT_EQ(*both, "2147483648");
  EXPECT_TRUE(common_reply(ReplyForm("{decimal some bits 0} {text}").pattern(),
                           ReplyForm("{text} {decimal none bits 0}").pattern()));
  EXPECT_FALSE(common_reply(ReplyForm("a {decimal some bits 3} {decimal}").pattern(),
                            ReplyForm("a {decimal none bits 3} {decimal}").pattern()));
}

TEST(ReplyFormTest, AnAxisHasAPlaceInAReplyForAll) {
  const ReplyForm letters("{before}{one of T V}{after}");
  ASSERT_TRUE(letters.has_places());
  EXPECT_TRUE(letters.at(1).match("TRR"));
  EXPECT_FALSE(letters.at(2).match("TRR"));
  EXPECT_TRUE(letters.at(3).match("RRV"));
  EXPECT_FALSE(letters.at(4).match("RRV"));
  const ReplyForm list("POS {before ,}{angle}{after ,}");
  EXPECT_EQ(list.at(1).match("POS 1.5, -2,3 , 4")->at("angle"), "1.5");
  EXPECT_EQ(list.at(2).match("POS 1.5, -2,3 , 4")->at("angle"), "-2");
  EXPECT_EQ(list.at(3).match("POS 1.5, -2,3 , 4")->at("angle"), "3");
  EXPECT_EQ(list.at(4).match("POS 1.5, -2,3 , 4")->at("angle"), "4");
  EXPECT_FALSE(list.at(5).match("POS 1.5, -2,3 , 4"));
  EXPECT_FALSE(list.at(3).match("POS 1.5,,3"));
  const ReplyForm words("{before blank}{decimal some bits 0}{after blank}");
  EXPECT_TRUE(words.at(2).match("0  1 0"));
  EXPECT_FALSE(words.at(2).match("1 0 1"));
  EXPECT_EQ(list.reply_of({"1", "2"}), "POS 1,2");
  EXPECT_EQ(words.reply_of({words.item().reply({}), "0"}), "1 0");
  for (const ReplyForm& form : {letters, list, words})
    for (const std::size_t place : {1U, 2U, 3U})
      for (const char* reply :
           {"TRR", "RT", "V", "POS 1,2,3", "POS 1 ,2,  3", "POS ,2", "1 2 3", "2  3", "1 ", ""})
        EXPECT_EQ(form.at(place).match(reply).has_value(), wire::matches(form.at(place).pattern(), reply))
            << form.text() << " " << place << " " << reply;
}

TEST(ReplyFormTest, AnIdentityMayBeOfAKind) {
  const ReplyForm form("{serial:digits6}");
  EXPECT_EQ(form.match("001234")->at("serial"), "001234");
  EXPECT_FALSE(form.match("1234"));
  EXPECT_EQ(form.reply({{"serial", "EMULATED"}}), "000001") << "only what fits";
  EXPECT_FALSE(common_reply(ReplyForm("Hydra {model}").pattern(), ReplyForm("{serial:digits}").pattern()));
}

TEST(ReplyFormTest, AGuardSeesTheSame) {
  for (const char* text :
       {"+ {hex4 some 0102}", "+ {hex none 10}", "{one of 39,1 40,1}", "+ {decimal some bits 2 8}",
        "{decimal none bits 0}", "@{digits2} {1..9} OK {word} F{word} 0", "{0..39},{digits}", "- {text}",
        "a {{b}}"}) {
    const ReplyForm form(text);
    EXPECT_TRUE(form.match(form.reply({}))) << form.reply({});
    for (const char* reply :
         {"+ 0102", "+ 10", "+ 00", "4", "-4", "+ -256", "@01 2 OK IDLE FS 0", "@01 0 OK IDLE FS 0", "39,1",
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
  for (const char* text : {"{angel}",
                           "{hex4 some}",
                           "{hex4 some 0}",
                           "{hex2 none 0102}",
                           "{hex9}",
                           "{9..1}",
                           "{decimal some 3}",
                           "{decimal some bits}",
                           "{decimal none bits 32}",
                           "{one of}",
                           "{before ,}{angle}",
                           "{angle}{after ,}",
                           "{before ,}{angle}{after ;}",
                           "{before .}1{after .}",
                           "{before ,}{word}{after ,}",
                           "{angle:digits}",
                           "{serial:angle}",
                           "{serial:}",
                           "{angle",
                           "angle}",
                           "{angle}{speed}",
                           "{text}{word}",
                           "{}"})
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

TEST(CommandFormTest, HasTheTargetsOfAllAxes) {
  const CommandForm form("{angles:.2f} move");
  EXPECT_EQ(form.with({}, {{"angle1", 1.0}, {"angle2", -0.001}, {"angle3", -7.126}}), "1.00 0.00 -7.13 move");
  EXPECT_EQ(form.match("1.00 0.00 -7.13 move", {})->at("angles"), "1.00 0.00 -7.13");
  EXPECT_FALSE(form.match("1.00 x move", {}));
  EXPECT_FALSE(form.match("move", {}));
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
