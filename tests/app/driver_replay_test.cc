// Every driver of the registry over its simulated instrument, recorded on all its connections and replayed
// from the recording: it sends the same bytes again, and gives the same values at the same times.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "app/measure/bench/make_firmware.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/registry.h"
#include "drivers/wire/recording_stream.h"
#include "drivers/wire/replay_stream.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/sim_clock.h"
#include "tests/app/stage_variants.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using Streams = std::vector<std::unique_ptr<wire::ByteStream>>;
using Events = std::vector<std::vector<wire::WireEvent>>;

/// Answers of a stage in a short session, in words.
std::string session_of(RotationStage& stage, Clock& clock) {
  std::string said;
  const auto look = [&](StageAxis axis) {
    const bool moving = stage.motion_state(axis) == MotionState::kMoving;
    said += fmt::format("{} {} {:.9f} at {}\n", to_string(axis), moving ? "moves" : "stands",
                        stage.encoder_angle(axis).deg(), clock.now().time_since_epoch().count());
    return moving;
  };
  const auto wait = [&](StageAxis axis) {
    while (look(axis)) clock.sleep_until(clock.now() + 100ms);
  };
  const StageInfo info = stage.identify();
  said += fmt::format("{} {} {} {}\n", info.maker, info.model, info.serial_number, info.firmware);
  for (const StageAxis axis : kStageAxes) stage.home(axis);
  for (const StageAxis axis : kStageAxes) wait(axis);
  stage.move_to(StageAxis::kX, Angle::degrees(12.5));
  stage.move_to(StageAxis::kZ, Angle::degrees(-90.0));
  wait(StageAxis::kX);
  said += stage.halt() ? "halted\n" : "not halted\n";
  wait(StageAxis::kZ);
  return said;
}

std::string session_of(Accelerometer& accelerometer, Clock& clock) {
  const AccelerometerInfo info = accelerometer.identify();
  std::string said = fmt::format("{} {} {} {}\n", info.maker, info.model, info.serial_number, info.firmware);
  accelerometer.start();
  for (int n = 0; n < 20; ++n) {
    const auto reading = accelerometer.next(clock.now() + 3s);
    if (!reading) {
      said += "nothing\n";
      continue;
    }
    said +=
        fmt::format("{} {:.9g} {:.9g} {:.9g} at {}\n", reading->sequence, reading->output.x(),
                    reading->output.y(), reading->output.z(), reading->arrival.time_since_epoch().count());
  }
  accelerometer.stop();
  return said;
}

/// Runs a session on the simulated instrument, keeps its events, and runs it again from these.
void expect_same_in_replay(const BenchConfig& config, const std::vector<InstrumentPort>& ports,
                           const std::function<std::string(Streams, Clock&)>& run) {
  Events events(ports.size());
  std::string first;
  {
    sim::SimClock clock;
    sim::BenchTruth truth;
    truth.noise = 1e-3;
    const auto world = std::make_shared<sim::SimBench>(truth, clock.now());
    Streams streams;
    for (std::size_t n = 0; n < ports.size(); ++n)
      streams.push_back(std::make_unique<wire::RecordingStream>(
          std::make_unique<sim::FirmwareStream>(make_firmware(config, ports[n], world), clock), clock,
          [&into = events[n]](wire::WireEvent&& event) { into.push_back(std::move(event)); }));
    first = run(std::move(streams), clock);
  }
  sim::SimClock clock;
  Streams streams;
  for (std::vector<wire::WireEvent>& each : events)
    streams.push_back(std::make_unique<wire::ReplayStream>(std::move(each), clock));
  EXPECT_EQ(run(std::move(streams), clock), first);
  EXPECT_GT(first.size(), 200U);
}

class DriverReplay : public testing::TestWithParam<std::string> {};

TEST_P(DriverReplay, ComesToTheSameValues) {
  for (const StageVariant& stage : stage_variants()) {
    if (stage.name != GetParam()) continue;
    const BenchConfig config = stage.config();
    expect_same_in_replay(config, connections_of(stage_ports(config.stage).at(0), stage.driver->connections),
                          [&](Streams streams, Clock& clock) {
                            return session_of(*stage.make(std::move(streams), clock), clock);
                          });
  }
  for (const AccelerometerDriver& driver : accelerometer_drivers()) {
    if (driver.name != GetParam()) continue;
    BenchConfig config;
    AccelerometerSettings settings;
    config.items.front().accelerometer.driver = driver.name;
    config.items.front().accelerometer.baud = 115200;
    settings.rate_hz = config.items.front().accelerometer.settings.rate_hz =
        driver.name.starts_with("scpi") ? 2.0 : 50.0;
    settings.integration_plc = 0.02;
    expect_same_in_replay(config, accelerometer_ports(config, 1), [&](Streams streams, Clock& clock) {
      return session_of(*driver.make(std::move(streams), clock, settings), clock);
    });
  }
}

INSTANTIATE_TEST_SUITE_P(All, DriverReplay, testing::ValuesIn([] {
                           std::vector<std::string> names = names_of_stage_variants();
                           for (const AccelerometerDriver& driver : accelerometer_drivers())
                             names.push_back(driver.name);
                           return names;
                         }()),
                         [](const auto& name) { return name.param; });

}  // namespace
}  // namespace abcal
