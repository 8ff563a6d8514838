#include "protocol/record/table_reader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>

namespace abcal {
namespace {

using ::testing::ElementsAre;

struct ReadTable {
  std::vector<std::vector<std::string>> rows;
  std::vector<std::size_t> lines;
  std::vector<double> numbers;  ///< The cells of the last row.
  std::string separator;
};

ReadTable read(const std::string& text) {
  std::istringstream in(text);
  TableProblems problems("t");
  TableReader reader(in, problems);
  ReadTable table;
  TableRow row;
  while (reader.next(row)) {
    table.rows.push_back(row.cells);
    table.lines.push_back(row.line);
  }
  if (problems.count() > 0) problems.fail();
  for (const std::string& cell : row.cells) table.numbers.push_back(reader.number(cell).value_or(-1.0));
  table.separator = reader.separator_words();
  return table;
}

TEST(TableReaderTest, TheFirstRowTellsWhatSeparatesCells) {
  for (const auto& [text, separator] : {std::pair{"1,2.5,3\n", "commas"},
                                        {"1;2,5;3\n", "semicolons"},
                                        {"1; 2.5;3\n", "semicolons"},
                                        {"1\t2,5\t3\n", "tabs"},
                                        {"  1   2.5 3 \n", "blanks"},
                                        {"1,0 2,5 3,0\n", "blanks"},
                                        {"1, 2.5, 3\n", "commas"}}) {
    const ReadTable table = read(text);
    EXPECT_EQ(table.separator, separator) << text;
    EXPECT_THAT(table.numbers, ElementsAre(1.0, 2.5, 3.0)) << text;
  }
}

TEST(TableReaderTest, LinesMayEndInEachOfThreeWays) {
  for (const char* text : {"a,b\n\n# c\n1,2\n",
                           "\xEF\xBB\xBF"
                           "a,b\r\n\r\n# c\r\n1,2",
                           "a,b\r\r# c\r1,2\r"}) {
    const ReadTable table = read(text);
    EXPECT_THAT(table.rows, ElementsAre(ElementsAre("a", "b"), ElementsAre("1", "2"))) << text;
    EXPECT_THAT(table.lines, ElementsAre(1U, 4U)) << text;
  }
}

TEST(TableReaderTest, CellsMayBeQuotedAndRowsEndWithASeparator) {
  EXPECT_THAT(read("\"a,\"\"b\",c,\n1,\"2\n3\",\n4,5\n").rows,
              ElementsAre(ElementsAre("a,\"b", "c"), ElementsAre("1", "2\n3"), ElementsAre("4", "5")));
}

}  // namespace
}  // namespace abcal
