#include "drivers/text_line/codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <clocale>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/drivers/text_line/reference_reader.h"

namespace abcal::text_line {
namespace {

namespace reference = test::text_line_reference;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

/// Lines that are read if the bytes come in pieces of this size.
std::vector<std::vector<double>> read(std::string_view bytes, std::size_t piece = 1, LineFormat format = {}) {
  LineReader reader(std::move(format));
  std::vector<std::vector<double>> lines;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    reader.feed(bytes.substr(at, piece));
    while (const auto line = reader.next()) lines.push_back(line->values);
  }
  return lines;
}

TEST(TextLineCodecTest, ReadsNumbersAsBoardsPrintThem) {
  EXPECT_EQ(parse_number("1"), 1.0);
  EXPECT_EQ(parse_number("+1.50"), 1.5);
  EXPECT_EQ(parse_number("-.5e-3"), -0.5e-3);
  EXPECT_EQ(parse_number("16384"), 16384.0);
  EXPECT_EQ(parse_number("-0.0000"), 0.0);
  EXPECT_EQ(parse_number("1E3"), 1000.0);
  EXPECT_TRUE(std::isnan(*parse_number("nan")));
  EXPECT_TRUE(std::isnan(*parse_number("NAN")));
  EXPECT_EQ(parse_number("-inf"), -std::numeric_limits<double>::infinity());
  for (const char* word : {"", "+", "-", ".", "1,5", "1.5.2", "1-2", "++1", "+-1", "1e", "0x10", "1 2", " 1",
                           "ovf", "1e999", "1e-999", "12a", "e5"})
    EXPECT_FALSE(parse_number(word)) << word;
}

TEST(TextLineCodecTest, DoesNotHeedTheLocale) {
  const std::string before = std::setlocale(LC_ALL, nullptr);
  const char* comma = std::setlocale(LC_ALL, "de_DE.UTF-8");
  EXPECT_EQ(parse_number("1.25"), 1.25);
  EXPECT_FALSE(parse_number("1,25"));
  std::setlocale(LC_ALL, before.c_str());
  if (comma == nullptr)
    GTEST_SKIP() << "this machine has no locale with a decimal comma; checked with its own";
}

// ---- Names, units, quotes and decimal commas ------------------------------------------------------------

const std::vector<std::string> kNames{"ax", "ay", "az"};

TEST(TextLineCodecTest, FindsNumbersBehindTheirNames) {
  const LineFormat format{.names = kNames};
  for (const std::string line :
       {R"({"t":7,"ax":0.5,"ay":-1e-3,"az":+9.81})", "ax=0.5 ay=-1e-3 az=9.81",
        "ax: 0.5, ay: -0.001, az: 9.81", "az:9.81;ay:-0.001;ax:0.5", ">ax:0.5|>ay:-.001|>az:9.81",
        R"({"acc":{"ax":"0.5","ay":"-0.001","az":"9.81"},"max":3,"ax2":4})"}) {
    for (const std::size_t piece : {1U, 7U, 500U})
      EXPECT_THAT(read("x\n" + line + "\n", piece, format), ElementsAre(ElementsAre(0.5, -0.001, 9.81)))
          << line;
  }
}

TEST(TextLineCodecTest, ANameThatIsNotClearIsNoReading) {
  const LineFormat format{.names = kNames};
  for (const std::string line :
       {"ax:1 ay:2 az:3 ax:4", "ax: ay:2 az:3", "ax:1.2.3 ay:2 az:3", "ax:1x ay:2 az:3",
        "ax:0,01,ay:0,02,az:1,00", "ax:null,ay:2,az:3", "ax 1 ay 2 az 3", "bax:1 bay:2 baz:3"})
    EXPECT_THAT(read("\n" + line + "\n", 9, format), IsEmpty()) << line;
}

TEST(TextLineCodecTest, EachNumberMayHaveALineOfItsOwn) {
  const LineFormat format{.names = kNames};
  const std::string bytes = "\n>ay:2\n>az:3\n>temp:23\n>ax:4\n>ay:5\n>az:6\n>ax:7\n>ay:8\n>az:9\n";
  // It began in the middle of a reading, whose rest is taken with the first number of the next: the sensor's
  // own order is not known. From then on a repeated name begins a new reading.
  EXPECT_THAT(read(bytes, 5, format), ElementsAre(ElementsAre(4, 2, 3), ElementsAre(7, 5, 6)));
}

TEST(TextLineCodecTest, ALostLineOfOneNumberIsALostReading) {
  LineReader reader({.names = kNames});
  reader.feed("\nax:1\nay:2\naz:3\nax:4\naz:6\nax:7\nay:8\naz:9\n");
  std::vector<std::vector<double>> found;
  while (const auto line = reader.next()) found.push_back(line->values);
  // "ax:7" came before "ay": the reading of 4 and 6 is dropped, and 7 with it.
  EXPECT_THAT(found, ElementsAre(ElementsAre(1, 2, 3)));
  EXPECT_EQ(reader.bad_frames(), 1U);
}

TEST(TextLineCodecTest, OnceAllStoodOnOneLineAPartIsABadLine) {
  LineReader reader({.names = kNames});
  reader.feed("\nax:1 ay:2 az:3\nax:4 ay:5\nax:6 ay:7 az:8\nnoise\n");
  std::vector<std::vector<double>> found;
  while (const auto line = reader.next()) found.push_back(line->values);
  EXPECT_THAT(found, ElementsAre(ElementsAre(1, 2, 3), ElementsAre(6, 7, 8)));
  EXPECT_EQ(reader.bad_frames(), 2U);
}

TEST(TextLineCodecTest, NumbersMayHaveAUnitQuotesAndADecimalComma) {
  EXPECT_THAT(read("\n0.5g,1 g,-2g\n", 3, {.unit = "g"}), ElementsAre(ElementsAre(0.5, 1.0, -2.0)));
  EXPECT_THAT(read("\n0.5,1,-2\n", 3, {.unit = "g"}), ElementsAre(ElementsAre(0.5, 1.0, -2.0)));
  EXPECT_THAT(read("\n\"0.5\",\"1\", \" -2 \"\n", 3), ElementsAre(ElementsAre(0.5, 1.0, -2.0)));
  EXPECT_THAT(read("\n\"0,5\",\"1,25\",\"-2,0\"\n", 3, {.decimal_mark = ','}),
              ElementsAre(ElementsAre(0.5, 1.25, -2.0)));
  EXPECT_THAT(read("\n0,5;1,25;-2\n", 3, {.separator = ";", .decimal_mark = ','}),
              ElementsAre(ElementsAre(0.5, 1.25, -2.0)));
  EXPECT_THAT(read("\nax=0,5 ay=1,25 az=-2\nax=1,ay=2,az=3\n", 3, {.names = kNames, .decimal_mark = ','}),
              ElementsAre(ElementsAre(0.5, 1.25, -2.0), ElementsAre(1, 2, 3)));
  EXPECT_THAT(read("\n0.5;1.25;2.5\n", 3, {.separator = ";", .decimal_mark = ','}), IsEmpty());
  EXPECT_THAT(read("\n0.5m,1m,2m\n", 3, {.unit = "g"}), IsEmpty());
}

TEST(TextLineCodecTest, NamesThatCannotBeAreRefused) {
  EXPECT_THROW(LineReader({.names = {"ax", "ax", "az"}}), std::invalid_argument);
  EXPECT_THROW(LineReader({.names = {"a x", "ay", "az"}}), std::invalid_argument);
  EXPECT_THROW(LineReader({.names = {"", "ay", "az"}}), std::invalid_argument);
  EXPECT_THROW(LineReader({.decimal_mark = '\''}), std::invalid_argument);
}

TEST(TextLineCodecTest, TakesEveryEndOfALine) {
  for (const std::string end : {"\r\n", "\n", "\r", "\r\r\n", "\n\n"}) {
    const std::string bytes = end + "1,2,3" + end + "4,5,6" + end;
    for (std::size_t piece = 1; piece < 20; ++piece)
      EXPECT_THAT(read(bytes, piece), ElementsAre(ElementsAre(1, 2, 3), ElementsAre(4, 5, 6)));
  }
}

TEST(TextLineCodecTest, NeverTakesHalfALine) {
  EXPECT_THAT(read("11.5,2,3\n4,5,6\n7,8,9"), ElementsAre(ElementsAre(4, 5, 6)));
  EXPECT_THAT(read("4,5,6"), IsEmpty());
  LineReader reader({});
  reader.feed("x\n1,2,3\n4,5,");
  EXPECT_TRUE(reader.next());
  EXPECT_FALSE(reader.next());
  EXPECT_TRUE(reader.has_partial());
  reader.lose_track();
  reader.feed("6\n7,8,9\n");
  EXPECT_THAT(reader.next()->values, ElementsAre(7, 8, 9));
  EXPECT_EQ(reader.skipped_bytes(), 2U + 4U + 2U);
  EXPECT_EQ(reader.bad_frames(), 0U);
}

TEST(TextLineCodecTest, SkipsCommentsEmptyLinesAndHeaders) {
  LineReader reader({});
  reader.feed("\nADXL355 ready\n# rate 100\nu,v,w\n\n  # more\n1,2,3\n#4,5,6\n7,8,9\nu,v,w\n");
  EXPECT_THAT(reader.next()->values, ElementsAre(1, 2, 3));
  EXPECT_EQ(reader.header_lines(), 2U);
  EXPECT_EQ(reader.bad_frames(), 0U);
  EXPECT_THAT(reader.next()->values, ElementsAre(7, 8, 9));
  EXPECT_FALSE(reader.next());
  EXPECT_EQ(reader.header_lines(), 2U) << "behind the first line of numbers there is no header";
  EXPECT_EQ(reader.bad_frames(), 1U);
  EXPECT_EQ(reader.skipped_bytes(), 1U + 6U);
}

TEST(TextLineCodecTest, TakesTheColumnsItIsTold) {
  const LineFormat time_first{.columns = {4, 2, 3}, .separator = ";", .comment = ""};
  EXPECT_THAT(read("\n12:30:01.5; 1 ;\t2;3;ok\n", 1, time_first), ElementsAre(ElementsAre(3, 1, 2)));
  const LineFormat blanks{.columns = {1, 2, 3}, .separator = " ", .comment = "//"};
  EXPECT_THAT(read("\n  1\t 2   3 \n// 4 5 6\n7 8 9\n", 1, blanks),
              ElementsAre(ElementsAre(1, 2, 3), ElementsAre(7, 8, 9)));
  const LineFormat tabs{.columns = {1, 3}, .separator = "\t", .comment = "#"};
  EXPECT_THAT(read("\n1\t\t3\n", 1, tabs), ElementsAre(ElementsAre(1, 3)));
  EXPECT_THAT(read("\n1,2\n"), IsEmpty());
}

TEST(TextLineCodecTest, RefusesLinesJoinedByALostEnd) {
  LineReader reader({});
  reader.feed("\n1,2,3\n");
  EXPECT_EQ(reader.next()->words, 3U);
  reader.require_words(3);
  reader.feed("1,2,34,5,6\n7,8\n9,8,7\n");
  EXPECT_THAT(reader.next()->values, ElementsAre(9, 8, 7));
  EXPECT_EQ(reader.bad_frames(), 2U);
}

TEST(TextLineCodecTest, BoundsTheLengthOfALine) {
  for (const std::size_t piece : {std::size_t{1}, std::size_t{100}, std::size_t{5000}}) {
    const std::string longest = "1,2,3" + std::string(LineReader::kLongestLine - 5, ' ');
    const std::string bytes = "\n" + longest + "\n" + longest + " \n" + std::string(3000, '7') + "\n4,5,6\n";
    EXPECT_THAT(read(bytes, piece), ElementsAre(ElementsAre(1, 2, 3), ElementsAre(4, 5, 6)));
    LineReader reader({});
    for (std::size_t at = 0; at < bytes.size(); at += piece) {
      reader.feed(std::string_view(bytes).substr(at, piece));
      while (reader.next()) continue;
    }
    EXPECT_EQ(reader.bad_frames(), 2U);
    EXPECT_EQ(reader.skipped_bytes(), 1U + longest.size() + 2U + 3001U);
  }
}

TEST(TextLineCodecTest, ReadsTheSameHoweverTheBytesAreSplitAndDamaged) {
  const std::string bytes =
      "3,4\r\nheader\r\n0.01,-0.02,1.0\r\n\x80\xFF,\x01\r\n0.02,nan,1.0\r\n#\r\n0.0.1,2,3\r\n5,6,7,"
      "8\r\r\n1e400,1,1\n";
  const auto expected = reference::decode(bytes, {});
  EXPECT_EQ(expected.lines.size(), 3U);
  EXPECT_EQ(expected.bad_lines, 3U);
  for (std::size_t piece = 1; piece <= bytes.size(); ++piece) {
    LineReader reader({});
    std::size_t found = 0;
    for (std::size_t at = 0; at < bytes.size(); at += piece) {
      reader.feed(std::string_view(bytes).substr(at, piece));
      while (reader.next()) ++found;
    }
    EXPECT_EQ(found, 3U);
    EXPECT_EQ(reader.header_lines(), expected.headers);
    EXPECT_EQ(reader.bad_frames(), expected.bad_lines);
    EXPECT_EQ(reader.skipped_bytes(), expected.skipped_bytes);
  }
}

TEST(TextLineCodecTest, RefusesFormatsThatCannotBe) {
  const auto make = [](std::vector<int> columns, std::string separator) {
    LineReader({.columns = std::move(columns), .separator = std::move(separator), .comment = "#"});
  };
  EXPECT_THROW(make({}, ","), std::invalid_argument);
  EXPECT_THROW(make({0, 1, 2}, ","), std::invalid_argument);
  EXPECT_THROW(make({1, 2, 1}, ","), std::invalid_argument);
  for (const char* separator : {"", ", ", ".", "-", "7", "e", "\n"})
    EXPECT_THROW(make({1, 2, 3}, separator), std::invalid_argument) << separator;
  for (const char* separator : {",", ";", " ", "\t", "|", ":"}) EXPECT_NO_THROW(make({1, 2, 3}, separator));
}

}  // namespace
}  // namespace abcal::text_line
