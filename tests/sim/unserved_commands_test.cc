#include "sim/firmware/unserved_commands.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace abcal::sim {
namespace {

TEST(UnservedCommandsTest, KeepTheBytesOfTheFirstOccurrence) {
  UnservedCommands commands;
  commands.note("0C,77", "not emulated", std::string("\x75\x65\x00", 3));
  commands.note("0C,77", "not emulated", "other");
  commands.note("WGO\n", "error 2");
  ASSERT_EQ(commands.all().size(), 2U);
  EXPECT_EQ(commands.all()[0].bytes, std::string("\x75\x65\x00", 3));
  EXPECT_EQ(commands.all()[0].count, 2U);
  EXPECT_EQ(commands.all()[1].bytes, "WGO\n");
}

TEST(UnservedCommandsTest, TellEachOccurrence) {
  UnservedCommands commands;
  std::vector<std::string> told;
  commands.on_note(
      [&](const UnservedCommand& each) { told.push_back(each.command + std::to_string(each.count)); });
  commands.note("A", "");
  commands.note("B", "");
  commands.note("A", "");
  EXPECT_THAT(told, testing::ElementsAre("A1", "B1", "A2"));
}

TEST(UnservedCommandsTest, CountTheRestTogether) {
  UnservedCommands commands;
  for (std::size_t n = 0; n < UnservedCommands::kCapacity + 10; ++n)
    commands.note("C" + std::to_string(n), "");
  ASSERT_EQ(commands.all().size(), UnservedCommands::kCapacity);
  EXPECT_EQ(commands.all().back().command, "others");
  EXPECT_EQ(commands.all().back().count, 11U);
}

}  // namespace
}  // namespace abcal::sim
