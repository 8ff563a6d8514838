// Correction registers that each instrument keeps when it is switched off, and writes that it refuses.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <utility>

#include "drivers/iio/accelerometer.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/mavlink/accelerometer.h"
#include "drivers/microstrain_mip/accelerometer.h"
#include "drivers/vectornav/accelerometer.h"
#include "drivers/witmotion/accelerometer.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/iio_firmware.h"
#include "sim/firmware/mavlink_firmware.h"
#include "sim/firmware/mip_firmware.h"
#include "sim/firmware/vectornav_firmware.h"
#include "sim/firmware/witmotion_firmware.h"
#include "sim/sim_clock.h"

namespace abcal {
namespace {

using testing::HasSubstr;

class KeptRegistersTest : public testing::Test {
 protected:
  template <class Driver, class Firmware, class Settings>
  std::unique_ptr<Driver> connect(const Settings& device, double scale) {
    sim::BenchTruth truth;
    truth.sensitivity_matrix *= scale;
    auto firmware = std::make_shared<Firmware>(std::make_shared<sim::SimBench>(truth, clock.now()), device);
    auto stream = std::make_unique<sim::FirmwareStream>(firmware, clock);
    line = stream.get();
    AccelerometerSettings settings;
    settings.rate_hz = 50.0;
    return std::make_unique<Driver>(std::move(stream), clock, settings);
  }

  void switch_off_and_on() {
    line->power(false);
    clock.sleep_until(clock.now() + std::chrono::seconds(1));
    line->power(true);
    clock.sleep_until(clock.now() + std::chrono::seconds(3));
  }

  static RegisterTexts read(Accelerometer& accelerometer) {
    (void)accelerometer.identify();
    return accelerometer.correction_registers();
  }

  /// Mean output of a second.
  Eigen::Vector3d output(Accelerometer& accelerometer) {
    accelerometer.start();
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (int n = 0; n < 50; ++n)
      sum += accelerometer.next(clock.now() + std::chrono::seconds(2)).value().output;
    accelerometer.stop();
    return sum / 50;
  }

  /// Follows the steps of apply: the instrument has streamed before, the registers are written, lost when it
  /// is switched off, and kept if they were saved.
  void check_keeping(Accelerometer& accelerometer, const Eigen::Vector3d& offset) {
    const Eigen::Vector3d before = output(accelerometer);
    const RegisterTexts factory = read(accelerometer);
    CorrectionRegisters& registers = *accelerometer.corrections();
    OutputCorrection wanted = registers.decode(factory);
    wanted.offset = offset;
    const RegisterTexts content = registers.encode(wanted, factory);
    registers.write(content);
    EXPECT_LT((output(accelerometer) - (before - offset)).norm(), 2e-3 * before.norm());
    EXPECT_EQ(read(accelerometer), content);
    switch_off_and_on();
    EXPECT_EQ(read(accelerometer), factory);
    registers.write(content);
    registers.save(content);
    EXPECT_EQ(read(accelerometer), content);
    switch_off_and_on();
    EXPECT_EQ(read(accelerometer), content);
  }

  std::string ask(std::string_view bytes) {
    line->discard_input();
    line->write(bytes);
    return line->read_until(clock.now() + std::chrono::milliseconds(100)).bytes;
  }

  sim::SimClock clock;
  sim::FirmwareStream* line = nullptr;
};

TEST_F(KeptRegistersTest, VectorNavKeepsRegister25AndNothingElseOfOurs) {
  const auto driver = connect<VectorNavAccelerometer, sim::VectorNavFirmware>(sim::VectorNavSettings{}, 9.81);
  (void)driver->identify();
  const std::string output_before = ask("$VNRRG,75*XX\r\n");
  check_keeping(*driver, {0.2, -0.1, 0.3});
  (void)driver->identify();
  EXPECT_EQ(ask("$VNRRG,75*XX\r\n"), output_before);
}

TEST_F(KeptRegistersTest, VectorNavIsNotDecodedWithATurnedFrame) {
  const auto driver = connect<VectorNavAccelerometer, sim::VectorNavFirmware>(sim::VectorNavSettings{}, 9.81);
  RegisterTexts content = read(*driver);
  content["reference frame rotation (26)"] = "0,1,0,-1,0,0,0,0,1";
  EXPECT_THROW((void)driver->decode(content), std::invalid_argument);
}

TEST_F(KeptRegistersTest, MicroStrainKeepsItsBias) {
  const auto driver = connect<MipAccelerometer, sim::MipFirmware>(sim::MipSettings{}, 1.0);
  check_keeping(*driver, {0.02, -0.01, 0.03});
}

TEST_F(KeptRegistersTest, WitMotionKeepsItsOffsetsAndItsOwnOutput) {
  const auto driver = connect<WitMotionAccelerometer, sim::WitMotionFirmware>(sim::WitMotionSettings{}, 1.0);
  check_keeping(*driver, {0.02, -0.01, 0.03});
  // All four kinds of frames, as it was delivered.
  switch_off_and_on();
  line->discard_input();
  std::string streamed;
  for (int n = 0; n < 20; ++n)
    streamed += line->read_until(clock.now() + std::chrono::milliseconds(100)).bytes;
  for (const std::string kind : {"\x55\x51", "\x55\x52", "\x55\x53", "\x55\x54"})
    EXPECT_THAT(streamed, HasSubstr(kind));
}

TEST_F(KeptRegistersTest, IioSaysThatItKeepsNothing) {
  const auto driver = connect<iio::IioAccelerometer, sim::IioFirmware>(sim::IioSettings{}, 9.81);
  const RegisterTexts factory = read(*driver);
  EXPECT_FALSE(driver->ability().can_save);
  EXPECT_THROW(driver->save(factory), InstrumentError);
  OutputCorrection wanted;
  wanted.matrix.diagonal() << 1.02, 0.97, 1.0;
  wanted.offset << 0.2, -0.1, 0.3;
  const RegisterTexts content = driver->encode(wanted, factory);
  driver->write(content);
  EXPECT_EQ(driver->correction_registers(), content);
  EXPECT_LT((driver->decode(content).offset - wanted.offset).norm(), 1e-7);
  // Whole numbers of an ADIS part, and texts without a known meaning.
  RegisterTexts adis = content;
  adis["accel_x calibscale"] = "655";
  EXPECT_NEAR(driver->decode(adis).matrix(0, 0), 1.0 + 655.0 / 32768.0, 1e-12);
  EXPECT_EQ(driver->encode(driver->decode(adis), adis).at("accel_x calibscale"), "655");
  adis["accel_x calibbias"] = "0.500000";  // m/s2, added before the effect of the factor is removed.
  EXPECT_NEAR(driver->decode(adis).offset[0], -0.5 / (1.0 + 655.0 / 32768.0), 1e-12);
  adis["accel_x calibscale"] = "-1.0";
  EXPECT_THROW((void)driver->decode(adis), std::invalid_argument);
}

TEST_F(KeptRegistersTest, AnArmedVehicleIsNotWritten) {
  sim::MavlinkSettings device;
  device.armed = true;
  const auto driver = connect<MavlinkAccelerometer, sim::MavlinkFirmware>(device, 9.81);
  const RegisterTexts before = read(*driver);
  RegisterTexts content = before;
  content["CAL_ACC0_XOFF"] = "0.5";
  EXPECT_THROW(driver->require_writable(), InstrumentError);
  try {
    driver->write(content);
    FAIL() << "written";
  } catch (const InstrumentError& error) {
    EXPECT_THAT(error.what(), HasSubstr("armed"));
  }
  EXPECT_EQ(read(*driver), before);
}

TEST_F(KeptRegistersTest, AControllerWithoutSuchParametersHasNoCorrections) {
  sim::MavlinkSettings device;
  device.has_parameters = false;
  const auto driver = connect<MavlinkAccelerometer, sim::MavlinkFirmware>(device, 9.81);
  EXPECT_TRUE(read(*driver).empty());
  device.autopilot = 0;
  const auto other = connect<MavlinkAccelerometer, sim::MavlinkFirmware>(device, 9.81);
  EXPECT_TRUE(read(*other).empty());
  EXPECT_THROW((void)other->ability(), InstrumentError);
}

TEST_F(KeptRegistersTest, TurnedOrUnnamedParametersAreNotDecoded) {
  const auto driver = connect<MavlinkAccelerometer, sim::MavlinkFirmware>(sim::MavlinkSettings{}, 9.81);
  const RegisterTexts content = read(*driver);
  EXPECT_NO_THROW((void)driver->decode(content));
  for (const auto& [name, value] :
       RegisterTexts{{"SENS_BOARD_ROT", "4"}, {"CAL_ACC0_ROT", "2"}, {"CAL_ACC0_ID", "0"}}) {
    RegisterTexts other = content;
    ASSERT_TRUE(other.contains(name));
    other[name] = value;
    EXPECT_THROW((void)driver->decode(other), std::invalid_argument) << name;
  }
  OutputCorrection wanted;
  wanted.matrix(1, 1) = 1.3;
  EXPECT_THROW((void)driver->encode(wanted, content), std::invalid_argument);
}

}  // namespace
}  // namespace abcal
