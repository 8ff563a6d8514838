// The program killed after it has written, and what --undo then does, over the bytes of an instrument in
// another process.

#include <gmock/gmock.h>

#include <chrono>
#include <nlohmann/json.hpp>
#include <string>

#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using testing::HasSubstr;

class KilledApplyTest : public EmulatedBenchTest {
 protected:
  nlohmann::json registers() {
    const test::ProgramResult shown = abcal({"apply", "a.run", "--to", "bench.toml", "--dry-run", "--json"});
    EXPECT_EQ(shown.exit_code, 0) << shown.err;
    return nlohmann::json::parse(shown.out).at("registers");
  }
};

TEST_F(KilledApplyTest, UndoBringsBackWhatAKilledProgramHasOverwritten) {
  bench.accelerometer_driver = "vectornav";
  bench.simulation = "sensitivity_matrix = [[9.83, 0.0, 0.0], [0.0, 9.81, 0.0], [0.0, 0.0, 9.79]]\n";
  start_emulator();
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "a.run"}).exit_code, 0);
  const nlohmann::json before = registers();
  EXPECT_EQ(before.at("before"), before.at("in_force"));
  {
    test::Program killed({"apply", "a.run", "--to", "bench.toml", "--yes"}, folder.path());
    ASSERT_TRUE(test::wait_for([&] { return killed.err().find("written\n") != std::string::npos; },
                               std::chrono::seconds(120)))
        << killed.err();
    killed.signal(SIGKILL);
    killed.wait();
  }
  EXPECT_EQ(registers().at("before"), before.at("after")) << "it was written";
  const test::ProgramResult again = abcal({"apply", "a.run", "--to", "bench.toml", "--yes"});
  EXPECT_EQ(again.exit_code, 2);
  EXPECT_THAT(again.err, HasSubstr("--undo first"));
  const test::ProgramResult undone = abcal({"apply", "a.run", "--to", "bench.toml", "--undo", "--yes"});
  EXPECT_EQ(undone.exit_code, 0) << undone.err;
  EXPECT_THAT(undone.out, HasSubstr("State: undone"));
  EXPECT_EQ(registers().at("before"), before.at("before"));
}

}  // namespace
}  // namespace abcal
