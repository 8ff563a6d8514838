#include "drivers/iio/accelerometer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <string>

#include "drivers/instrument/instrument_error.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/iio_firmware.h"
#include "sim/sim_clock.h"
#include "tests/drivers/endless_stream.h"
#include "tests/support/error_of.h"

namespace abcal::iio {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using testing::HasSubstr;

class IioTest : public testing::Test {
 protected:
  IioTest() : IioTest(sim::IioSettings{}) {}
  explicit IioTest(const sim::IioSettings& settings) {
    sim::BenchTruth truth;
    truth.sensitivity_matrix = 9.81 * Eigen::Matrix3d::Identity();
    truth.offset = {0.25, -0.5, 0.0};
    world = std::make_shared<sim::SimBench>(truth, clock.now());
    firmware = std::make_shared<sim::IioFirmware>(world, settings);
  }

  IioAccelerometer make(double rate_hz = 100.0, const std::string& names = "") {
    AccelerometerSettings settings;
    settings.rate_hz = rate_hz;
    settings.names = names;
    return {std::make_unique<sim::FirmwareStream>(firmware, clock), clock, settings};
  }

  std::string ask(const std::string& question) {
    firmware->receive(question, clock.now());
    return firmware->transmit(clock.now() + 1s);
  }

  sim::SimClock clock;
  std::shared_ptr<sim::SimBench> world;
  std::shared_ptr<sim::IioFirmware> firmware;
};

TEST_F(IioTest, SaysWhatItIs) {
  auto driver = make();
  const AccelerometerInfo info = driver.identify();
  EXPECT_EQ(info.maker, "Linux IIO");
  EXPECT_EQ(info.model, "adis16485");
  EXPECT_EQ(info.serial_number, "0x2a51");
  EXPECT_EQ(info.firmware, "1.2 (iiod 0.24.v0.24  )");
  EXPECT_EQ(info.output_unit, "m/s2");
  EXPECT_NEAR(*info.full_scale, 80.33, 0.01);
  EXPECT_NEAR(*info.resolution, 3.7409e-8, 1e-14);
}

TEST_F(IioTest, ReadsInMetresPerSecondSquared) {
  auto driver = make();
  driver.start();
  const auto reading = driver.next(clock.now() + 1s);
  ASSERT_TRUE(reading);
  EXPECT_NEAR(reading->output.x(), 0.25, 1e-6);
  EXPECT_NEAR(reading->output.y(), -0.5, 1e-6);
  EXPECT_NEAR(reading->output.z(), 9.81, 1e-6);
  EXPECT_FALSE(reading->over_range);
}

TEST_F(IioTest, TheCorrectionsInThePartActAndAreKept) {
  const std::string value = "1000000";
  EXPECT_EQ(ask("WRITE iio:device0 INPUT accel_x calibbias 7\r\n" + value), "7\n");
  auto driver = make();
  driver.identify();
  const auto registers = driver.correction_registers();
  EXPECT_EQ(registers.size(), 6U);
  EXPECT_EQ(registers.at("accel_x calibbias"), value);
  EXPECT_EQ(registers.at("accel_z calibscale"), "1.000000");
  driver.start();
  EXPECT_NEAR(driver.next(clock.now() + 1s)->output.x(), 0.25 + 0.037409, 1e-6);
}

TEST_F(IioTest, SetsTheRateAndRefusesOneThatTheDeviceDoesNotHave) {
  auto driver = make(250.0);
  driver.start();
  EXPECT_EQ(ask("READ iio:device0 sampling_frequency\r\n"), std::string("11\n250.000000\0\n", 15));
  auto too_fast = make(5000.0);
  EXPECT_THAT(error_of([&] { too_fast.start(); }, Fault::kRefused), HasSubstr("sampling_frequency"));
}

TEST_F(IioTest, ASlowRateHasBlocksOfOneSample) {
  auto driver = make(0.5);
  driver.start();
  EXPECT_TRUE(driver.next(clock.now() + 3s));
  EXPECT_TRUE(driver.next(clock.now() + 3s));
}

TEST_F(IioTest, ATriggerIsSetWhereThereIsNone) {
  EXPECT_EQ(ask("SETTRIG iio:device0\r\nGETTRIG iio:device0\r\n"), "0\n0\n");
  auto driver = make();
  driver.start();
  EXPECT_EQ(ask("GETTRIG iio:device0\r\n"), "14\nadis16485-dev0\n");
}

class TinyiiodTest : public IioTest {
 protected:
  TinyiiodTest()
      : IioTest([] {
          sim::IioSettings settings;
          settings.version = "0.1.v0.1";
          settings.knows_triggers = false;
          return settings;
        }()) {}
};

// As Analog Devices' emulator iio-emu, on libtinyiiod.
TEST_F(TinyiiodTest, AServerWithoutTriggersStreams) {
  auto driver = make();
  EXPECT_EQ(driver.identify().firmware, "1.2 (iiod 0.1.v0.1)");
  driver.start();
  const auto reading = driver.next(clock.now() + 1s);
  ASSERT_TRUE(reading);
  EXPECT_NEAR(reading->output.z(), 9.81, 1e-6);
}

TEST_F(IioTest, TimesSayHowManySamplesAreMissing) {
  auto driver = make();
  driver.start();
  ASSERT_TRUE(driver.next(clock.now() + 1s));
  // Longer than the kernel's buffer holds: 128 blocks of 2 samples.
  clock.sleep_until(clock.now() + 10s);
  const Clock::Instant end = clock.now() + 4s;
  std::uint64_t readings = 1;
  std::optional<Reading> last;
  while (clock.now() < end)
    if (auto reading = driver.next(end)) {
      last = reading;
      ++readings;
    }
  ASSERT_TRUE(last);
  const StreamHealth health = driver.health();
  EXPECT_GT(health.lost_readings, 700U);
  EXPECT_LT(health.lost_readings, 800U);
  EXPECT_EQ(last->sequence + 1, readings + health.lost_readings);
}

TEST_F(IioTest, WhatIsDiscardedIsNotDeliveredLater) {
  auto driver = make();
  driver.start();
  ASSERT_TRUE(driver.next(clock.now() + 1s));
  clock.sleep_until(clock.now() + 1s);
  sim::OutputTruth truth = world->output_truth(clock.now());
  truth.offset = {5.0, 0.0, 0.0};
  world->change(truth, clock.now());
  driver.discard_pending();
  EXPECT_NEAR(driver.next(clock.now() + 1s)->output.x(), 5.0, 1e-6);
  EXPECT_EQ(driver.health().lost_readings, 0U);
}

TEST_F(IioTest, OneOfSeveralAccelerometersMustBeNamed) {
  auto driver = make(100.0, "bmi160");
  EXPECT_THAT(error_of([&] { driver.identify(); }, Fault::kWrongIdentity),
              HasSubstr("no accelerometer \"bmi160\"; it has: adis16485 (iio:device0)"));
  auto by_id = make(100.0, "iio:device0");
  EXPECT_EQ(by_id.identify().model, "adis16485");
}

TEST_F(IioTest, AnEndOfTheRangeIsSaid) {
  sim::OutputTruth truth = world->output_truth(clock.now());
  truth.offset = {0.0, 0.0, 200.0};
  world->change(truth, clock.now());
  auto driver = make();
  driver.start();
  EXPECT_TRUE(driver.next(clock.now() + 1s)->over_range);
}

TEST_F(IioTest, TwoClientsHaveBuffersOfTheirOwn) {
  auto driver = make();
  driver.start();
  const auto second = firmware->another_session();
  ASSERT_NE(second, nullptr);
  second->receive("OPEN iio:device0 1 00000008\r\nREADBUF iio:device0 4\r\n", clock.now());
  EXPECT_EQ(second->transmit(clock.now() + 1s).substr(0, 13), "0\n4\n00000008\n");
  EXPECT_TRUE(driver.next(clock.now() + 1s));
}

// ---- Bytes without end

TEST(IioEndlessBytesTest, OfALineWithoutEndNoMoreIsReadThanIsKept) {
  test::FakeClock clock;
  auto owned = std::make_unique<test::EndlessStream>(clock, std::string(4096, 'x'));
  const test::EndlessStream& stream = *owned;
  IioAccelerometer driver(std::move(owned), clock, AccelerometerSettings{});
  try {
    driver.identify();
    ADD_FAILURE() << "nothing was thrown";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
    EXPECT_THAT(error.what(), HasSubstr("bytes arrived that are no iiod's, beginning \"xxxx"));
    EXPECT_LT(std::string_view(error.what()).size(), 1000U);
  }
  EXPECT_LE(stream.given(), 65536U + 4096U);
}

/// A port whose instrument starts to send without end.
class TurningStream final : public wire::ByteStream {
 public:
  TurningStream(std::shared_ptr<sim::Firmware> firmware, Clock& clock)
      : clock_(clock), good_(std::move(firmware), clock) {}
  bool babbles = false;
  std::size_t given = 0;

  void write(std::string_view bytes) override {
    if (!babbles) good_.write(bytes);
  }
  wire::ReceivedBytes read_until(Clock::Instant deadline) override {
    if (!babbles) return good_.read_until(deadline);
    clock_.sleep_until(clock_.now() + 1ms);
    given += 4096;
    return {std::string(4096, 'x'), clock_.now()};
  }
  void discard_input() override { good_.discard_input(); }
  std::string name() const override { return "turning"; }

 private:
  Clock& clock_;
  sim::FirmwareStream good_;
};

TEST_F(IioTest, AServerThatBabblesIsGivenUpAndItsBytesAreNotKept) {
  auto owned = std::make_unique<TurningStream>(firmware, clock);
  TurningStream& stream = *owned;
  AccelerometerSettings settings;
  settings.rate_hz = 100.0;
  IioAccelerometer driver(std::move(owned), clock, settings);
  driver.start();
  ASSERT_TRUE(driver.next(clock.now() + 1s));
  stream.babbles = true;
  const Clock::Instant end = clock.now() + 60s;
  const auto read_on = [&] {
    while (clock.now() < end) driver.next(clock.now() + 1s);
  };
  EXPECT_THAT(error_of(read_on, Fault::kNoReply), HasSubstr("\"VERSION\" was not answered"));
  EXPECT_LT(clock.now(), end);
  ASSERT_GT(stream.given, 1'000'000U);
  EXPECT_GE(driver.health().skipped_bytes + 2 * 65536U, stream.given) << "the others are kept";
}

}  // namespace
}  // namespace abcal::iio
