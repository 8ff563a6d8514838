// Answers to the questions of `abcal init`, sense and nonsense, and the bench file made of them.

#include "app/commands/init_answers.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "app/commands/init_bench_file.h"
#include "app/commands/port_listing.h"
#include "app/system/output_file.h"
#include "drivers/instrument/instrument_error.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

template <class Call>
std::string refusal(const Call& call) {
  try {
    call();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "accepted";
}

TEST(InitAnswers, TravelForBothAxesOrEach) {
  const auto both = parse_travel("-100 365");
  EXPECT_EQ(both[0].min.deg(), -100.0);
  EXPECT_EQ(both[1].max.deg(), 365.0);
  const auto each = parse_travel(" -100 365 ,  -5.5 +400 ");
  EXPECT_EQ(each[0].max.deg(), 365.0);
  EXPECT_EQ(each[1].min.deg(), -5.5);
  EXPECT_EQ(each[1].max.deg(), 400.0);
  EXPECT_EQ(parse_travel("-400 0")[0].min.deg(), -400.0);
}

TEST(InitAnswers, NonsenseForTravelIsRefusedWithWhatIsRequired) {
  for (const char* text :
       {"", "far", "365", "-100 to 365", "-100;365", "-100 365 5", "nan 365", "-1e999 365", "0x10 365"})
    EXPECT_THAT(refusal([&] { parse_travel(text); }), HasSubstr("required:")) << text;
  EXPECT_THAT(refusal([] { parse_travel("-100 365, 1 2, 3 4"); }), HasSubstr("MIN MAX"));
  EXPECT_THAT(refusal([] { parse_travel("10 365"); }), HasSubstr("both sides of zero"));
  EXPECT_THAT(refusal([] { parse_travel("365 -100"); }), HasSubstr("both sides of zero"));
  EXPECT_THAT(refusal([] { parse_travel("-20 20"); }), HasSubstr("30"));
  EXPECT_THAT(refusal([] { parse_travel("\u2212100 365"); }), HasSubstr("- as its minus sign"));
  EXPECT_THAT(refusal([] { parse_travel("-100\u00b0 365\u00b0"); }), HasSubstr("without a unit"));
  EXPECT_THAT(refusal([] { parse_travel("-99999 365"); }), HasSubstr("-36000 to 36000"));
}

TEST(InitAnswers, APlaceIsLatitudeAndHeightOrASurvey) {
  EXPECT_EQ(parse_place("52.3 80").latitude_deg, 52.3);
  EXPECT_EQ(parse_place("-33.9, 20").height_m, 20.0);
  const PlaceAnswer survey = parse_place("g 9.81234 0.00002");
  EXPECT_EQ(survey.g_loc_mps2, 9.81234);
  EXPECT_EQ(survey.expanded_uncertainty_mps2, 0.00002);
  EXPECT_FALSE(survey.latitude_deg);
  for (const char* text :
       {"", "Berlin", "52.3", "52.3N 80", "g 9.81", "g 981 0.1", "91 0", "0 9999", "g 9.81 -1", "g 9.81 0"})
    EXPECT_THAT(refusal([&] { parse_place(text); }), HasSubstr("required:")) << text;
  EXPECT_THAT(refusal([] { parse_place("52,3 80"); }), HasSubstr("decimal point"));
  // As a person sees that a longitude was taken for a height.
  EXPECT_EQ(gravity_by_formula(parse_place("52.3 80")), "gravity 9.81249 m/s2 by formula, U = 0.00057 m/s2");
}

TEST(InitAnswers, NamesAxesAndYes) {
  EXPECT_EQ(parse_operator("  Zoë N. "), "Zoë N.");
  for (const char* text : {"", "   ", "52.3 80", "a\x1b[2J", "\xff\xfe", "a\x7f"})
    EXPECT_THAT(refusal([&] { parse_operator(text); }), HasSubstr("required:")) << text;
  EXPECT_THAT(parse_axes("A B"), ElementsAre("A", "B"));
  EXPECT_THAT(refusal([] { parse_axes("1 1"); }), HasSubstr("outer and the inner"));
  EXPECT_TRUE(parse_yes_or_no(" yes"));
  EXPECT_TRUE(parse_yes_or_no("Yes"));
  EXPECT_FALSE(parse_yes_or_no("NO"));
  EXPECT_FALSE(parse_yes_or_no("n"));
  for (const char* text : {"", "YES!", "ja", "1"})
    EXPECT_THAT(refusal([&] { parse_yes_or_no(text); }), HasSubstr("yes or no")) << text;
}

Probed answering(const std::string& port, const std::string& driver, bool is_stage) {
  return {port, ProbeAnswer{driver, is_stage, "Maker", "Model", "7", "1"}, ""};
}

TEST(InitAnswers, OneOfTwoStagesIsChosenByNumberOrPort) {
  const std::vector<Probed> probed{answering("/dev/ttyUSB0", "pi_gcs", true),
                                   answering("/dev/ttyUSB1", "microstrain_mip", false),
                                   answering("/dev/ttyUSB2", "zaber_ascii", true),
                                   {"/dev/ttyUSB3", {}, ""},
                                   {"/dev/ttyUSB4", {}, "in use by pid 12 (screen)"}};
  const std::vector<Probed> stages = candidates(probed, "stage");
  ASSERT_EQ(stages.size(), 2U);
  EXPECT_EQ(chosen(stages, "2")->port, "/dev/ttyUSB2");
  EXPECT_EQ(chosen(stages, "/dev/ttyUSB0")->answer->driver, "pi_gcs");
  EXPECT_FALSE(chosen(stages, "tcp:host:50000")) << "another port";
  EXPECT_THAT(refusal([&] { (void)chosen(stages, ""); }), HasSubstr("2 answer; required"));
  EXPECT_THAT(refusal([&] { (void)chosen(stages, "3"); }), HasSubstr("1 to 2"));
  EXPECT_THAT(refusal([&] { (void)chosen(stages, "0"); }), HasSubstr("1 to 2"));
  EXPECT_EQ(chosen(candidates(probed, "accelerometer"), "")->port, "/dev/ttyUSB1") << "the only one";
  EXPECT_THAT(refusal([&] { (void)chosen({}, ""); }), HasSubstr("none answers"));
}

TEST(InitAnswers, AnInstrumentThatCannotBeUsedIsRefusedWithTheReason) {
  const auto reason = [](const Probed& probed, const char* role) {
    return refusal([&] { require_role(probed, role); });
  };
  EXPECT_EQ(reason(answering("p", "pi_gcs", true), "stage"), "accepted");
  EXPECT_THAT(reason(answering("p", "microstrain_mip", false), "stage"),
              AllOf(HasSubstr("an accelerometer answers"), HasSubstr("required: a stage")));
  EXPECT_THAT(reason({"p", {}, "in use by pid 12 (screen)"}, "stage"), HasSubstr("pid 12 (screen)"));
  EXPECT_THAT(reason({"p", {}, ""}, "stage"),
              AllOf(HasSubstr("no instrument"), HasSubstr("abcal instruments")));
  Probed several = answering("p", "scpi_single", false);
  several.answer->ports = 3;
  EXPECT_THAT(reason(several, "accelerometer"), HasSubstr("written by hand"));
}

TEST(InitAnswers, TheAxesOfAChainAreNamedWhereTheyAreNotTwo) {
  ProbeAnswer stage{"zaber_ascii", true, "Zaber", "X", "1", "7"};
  EXPECT_THAT(axes_of(stage, {}), ElementsAre("1", "2"));
  stage.axes = {"1/1", "2/1"};
  EXPECT_THAT(axes_of(stage, {}), ElementsAre("1/1", "2/1"));
  EXPECT_THAT(axes_of(stage, {{"2/1", "1/1"}}), ElementsAre("2/1", "1/1"));
  EXPECT_THAT(refusal([&] { axes_of(stage, {{"2/1", "3/1"}}); }), HasSubstr("3/1"));
  stage.axes.emplace_back("3/1");
  EXPECT_THAT(refusal([&] { axes_of(stage, {}); }), AllOf(HasSubstr("1/1, 2/1, 3/1"), HasSubstr("--axes")));
  stage.axes = {"1/1"};
  EXPECT_THAT(refusal([&] { axes_of(stage, {}); }), HasSubstr("split_stage"));
}

wire::PortInfo usb_port(const std::string& path, const std::string& serial_number) {
  wire::PortInfo port;
  port.path = path;
  port.usb_vendor = 0x1a72;
  port.usb_product = 0x1007;
  port.serial_number = serial_number;
  port.permitted = true;
  return port;
}

TEST(InitAnswers, APortIsNamedByWhatStays) {
  std::vector<wire::PortInfo> listed{usb_port("/dev/ttyUSB0", "A"), usb_port("/dev/ttyUSB1", ""),
                                     usb_port("/dev/ttyUSB2", "")};
  listed[2].by_id = "/dev/serial/by-id/two";
  EXPECT_EQ(stable_port_name("/dev/ttyUSB0", listed), "usb:1A72:1007:A");
  EXPECT_EQ(stable_port_name("/dev/ttyUSB1", listed), "/dev/ttyUSB1") << "another one has the same identity";
  EXPECT_EQ(stable_port_name("/dev/ttyUSB2", listed), "/dev/serial/by-id/two");
  EXPECT_EQ(stable_port_name("tcp:host:50000", listed), "tcp:host:50000");
  EXPECT_EQ(stable_port_name("links/stage", {}), (std::filesystem::current_path() / "links/stage").string());
}

TEST(InitAnswers, EachPortIsAskedOnceAndOneWithoutPermissionSaysSo) {
  std::vector<wire::PortInfo> listed{usb_port("/dev/ttyUSB0", "A"), usb_port("/dev/ttyUSB1", "B"),
                                     usb_port("/dev/ttyUSB2", "C")};
  listed[2].permitted = false;
  listed[2].owner_group = "dialout";
  EXPECT_THAT(ports_for({}, 2, listed), ElementsAre("/dev/ttyUSB0", "/dev/ttyUSB1"));
  EXPECT_THAT(ports_for({"usb:1A72:1007:A"}, 2, listed), ElementsAre("usb:1A72:1007:A", "/dev/ttyUSB1"));
  EXPECT_THAT(ports_for({"tcp:h:1", "tcp:h:2"}, 2, listed), ElementsAre("tcp:h:1", "tcp:h:2"));
  EXPECT_THAT(port_text(listed[2]), AllOf(HasSubstr("not permitted"), HasSubstr("usermod -aG dialout")));
}

BenchDraft draft() {
  BenchDraft draft;
  draft.stage_name = "Maker\nC-884";  // A comment stays one line.
  draft.stage_driver = "pi_gcs";
  draft.stage_port = "/dev/serial/by-id/a \"b\"";
  draft.accelerometer_driver = "microstrain_mip";
  draft.accelerometer_port = "usb:199B:3065";
  draft.item = {"MicroStrain", "3DM-GV7-AR", "6284.1"};
  draft.travel = parse_travel("-100 365, -5 400");
  draft.place = parse_place("g 9.81 0.0002");
  draft.operator_name = "Zoë \"Z\" N\\.";
  draft.made = "Made by a test.";
  return draft;
}

TEST(InitBenchFile, IsReadBackAsItWasMeant) {
  BenchDraft made = draft();
  const BenchConfig before = parse_bench(bench_draft_text(made), "first");
  EXPECT_EQ(before.stage.z.sign, +1);
  EXPECT_EQ(before.items.front().expected.mounting, "x y z");
  made.learned = LearnedMounting{"-y x z", +1, -1, false, Angle::degrees(2.0), 1.0, 0.0};
  const BenchConfig config = parse_bench(bench_draft_text(made), "second");
  EXPECT_EQ(config.stage.port, made.stage_port);
  EXPECT_EQ(config.operator_name, made.operator_name);
  EXPECT_EQ(config.g_loc.value_mps2, 9.81);
  EXPECT_EQ(config.g_loc.expanded_uncertainty_mps2, 0.0002);
  EXPECT_EQ(config.items.front().item.serial_number, "6284.1");
  EXPECT_EQ(config.items.front().expected.mounting, "-y x z");
  EXPECT_EQ(config.stage.x.sign, +1);
  EXPECT_EQ(config.stage.x.travel_min_deg, -100.0);
  // The limits were stated as the controller counts, and a bench file has them in the angles of the protocol.
  EXPECT_EQ(config.stage.z.sign, -1);
  EXPECT_EQ(config.stage.z.travel_min_deg, -400.0);
  EXPECT_EQ(config.stage.z.travel_max_deg, 5.0);
  EXPECT_EQ(config.stage.z.zero.deg(), 0.0);
  EXPECT_TRUE(config.items.front().tolerances.sources.empty()) << "no size is stated";
}

TEST(InitBenchFile, TakesThePlaceOfNoFileNotEvenOfOneMadeMeanwhile) {
  const test::TemporaryFolder folder;
  const std::filesystem::path path = folder / "bench.toml";
  OutputFile file(path);
  test::write_file(path, "# mine\n");
  EXPECT_THAT(refusal([&] { file.write_new("# theirs\n"); }), HasSubstr("exists already"));
  EXPECT_EQ(test::read_file(path), "# mine\n");
  OutputFile(folder / "other.toml").write_new("# new\n");
  EXPECT_EQ(test::read_file(folder / "other.toml"), "# new\n");
  std::filesystem::create_symlink(folder / "nowhere", folder / "link.toml");
  EXPECT_THAT(refusal([&] { OutputFile(folder / "link.toml").write_new("x"); }), HasSubstr("exists already"));
}

}  // namespace
}  // namespace abcal
