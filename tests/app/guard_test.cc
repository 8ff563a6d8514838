// The guard's packets, its log, and its work on a chamber, in which time is passed in. Its work on a stage is
// tested in tests/survival/hang.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <chrono>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "app/measure/guard/guard_log.h"
#include "app/measure/guard/guard_packets.h"
#include "app/measure/guard/guard_service.h"
#include "app/system/boot_clock.h"
#include "drivers/registry.h"
#include "drivers/wire/socket_stream.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/weiss_firmware.h"
#include "sim/sim_bench.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::HasSubstr;

const Clock::UtcTime kNoon{std::chrono::sys_days{std::chrono::year{2026} / 3 / 1} + 12h};

class GuardLogTest : public testing::Test {
 protected:
  /// Entries of one guard, written when this object ends.
  struct Session {
    Session(const std::filesystem::path& file, std::string owner) : owner_(std::move(owner)) {
      log_.open(file);
      add(GuardLog::kBegan);
    }
    void add(std::string_view what, const std::string& text = {}) {
      log_.add(what, kNoon, {{"owner", owner_}, {"text", text}});
    }
    std::string owner_;
    GuardLog log_;
  };

  test::TemporaryFolder folder;
  std::filesystem::path file = folder / "state/motion.log";
};

TEST_F(GuardLogTest, TellsHowTheLatestSessionOfABenchEnded) {
  {
    Session run(file, "a run by A. B. on the bench \"left\"");
    run.add(GuardLog::kDied, "it has died");
    run.add(GuardLog::kHalted, "stage: axis X: halted");
  }
  const std::string words = last_incident(file, "on the bench \"left\"").value_or("");
  EXPECT_THAT(words, AllOf(HasSubstr("a run by A. B."), HasSubstr("2026-03-01T12:00:00"),
                           HasSubstr("it has died"), HasSubstr("axis X: halted")));
  EXPECT_FALSE(last_incident(file, "on the bench \"right\"")) << "another bench";
}

TEST_F(GuardLogTest, ASessionThatEndedInOrderIsNoIncident) {
  { Session(file, "bench 1").add(GuardLog::kDied, "it has died"); }
  EXPECT_TRUE(last_incident(file, "bench 1"));
  { Session(file, "bench 1").add(GuardLog::kEnded); }
  EXPECT_FALSE(last_incident(file, "bench 1"));
}

TEST_F(GuardLogTest, AnAxisThatMovedWhenProgramAndGuardEndedTogetherIsNamed) {
  const auto move = [&](std::string_view what, const char* axis) {
    Session run(file, "bench 1");
    run.log_.add(GuardLog::kMoves, kNoon, {{"axis", "Z"}});
    run.log_.add(what, kNoon, {{"axis", axis}});
  };
  move(GuardLog::kAtRest, "X");
  EXPECT_THAT(last_incident(file, "bench 1").value_or(""),
              AllOf(HasSubstr("bench 1 did not end in order"),
                    HasSubstr("axis Z was moving since 2026-03-01T12:00:00")));
  move(GuardLog::kAtRest, "Z");
  EXPECT_FALSE(last_incident(file, "bench 1")) << "it was at rest";
}

TEST_F(GuardLogTest, ALineThatWasCutOffIsPassedOver) {
  { Session(file, "bench 1").add(GuardLog::kHalted, "axis X: halted"); }
  test::write_file(file, test::read_file(file) + "{\"what\":\"en");
  EXPECT_THAT(last_incident(file, "bench 1").value_or(""), HasSubstr("axis X: halted"));
}

TEST_F(GuardLogTest, WithoutALogThereIsNoIncident) {
  EXPECT_FALSE(last_incident(folder / "none.log", ""));
}

TEST(GuardPackets, ARecipeComesThroughAsItIs) {
  HaltRecipe recipe;
  recipe.driver = "example";
  recipe.axes = {true, false};
  recipe.end_partial = std::string("\0\xff", 2);
  recipe.stop = "ST\n";
  recipe.reply_time = 6s;
  recipe.reply_end = ",EndOfAPI";
  recipe.binary = true;
  std::array<int, 2> ends{};
  ASSERT_EQ(::socketpair(AF_UNIX, SOCK_SEQPACKET, 0, ends.data()), 0);
  ASSERT_TRUE(send_guard_packet(ends[0], to_json(recipe), {ends[0]}));
  const auto packet = receive_guard_packet(ends[1]);
  ASSERT_TRUE(packet);
  EXPECT_EQ(halt_recipe_from(packet->json), recipe);
  ASSERT_EQ(packet->descriptors.size(), 1U);
  ::close(packet->descriptors[0]);
  ::close(ends[0]);
  EXPECT_FALSE(receive_guard_packet(ends[1])) << "the end of the connection";
  ::close(ends[1]);
}

TEST(GuardPackets, AFullQueueIsReportedAndNeverWaitedFor) {
  std::array<int, 2> ends{};
  ASSERT_EQ(::socketpair(AF_UNIX, SOCK_SEQPACKET, 0, ends.data()), 0);
  int sent = 0;
  while (send_guard_packet(ends[0], to_json(OwnerBeat{{true, false}, false, "bytes from the stage"})) &&
         sent < 100'000)
    ++sent;
  EXPECT_LT(sent, 100'000);
  ::close(ends[0]);
  ::close(ends[1]);
}

/// Real time that a test moves ahead.
class AheadClock final : public Clock {
 public:
  Instant now() const override { return std::chrono::steady_clock::now() + ahead_.load(); }
  UtcTime utc_now() const override { return std::chrono::system_clock::now() + ahead_.load(); }
  void sleep_until(Instant instant) override {
    while (now() < instant) std::this_thread::sleep_for(1ms);
  }
  void move_ahead(Duration time) { ahead_ = ahead_.load() + time; }

 private:
  std::atomic<Duration> ahead_{};
};

/// The guard of a program that drives a chamber; the test is that program.
class GuardedChamberTest : public testing::Test {
 protected:
  GuardedChamberTest() {
    EXPECT_EQ(::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends_.data()), 0);
    guard_ = std::jthread([this] {
      GuardService::Options options;
      options.socket = ends_[1];
      options.uptime = [] { return uptime(); };
      options.open = [this](const PortRequest&) {
        return std::make_unique<sim::FirmwareStream>(std::make_shared<sim::WeissFirmware>(world), clock);
      };
      GuardService(clock, std::move(options)).serve();
    });
    tell({{"kind", to_guard::kOwner}, {"words", "a series"}, {"log", ""}, {"listen", ""}});
  }
  ~GuardedChamberTest() override {
    tell({{"kind", to_guard::kEnd}});
    guard_ = {};
    for (const int end : ends_) ::close(end);
  }

  void tell(const nlohmann::json& packet) { EXPECT_TRUE(send_guard_packet(ends_[0], packet)); }
  /// A sign of life.
  void beat(bool has_set_point) { tell(to_json(OwnerBeat{{}, has_set_point, "the temperature"})); }

  /// The next packet of a kind; all packets but beats are kept in `told`.
  GuardPacket next(const std::string& kind) {
    const auto latest = std::chrono::steady_clock::now() + 20s;
    pollfd more{.fd = ends_[0], .events = POLLIN, .revents = 0};
    while (std::chrono::steady_clock::now() < latest && ::poll(&more, 1, 20'000) == 1) {
      GuardPacket packet = receive_guard_packet(ends_[0]).value_or(GuardPacket{});
      const std::string found = packet.json.value("kind", "");
      if (found != to_owner::kBeat) told.push_back(found);
      if (found == kind) return packet;
      if (found.empty()) break;
    }
    ADD_FAILURE() << "no packet \"" << kind << "\"";
    return {};
  }
  /// The guard has looked at the time since it was moved ahead: it does before each of its beats.
  void let_guard_look() {
    for (int k = 0; k < 3; ++k) next(to_owner::kBeat);
  }

  /// Opens the chamber, sets 60 degC, and tells the guard how to leave it.
  void drive_to_60(ChamberPolicy policy) {
    tell(to_json(PortRequest{"chamber", "a port", {}, "a series"}));
    std::vector<std::unique_ptr<wire::ByteStream>> streams;
    streams.push_back(
        std::make_unique<wire::SocketStream>(next(to_owner::kOpened).descriptors.at(0), "chamber", clock));
    for (const ChamberDriver& driver : chamber_drivers())
      if (driver.name == "weiss_simserv")
        chamber = driver.make(std::move(streams), clock, {.model = "simserv"});
    chamber->identify();
    chamber->set_temperature(60.0, std::nullopt);
    chamber->run();
    if (const auto recipe = chamber->rest_recipe(policy)) {
      tell({{"kind", to_guard::kRecipes}, {"name", "chamber"}, {"recipes", {to_json(*recipe)}}});
      next(to_owner::kTaken);
    }
    told.clear();
  }
  double set_degc() const { return world->commanded_chamber().target_degc; }

  AheadClock clock;
  std::shared_ptr<sim::SimBench> world = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
  std::unique_ptr<ThermalChamber> chamber;
  std::vector<std::string> told;

 private:
  std::array<int, 2> ends_{};
  std::jthread guard_;
};

TEST_F(GuardedChamberTest, WithoutABeatForAMinuteItFollowsItsPolicy) {
  drive_to_60(ChamberPolicy::kAmbient);
  for (int k = 0; k < 3; ++k) {  // Two and a half minutes, but with a beat in each.
    beat(true);
    let_guard_look();
    clock.move_ahead(50s);
    let_guard_look();
  }
  EXPECT_EQ(set_degc(), 60.0);
  EXPECT_TRUE(told.empty()) << told.front();
  clock.move_ahead(11s);
  EXPECT_THAT(
      next(to_owner::kHalting).json.at("why").get<std::string>(),
      AllOf(HasSubstr("did not give a sign of life for 61"), HasSubstr("waited for the temperature")));
  const GuardPacket halted = next(to_owner::kHalted);
  EXPECT_TRUE(halted.json.at("confirmed").get<bool>());
  EXPECT_THAT(halted.json.at("words").get<std::string>(), HasSubstr("23 degC"));
  EXPECT_EQ(set_degc(), 23.0);
}

/// A policy under which it goes on has no recipe, and its owner no set point that the guard watches over.
TEST_F(GuardedChamberTest, OneThatIsToHoldGoesOn) {
  drive_to_60(ChamberPolicy::kHold);
  beat(false);
  let_guard_look();
  clock.move_ahead(1h);
  let_guard_look();
  EXPECT_EQ(set_degc(), 60.0);
  EXPECT_TRUE(told.empty()) << told.front();
  EXPECT_EQ(chamber->read().set_degc, 60.0) << "its port is still open";
}

}  // namespace
}  // namespace abcal
