#include "drivers/mavlink/accelerometer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <stdexcept>

#include "drivers/instrument/instrument_error.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/mavlink_firmware.h"
#include "sim/sim_clock.h"
#include "tests/support/error_of.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using test::error_of;
using ::testing::HasSubstr;

/// Passes on only the frames that `passes` selects.
class Filter final : public wire::ByteStream {
 public:
  Filter(std::unique_ptr<wire::ByteStream> inner, std::function<bool(const mavlink::Frame&)>& passes)
      : inner_(std::move(inner)), passes_(passes) {}
  void write(std::string_view bytes) override { inner_->write(bytes); }
  wire::ReceivedBytes read_until(Clock::Instant deadline) override {
    for (;;) {
      wire::ReceivedBytes received = inner_->read_until(deadline);
      std::string kept;
      mavlink::FrameParser parser;
      parser.feed(received.bytes);
      std::size_t at = 0;
      while (const auto frame = parser.next()) {
        if (passes_(*frame)) kept += received.bytes.substr(at, frame->size);
        at += frame->size;
      }
      const bool nothing_came = received.bytes.empty();
      received.bytes = kept;
      if (nothing_came || !kept.empty()) return received;
    }
  }
  void discard_input() override { inner_->discard_input(); }
  std::string name() const override { return inner_->name(); }

 private:
  std::unique_ptr<wire::ByteStream> inner_;
  std::function<bool(const mavlink::Frame&)>& passes_;
};

class MavlinkAccelerometerTest : public ::testing::Test {
 protected:
  std::unique_ptr<MavlinkAccelerometer> connect(const sim::MavlinkSettings& device = {}) {
    sim::BenchTruth truth;
    truth.sensitivity_matrix *= 9.81;
    world_ = std::make_shared<sim::SimBench>(truth, clock_.now());
    firmware_ = std::make_shared<sim::MavlinkFirmware>(world_, device);
    AccelerometerSettings settings;
    settings.rate_hz = 50.0;
    return std::make_unique<MavlinkAccelerometer>(
        std::make_unique<Filter>(std::make_unique<sim::FirmwareStream>(firmware_, clock_), passes_), clock_,
        settings);
  }

  sim::SimClock clock_;
  std::shared_ptr<sim::SimBench> world_;
  std::shared_ptr<sim::MavlinkFirmware> firmware_;
  std::function<bool(const mavlink::Frame&)> passes_ = [](const mavlink::Frame&) { return true; };
};

TEST_F(MavlinkAccelerometerTest, SaysWhatItIs) {
  const AccelerometerInfo info = connect()->identify();
  EXPECT_EQ(info.model, "PX4");
  EXPECT_EQ(info.serial_number, "0000000000000042");
  EXPECT_EQ(info.firmware, "1.14.3");
  EXPECT_EQ(info.output_unit, "m/s2");
}

TEST_F(MavlinkAccelerometerTest, ReadsHighresImuAtTheRate) {
  const auto accelerometer = connect();
  accelerometer->start();
  const auto first = accelerometer->next(clock_.now() + 1s);
  ASSERT_TRUE(first);
  EXPECT_NEAR(first->output.z(), 9.81, 1e-3);
  EXPECT_TRUE(first->temperature_degc);
  for (int n = 0; n < 49; ++n) ASSERT_TRUE(accelerometer->next(clock_.now() + 1s));
  const auto last = accelerometer->next(clock_.now() + 1s);
  ASSERT_TRUE(last);
  EXPECT_EQ(last->sequence - first->sequence, 50U);
  EXPECT_NEAR(to_seconds(last->arrival - first->arrival), 1.0, 1e-3);
  EXPECT_EQ(accelerometer->health().lost_readings, 0U);
}

TEST_F(MavlinkAccelerometerTest, TakesScaledImuWhereThereIsNothingElseAndVersion1) {
  const auto accelerometer = connect({.version = 1, .has_highres = false});
  accelerometer->start();
  const auto reading = accelerometer->next(clock_.now() + 1s);
  ASSERT_TRUE(reading);
  EXPECT_NEAR(reading->output.z(), 9.81, 5e-3);
  EXPECT_NEAR(*accelerometer->identify().resolution, 9.80665e-3, 1e-12);
}

TEST_F(MavlinkAccelerometerTest, CountsWhatIsMissing) {
  const auto accelerometer = connect();
  accelerometer->start();
  const auto first = accelerometer->next(clock_.now() + 1s);
  int dropped = 0;
  passes_ = [&dropped](const mavlink::Frame& frame) {
    return frame.id != mavlink::kHighresImu || ++dropped > 3;
  };
  const auto second = accelerometer->next(clock_.now() + 1s);
  ASSERT_TRUE(first && second);
  EXPECT_EQ(second->sequence - first->sequence, 4U);
  EXPECT_EQ(accelerometer->health().lost_readings, 3U);
}

TEST_F(MavlinkAccelerometerTest, AMissingHeartbeatEndsTheStream) {
  const auto accelerometer = connect();
  accelerometer->start();
  passes_ = [](const mavlink::Frame& frame) { return frame.id != mavlink::kHeartbeat; };
  const Clock::Instant begin = clock_.now();
  const auto error = error_of([&] {
    while (clock_.now() < begin + 20s) accelerometer->next(clock_.now() + 1s);
  });
  EXPECT_EQ(error.fault(), Fault::kNotReady);
  EXPECT_THAT(error.detail(), HasSubstr("no heartbeat for 5"));
  EXPECT_LT(to_seconds(clock_.now() - begin), 7.0);
}

TEST_F(MavlinkAccelerometerTest, ARestartIsSeen) {
  const auto accelerometer = connect();
  accelerometer->start();
  ASSERT_TRUE(accelerometer->next(clock_.now() + 1s));
  clock_.sleep_until(clock_.now() + 10s);
  accelerometer->discard_pending();
  // Another one like it, which has just been switched on, takes its place on the line.
  const auto other = std::make_shared<sim::SimBench>(sim::BenchTruth(), clock_.now());
  firmware_->restart(other, {.streams_at_power_on = true});
  const auto error = error_of([&] {
    for (int n = 0; n < 10; ++n) accelerometer->next(clock_.now() + 1s);
  });
  EXPECT_EQ(error.fault(), Fault::kNotReady);
  EXPECT_THAT(error.detail(), HasSubstr("was restarted"));
}

TEST_F(MavlinkAccelerometerTest, ARateThatItDoesNotHaveIsRefusedInItsWords) {
  connect();
  AccelerometerSettings settings;
  settings.rate_hz = 5000.0;
  MavlinkAccelerometer fast(std::make_unique<sim::FirmwareStream>(firmware_, clock_), clock_, settings);
  const auto error = error_of([&] { fast.start(); });
  EXPECT_EQ(error.fault(), Fault::kRefused);
  EXPECT_THAT(error.detail(), HasSubstr("2 (denied)"));
}

TEST_F(MavlinkAccelerometerTest, StopAsksForItsOwnRateAgain) {
  const auto accelerometer = connect();
  accelerometer->start();
  ASSERT_TRUE(accelerometer->next(clock_.now() + 1s));
  accelerometer->stop();
  clock_.sleep_until(clock_.now() + 10ms);
  firmware_->transmit(clock_.now());
  clock_.sleep_until(clock_.now() + 900ms);
  EXPECT_LT(firmware_->transmit(clock_.now()).size(), 50U);  // A heartbeat at most.
}

TEST_F(MavlinkAccelerometerTest, SettingsThatCannotBeAreRefused) {
  AccelerometerSettings settings;
  settings.rate_hz = 0.0;
  EXPECT_THROW(MavlinkAccelerometer(nullptr, clock_, {}), std::invalid_argument);
  connect();
  EXPECT_THROW(
      MavlinkAccelerometer(std::make_unique<sim::FirmwareStream>(firmware_, clock_), clock_, settings),
      std::invalid_argument);
}

}  // namespace
}  // namespace abcal
