#include "drivers/manual_chamber/manual_chamber.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <deque>
#include <stdexcept>

#include "drivers/instrument/instrument_error.h"

namespace abcal::manual_chamber {
namespace {

using testing::HasSubstr;

struct Talk {
  std::deque<std::string> answers;
  std::string told;
  ManualChamber::Person person() {
    return {[this](std::string_view text) { told += text; },
            [this]() -> std::optional<std::string> {
              if (answers.empty()) return std::nullopt;
              std::string line = answers.front();
              answers.pop_front();
              return line;
            }};
  }
};

TEST(ManualChamberTest, AsksAndTakesWhatIsTyped) {
  Talk talk{{"4O", "90", "-39,6"}, {}};
  ManualChamber chamber(talk.person(), {});
  EXPECT_THROW(chamber.read(), InstrumentError);
  chamber.set_temperature(-40.0, 1.0);
  EXPECT_THAT(talk.told, testing::AllOf(HasSubstr("Set the chamber to -40 degC, ramp 1 K/min"),
                                        HasSubstr("required: a temperature within 5 K of -40 degC")));
  EXPECT_EQ(chamber.read().air_degc, -39.6);
  EXPECT_TRUE(chamber.read().running);
  EXPECT_FALSE(chamber.pause(true));
}

TEST(ManualChamberTest, NobodyThereIsAnError) {
  Talk talk;
  ManualChamber chamber(talk.person(), {});
  EXPECT_THROW(chamber.set_temperature(23.0, std::nullopt), InstrumentError);
  ChamberSettings settings;
  settings.pause_output = 1;
  EXPECT_THROW(ManualChamber(talk.person(), settings), std::invalid_argument);
}

}  // namespace
}  // namespace abcal::manual_chamber
