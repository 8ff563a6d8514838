// Faults and changes while an emulator runs: the control lines, and [[fault]] and [[change]] of bench files.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <boost/asio/connect.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/read_until.hpp>
#include <boost/asio/streambuf.hpp>
#include <boost/asio/write.hpp>
#include <memory>
#include <nlohmann/json.hpp>

#include "app/bench_file/bench_config.h"
#include "app/measure/bench/make_bench.h"
#include "app/measure/emulator/control_server.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/record/sqlite.h"
#include "sim/firmware/faulty_port.h"
#include "sim/firmware/pi_gcs_firmware.h"
#include "sim/sim_clock.h"
#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using test::ProgramResult;
using testing::HasSubstr;
using Json = nlohmann::json;

const std::string kBench =
    "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"pi_gcs\"\nport = \"simulated\"\n[accelerometer]\ndriver "
    "= "
    "\"microstrain_mip\"\nport = \"simulated\"\n[simulation]\noffset = [0.1, 0.2, 0.3]\n";

class EmulatorControlTest : public testing::Test {
 protected:
  Json ask(const std::string& line) { return Json::parse(control.answer(line)); }

  sim::SimClock clock;
  std::shared_ptr<sim::SimBench> world = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
  sim::FaultyPort stage{std::make_shared<sim::PiGcsFirmware>(world), clock};
  EmulatorControl control{{world}, clock, {{"stage", &stage.link()}}};
};

TEST_F(EmulatorControlTest, SaysWhereTheStageIsAndWhatIsWrong) {
  world->move(StageAxis::kZ, Angle::degrees(30.0), clock.now());
  clock.sleep_until(clock.now() + 60s);
  const Json status = ask(R"({"do": "status"})");
  EXPECT_EQ(status["ok"], true);
  EXPECT_EQ(status["time_s"], 60.0);
  EXPECT_EQ(status["z"]["commanded_deg"], 30.0);
  EXPECT_EQ(status["z"]["moving"], false);
  EXPECT_EQ(status["faults"], Json::array());
}

TEST_F(EmulatorControlTest, SaysWhatAChamberWasTold) {
  EXPECT_FALSE(ask(R"({"do": "status"})").contains("chamber"));
  world->command_chamber({.target_degc = -40.0, .running = true}, clock.now());
  const Json status = ask(R"({"do": "status"})");
  EXPECT_EQ(status["chamber"]["target_degc"], -40.0);
  EXPECT_EQ(status["chamber"]["running"], true);
  EXPECT_EQ(status["chamber"]["paused"], false);
}

TEST_F(EmulatorControlTest, AFaultOfTheWireBeginsNowAndEnds) {
  clock.sleep_until(clock.now() + 10s);
  EXPECT_EQ(ask(R"({"do": "fault", "kind": "silence", "instrument": "stage", "for_s": 5})")["ok"], true);
  EXPECT_EQ(ask(R"({"do": "status"})")["faults"], Json::parse(R"([{"kind": "silence", "where": "stage"}])"));
  const auto asked = [&] {
    stage.receive("CSV?\n", clock.now());
    clock.sleep_until(clock.now() + 1s);
    return stage.transmit(clock.now());
  };
  EXPECT_EQ(asked(), "");
  clock.sleep_until(clock.now() + 5s);
  EXPECT_EQ(asked(), "2.0\n");
}

TEST_F(EmulatorControlTest, UnpluggedAndPluggedInAgain) {
  ask(R"({"do": "fault", "kind": "unplug", "instrument": "stage", "for_s": 2})");
  EXPECT_FALSE(stage.plugged_in());
  clock.sleep_until(clock.now() + 3s);
  EXPECT_TRUE(stage.plugged_in());
}

TEST_F(EmulatorControlTest, AFaultOfTheWorldAndTheEndOfAllFaults) {
  EXPECT_EQ(ask(R"({"do": "fault", "kind": "clipped-output", "value": 0.5})")["ok"], true);
  EXPECT_EQ(world->output(clock.now(), 0).value[2], 0.5);
  EXPECT_EQ(ask(R"({"do": "clear"})")["ok"], true);
  EXPECT_EQ(world->output(clock.now(), 0).value[2], 1.0);
}

TEST_F(EmulatorControlTest, AChangeKeepsWhatItDoesNotName) {
  EXPECT_EQ(ask(R"({"do": "change", "offset": [0.5, 0, 0]})")["ok"], true);
  EXPECT_EQ(ask(R"({"do": "change", "temperature_degc": 30})")["ok"], true);
  const sim::SimOutput output = world->output(clock.now(), 0);
  EXPECT_EQ(output.value, Eigen::Vector3d(0.5, 0.0, 1.0));
  EXPECT_EQ(output.temperature_degc, 30.0);
}

TEST_F(EmulatorControlTest, WhatIsNotUnderstoodChangesNothingAndSaysWhy) {
  const auto refusal = [&](const std::string& line) {
    const Json reply = ask(line);
    EXPECT_EQ(reply["ok"], false) << line;
    return reply.value("error", "");
  };
  EXPECT_THAT(refusal("nonsense"), HasSubstr("status"));
  EXPECT_THAT(refusal("\xff\xfe"), HasSubstr("status"));
  EXPECT_THAT(refusal(R"({"do": "dance"})"), HasSubstr("dance"));
  EXPECT_THAT(refusal(R"({"do": "status", "who": 1})"), HasSubstr("who"));
  EXPECT_THAT(refusal(R"({"do": "fault", "kind": "gremlins"})"), HasSubstr("silence"));
  EXPECT_THAT(refusal(R"({"do": "fault", "kind": "silence"})"), HasSubstr("instrument"));
  EXPECT_THAT(refusal(R"({"do": "fault", "kind": "silence", "instrument": "accelerometer"})"),
              HasSubstr("accelerometer"));
  EXPECT_THAT(refusal(R"({"do": "fault", "kind": "stuck-output", "for_s": "long"})"), HasSubstr("for_s"));
  EXPECT_THAT(refusal(R"({"do": "change", "ofset": [1, 2, 3]})"), HasSubstr("offset"));
  EXPECT_EQ(ask(R"({"do": "status"})")["faults"], Json::array());
}

TEST_F(EmulatorControlTest, IsServedOnTheLoopback) {
  ControlServer server(control, 0);
  boost::asio::io_context io;
  boost::asio::ip::tcp::socket socket(io);
  socket.connect({boost::asio::ip::address_v4::loopback(), server.port()});
  boost::asio::streambuf input;
  for (int n = 0; n < 2; ++n) {
    boost::asio::write(socket, boost::asio::buffer(std::string("{\"do\": \"status\"}\n")));
    boost::asio::read_until(socket, input, '\n');
    std::istream lines(&input);
    std::string line;
    std::getline(lines, line);
    EXPECT_EQ(Json::parse(line)["ok"], true);
  }
  EXPECT_THROW(ControlServer(control, server.port()), std::runtime_error);
}

TEST(FaultSchedule, ABenchFileMakesThingsGoWrongInTime) {
  const BenchConfig config =
      parse_bench(kBench +
                      "[[fault]]\nkind = \"not-finite\"\nat_s = 5.0\nfor_s = 2.0\n"
                      "[[fault]]\nkind = \"silence\"\ninstrument = \"stage\"\nat_s = 8\n"
                      "[[change]]\nat_s = 10\noffset = [1.0, 1.0, 1.0]\n"
                      "[[change]]\nat_s = 20\nnoise = 0.0\ntemperature_degc = 40\n",
                  "test");
  Bench bench = make_bench(config);
  const Clock::Instant start = bench.world->start();
  EXPECT_EQ(bench.world->output(start + 4s, 0).value[0], 0.1);
  EXPECT_TRUE(std::isnan(bench.world->output(start + 6s, 0).value[0]));
  EXPECT_EQ(bench.world->output(start + 8s, 0).value[0], 0.1);
  EXPECT_EQ(bench.world->output(start + 11s, 0).value[0], 1.0);
  EXPECT_EQ(bench.world->output(start + 21s, 0).value[0], 1.0);  // values that a change does not name stay
  EXPECT_EQ(bench.world->temperature_degc(start + 21s), 40.0);

  bench.stage->identify();
  bench.clock->sleep_until(start + 9s);
  EXPECT_THROW(bench.stage->encoder_angle(StageAxis::kX), InstrumentError);
  // A written file reads back unchanged.
  EXPECT_EQ(write_bench(parse_bench(write_bench(config), "again")), write_bench(config));
}

TEST(FaultSchedule, EveryProblemOfAScheduleIsReported) {
  try {
    parse_bench(
        kBench +
            "[[fault]]\nkind = \"silence\"\n[[fault]]\nkind = \"gremlins\"\nfor_s = -1\n[[fault]]\nat_s "
            "= 1\n[[change]]\nat_s = 2\n[[change]]\nat_s = 1\nofset = 1\n",
        "test");
    FAIL();
  } catch (const BenchError& error) {
    const std::string text = error.what();
    for (const char* part : {"instrument", "gremlins", "for_s", "kind", "order of time", "ofset"})
      EXPECT_THAT(text, HasSubstr(part));
  }
}

TEST(TwoControllers, EachAxisAnswersOnItsOwnPort) {
  std::string text = kBench;
  const std::string one = "[stage]\ndriver = \"pi_gcs\"\nport = \"simulated\"\n";
  text.replace(text.find(one), one.size(),
               "[stage.x]\ndriver = \"pi_gcs\"\nport = \"simulated\"\naxis = \"1\"\n"
               "[stage.z]\ndriver = \"newport_esp\"\nport = \"simulated\"\naxis = \"1\"\n");
  Bench bench = make_bench(parse_bench(text, "test"));
  const StageInfo info = bench.stage->identify();
  EXPECT_THAT(info.model, testing::AllOf(HasSubstr("C-884"), HasSubstr("ESP")));
  for (const StageAxis axis : kStageAxes) {
    bench.stage->home(axis);
    while (bench.stage->motion_state(axis) == MotionState::kMoving)
      bench.clock->sleep_until(bench.clock->now() + 100ms);
  }
  bench.stage->identify();
  bench.stage->move_to(StageAxis::kX, Angle::degrees(10.0));
  bench.stage->move_to(StageAxis::kZ, Angle::degrees(-20.0));
  bench.clock->sleep_until(bench.clock->now() + 60s);
  EXPECT_NEAR(bench.stage->encoder_angle(StageAxis::kX).deg(), 10.0, 1e-3);
  EXPECT_NEAR(bench.stage->encoder_angle(StageAxis::kZ).deg(), -20.0, 1e-3);
  EXPECT_NEAR(bench.world->commanded_angle(StageAxis::kX, bench.clock->now()).deg(), 10.0, 1e-3);
}

TEST(EnvironmentSensorOnTheBench, SaysWhatTheWorldIs) {
  Bench bench = make_bench(parse_bench(kBench + "temperature_degc = 24.5\n[environment]\ndriver = "
                                                "\"text_line\"\nport = \"simulated\"\nhumidity_column = 2\n",
                                       "test"));
  const EnvironmentReading reading = bench.environment->read(bench.clock->now() + 10s);
  EXPECT_NEAR(reading.temperature_degc.value(), 24.5, 0.01);
  EXPECT_TRUE(reading.humidity_percent.has_value());
  EXPECT_FALSE(reading.pressure_hpa.has_value());
}

class EmulatorProcessTest : public EmulatedBenchTest {};

TEST_F(EmulatorProcessTest, TheEnvironmentSensorsReadingsAreInTheRunFile) {
  const BenchText simulated;
  test::write_file(folder / "bench.toml",
                   simulated.text() + "\n[environment]\ndriver = \"text_line\"\nport = \"simulated\"\n");
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "a.run"}).exit_code, 0);
  SqliteDatabase file(folder / "a.run", SqliteDatabase::Mode::kReadOnly);
  EXPECT_EQ(file.value("select count(*) from environment where abs(temperature_degc - 23.0) < 0.01"), "2");
}

TEST_F(EmulatorProcessTest, AnUnpluggedInstrumentsPortVanishesAndComesBack) {
  test::write_file(folder / "bench.toml", bench.text());
  test::Program serving({"emulate", "bench.toml", "--link-dir", "links", "--control", "0"}, folder.path());
  ASSERT_TRUE(test::wait_for([&] { return serving.out().find("Serving") != std::string::npos; }, 20s));
  const std::string out = serving.out();
  const std::size_t at = out.find("127.0.0.1:") + 10;
  const auto port = static_cast<std::uint16_t>(std::stoi(out.substr(at, out.find('\n', at) - at)));
  boost::asio::io_context io;
  boost::asio::ip::tcp::socket socket(io);
  socket.connect({boost::asio::ip::address_v4::loopback(), port});
  const std::filesystem::path link = folder / "links/accelerometer";
  const auto there = [&] { return std::filesystem::is_symlink(std::filesystem::symlink_status(link)); };
  ASSERT_TRUE(there());
  boost::asio::write(
      socket, boost::asio::buffer(std::string("{\"do\": \"fault\", \"kind\": \"unplug\", \"instrument\": "
                                              "\"accelerometer\", \"for_s\": 1.0}\n")));
  EXPECT_TRUE(test::wait_for([&] { return !there(); }, 10s));
  EXPECT_TRUE(test::wait_for(there, 10s));
  // The next program that opens the link finds the instrument again.
  const ProgramResult check = abcal({"check", "bench.toml", "--no-motion"});
  EXPECT_EQ(check.exit_code, 0) << check.out << check.err;
}

TEST_F(EmulatorProcessTest, AnAccelerometerOfThisProgramFollowsAStageOfAnother) {
  // The stage is another process's, as a real one would be; the accelerometer is simulated here.
  start_emulator();
  BenchText mixed;
  mixed.stage_port = "links/stage";
  test::write_file(folder / "mixed.toml", mixed.text());
  const ProgramResult run = abcal({"run", "mixed.toml", "-o", "a.run"});
  ASSERT_EQ(run.exit_code, 0) << run.err;
  // Turned by the encoder's angles, so within the run's own uncertainty of the truth.
  const ProgramResult truth = abcal({"analyse", "a.run", "--truth", "mixed.toml"});
  EXPECT_EQ(truth.exit_code, 0) << truth.out;
}

TEST_F(EmulatorProcessTest, AnEmulatedAccelerometerFollowsAStageThatAnotherProgramServes) {
  start_emulator();
  BenchText follower = bench;
  test::write_file(folder / "follow.toml", follower.text());
  test::Program following(
      {"emulate", "follow.toml", "--link-dir", "follow", "--follow-stage", "--control", "0"}, folder.path());
  ASSERT_TRUE(test::wait_for([&] { return following.out().find("Serving") != std::string::npos; }, 20s))
      << following.err();
  EXPECT_THAT(following.out(), HasSubstr("follows the encoders"));
  EXPECT_FALSE(std::filesystem::exists(folder / "follow/stage"));
  EXPECT_TRUE(std::filesystem::exists(folder / "follow/accelerometer"));
  // A lost stage ends the emulator: an accelerometer that no longer follows it would report false outputs.
  emulator->signal(SIGKILL);
  EXPECT_EQ(following.wait(), 3);
  EXPECT_NE(following.err(), "");
}

TEST(TwoControllers, HalfAConfigurationIsRefused) {
  const auto problems = [](const std::string& stage) {
    std::string text = kBench;
    const std::string one = "[stage]\ndriver = \"pi_gcs\"\nport = \"simulated\"\n";
    text.replace(text.find(one), one.size(), stage);
    try {
      parse_bench(text, "test");
    } catch (const BenchError& error) {
      return std::string(error.what());
    }
    return std::string("none");
  };
  EXPECT_THAT(problems("[stage.x]\ndriver = \"pi_gcs\"\nport = \"simulated\"\n"),
              HasSubstr("[stage.z] driver"));
  EXPECT_THAT(problems("[stage]\ndriver = \"pi_gcs\"\nport = \"simulated\"\n[stage.x]\nport = \"tcp:a:1\"\n"),
              HasSubstr("[stage.x] port"));
  EXPECT_THAT(problems("[stage]\ndriver = \"pi_gcs\"\n"), HasSubstr("[stage] port"));
  EXPECT_THAT(problems("[stage]\nport = \"simulated\"\n"), HasSubstr("[stage] driver"));
  EXPECT_THAT(problems("[stage]\ndriver = \"manual_stage\"\nport = \"tcp:a:1\"\n"),
              HasSubstr("\"manual_stage\""));
  EXPECT_EQ(problems("[stage]\ndriver = \"manual_stage\"\n"), "none");
}

}  // namespace
}  // namespace abcal
