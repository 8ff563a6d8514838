#include "app/measure/bench/probe.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "app/measure/bench/probe_ports.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/iio_firmware.h"
#include "sim/firmware/mavlink_firmware.h"
#include "sim/firmware/mip_firmware.h"
#include "sim/firmware/newport_esp_firmware.h"
#include "sim/firmware/newport_xps_firmware.h"
#include "sim/firmware/pi_gcs_firmware.h"
#include "sim/firmware/scpi_voltmeter_firmware.h"
#include "sim/firmware/text_line_firmware.h"
#include "sim/firmware/thorlabs_apt_firmware.h"
#include "sim/firmware/vectornav_firmware.h"
#include "sim/firmware/watlow_f4_firmware.h"
#include "sim/firmware/weiss_firmware.h"
#include "sim/firmware/witmotion_firmware.h"
#include "sim/firmware/xsens_mti_firmware.h"
#include "sim/firmware/zaber_ascii_firmware.h"
#include "sim/sim_clock.h"

namespace abcal {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

/// A known instrument, and the questions that show whether anything in it has changed.
struct Known {
  std::string driver;
  std::function<std::shared_ptr<sim::Firmware>(std::shared_ptr<sim::SimBench>)> make;
  std::string questions{};
};

std::shared_ptr<sim::Firmware> streaming_text(std::shared_ptr<sim::SimBench> bench) {
  sim::TextLineSettings settings;
  settings.rate_hz = 20.0;
  return std::make_shared<sim::TextLineFirmware>(std::move(bench), settings);
}

template <class Made>
std::shared_ptr<sim::Firmware> made(std::shared_ptr<sim::SimBench> bench) {
  return std::make_shared<Made>(std::move(bench));
}

std::vector<Known> known_instruments() {
  const auto meter = [](const std::string& model) {
    return [model](std::shared_ptr<sim::SimBench> bench) -> std::shared_ptr<sim::Firmware> {
      return std::make_shared<sim::ScpiVoltmeterFirmware>(std::move(bench), sim::scpi_model(model));
    };
  };
  const std::string meter_questions = "CONF?\nROUT:SCAN?\nTRIG:COUN?\nSENS:VOLT:DC:NPLC?\n";
  return {{"pi_gcs", made<sim::PiGcsFirmware>, "SVO?\nFRF?\nVEL?\nACC?\nMOV?\nPOS?\nSPA?\nCCL?\n"},
          {"newport_esp", made<sim::NewportEspFirmware>, "1MO?;1TP;1VA?;1AC?;1SN?;1SL?;1SR?;2MO?;2TP;2VA?\r"},
          {"newport_xps", made<sim::NewportXpsFirmware>,
           "GroupStatusGet(Group1,int *)GroupPositionCurrentGet(Group1.Pos,double *)"
           "PositionerSGammaParametersGet(Group1.Pos,double *,double *,double *,double *)"},
          {"thorlabs_apt", made<sim::ThorlabsAptFirmware>,
           std::string("\x14\x04\x01\x00\x21\x01\x90\x04\x01\x00\x22\x01", 12)},
          {"zaber_ascii", made<sim::ZaberAsciiFirmware>,
           "/1 get pos\n/1 get maxspeed\n/1 get accel\n/1 get limit.min\n/1 get comm.alert\n/1 warnings\n"},
          {"iio", made<sim::IioFirmware>},
          {"mavlink", made<sim::MavlinkFirmware>},
          {"microstrain_mip", made<sim::MipFirmware>},
          {"vectornav", made<sim::VectorNavFirmware>,
           "$VNRRG,05*XX\r\n$VNRRG,06*XX\r\n$VNRRG,07*XX\r\n$VNRRG,25*XX\r\n$VNRRG,75*XX\r\n"},
          {"xsens_mti", made<sim::XsensMtiFirmware>},
          {"witmotion", made<sim::WitMotionFirmware>},
          {"text_line", streaming_text},
          {"scpi_voltmeter", meter("34970A"), meter_questions},
          {"scpi_voltmeter", meter("2001")},
          {"scpi_single", meter("34465A"), "CONF?\nTRIG:COUN?\nSAMP:COUN?\n"}};
}

class ProbeTest : public testing::Test {
 protected:
  std::optional<ProbeAnswer> probe(const std::shared_ptr<sim::Firmware>& firmware) {
    const ProbeOpener open = [&](const SerialDefaults&) {
      return std::make_unique<sim::FirmwareStream>(firmware, clock);
    };
    return probe_port(open, clock, [](const std::string&) {});
  }
  std::string ask(sim::Firmware& firmware, const std::string& questions) {
    firmware.transmit(clock.now());
    firmware.receive(questions, clock.now());
    clock.sleep_until(clock.now() + milliseconds(100));
    return firmware.transmit(clock.now());
  }

  sim::SimClock clock;
};

TEST_F(ProbeTest, ChambersAreFound) {
  const auto world = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
  const auto weiss = probe(std::make_shared<sim::WeissFirmware>(world));
  ASSERT_TRUE(weiss);
  EXPECT_EQ(weiss->driver, "weiss_simserv");
  EXPECT_EQ(weiss->role(), "chamber");
  EXPECT_EQ(weiss->serial_number, sim::WeissSettings{}.serial_number);
  for (const bool f4t : {true, false}) {
    const auto watlow =
        probe(std::make_shared<sim::WatlowF4Firmware>(world, sim::WatlowF4Settings{.f4t = f4t}));
    ASSERT_TRUE(watlow);
    EXPECT_EQ(watlow->driver, "watlow_f4");
    EXPECT_TRUE(watlow->model.starts_with(f4t ? "F4T" : "F4")) << watlow->model;
  }
  EXPECT_FALSE(world->commanded_chamber().running);
}

TEST_F(ProbeTest, AControllerWithOneAxisIsFoundToo) {
  sim::ThorlabsAptSettings settings;
  settings.model = "K10CR1";
  settings.axis_names = {"1", ""};
  settings.servo = false;
  const auto found = probe(std::make_shared<sim::ThorlabsAptFirmware>(
      std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now()), settings));
  ASSERT_TRUE(found);
  EXPECT_EQ(found->driver, "thorlabs_apt");
  EXPECT_EQ(found->model, "K10CR1");
}

TEST_F(ProbeTest, EveryKnownInstrumentIsFoundWithinThreeSeconds) {
  for (const Known& known : known_instruments()) {
    const auto firmware = known.make(std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now()));
    const Clock::Instant start = clock.now();
    const auto found = probe(firmware);
    ASSERT_TRUE(found) << known.driver;
    EXPECT_EQ(found->driver, known.driver);
    EXPECT_LT(to_seconds(clock.now() - start), 3.0) << known.driver;
  }
}

/// A chain that a probe must find.
struct KnownChain {
  std::string name;
  std::function<std::shared_ptr<sim::Firmware>(std::shared_ptr<sim::SimBench>)> make;
  std::string serial_number;
  std::vector<std::string> axes;
  std::string questions;  ///< They show whether anything has changed.
};

std::vector<KnownChain> known_chains() {
  const auto pi = [](sim::PiGcsSettings settings) {
    return [settings](std::shared_ptr<sim::SimBench> bench) -> std::shared_ptr<sim::Firmware> {
      return std::make_shared<sim::PiGcsFirmware>(std::move(bench), settings);
    };
  };
  const auto zaber = [](sim::ZaberAsciiSettings settings) {
    return [settings](std::shared_ptr<sim::SimBench> bench) -> std::shared_ptr<sim::Firmware> {
      return std::make_shared<sim::ZaberAsciiFirmware>(std::move(bench), settings);
    };
  };
  const auto of_pi = [](const std::string& address) {
    std::string all;
    for (const char* query : {"SVO?", "FRF?", "VEL?", "ACC?", "MOV?", "POS?", "SPA?", "CCL?", "ERR?"})
      all += fmt::format("{} {}\n", address, query);
    return all;
  };
  const std::string of_zaber =
      "/get pos\n/get maxspeed\n/get accel\n/get limit.min\n/get comm.alert\n/warnings\n/get comm.address\n";
  return {
      {"PI, the first two addresses",
       pi({.axis_names = {"1 1", "2 1"}}),
       "118001234/118001235",
       {"1 1", "2 1"},
       of_pi("1") + of_pi("2")},
      {"PI, the first address and the last",
       pi({.axis_names = {"16 1", "1 1"}}),
       "118001235/118001234",
       {"1 1", "16 1"},
       of_pi("1") + of_pi("16")},
      {"PI, one alone with other names", pi({.axis_names = {"A", "B"}}), "118001234", {"A", "B"}, of_pi("1")},
      {"Zaber, the first two numbers",
       zaber({.axis_names = {"1 1", "2 1"}}),
       "54321/54322",
       {"1 1", "2 1"},
       of_zaber},
      {"Zaber, other numbers",
       zaber({.axis_names = {"7 1", "3 1"}, .alerts = true}),
       "54322/54321",
       {"3 1", "7 1"},
       of_zaber},
      {"Zaber, one alone", zaber({.axis_names = {"4 1", "4 2"}}), "54321", {"4 1", "4 2"}, of_zaber}};
}

TEST_F(ProbeTest, AChainIsFoundWithTheAddressesOfItsAxesAndNothingChanges) {
  for (const KnownChain& chain : known_chains()) {
    SCOPED_TRACE(chain.name);
    const auto bench = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
    const auto firmware = chain.make(bench);
    const std::string before = ask(*firmware, chain.questions);
    const Clock::Instant start = clock.now();
    const auto found = probe(firmware);
    EXPECT_LT(to_seconds(clock.now() - start), 3.0);
    ASSERT_TRUE(found);
    EXPECT_EQ(found->axes, chain.axes);
    EXPECT_EQ(found->serial_number, chain.serial_number);
    EXPECT_EQ(ask(*firmware, chain.questions), before);
    for (const StageAxis axis : kStageAxes) {
      EXPECT_FALSE(bench->moving(axis, clock.now()));
      EXPECT_EQ(bench->target(axis, clock.now()).deg(), 0.0);
    }
  }
}

TEST(ProbeWords, SayHowTheBenchFileNamesTheAxes) {
  const auto probed = [](const std::vector<std::string>& axes) {
    ProbeAnswer answer{"pi_gcs", true, "PI", "C-863.12", "1/2", "1"};
    answer.axes = axes;
    return Probed{"/dev/ttyUSB0", answer, {}};
  };
  const auto words = [&](const std::vector<std::string>& axes) { return in_words(probed(axes)); };
  EXPECT_EQ(words({}), "PI C-863.12, serial number 1/2: driver = \"pi_gcs\" under [stage]");
  EXPECT_EQ(
      words({"1"}),
      "PI C-863.12, serial number 1/2: driver = \"pi_gcs\" under [stage]; axis = \"1\" under [stage.x] or "
      "[stage.z]");
  const std::string two =
      "PI C-863.12, serial number 1/2: driver = \"pi_gcs\" under [stage]; axis = \"1 1\" under [stage.x] and "
      "axis = \"2 1\" under [stage.z], or the other way round";
  EXPECT_EQ(words({"1 1", "2 1"}), two);
  EXPECT_EQ(words({"1 1", "2 1", "3 1"}), two + "; the axes on this port are \"1 1\", \"2 1\", \"3 1\"");
  EXPECT_EQ(probed_json(probed({"1 1", "2 1"}))["axes"], (nlohmann::ordered_json{"1 1", "2 1"}));
  EXPECT_FALSE(probed_json(probed({})).contains("axes"));
}

class DeadFirmware final : public sim::Firmware {
 public:
  void receive(std::string_view bytes, Clock::Instant) override { heard += bytes; }
  std::string transmit(Clock::Instant) override { return {}; }
  std::optional<Clock::Instant> next_due() const override { return std::nullopt; }
  std::string heard;
};

TEST_F(ProbeTest, ASilentPortIsDoneWithinEightSecondsAndAskedEachQuestionOnce) {
  const auto dead = std::make_shared<DeadFirmware>();
  const Clock::Instant start = clock.now();
  EXPECT_FALSE(probe(dead));
  EXPECT_LT(to_seconds(clock.now() - start), 8.0);
  // PI and voltmeters share the question, but not the speed of their lines.
  std::size_t asked = 0;
  for (std::size_t at = 0; (at = dead->heard.find("*IDN?", at)) != std::string::npos; ++at) ++asked;
  EXPECT_EQ(asked, 2U);
}

/// Gives one reply to every command.
class OtherFirmware final : public sim::Firmware {
 public:
  void receive(std::string_view bytes, Clock::Instant now) override {
    if (bytes.find("*IDN?") != std::string_view::npos) due_ = now;
  }
  std::string transmit(Clock::Instant now) override {
    if (!due_ || *due_ > now) return {};
    due_.reset();
    return "ACME,Oven 3000,17,1.0\n";
  }
  std::optional<Clock::Instant> next_due() const override { return due_; }

 private:
  std::optional<Clock::Instant> due_;
};

TEST_F(ProbeTest, AnIdentityIsToldEvenIfNoDriverFits) {
  const auto found = probe(std::make_shared<OtherFirmware>());
  ASSERT_TRUE(found);
  EXPECT_EQ(found->driver, "");
  EXPECT_EQ(found->said, "ACME,Oven 3000,17,1.0");
}

// Sends to every instrument all that a probe writes before an instrument has been recognised.
TEST_F(ProbeTest, NoQuestionMovesOrChangesAnything) {
  std::vector<std::string> questions;
  for (const StageDriver& driver : stage_drivers()) questions.push_back(driver.recognition.question);
  for (const AccelerometerDriver& driver : accelerometer_drivers())
    questions.push_back(driver.recognition.question);
  for (const ChamberDriver& driver : chamber_drivers()) questions.push_back(driver.recognition.question);
  for (const Known& known : known_instruments()) {
    const auto bench = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
    const auto firmware = known.make(bench);
    clock.sleep_until(clock.now() + seconds(1));
    firmware->transmit(clock.now());
    const std::string before = known.questions.empty() ? "" : ask(*firmware, known.questions);
    for (const std::string& question : questions) {
      firmware->receive(question, clock.now());
      clock.sleep_until(clock.now() + milliseconds(350));
      firmware->transmit(clock.now());
      for (const StageAxis axis : kStageAxes) {
        EXPECT_FALSE(bench->moving(axis, clock.now())) << known.driver;
        EXPECT_EQ(bench->target(axis, clock.now()).deg(), 0.0) << known.driver;
        EXPECT_EQ(bench->motion_limits(axis).speed_deg_per_s, 20.0) << known.driver;
      }
    }
    // A stream goes on, and is cut away from the answers by their beginning.
    if (known.driver != "vectornav" && !known.questions.empty()) {
      EXPECT_EQ(ask(*firmware, known.questions), before) << known.driver;
    }
  }
}

TEST_F(ProbeTest, AStreamGoesOnAfterTheQuestions) {
  std::vector<std::string> questions;
  for (const StageDriver& driver : stage_drivers()) questions.push_back(driver.recognition.question);
  for (const AccelerometerDriver& driver : accelerometer_drivers())
    questions.push_back(driver.recognition.question);
  const auto bench = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
  for (const auto& firmware : std::vector<std::shared_ptr<sim::Firmware>>{
           std::make_shared<sim::MipFirmware>(bench, sim::MipSettings{.streaming_at_power_on = true}),
           std::make_shared<sim::VectorNavFirmware>(bench), std::make_shared<sim::XsensMtiFirmware>(bench),
           std::make_shared<sim::WitMotionFirmware>(bench)}) {
    const auto in_a_second = [&] {
      firmware->transmit(clock.now());
      clock.sleep_until(clock.now() + seconds(1));
      return firmware->transmit(clock.now()).size();
    };
    clock.sleep_until(clock.now() + seconds(1));
    const std::size_t before = in_a_second();
    for (const std::string& question : questions) {
      firmware->receive(question, clock.now());
      clock.sleep_until(clock.now() + milliseconds(350));
      firmware->transmit(clock.now());
    }
    const std::size_t after = in_a_second();
    EXPECT_GT(before, 0U);
    EXPECT_NEAR(static_cast<double>(after), static_cast<double>(before), 0.02 * static_cast<double>(before));
  }
}

}  // namespace
}  // namespace abcal
