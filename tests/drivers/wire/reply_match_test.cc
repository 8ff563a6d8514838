#include "drivers/wire/reply_match.h"

#include <gtest/gtest.h>

#include <cstddef>
#include <string>

namespace abcal::wire {
namespace {

using namespace std::string_literals;

TEST(ReplyMatchTest, APatternWithoutAlternativesFitsNothing) {
  EXPECT_TRUE(ReplyPattern().empty());
  EXPECT_FALSE(matches({}, ""));
  EXPECT_FALSE(matches({}, "0"));
  EXPECT_FALSE(occurs_in({}, "0"));
}

TEST(ReplyMatchTest, AnEmptyReplyFitsPartsThatMayBeEmpty) {
  EXPECT_TRUE(matches({pattern::text()}, ""));
  EXPECT_TRUE(matches({pattern::spaces(), pattern::text(), pattern::run("0", 0)}, ""));
  EXPECT_TRUE(matches({pattern::literal("")}, ""));
  EXPECT_FALSE(matches({pattern::literal("0")}, ""));
  EXPECT_FALSE(matches({pattern::run("0")}, ""));
  EXPECT_FALSE(matches({pattern::number(0, 9)}, ""));
  EXPECT_FALSE(matches({pattern::any_bytes(1)}, ""));
  EXPECT_FALSE(occurs_in({pattern::any_bytes(1)}, ""));
}

TEST(ReplyMatchTest, ADecimalNumberHasBits) {
  const ReplyPattern some{pattern::some_bit_of(0x80000008U)}, none{pattern::no_bit_of(0x80000008U)};
  for (const char* number : {"8", "-1", "+12", "-2147483648", "4294967295", "0000000009"}) {
    EXPECT_TRUE(matches(some, number)) << number;
    EXPECT_FALSE(matches(none, number)) << number;
  }
  for (const char* number : {"0", "-0", "7", "2147483623"}) {
    EXPECT_FALSE(matches(some, number)) << number;
    EXPECT_TRUE(matches(none, number)) << number;
  }
  for (const char* other : {"", "-", "+", "4294967296", "-2147483649", "00000000008", "8.0", " 8", "8 "}) {
    EXPECT_FALSE(matches(some, other)) << other;
    EXPECT_FALSE(matches(none, other)) << other;
  }
  EXPECT_TRUE(matches({pattern::literal("st="), pattern::some_bit_of(1), pattern::literal("0")}, "st=10"));
}

TEST(ReplyMatchTest, ALiteralIsTheWholeReply) {
  const ReplyPattern zero{pattern::literal("0,")};
  EXPECT_TRUE(matches(zero, "0,"));
  for (const char* other : {"0", "0,0", " 0,", "0, ", "1,", "0.", "-0,"})
    EXPECT_FALSE(matches(zero, other)) << other;
  EXPECT_TRUE(matches({pattern::literal("a\0b"s)}, "a\0b"s));
  EXPECT_FALSE(matches({pattern::literal("a\0b"s)}, "a\0c"s));
  EXPECT_FALSE(matches({pattern::literal("IDLE")}, "idle"));
}

TEST(ReplyMatchTest, LettersOfRegularExpressionsAreLetters) {
  for (const std::string text : {".", "*", "[0-9]", "(a|b)", "\\d", "^", "$", "a+", "a{2}", "?"}) {
    EXPECT_TRUE(matches({pattern::literal(text)}, text));
    EXPECT_FALSE(matches({pattern::literal(text)}, "a"));
    EXPECT_FALSE(matches({pattern::literal(text)}, "7"));
  }
}

TEST(ReplyMatchTest, ANumberHasARangeAndNoLeadingZeros) {
  const ReplyPattern number{pattern::number(7, 205)};
  for (const char* in : {"7", "8", "9", "10", "42", "99", "100", "204", "205"})
    EXPECT_TRUE(matches(number, in)) << in;
  for (const char* out :
       {"0", "6", "206", "210", "999", "1000", "007", "07", "0205", "+7", "-7", " 7", "7 ", "7.0", "1e2", "a",
        "4294967303", "18446744073709551623", "99999999999999999999999999999"})
    EXPECT_FALSE(matches(number, out)) << out;
  EXPECT_TRUE(matches({pattern::number(0, 0)}, "0"));
  EXPECT_FALSE(matches({pattern::number(0, 0)}, "00"));
  EXPECT_FALSE(matches({pattern::number(0, 0)}, "1"));
  const ReplyPattern any{pattern::number(0, pattern::kAnyCount)};
  EXPECT_TRUE(matches(any, "4294967295"));
  EXPECT_FALSE(matches(any, "4294967296"));
  EXPECT_FALSE(matches({pattern::number(5, 4)}, "5"));
}

TEST(ReplyMatchTest, ANumberMayBePartOfMoreDigits) {
  const ReplyPattern pair{pattern::number(1, 12), pattern::number(3, 4)};
  for (const char* in : {"13", "14", "123", "124", "93"}) EXPECT_TRUE(matches(pair, in)) << in;
  for (const char* out : {"3", "133", "12", "03"}) EXPECT_FALSE(matches(pair, out)) << out;
}

TEST(ReplyMatchTest, ARunHasBytesOfItsSetAndItsLength) {
  const ReplyPattern two{pattern::run(pattern::kDecimalDigits, 2, 2)};
  for (const char* in : {"00", "07", "42", "99"}) EXPECT_TRUE(matches(two, in)) << in;
  for (const char* out : {"", "0", "000", "a0", "0a", "0 ", "-1"}) EXPECT_FALSE(matches(two, out)) << out;
  const ReplyPattern hexadecimal{pattern::run(pattern::kHexadecimalDigits)};
  for (const char* in : {"0", "9", "a", "f", "A", "F", "00fF"}) EXPECT_TRUE(matches(hexadecimal, in)) << in;
  for (const char* out : {"", "g", "G", "0x0", "/", ":", "@", "`"})
    EXPECT_FALSE(matches(hexadecimal, out)) << out;
  const ReplyPattern perhaps{pattern::literal("1"), pattern::run("Z", 0, 1)};
  EXPECT_TRUE(matches(perhaps, "1"));
  EXPECT_TRUE(matches(perhaps, "1Z"));
  EXPECT_FALSE(matches(perhaps, "1ZZ"));
  const ReplyPattern none{pattern::run("", 0)};
  EXPECT_TRUE(matches(none, ""));
  EXPECT_FALSE(matches(none, "0"));
}

TEST(ReplyMatchTest, ARunLeavesBytesToTheNextPart) {
  const ReplyPattern zeros{pattern::run("0", 0), pattern::literal("0.5"), pattern::run("05", 1, 3),
                           pattern::literal("5")};
  for (const char* in : {"0.505", "0.555", "00000.50555"}) EXPECT_TRUE(matches(zeros, in)) << in;
  for (const char* out : {".505", "0.5", "0.55", "0.505555"}) EXPECT_FALSE(matches(zeros, out)) << out;
}

TEST(ReplyMatchTest, SpacesAreNoOtherBlanks) {
  const ReplyPattern one{pattern::spaces(), pattern::literal("1"), pattern::spaces()};
  for (const char* in : {"1", " 1", "1   ", "  1 "}) EXPECT_TRUE(matches(one, in)) << in;
  for (const char* out : {"\t1", "1\t", "1\v", "1 1", "0"}) EXPECT_FALSE(matches(one, out)) << out;
}

TEST(ReplyMatchTest, TextIsAnythingInALine) {
  const ReplyPattern within{pattern::text(), pattern::literal("Physik"), pattern::text()};
  for (const char* in :
       {"Physik", "(c) Physik", "Physik Instrumente", "PhysiPhysik", "PhysikPhysik", "\x80\xff Physik\t"})
    EXPECT_TRUE(matches(within, in)) << in;
  EXPECT_TRUE(matches(within, "\0Physik\0"s));
  for (const char* out :
       {"", "Physi", "physik", "Phy sik", "\nPhysik", "Physik\r", "a\rPhysik", "Physik\n\n"})
    EXPECT_FALSE(matches(within, out)) << out;
}

TEST(ReplyMatchTest, AnyBytesAreAlsoEndsOfLines) {
  const ReplyPattern three{pattern::literal("1"), pattern::any_bytes(2)};
  for (const std::string& in : {"1ab"s, "1\r\n"s, "1\0\xff"s}) EXPECT_TRUE(matches(three, in));
  for (const std::string& out : {"1"s, "1a"s, "1abc"s, "2ab"s}) EXPECT_FALSE(matches(three, out));
}

TEST(ReplyMatchTest, BitsUnderTheMaskAreZeroAndAllOthersDoNotCount) {
  const ReplyPattern clear{pattern::zero_bits("\xf0\x02"s)};
  for (unsigned first = 0; first < 256; ++first) {
    for (unsigned second = 0; second < 256; ++second) {
      const std::string bytes{static_cast<char>(first), static_cast<char>(second)};
      ASSERT_EQ(matches(clear, bytes), first < 16 && second / 2 % 2 == 0) << first << ' ' << second;
    }
  }
}

TEST(ReplyMatchTest, AMaskIsForAsManyBytesAsItHas) {
  const ReplyPattern pattern{{.kind = ReplyPart::Kind::kBytes, .bytes = "\x21\x43"s, .mask = "\x0f"s}};
  EXPECT_TRUE(matches(pattern, "\xf1\x43"));
  EXPECT_FALSE(matches(pattern, "\x22\x43"));
  EXPECT_FALSE(matches(pattern, "\x21\x42"));
  const ReplyPattern longer{{.kind = ReplyPart::Kind::kBytes, .bytes = "\x21"s, .mask = "\x0f\xff"s}};
  EXPECT_TRUE(matches(longer, "\x31"));
  EXPECT_FALSE(matches(longer, "\x32"));
}

TEST(ReplyMatchTest, AnyOfTheAlternativesIsEnough) {
  const ReplyPattern either = ReplyPattern{pattern::literal("0,"), pattern::number(0, 39)} |
                              ReplyPattern{pattern::literal("0,42")} | ReplyPattern{pattern::literal("0,63")};
  EXPECT_EQ(either.alternatives.size(), 3U);
  for (const char* in : {"0,0", "0,39", "0,42", "0,63"}) EXPECT_TRUE(matches(either, in)) << in;
  for (const char* out : {"0,40", "0,420", "0,62", "0,", "0,630,42"})
    EXPECT_FALSE(matches(either, out)) << out;
}

TEST(ReplyMatchTest, AReplyOfMoreThan256BytesFitsNothing) {
  EXPECT_TRUE(matches({pattern::text()}, std::string(256, 'x')));
  EXPECT_FALSE(matches({pattern::text()}, std::string(257, 'x')));
  EXPECT_TRUE(matches({pattern::run("0")}, std::string(256, '0')));
  EXPECT_FALSE(matches({pattern::run("0")}, std::string(257, '0')));
  EXPECT_TRUE(matches({pattern::literal(std::string(256, 'a'))}, std::string(256, 'a')));
  EXPECT_FALSE(matches({pattern::literal(std::string(257, 'a'))}, std::string(257, 'a')));
  EXPECT_FALSE(matches({pattern::literal(std::string(257, 'a'))}, std::string(256, 'a')));
}

TEST(ReplyMatchTest, IsSearchedForAtAnyByteAndAmongTheNewestOnly) {
  const ReplyPattern frame{pattern::literal("\x2a\x04"s), pattern::run("\x21\x50", 1, 1),
                           pattern::zero_bits("\xf0"s)};
  const std::string wanted = "\x2a\x04\x50\x0f"s;
  EXPECT_TRUE(occurs_in(frame, wanted));
  EXPECT_FALSE(matches(frame, "x" + wanted));
  for (std::size_t before = 0; before <= 252; ++before)
    EXPECT_TRUE(occurs_in(frame, std::string(before, 'x') + wanted));
  for (std::size_t after = 0; after <= 252; ++after) {
    EXPECT_TRUE(occurs_in(frame, wanted + std::string(after, 'x')));
    EXPECT_TRUE(occurs_in(frame, std::string(1000, 'x') + wanted + std::string(after, 'x')));
  }
  EXPECT_FALSE(occurs_in(frame, wanted + std::string(253, 'x')));
  EXPECT_TRUE(occurs_in(frame, "\x2a\x2a\x04\x2a\x04\x21\x10\x2a\x04\x21\x0f"s))
      << "parts of it come before it";
  for (std::size_t at = 0; at < wanted.size(); ++at) {
    std::string other = wanted;
    other[at] = static_cast<char>(other[at] ^ 0x10);
    EXPECT_FALSE(occurs_in(frame, other)) << at;
    EXPECT_FALSE(occurs_in(frame, wanted.substr(0, at))) << at;
  }
}

}  // namespace
}  // namespace abcal::wire
