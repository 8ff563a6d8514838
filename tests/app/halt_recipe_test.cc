// Halting without the driver: by its recipe, on the port that it left in the middle of a command.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <memory>
#include <tuple>

#include "app/measure/bench/make_firmware.h"
#include "app/measure/guard/guard_packets.h"
#include "app/system/real_clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/split_stage.h"
#include "drivers/registry.h"
#include "drivers/wire/halt_recipe.h"
#include "sim/faults.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/sim_clock.h"
#include "tests/app/stage_variants.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;

/// Stream of the driver; the test holds the other end and records the written bytes.
class NotedStream final : public wire::ByteStream {
 public:
  NotedStream(std::shared_ptr<wire::ByteStream> inner, std::vector<std::string>& written)
      : inner_(std::move(inner)), written_(written) {}
  void write(std::string_view bytes) override {
    written_.emplace_back(bytes);
    inner_->write(bytes);
  }
  wire::ReceivedBytes read_until(Clock::Instant deadline) override { return inner_->read_until(deadline); }
  void discard_input() override { inner_->discard_input(); }
  std::string name() const override { return inner_->name(); }

 private:
  std::shared_ptr<wire::ByteStream> inner_;
  std::vector<std::string>& written_;
};

template <class AnyClock>
struct HaltRig {
  explicit HaltRig(const std::string& name) : variant(stage_variant(name)) {
    const BenchConfig config = variant.config();
    std::vector<std::unique_ptr<wire::ByteStream>> streams;
    for (const InstrumentPort& connection :
         connections_of(stage_ports(config.stage).at(0), variant.driver->connections)) {
      auto stream = std::make_shared<sim::FirmwareStream>(make_firmware(config, connection, world), clock);
      if (!port) port = stream;
      std::vector<std::string>& notes = port == stream ? written : written_elsewhere;
      streams.push_back(std::make_unique<NotedStream>(std::move(stream), notes));
    }
    driver = variant.make(std::move(streams), clock);
  }

  void home() {
    driver->identify();
    for (const StageAxis axis : kStageAxes) driver->home(axis);
    for (const StageAxis axis : kStageAxes)
      while (driver->motion_state(axis) == MotionState::kMoving) clock.sleep_until(clock.now() + 50ms);
  }

  /// Carries out recipes without the driver, on the port that it used. @return whether all were acknowledged
  bool carried_out(const std::vector<HaltRecipe>& recipes, wire::ByteStream& stream) {
    bool all = !recipes.empty();
    for (const HaltRecipe& recipe : recipes)
      all = wire::carry_out(recipe, stream, clock, clock.now() + 20s) && all;
    return all;
  }

  bool anything_moves() const {
    return world->moving(StageAxis::kX, clock.now()) || world->moving(StageAxis::kZ, clock.now());
  }

  const StageVariant& variant;
  AnyClock clock;
  std::shared_ptr<sim::SimBench> world = std::make_shared<sim::SimBench>(sim::BenchTruth(), clock.now());
  std::shared_ptr<wire::ByteStream> port;
  std::vector<std::string> written;
  std::vector<std::string> written_elsewhere;  ///< On further connections to the same controller.
  std::unique_ptr<RotationStage> driver;
};

class HaltRecipes : public testing::TestWithParam<std::string> {};

TEST_P(HaltRecipes, StopBothAxesInTheMiddleOfAnyCommand) {
  // The commands of a move, one write each.
  HaltRig<sim::SimClock> model(GetParam());
  model.home();
  model.driver->move_to(StageAxis::kX, Angle::degrees(150.0));
  model.written.clear();
  model.driver->move_to(StageAxis::kZ, Angle::degrees(-120.0));
  std::string commands;
  for (const std::string& write : model.written) commands += write;
  ASSERT_FALSE(commands.empty());

  for (std::size_t length = 0; length <= commands.size(); ++length) {
    SCOPED_TRACE(fmt::format("after {} of {} bytes", length, commands.size()));
    HaltRig<sim::SimClock> rig(GetParam());
    rig.home();
    rig.driver->move_to(StageAxis::kX, Angle::degrees(150.0));
    const std::vector<HaltRecipe> recipes = rig.driver->halt_recipes();
    std::array<int, 2> told_of{};
    for (const HaltRecipe& recipe : recipes) {
      EXPECT_EQ(recipe.driver, rig.variant.driver->name);
      for (const StageAxis axis : kStageAxes) told_of[index(axis)] += recipe.axes[index(axis)] ? 1 : 0;
    }
    EXPECT_EQ(told_of, (std::array{1, 1}));
    rig.clock.sleep_until(rig.clock.now() + 500ms);
    rig.port->write(std::string_view(commands).substr(0, length));
    const bool z_was_told = rig.world->moving(StageAxis::kZ, rig.clock.now());
    ASSERT_TRUE(rig.anything_moves());
    // The process dies here. Another one:
    const Clock::Instant begin = rig.clock.now();
    ASSERT_TRUE(rig.carried_out(recipes, *rig.port));
    EXPECT_FALSE(rig.anything_moves());
    EXPECT_LE(rig.clock.now() - begin, 5s);
    if (!z_was_told) {
      // Half a command is not carried out; or, if nothing spoils it, it is halted as it begins.
      const auto description = rig.variant.settings().description;
      const bool is_executed = description && description->half_command_executed;
      EXPECT_NEAR(rig.world->commanded_angle(StageAxis::kZ, rig.clock.now()).deg(), 0.0,
                  is_executed ? 0.05 : 1e-3);
    }
  }
}

TEST_P(HaltRecipes, WorkBeforeAnythingWasAskedAndAreNotAcknowledgedBySilence) {
  HaltRig<sim::SimClock> rig(GetParam());
  // Recipes of a driver that has not asked anything yet.
  const std::vector<HaltRecipe> recipes = rig.driver->halt_recipes();
  rig.home();
  rig.driver->move_to(StageAxis::kX, Angle::degrees(150.0));
  rig.port->write("\x7F half a li");
  ASSERT_TRUE(rig.carried_out(recipes, *rig.port));
  EXPECT_FALSE(rig.anything_moves());

  rig.driver->identify();  // Reads and clears the errors that the half line has left.
  rig.driver->move_to(StageAxis::kX, Angle::degrees(-150.0));
  sim::FaultyStream deaf(std::make_unique<NotedStream>(rig.port, rig.written), rig.clock,
                         {{.kind = sim::FaultKind::kSilence}});
  for (const HaltRecipe& recipe : recipes) {
    const Clock::Instant begin = rig.clock.now();
    EXPECT_FALSE(wire::carry_out(recipe, deaf, rig.clock, begin + 20s));
    EXPECT_LE(rig.clock.now() - begin, 21s);
  }
  sim::FaultyStream gone(std::make_unique<NotedStream>(rig.port, rig.written), rig.clock,
                         {{.kind = sim::FaultKind::kUnplug}});
  for (const HaltRecipe& recipe : recipes)
    EXPECT_FALSE(wire::carry_out(recipe, gone, rig.clock, rig.clock.now() + 20s));
}

TEST_P(HaltRecipes, AreUsedByAnotherProcessOnAnInheritedDescriptor) {
  HaltRig<RealClock> rig(GetParam());
  const std::vector<HaltRecipe> recipes = rig.driver->halt_recipes();
  std::array<int, 2> ends{};
  ASSERT_EQ(::socketpair(AF_UNIX, SOCK_STREAM, 0, ends.data()), 0);
  const std::string half = "\x7F half a li";
  ASSERT_EQ(::write(ends[0], half.data(), half.size()), static_cast<ssize_t>(half.size()));
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    wire::DescriptorStream port(ends[0], "inherited", rig.clock);
    ::_exit(rig.carried_out(recipes, port) ? 0 : 1);
  }
  ::close(ends[0]);
  // The controller, until the child has ended.
  wire::DescriptorStream far_end(ends[1], "controller's end", rig.clock);
  int status = -1;
  try {
    while (::waitpid(child, &status, WNOHANG) == 0) {
      rig.port->write(far_end.read_until(rig.clock.now() + 5ms).bytes);
      far_end.write(rig.port->read_until(rig.clock.now()).bytes);
    }
  } catch (const InstrumentError&) {  // The child has closed its end.
    ::waitpid(child, &status, 0);
  }
  ::close(ends[1]);
  EXPECT_EQ(status, 0) << "not acknowledged";
}

TEST_P(HaltRecipes, AreTheSameOnceSentToTheGuard) {
  HaltRig<sim::SimClock> rig(GetParam());
  const std::vector<HaltRecipe> before = rig.driver->halt_recipes();
  rig.driver->identify();
  const std::vector<HaltRecipe> after = rig.driver->halt_recipes();
  for (const std::vector<HaltRecipe>& recipes : {before, after}) {
    ASSERT_FALSE(recipes.empty());
    std::size_t bytes = 0;
    for (const HaltRecipe& recipe : recipes) {
      const nlohmann::json json = to_json(recipe);
      EXPECT_EQ(halt_recipe_from(json), recipe);
      bytes += nlohmann::json::to_msgpack(json).size();
    }
    EXPECT_LT(bytes, kLongestGuardPacket / 4);
  }
}

INSTANTIATE_TEST_SUITE_P(EachStage, HaltRecipes, testing::ValuesIn(names_of_stage_variants()),
                         [](const auto& name) { return name.param; });

/// A chamber's driver in one of its languages.
struct ChamberCase {
  std::string name, driver, model, port;
};

std::vector<ChamberCase> chambers() {
  return {{"f4_rtu", "watlow_f4", "F4", "simulated"},
          {"f4_tcp", "watlow_f4", "F4", "tcp:chamber:502"},
          {"f4t_rtu", "watlow_f4", "F4T", "simulated"},
          {"f4t_tcp", "watlow_f4", "F4T", "tcp:chamber:502"},
          {"simserv", "weiss_simserv", "simserv", "simulated"},
          {"ascii2", "weiss_simserv", "ascii2", "simulated"}};
}

constexpr int kPauseOutput = 3;
constexpr double kCold = -40.0;

/// A chamber that ramps to -40 degC and pauses in a dwell.
struct ChamberRig {
  explicit ChamberRig(const ChamberCase& which) {
    BenchConfig config;
    config.chamber.driver = which.driver;
    config.chamber.settings.model = which.model;
    config.chamber.port = which.port;
    config.chamber.settings.pause_output = kPauseOutput;
    port = std::make_shared<sim::FirmwareStream>(
        make_firmware(config, chamber_ports(config.chamber).at(0), world), clock);
    ChamberSettings settings = config.chamber.settings;
    settings.tcp_framing = has_tcp_frames(which.port);
    std::vector<std::unique_ptr<wire::ByteStream>> streams;
    streams.push_back(std::make_unique<NotedStream>(port, written));
    for (const ChamberDriver& each : chamber_drivers())
      if (each.name == which.driver) driver = each.make(std::move(streams), clock, settings);
    driver->identify();
  }

  void cool() {
    driver->set_temperature(kCold, 1.0);
    driver->run();
    driver->pause(true);
    clock.sleep_until(clock.now() + 60s);
  }

  sim::SimClock clock;
  std::shared_ptr<sim::SimBench> world = std::make_shared<sim::SimBench>(sim::BenchTruth(), clock.now());
  std::shared_ptr<wire::ByteStream> port;
  std::vector<std::string> written;
  std::unique_ptr<ThermalChamber> driver;
};

class ChamberRecipes : public testing::TestWithParam<ChamberCase> {};

TEST_P(ChamberRecipes, DriveToAmbientAfterAnyPartOfAnyCommand) {
  ChamberRig model(GetParam());
  model.cool();
  model.written.clear();
  model.driver->set_temperature(60.0, 2.0);
  model.driver->read();
  std::string commands;
  for (const std::string& write : model.written) commands += write;
  ASSERT_FALSE(commands.empty());
  for (const ChamberPolicy policy : {ChamberPolicy::kAmbient, ChamberPolicy::kOff}) {
    for (std::size_t length = 0; length <= commands.size(); length += 3) {
      SCOPED_TRACE(fmt::format("after {} of {} bytes", length, commands.size()));
      ChamberRig rig(GetParam());
      const auto recipe = rig.driver->rest_recipe(policy);  // Before the first set point.
      ASSERT_TRUE(recipe);
      EXPECT_EQ(recipe->driver, GetParam().driver);
      EXPECT_EQ(recipe->chamber, "is driven to 23 degC");
      rig.cool();
      // One at a time, as the driver writes them; the last one is half written.
      std::size_t left = length;
      for (const std::string& write : model.written) {
        rig.port->write(std::string_view(write).substr(0, left));
        left -= std::min(left, write.size());
        if (left == 0) break;
        rig.clock.sleep_until(rig.clock.now() + 20ms);
      }
      // The process dies here. Another one:
      const Clock::Instant begin = rig.clock.now();
      ASSERT_TRUE(wire::carry_out(*recipe, *rig.port, rig.clock, begin + 20s));
      EXPECT_LE(rig.clock.now() - begin, 10s);
      const sim::ChamberCommand command = rig.world->commanded_chamber();
      EXPECT_EQ(command.target_degc, 23.0);
      EXPECT_FALSE(command.rate_k_per_min) << "as fast as it can";
      EXPECT_TRUE(command.running);
      EXPECT_FALSE(command.paused);
    }
  }
}

TEST_P(ChamberRecipes, AreTheSameOnceSentToTheGuard) {
  ChamberRig rig(GetParam());
  for (const ChamberPolicy policy : {ChamberPolicy::kAmbient, ChamberPolicy::kHold}) {
    const auto recipe = rig.driver->rest_recipe(policy);
    if (!recipe) continue;  // ASCII-2 needs no command to hold.
    EXPECT_EQ(halt_recipe_from(to_json(*recipe)), *recipe);
  }
}

TEST_P(ChamberRecipes, HoldEndsThePauseAndNothingElse) {
  ChamberRig rig(GetParam());
  const auto recipe = rig.driver->rest_recipe(ChamberPolicy::kHold);
  rig.cool();
  if (GetParam().name == "ascii2") {  // Its only command sets everything.
    EXPECT_FALSE(recipe);
    return;
  }
  ASSERT_TRUE(recipe);
  EXPECT_TRUE(wire::carry_out(*recipe, *rig.port, rig.clock, rig.clock.now() + 20s));
  const sim::ChamberCommand command = rig.world->commanded_chamber();
  EXPECT_NEAR(command.target_degc, kCold, 1e-3);
  EXPECT_TRUE(command.running);
  EXPECT_FALSE(command.paused);
}

TEST_P(ChamberRecipes, AreNotAcknowledgedBySilence) {
  ChamberRig rig(GetParam());
  const auto recipe = rig.driver->rest_recipe(ChamberPolicy::kAmbient);
  ASSERT_TRUE(recipe);
  sim::FaultyStream deaf(std::make_unique<NotedStream>(rig.port, rig.written), rig.clock,
                         {{.kind = sim::FaultKind::kSilence}});
  const Clock::Instant begin = rig.clock.now();
  EXPECT_FALSE(wire::carry_out(*recipe, deaf, rig.clock, begin + 20s));
  EXPECT_LE(rig.clock.now() - begin, 21s);
}

TEST_P(ChamberRecipes, AskForWhatWasIdentifiedFirst) {
  ChamberRig rig(GetParam());
  std::vector<std::unique_ptr<wire::ByteStream>> streams;
  streams.push_back(std::make_unique<NotedStream>(rig.port, rig.written));
  std::unique_ptr<ThermalChamber> unknown;
  for (const ChamberDriver& each : chamber_drivers())
    if (each.name == GetParam().driver) unknown = each.make(std::move(streams), rig.clock, {});
  EXPECT_THROW(unknown->rest_recipe(ChamberPolicy::kAmbient), InstrumentError);
}

INSTANTIATE_TEST_SUITE_P(EachChamber, ChamberRecipes, testing::ValuesIn(chambers()),
                         [](const auto& which) { return which.param.name; });

TEST(HaltGuardPacket, EveryByteAndEveryKindOfPartArrives) {
  std::string bytes;
  for (int byte = 0; byte < 256; ++byte) bytes += static_cast<char>(byte);
  const ReplyPattern all =
      ReplyPattern{pattern::literal(bytes), pattern::zero_bits(bytes), pattern::run(bytes, 2)} |
      ReplyPattern{pattern::number(7, pattern::kAnyCount), pattern::some_bit_of(0x80000001U),
                   pattern::text()};
  const HaltRecipe recipe{.driver = "test",
                          .axes = {false, true},
                          .end_partial = bytes,
                          .stop = bytes,
                          .questions = {{.bytes = bytes, .reply = all, .standing = {}, .listen = 70ms},
                                        {.bytes = "?", .reply = {pattern::text()}, .standing = all}},
                          .reply_time = 1234ms,
                          .further_stops = {bytes, "STOP2"},
                          .gap = 5ms,
                          .reply_end = bytes,
                          .binary = true,
                          .chamber = "holds"};
  for (const HaltRecipe& each : {recipe, HaltRecipe()})
    EXPECT_EQ(halt_recipe_from(nlohmann::json::from_msgpack(nlohmann::json::to_msgpack(to_json(each)))),
              each);
}

/// Two controllers in a daisy chain, one of which is cut off while both axes turn.
class ChainHalts : public testing::TestWithParam<std::tuple<std::string, StageAxis>> {
 protected:
  ChainHalts() {
    rig.home();
    for (const StageAxis axis : kStageAxes) rig.driver->move_to(axis, Angle::degrees(350.0));
    rig.clock.sleep_until(rig.clock.now() + 500ms);
    rig.world->inject({.kind = sim::FaultKind::kLostController, .at = rig.clock.now(), .axis = lost});
    begin = rig.clock.now();
  }

  void expect_the_other_stopped_at_once() {
    EXPECT_FALSE(rig.world->moving(left, rig.clock.now()));
    EXPECT_LE(rig.world->motion_end(left, rig.clock.now()) - begin, 1s);
    EXPECT_GE(rig.world->motion_end(lost, begin) - begin, 10s) << "it was not cut off";
  }

  HaltRig<sim::SimClock> rig{std::get<0>(GetParam())};
  const StageAxis lost = std::get<1>(GetParam());
  const StageAxis left = lost == StageAxis::kX ? StageAxis::kZ : StageAxis::kX;
  const HaltReport each{lost == StageAxis::kX ? std::array{AxisHalt::kUnreachable, AxisHalt::kHalted}
                                              : std::array{AxisHalt::kHalted, AxisHalt::kUnreachable}};
  Clock::Instant begin;
};

TEST_P(ChainHalts, TheAxisThatIsLeftIsHaltedAtOnceAndEachIsReported) {
  EXPECT_EQ(rig.driver->halt_axes(), each);
  expect_the_other_stopped_at_once();
  EXPECT_LE(rig.clock.now() - begin, 9s);
  // Once more, by a driver that knows which controller is silent.
  EXPECT_EQ(rig.driver->halt_axes(), each);
  EXPECT_FALSE(rig.driver->halt());
}

TEST_P(ChainHalts, OfADriverThatHasAskedNothingYet) {
  std::vector<std::unique_ptr<wire::ByteStream>> streams;
  streams.push_back(std::make_unique<NotedStream>(rig.port, rig.written));
  const auto another = rig.variant.make(std::move(streams), rig.clock);
  EXPECT_EQ(another->halt_axes(), each);
  expect_the_other_stopped_at_once();
}

TEST_P(ChainHalts, InTheMiddleOfAQuestionToTheOneThatIsLost) {
  EXPECT_THROW(rig.driver->motion_state(lost), InstrumentError);
  begin = rig.clock.now();
  EXPECT_EQ(rig.driver->halt_axes(), each);
  expect_the_other_stopped_at_once();
}

TEST_P(ChainHalts, WithoutTheDriver) {
  HaltReport report;
  for (const HaltRecipe& recipe : rig.driver->halt_recipes()) {
    if (!wire::carry_out(recipe, *rig.port, rig.clock, rig.clock.now() + 5s)) continue;
    for (const StageAxis axis : kStageAxes)
      if (recipe.axes[index(axis)]) report.axes[index(axis)] = AxisHalt::kHalted;
  }
  EXPECT_EQ(report, each);
  expect_the_other_stopped_at_once();
}

INSTANTIATE_TEST_SUITE_P(EachChain, ChainHalts,
                         testing::Combine(testing::Values("pi_gcs_chain", "zaber_ascii_chain"),
                                          testing::ValuesIn(kStageAxes)),
                         [](const auto& one) {
                           return std::get<0>(one.param) + "_" +
                                  std::string(to_string(std::get<1>(one.param)));
                         });

TEST(SplitStageHalts, TheAxisThatIsLeftWhereTheOtherOnesPortIsGone) {
  for (const StageAxis lost : kStageAxes) {
    for (const StageDriver& driver : stage_drivers()) {
      SCOPED_TRACE(fmt::format("{} lost, {}", to_string(lost), driver.name));
      sim::SimClock clock;
      const auto world = std::make_shared<sim::SimBench>(sim::BenchTruth(), clock.now());
      BenchConfig config;
      config.stage.driver = driver.name;
      std::array<sim::FaultyStream*, 2> links{};
      std::array<std::unique_ptr<RotationStage>, 2> parts;
      for (const StageAxis axis : kStageAxes) {
        std::vector<std::unique_ptr<wire::ByteStream>> streams;
        for (const InstrumentPort& connection :
             connections_of(stage_ports(config.stage).at(0), driver.connections)) {
          auto link = std::make_unique<sim::FaultyStream>(
              std::make_unique<sim::FirmwareStream>(make_firmware(config, connection, world), clock), clock,
              std::vector<sim::WireFault>{});
          if (streams.empty()) links[index(axis)] = link.get();
          streams.push_back(std::move(link));
        }
        StageSettings settings;
        settings.axis_names[1 - index(axis)].clear();
        parts[index(axis)] = driver.make(std::move(streams), clock, settings);
      }
      SplitStage stage(std::move(parts[0]), std::move(parts[1]));
      stage.identify();
      for (const StageAxis axis : kStageAxes) stage.home(axis);
      for (const StageAxis axis : kStageAxes)
        while (stage.motion_state(axis) == MotionState::kMoving) clock.sleep_until(clock.now() + 50ms);
      const StageAxis left = lost == StageAxis::kX ? StageAxis::kZ : StageAxis::kX;
      stage.move_to(left, Angle::degrees(150.0));
      links[index(lost)]->add({.kind = sim::FaultKind::kUnplug});
      const HaltReport report = stage.halt_axes();
      EXPECT_EQ(report.axes[index(left)], AxisHalt::kHalted);
      EXPECT_EQ(report.axes[index(lost)], AxisHalt::kUnreachable);
      EXPECT_FALSE(stage.halt());
      EXPECT_FALSE(world->moving(left, clock.now()));
      EXPECT_EQ(in_words(report), lost == StageAxis::kX
                                      ? "axis X: unreachable, may be moving; axis Z: halted"
                                      : "axis X: halted; axis Z: unreachable, may be moving");
    }
  }
}

}  // namespace
}  // namespace abcal
