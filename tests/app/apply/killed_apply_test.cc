// The program killed after it has written, and what --undo then does, over the bytes of an instrument in
// another process.

#include <gmock/gmock.h>

#include <chrono>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <utility>

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

class AppliedCertificateTest : public ProgramTest {};

TEST_F(AppliedCertificateTest, OneCertificateHasAsFoundAndAsLeft) {
  std::string bench = test::read_file(test::source_folder() / "docs/examples/simulated.toml");
  for (const auto& [from, to] : {std::pair("steps = 72\nstep_deg = 5.0", "steps = 12\nstep_deg = 30.0"),
                                 std::pair("dwell_readings = 1000", "dwell_readings = 50"),
                                 // Its offset is then the one in the file.
                                 std::pair("draw = \"stated\"", "# nothing is drawn")})
    bench.replace(bench.find(from), std::string_view(from).size(), to);
  test::write_file(folder / "bench.toml", bench);
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "a.run"}).exit_code, 0);
  const test::ProgramResult applied =
      abcal({"apply", "a.run", "--to", "bench.toml", "--yes", "--save", "--json"});
  ASSERT_EQ(applied.exit_code, 0) << applied.err;
  const nlohmann::json json = nlohmann::json::parse(applied.out);
  EXPECT_EQ(json.at("state"), "saved");
  const auto offset_z = [&](const char* when) {
    return json.at("errors").at(when).at("offset").at(2).get<double>();
  };
  EXPECT_NEAR(offset_z("as_found"), 0.0226, 2e-4);
  EXPECT_NEAR(offset_z("as_left"), 0.0, 2e-4);
  std::string laboratory = test::read_file(test::source_folder() / "docs/examples/laboratory.toml");
  laboratory.replace(laboratory.find("[job]"), 5, "[job]\nadjustment = \"The bias was written.\"");
  test::write_file(folder / "lab.toml", laboratory);
  const test::ProgramResult report = abcal({"report", "a.as-left.run", "--as-found", "a.run", "--laboratory",
                                            "lab.toml", "--draft", "--dcc", "both.xml"});
  ASSERT_EQ(report.exit_code, 0) << report.err;
  const std::string xml = test::read_file(folder / "both.xml");
  for (const char* part : {"beforeAdjustment", "afterAdjustment", "The bias was written."})
    EXPECT_THAT(xml, HasSubstr(part));
}

}  // namespace
}  // namespace abcal
