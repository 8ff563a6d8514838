#include "app/bench_file/bench_config.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "app/measure/bench/make_firmware.h"
#include "tests/app/bench_text.h"
#include "tests/app/instrument_cases.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::HasSubstr;

constexpr const char* kSmallest = R"(
[bench]
g_loc_mps2 = 9.81
[stage]
driver = "pi_gcs"
port = "simulated"
[accelerometer]
driver = "microstrain_mip"
port = "simulated"
)";

std::string problems_of(const std::string& toml) {
  try {
    parse_bench(toml, "bench.toml");
  } catch (const BenchError& error) {
    return error.what();
  }
  ADD_FAILURE() << "accepted: " << toml;
  return {};
}

TEST(BenchConfigTest, FillsInTheDocumentedDefaults) {
  const BenchConfig config = parse_bench(kSmallest, "bench.toml");
  EXPECT_EQ(config.protocol.steps, 72);
  EXPECT_EQ(config.protocol.step, Angle::degrees(5.0));
  EXPECT_EQ(config.item(1).tolerances.alignment, Angle::degrees(0.008));
  EXPECT_EQ(config.item(1).tolerances.drift, 1e-4);
  EXPECT_EQ(config.stage.x.axis, "1");
  EXPECT_EQ(config.stage.z.axis, "2");
}

TEST(BenchConfigTest, AnUnknownDriverIsToldOnceWithThoseThatAreKnown) {
  std::string toml = kSmallest;
  toml.replace(toml.find("pi_gcs"), 6, "nope");
  EXPECT_EQ(problems_of(toml),
            "bench file bench.toml: 1 problem\n"
            "  line 5, [stage] driver: found \"nope\"; required: one of \"newport_esp\", \"newport_xps\", "
            "\"pi_gcs\", \"thorlabs_apt\", \"zaber_ascii\", \"described\", \"simulated\", \"manual_stage\"\n"
            "      driver = \"nope\"\n"
            "               ^");
}

TEST(BenchConfigTest, WritesEveryDefaultOutAndReadsItBackToTheSame) {
  BenchConfig config = parse_bench(kSmallest, "bench.toml");
  config.name = "a \"name\" with \\ and ü";
  config.protocol.settle_s = 0.1 + 0.2;  // a number with all its digits
  config.simulation.x.harmonics.push_back({2, Angle::degrees(0.001), Angle::degrees(-1.0 / 3.0)});
  config.stage.x.speed_deg_per_s = 3.0;
  const std::string once = write_bench(config);
  const BenchConfig again = parse_bench(once, "stored");
  EXPECT_EQ(write_bench(again), once);
  EXPECT_TRUE(again.is_same_bench(config));
  EXPECT_EQ(again.name, config.name);
  EXPECT_EQ(again.protocol.settle_s, config.protocol.settle_s);
  ASSERT_EQ(again.simulation.x.harmonics.size(), 1U);
  EXPECT_EQ(again.simulation.x.harmonics[0].cos_coefficient, Angle::degrees(-1.0 / 3.0));
  EXPECT_THAT(once, HasSubstr("alignment_deg = { value = 0.008, source = 'default' }"));
}

TEST(BenchConfigTest, ReportsEveryProblemAtOnceWithItsLine) {
  const std::string text = problems_of(R"([bench]
g_loc_mps2 = "heavy"
[stage]
driver = "pi_gsc"
port = 7
[stage.x]
sign = 2
[protocol]
steps = 2
setle_s = 3.0
settle_s = nan
dwell_readings = 10.5
[tolerances]
step_deg = -0.1
[simulation]
offset = [1, 2]
[acelerometer]
port = "simulated"
)");
  EXPECT_THAT(text, HasSubstr("line 2, [bench] g_loc_mps2: found \"heavy\""));
  EXPECT_THAT(text, HasSubstr("line 4, [stage] driver: found \"pi_gsc\""));
  EXPECT_THAT(text, HasSubstr("\"pi_gcs\""));
  EXPECT_THAT(text, HasSubstr("line 5, [stage] port: found 7"));
  EXPECT_THAT(text, HasSubstr("line 7, [stage.x] sign: found 2"));
  EXPECT_THAT(text, HasSubstr("line 9, [protocol] steps: found 2"));
  EXPECT_THAT(text, HasSubstr("line 10, [protocol] setle_s"));
  EXPECT_THAT(text, HasSubstr("did you mean \"settle_s\"?"));
  EXPECT_THAT(text, HasSubstr("line 11, [protocol] settle_s: found nan"));
  EXPECT_THAT(text, HasSubstr("line 12, [protocol] dwell_readings: found 10.5"));
  EXPECT_THAT(text, HasSubstr("line 14, [tolerances] step_deg: found -0.1"));
  EXPECT_THAT(text, HasSubstr("line 16, [simulation] offset"));
  EXPECT_THAT(text, HasSubstr("did you mean \"accelerometer\"?"));
  EXPECT_THAT(text, HasSubstr("[accelerometer] driver: found nothing"));
}

TEST(BenchConfigTest, RefusesSettingsThatContradictEachOther) {
  const std::string base = kSmallest;
  EXPECT_THAT(problems_of(base + "[stage.x]\ntravel_min_deg = 10\ntravel_max_deg = -10\n"),
              HasSubstr("travel_min_deg <"));
  EXPECT_THAT(problems_of(base + "[stage.z]\naxis = \"1\"\n"), HasSubstr("two different axes"));
  // The last of 73 angles would be the first again, one turn later.
  EXPECT_THAT(problems_of(base + "[protocol]\nsteps = 73\nstep_deg = 5\n"),
              HasSubstr("(steps - 1) * step_deg < 360"));
  EXPECT_NO_THROW(parse_bench(base + "[protocol]\nsteps = 72\nstep_deg = 5\n", "bench.toml"));
  // Half of the angles of an experiment belong to each face, and a circle needs four.
  for (const char* steps : {"71", "6"}) {
    EXPECT_THAT(problems_of(base + "[protocol]\nsteps = " + steps + "\nstep_deg = 5\nfaces = 2\n"),
                HasSubstr(std::string("steps: found ") + steps +
                          " with faces = 2; required: an even number of at least 8"));
  }
  EXPECT_NO_THROW(parse_bench(base + "[protocol]\nsteps = 8\nstep_deg = 45\nfaces = 2\n", "bench.toml"));
  EXPECT_THAT(problems_of(base + "[protocol]\nfaces = 3\n"), HasSubstr("[protocol] faces: found 3"));
  EXPECT_THAT(problems_of(base + "[protocol]\nfaces = 2\n[temperature]\nset_points_degc = [23, 60]\n"),
              HasSubstr("faces: found 2 with [temperature] set_points_degc; required: faces = 1"));
  EXPECT_THAT(
      problems_of("[stage]\ndriver=\"pi_gcs\"\nport=\"simulated\"\n[accelerometer]\ndriver=\"simulated\"\n"
                  "port=\"simulated\"\n"),
      HasSubstr("local gravity"));
}

TEST(BenchConfigTest, ATravelThatContradictsItselfOrTheSimulationIsToldWithItsLine) {
  const std::string base = kSmallest;  // 9 lines
  EXPECT_THAT(problems_of(base + "[stage.x]\ntravel_min_deg = 10\ntravel_max_deg = -10\n"),
              HasSubstr("line 11, [stage.x] travel_min_deg: found 10 to -10; required: travel_min_deg < "));
  EXPECT_THAT(
      problems_of(base + "[simulation.z]\ntravel_max_deg = -400\n"),
      HasSubstr("line 11, [simulation.z] travel_max_deg: found -360 to -400; required: travel_min_deg < "));
  EXPECT_THAT(problems_of(base + "[stage.x]\ntravel_min_deg = 400\n"),
              HasSubstr("line 11, [stage.x] travel_min_deg: found 400; required: below 360, as the travel of "
                        "[simulation.x] is -360 to 360"));
  EXPECT_THAT(problems_of(base + "[stage.z]\ntravel_max_deg = -360\n"),
              HasSubstr("line 11, [stage.z] travel_max_deg: found -360; required: above -360"));
  const std::string wrong = problems_of(base + "[stage.x]\ntravel_min_deg = 10\ntravel_max_deg = 1e308\n");
  EXPECT_THAT(wrong, HasSubstr("1 problem\n"));
  EXPECT_THAT(wrong, HasSubstr("line 12, [stage.x] travel_max_deg: found 1e+308; required: a number from "));
}

TEST(BenchConfigTest, AScaleByWhichNothingCanBeDividedIsRefused) {
  std::string toml = kSmallest;
  toml += "scale = [1.0, 1e-300, 1.0]\n";
  EXPECT_THAT(problems_of(toml),
              HasSubstr("line 10, [accelerometer] scale: found 1e-300; required: no zeros"));
}

TEST(BenchConfigTest, WhomToTellIsAnAddressOrEveryReasonWhyNot) {
  const std::string base = kSmallest;
  const std::string text = problems_of(
      base + "[notify]\nwebhook = \"example.org\"\nmail_to = \"nobody\"\nmail_server = \"mail\"\n");
  EXPECT_THAT(text, HasSubstr("[notify] webhook: found \"example.org\"; required: http://"));
  EXPECT_THAT(text, HasSubstr("[notify] mail_to: found \"nobody\"; required: a mail address"));
  EXPECT_THAT(text, HasSubstr("[notify] mail_from: found nothing"));
  EXPECT_THAT(text, HasSubstr("[notify] mail_server: found \"mail\"; required: smtp://"));
  EXPECT_EQ(parse_bench(base + "[notify]\nwebhook = \"env:HOOK\"\n", "bench.toml").notify.webhook,
            "env:HOOK");
}

TEST(BenchConfigTest, TakesGravityFromAFormulaAndWarns) {
  std::string text = kSmallest;
  text.replace(text.find("g_loc_mps2 = 9.81"), 17, "latitude_deg = 45.0\nheight_m = 0.0");
  const BenchConfig config = parse_bench(text, "bench.toml");
  EXPECT_NEAR(config.g_loc.value_mps2, 9.8061992025, 5e-11);  // GRS80 to the digits
  EXPECT_GT(config.g_loc.expanded_uncertainty_mps2, 4e-4);
  ASSERT_EQ(config.warnings.size(), 1U);
}

TEST(BenchConfigTest, SaysWhereTheTomlItselfIsBroken) {
  EXPECT_THAT(problems_of("[bench]\nname = unquoted\n"), HasSubstr("line 2"));
  EXPECT_THAT(problems_of("  \n\n"), HasSubstr("nothing in it"));
  EXPECT_THAT(problems_of("stage = 3\n"), HasSubstr("a table [stage]"));
}

std::string tray_item(const std::string& port, const std::string& more = "") {
  return "[[item]]\n" + more + "[item.accelerometer]\ndriver = \"microstrain_mip\"\nport = \"" + port +
         "\"\n";
}
const std::string kTrayBench =
    "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"pi_gcs\"\nport = \"simulated\"\n";

TEST(BenchConfigTest, SeveralItemsHaveTheirOwnAccelerometersAndTheDefaultsOfTheFile) {
  const std::string toml = kTrayBench + "[limits]\ndrift = 0.5\n[simulation]\nnoise = 1e-3\n" +
                           tray_item("/dev/a", "serial_number = \"1\"\n") +
                           tray_item("/dev/b", "serial_number = \"2\"\nmounting = \"y -x z\"\n") +
                           "rate_hz = 50.0\n[item.limits]\ndrift = 0.25\n[item.simulation]\nnoise = 2e-3\n";
  const BenchConfig config = parse_bench(toml, "bench.toml");
  ASSERT_EQ(config.items.size(), 2U);
  EXPECT_EQ(config.item(1).item.serial_number, "1");
  EXPECT_EQ(config.item(1).accelerometer.port, "/dev/a");
  EXPECT_EQ(config.item(1).limits.drift, 0.5);
  EXPECT_EQ(config.item(1).simulation.noise, 1e-3);
  EXPECT_EQ(config.item(2).limits.drift, 0.25);
  EXPECT_EQ(config.item(2).accelerometer.settings.rate_hz, 50.0);
  const sim::ItemTruth second = item_truth(config, 2);
  EXPECT_EQ(second.noise, 2e-3);
  EXPECT_EQ(second.sensitivity_matrix.row(0), Eigen::RowVector3d(0, 1, 0)) << "turned as mounted";
  EXPECT_NE(second.seed, item_truth(config, 1).seed);
  const std::string once = write_bench(config);
  EXPECT_EQ(write_bench(parse_bench(once, "stored")), once);
  EXPECT_EQ(parse_bench(once, "stored"), config);
  EXPECT_EQ(once.find("\n[accelerometer]"), std::string::npos);
}

TEST(BenchConfigTest, WhatOneOfSeveralItemsLeavesOutIsNotTakenFromAnotherWhenReadBack) {
  BenchConfig config = parse_bench(kTrayBench + tray_item("/dev/a") + tray_item("/dev/b"), "bench.toml");
  config.item(1).simulation.full_scale = 2.0;
  config.item(1).limits.drift = 0.5;
  config.item(1).tolerances.k2 = 0.05;
  config.item(1).tolerances.sources["k2"] = "data sheet";
  config.item(1).at_power_on = "silent";
  EXPECT_EQ(parse_bench(write_bench(config), "stored"), config);
}

TEST(BenchConfigTest, AListOfOneItemMeansTheSameAsTheFormOfOne) {
  const std::string keys = "serial_number = \"1\"\nmounting = \"y -x z\"\n";
  const std::string accelerometer = "driver = \"microstrain_mip\"\nport = \"simulated\"\nrate_hz = 50.0\n";
  const std::string limits = "[limits]\ndrift = 0.5\n";
  const std::string fault = "[[fault]]\nkind = \"no-output\"\ninstrument = \"";
  const std::string change = "\"\n[[change]]\nat_s = 5.0\noffset = [0.1, 0.0, 0.0]\n";
  // A truth in a list is stated along the item's own axes, in [simulation] along those of the platter.
  const BenchConfig listed =
      parse_bench(kTrayBench + limits + "[[item]]\n" + keys + "[item.accelerometer]\n" + accelerometer +
                      "[item.simulation]\nnoise = 1e-3\n" + fault + "item-1" + change,
                  "bench.toml");
  const BenchConfig plain =
      parse_bench(kTrayBench + limits + "[item]\n" + keys + "[accelerometer]\n" + accelerometer +
                      "[simulation]\nnoise = 1e-3\n"
                      "sensitivity_matrix = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]\n" +
                      fault + "accelerometer" + change,
                  "bench.toml");
  EXPECT_EQ(listed, plain);
  EXPECT_EQ(write_bench(listed), write_bench(plain));
  EXPECT_EQ(accelerometer_name(listed, 1), "accelerometer");
  EXPECT_EQ(item_words(listed, 1), "");
}

TEST(BenchConfigTest, SeveralItemsAreMeasuredInOneFace) {
  EXPECT_THAT(problems_of(kTrayBench + tray_item("/dev/a") + tray_item("/dev/b") + "[protocol]\nfaces = 2\n"),
              HasSubstr("[protocol] faces: found 2 with several items; required: faces = 1"));
}

TEST(BenchConfigTest, EveryProblemOfSeveralItemsIsToldAtOnceWithItsLine) {
  const std::string text = problems_of(kTrayBench + R"([accelerometer]
driver = "vectornav"
[[item]]
serial_number = "7"
mounting = "x y -z"
[item.accelerometer]
driver = "microstrain_mip"
port = "/dev/a"
[[item]]
serial_number = "7"
mounting = "1 0 0 0 1 0 0 0 2"
[item.accelerometer]
driver = "microstrain_mip"
port = "/dev/a"
ratehz = 7.0
[[item]]
mounting = "up"
[item.limits]
repeats = -1
[[fault]]
kind = "no-output"
instrument = "item-4"
)");
  EXPECT_THAT(text, HasSubstr("line 6, accelerometer: found a section [accelerometer] beside [[item]]"));
  EXPECT_THAT(
      text, HasSubstr("line 10, [item[0]] mounting: found \"x y -z\", a mirror image; required: a rotation"));
  EXPECT_THAT(text,
              HasSubstr("line 15, [item[1]] serial_number: found \"7\", as item 1 has; required: each item"));
  EXPECT_THAT(text,
              HasSubstr("line 16, [item[1]] mounting: found \"1 0 0 0 1 0 0 0 2\"; required: the axes"));
  EXPECT_THAT(
      text,
      HasSubstr("line 19, [item[1].accelerometer] port: found \"/dev/a\", as item 1 has; required: a port"));
  EXPECT_THAT(text, HasSubstr("line 20, [item.accelerometer] ratehz"));
  EXPECT_THAT(text, HasSubstr("line 21, [item.accelerometer] driver: found nothing"));
  EXPECT_THAT(text, HasSubstr("line 22, [item[2]] mounting: found \"up\""));
  EXPECT_THAT(text, HasSubstr("line 24, [item.limits] repeats: found -1"));
  EXPECT_THAT(text, HasSubstr("line 27, [fault[0]] instrument: found \"item-4\""));
}

TEST(BenchConfigTest, MoreThan32ItemsAreRefused) {
  std::string toml = kTrayBench;
  for (int k = 1; k <= 32; ++k) toml += tray_item("/dev/" + std::to_string(k));
  EXPECT_EQ(parse_bench(toml, "bench.toml").items.size(), 32U);
  EXPECT_THAT(problems_of(toml + tray_item("/dev/33")),
              testing::AllOf(HasSubstr("line 134, item[32]: found 33 items; required: at most 32")));
}

TEST(BenchConfigTest, ReadsEveryExampleFile) {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(test::source_folder() / "docs" / "examples")) {
    const std::string name = entry.path().filename();
    if (entry.path().extension() != ".toml" || name == "laboratory.toml" || name == "described_stage.toml")
      continue;
    EXPECT_NO_THROW(read_bench(entry.path())) << entry.path();
    ++count;
  }
  EXPECT_GE(count, 3);
}

TEST(BenchConfigTest, TwoControllersOnOnePortAreADaisyChain) {
  const std::string toml = R"(
[bench]
g_loc_mps2 = 9.81
[stage.x]
driver = "pi_gcs"
port = "/dev/stage"
address = "1"
axis = "1"
[stage.z]
driver = "pi_gcs"
port = "/dev/stage"
address = "2"
axis = "1"
[accelerometer]
driver = "microstrain_mip"
port = "simulated"
)";
  const BenchConfig config = parse_bench(toml, "bench.toml");
  EXPECT_TRUE(config.stage.chained());
  const std::vector<InstrumentPort> ports = stage_ports(config.stage);
  ASSERT_EQ(ports.size(), 1U);
  EXPECT_EQ(ports[0].name, "stage");
  EXPECT_THAT(ports[0].axis_names(config.stage), testing::ElementsAre("1 1", "2 1"));
  EXPECT_THAT(problems_of(replaced(toml, "address = \"1\"\n", "")), HasSubstr("[stage.z] address"));
  EXPECT_THAT(problems_of(replaced(toml, "address = \"2\"", "address = \"1\"")),
              HasSubstr("two different axes"));
  EXPECT_THAT(problems_of(replaced(toml, "pi_gcs", "newport_esp")), HasSubstr("in a daisy chain"));
  EXPECT_THAT(problems_of(replaced(toml, "address = \"2\"", "address = \"17\"")),
              HasSubstr("[stage.z] address: found \"17\"; required: \"1\" to \"16\""));
}

TEST(BenchConfigTest, TheAxesOfADaisyChainMayHaveOneDriverAndTwoAddresses) {
  const std::string toml = R"(
[bench]
g_loc_mps2 = 9.81
[stage]
driver = "zaber_ascii"
port = "/dev/stage"
[stage.x]
address = "2"
axis = "1"
[stage.z]
address = "14"
axis = "1"
[accelerometer]
driver = "microstrain_mip"
port = "simulated"
)";
  const StageConfig stage = parse_bench(toml, "bench.toml").stage;
  ASSERT_EQ(stage_ports(stage).size(), 1U);
  EXPECT_THAT(stage_ports(stage)[0].axis_names(stage), testing::ElementsAre("2 1", "14 1"));
  EXPECT_THAT(problems_of(replaced(toml, "\"14\"", "\"2\"")), HasSubstr("two different axes"));
  EXPECT_THAT(problems_of(replaced(toml, "\"14\"", "\"100\"")), HasSubstr("required: \"1\" to \"99\""));
  EXPECT_THAT(problems_of(replaced(toml, "zaber_ascii", "newport_esp")), HasSubstr("in a daisy chain"));
  EXPECT_THAT(problems_of(replaced(toml, "port = \"/dev/stage\"", "port = \"/dev/stage\"\naddress = \"3\"")),
              HasSubstr("beside the addresses of the axes"));
  const std::string pi = replaced(replaced(toml, "zaber_ascii", "pi_gcs"), "address = \"2\"\n", "");
  EXPECT_THAT(problems_of(pi), HasSubstr("[stage.z] address"));
}

TEST(BenchConfigTest, AControllerIsLostFromADaisyChainOnly) {
  const std::string fault = "[[fault]]\nkind = \"lost-controller\"\naxis = \"z\"\n";
  const std::string toml =
      "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"pi_gcs\"\nport = \"simulated\"\n"
      "[accelerometer]\ndriver = \"microstrain_mip\"\nport = \"simulated\"\n" +
      fault;
  EXPECT_NO_THROW(parse_bench(toml, "bench.toml"));
  EXPECT_THAT(problems_of(replaced(toml, "pi_gcs", "newport_esp")), HasSubstr("lost-controller"));
}

TEST(BenchConfigTest, ASimulatedSensitivityInAnotherUnitIsAProblem) {
  const std::string toml = replaced(kSmallest, "microstrain_mip", "vectornav");
  EXPECT_THAT(problems_of(toml), testing::AllOf(HasSubstr("[simulation] sensitivity_matrix"),
                                                HasSubstr("output is in m/s2"), HasSubstr("about 9.807")));
  const std::string matrix =
      "[simulation]\nsensitivity_matrix = [[9.8, 0.0, 0.0], [0.0, 9.8, 0.0], [0.0, 0.0, 9.8]]\n";
  EXPECT_NO_THROW(parse_bench(toml + matrix, "bench.toml"));
  EXPECT_THAT(problems_of(kSmallest + matrix), HasSubstr("output is in g"));
  // An instrument that is not simulated has no such problem.
  EXPECT_NO_THROW(parse_bench(
      replaced(toml, "\"vectornav\"\nport = \"simulated\"", "\"vectornav\"\nport = \"/dev/ttyUSB0\""),
      "bench.toml"));
}

// A survey states its uncertainty; the default that a written file has is no statement.
TEST(BenchConfigTest, GravityThatIsKnownExactlyIsDoubted) {
  const auto warnings = [](const std::string& more) {
    const std::string bench = BenchText().text();
    const std::string g_loc = "g_loc_mps2 = 9.81\n";
    const std::size_t at = bench.find(g_loc) + g_loc.size();
    return parse_bench(bench.substr(0, at) + more + bench.substr(at), "bench").warnings;
  };
  const std::string none = "g_loc_expanded_uncertainty_mps2 = 0.0\n", source = "g_loc_source = \"survey\"\n";
  EXPECT_THAT(warnings(none + source), testing::Contains(testing::HasSubstr("no gravity is known exactly")));
  EXPECT_THAT(warnings(none), testing::IsEmpty());
  EXPECT_THAT(warnings("g_loc_expanded_uncertainty_mps2 = 1e-5\n" + source), testing::IsEmpty());
}

}  // namespace
}  // namespace abcal
