// Groups and datasets on their way to the program that writes them: every bit arrives, and nothing else is
// taken.

#include "app/document/data_tree.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

namespace abcal {
namespace {

using ::testing::ElementsAre;
using Reals = DataNode::Array<double>;
using Wholes = DataNode::Array<std::int64_t>;

DataNode through_a_stream(const DataNode& node) {
  std::stringstream stream;
  write_node(node, stream);
  return read_node(stream).value();
}

std::vector<std::uint64_t> bits_of(const std::vector<double>& values) {
  std::vector<std::uint64_t> bits;
  for (const double value : values) bits.push_back(std::bit_cast<std::uint64_t>(value));
  return bits;
}

TEST(DataTree, ANumberArrivesBitForBit) {
  using Limits = std::numeric_limits<double>;
  const Reals sent{{2, 1, 3},
                   {0.1, -0.0, Limits::denorm_min(), Limits::infinity(), std::nan("7"), -Limits::max()}};
  const DataNode arrived = through_a_stream({"/a", sent, true, {}});
  EXPECT_EQ(arrived.path, "/a");
  EXPECT_TRUE(arrived.grows);
  const Reals& reals = std::get<Reals>(arrived.content);
  EXPECT_EQ(reals.shape, sent.shape);
  EXPECT_EQ(bits_of(reals.values), bits_of(sent.values));

  const std::vector<std::int64_t> extremes{std::numeric_limits<std::int64_t>::min(), -1,
                                           std::numeric_limits<std::int64_t>::max()};
  const DataNode whole = through_a_stream({"/b", Wholes{{3}, extremes}, false, {}});
  EXPECT_FALSE(whole.grows);
  EXPECT_EQ(std::get<Wholes>(whole.content).values, extremes);
}

TEST(DataTree, ASingleNumberHasNoDimensionsAndAnArrayMayBeEmpty) {
  const DataNode single = through_a_stream({"/a", Reals{{}, {2.5}}, false, {}});
  EXPECT_THAT(std::get<Reals>(single.content).shape, ElementsAre());
  EXPECT_THAT(std::get<Reals>(single.content).values, ElementsAre(2.5));
  const DataNode empty = through_a_stream({"/a", Wholes{{0, 3}, {}}, false, {}});
  EXPECT_THAT(std::get<Wholes>(empty.content).shape, ElementsAre(0U, 3U));
  EXPECT_THAT(std::get<Wholes>(empty.content).values, ElementsAre());
}

TEST(DataTree, NodesFollowEachOtherWithTextsAndAttributes) {
  const std::vector<std::string> axes{"alpha", "."};
  std::stringstream stream;
  write_node(
      {"/", DataNode::Group{}, false, {{"name", "Sö\xffhne"}, {"axes", axes}, {"n", std::int64_t{-1}}}},
      stream);
  write_node({"/text", "one\x01two", false, {}}, stream);
  const DataNode group = read_node(stream).value();
  EXPECT_TRUE(std::holds_alternative<DataNode::Group>(group.content));
  ASSERT_EQ(group.attributes.size(), 3U);
  EXPECT_EQ(std::get<std::string>(group.attributes.at("name")), "Sö\uFFFDhne");
  EXPECT_EQ(std::get<std::vector<std::string>>(group.attributes.at("axes")), axes);
  EXPECT_EQ(std::get<std::int64_t>(group.attributes.at("n")), -1);
  EXPECT_EQ(std::get<std::string>(read_node(stream).value().content), "one two");
  EXPECT_FALSE(read_node(stream));
}

TEST(DataTree, BytesThatAreNoNodeAreRefused) {
  std::stringstream whole;
  write_node({"/a", Reals{{2}, {1.0, 2.0}}, false, {}}, whole);
  for (std::size_t size = 1; size < whole.str().size(); ++size) {
    std::stringstream cut(whole.str().substr(0, size));
    EXPECT_THROW(read_node(cut), std::runtime_error) << size;
  }
  std::stringstream too_few;
  write_node({"/a", Reals{{3}, {1.0, 2.0}}, false, {}}, too_few);
  EXPECT_THROW(read_node(too_few), std::runtime_error);
  std::stringstream text("a,b\n1,2\n");
  EXPECT_THROW(read_node(text), std::runtime_error);
}

TEST(DataTree, AStreamThatFailsIsNotItsEnd) {
  std::stringstream stream;
  stream.setstate(std::ios::badbit);
  EXPECT_THROW(read_node(stream), std::runtime_error);
}

}  // namespace
}  // namespace abcal
