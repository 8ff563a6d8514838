// The guard's packets, its log, and its work on a chamber and a stage, in which time is passed in. Programs
// and guards as processes are tested in tests/survival/hang.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <filesystem>
#include <fstream>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "app/measure/guard/guard_log.h"
#include "app/measure/guard/guard_packets.h"
#include "app/measure/guard/guard_service.h"
#include "app/system/channel.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/registry.h"
#include "drivers/wire/port_held.h"
#include "drivers/wire/socket_stream.h"
#include "protocol/record/run_file.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/firmware/pi_gcs_firmware.h"
#include "sim/firmware/weiss_firmware.h"
#include "sim/sim_bench.h"
#include "tests/app/stage_variants.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

const Clock::UtcTime kNoon{std::chrono::sys_days{std::chrono::year{2026} / 3 / 1} + 12h};

class GuardLogTest : public testing::Test {
 protected:
  /// Entries of one guard, written when this object ends.
  struct Session {
    Session(const std::filesystem::path& file, std::string owner) : owner_(std::move(owner)) {
      log_.open(file);
      add(GuardLog::kBegan);
    }
    void add(std::string_view what, const std::string& text = {}, const std::vector<std::string>& axes = {},
             Clock::UtcTime utc = kNoon) {
      log_.add(what, utc, {{"owner", owner_}, {"text", text}, {"axes", axes}});
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
  const std::string words = read_motion(file, "on the bench \"left\"").incident;
  EXPECT_THAT(words, AllOf(HasSubstr("a run by A. B."), HasSubstr("2026-03-01T12:00:00"),
                           HasSubstr("it has died"), HasSubstr("axis X: halted")));
  EXPECT_EQ(read_motion(file, "on the bench \"right\"").incident, "") << "another bench";
}

TEST_F(GuardLogTest, ASessionThatEndedInOrderIsNoIncident) {
  { Session(file, "bench 1").add(GuardLog::kDied, "it has died"); }
  EXPECT_NE(read_motion(file, "bench 1").incident, "");
  { Session(file, "bench 1").add(GuardLog::kEnded); }
  EXPECT_EQ(read_motion(file, "bench 1").incident, "");
}

TEST_F(GuardLogTest, AnAxisThatMovedWhenProgramAndGuardEndedTogetherIsNamed) {
  const auto move = [&](std::string_view what, const char* axis) {
    Session run(file, "bench 1");
    run.add(GuardLog::kMoves, {}, {"Z"});
    run.add(what, {}, {axis});
  };
  move(GuardLog::kAtRest, "X");
  EXPECT_THAT(read_motion(file, "bench 1").incident,
              AllOf(HasSubstr("bench 1 did not end in order"),
                    HasSubstr("axis Z was moving since 2026-03-01T12:00:00")));
  move(GuardLog::kAtRest, "Z");
  EXPECT_EQ(read_motion(file, "bench 1").incident, "") << "it was at rest";
}

/// The guards run no more: nobody has seen what an axis did after its last entry.
TEST_F(GuardLogTest, EachAxisIsKnownByItsLatestEntryOnThisBench) {
  const auto states = [&] {
    const AxesReport axes = read_motion(file, "bench 1").axes;
    return std::pair(axes[0].state, axes[1].state);
  };
  const auto known = [](const char* x, const char* z) { return std::pair<std::string, std::string>(x, z); };
  EXPECT_EQ(states(), known(axis_state::kNotMoved, axis_state::kNotMoved));
  { Session(file, "bench 2").add(GuardLog::kMoves, {}, {"X", "Z"}); }
  EXPECT_EQ(states(), known(axis_state::kNotMoved, axis_state::kNotMoved)) << "another bench";
  { Session(file, "bench 1").add(GuardLog::kMoves, {}, {"X", "Z"}); }
  { Session(file, "bench 1").add(GuardLog::kAtRest, {}, {"X"}, kNoon + 1s); }
  EXPECT_EQ(states(), known(axis_state::kAtRest, axis_state::kUnknown));
  EXPECT_EQ(read_motion(file, "bench 1").axes[0].since, format_utc(kNoon + 1s));
  EXPECT_EQ(read_motion(file, "bench 1").axes[1].since, format_utc(kNoon));
  { Session(file, "bench 1").add(GuardLog::kEnded); }
  EXPECT_EQ(states(), known(axis_state::kAtRest, axis_state::kUnknown)) << "Z has not been moved since";
  std::filesystem::rename(file, file.string() + ".1");
  EXPECT_EQ(states(), known(axis_state::kAtRest, axis_state::kUnknown)) << "the log was put aside";
  { Session(file, "bench 1").add(GuardLog::kHalted, "halted", {"X", "Z"}); }
  EXPECT_EQ(states(), known(axis_state::kAtRest, axis_state::kAtRest));
  { Session(file, "bench 1").add(GuardLog::kNotHalted, "the port is gone", {"X"}); }
  EXPECT_EQ(states(), known(axis_state::kUnknown, axis_state::kAtRest)) << "nobody tries any more";
}

TEST_F(GuardLogTest, ALineThatWasCutOffIsPassedOver) {
  { Session(file, "bench 1").add(GuardLog::kHalted, "axis X: halted"); }
  test::write_file(file, test::read_file(file) + "{\"what\":\"en");
  EXPECT_THAT(read_motion(file, "bench 1").incident, HasSubstr("axis X: halted"));
}

TEST_F(GuardLogTest, WithoutALogThereIsNoIncident) {
  EXPECT_EQ(read_motion(folder / "none.log", "").incident, "");
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
  std::vector<Descriptor> sent;
  sent.emplace_back(::dup(ends[0]));
  ASSERT_TRUE(send_guard_packet(ends[0], to_json(recipe), sent));
  sent.clear();
  auto packet = receive_guard_packet(ends[1]);
  ASSERT_TRUE(packet);
  EXPECT_EQ(halt_recipe_from(packet->json), recipe);
  ASSERT_EQ(packet->descriptors.size(), 1U);
  packet->descriptors.clear();
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

/// Real time that a test moves ahead, or lets pass only so.
class AheadClock final : public Clock {
 public:
  Instant now() const override {
    if (std::this_thread::get_id() == watched_.load()) ++looks_;
    const Instant stopped = stopped_.load();
    return (stopped == Instant{} ? std::chrono::steady_clock::now() : stopped) + ahead_.load();
  }
  UtcTime utc_now() const override { return std::chrono::system_clock::now() + ahead_.load(); }
  void sleep_until(Instant instant) override {
    while (now() < instant) std::this_thread::sleep_for(1ms);
  }
  void move_ahead(Duration time) { ahead_ = ahead_.load() + time; }
  /// From here on only move_ahead() moves it.
  void stop() { stopped_ = std::chrono::steady_clock::now(); }
  void watch_this_thread() { watched_ = std::this_thread::get_id(); }
  /// The watched thread has asked for the time often enough to have decided with the present one.
  void let_watched_thread_look() const {
    for (const int before = looks_; looks_ < before + 10;) std::this_thread::yield();
  }

 private:
  std::atomic<std::thread::id> watched_{};
  mutable std::atomic<int> looks_ = 0;
  std::atomic<Duration> ahead_{};
  std::atomic<Instant> stopped_{};
};

/// A guard; the test is the program that it guards.
class GuardedTest : public testing::Test {
 protected:
  GuardedTest() { EXPECT_EQ(::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends_.data()), 0); }
  ~GuardedTest() override {
    for (const int end : ends_) ::close(end);
  }

  void begin(GuardedConnection::OpenPort opener, const GuardLimits& limits = {}) {
    guard_ = std::jthread([this, opener = std::move(opener), limits] {
      const auto uptime = [this, own = std::this_thread::get_id()] {
        return uptime_seen_by(std::this_thread::get_id() == own);
      };
      GuardService(clock, {.socket = ends_[1], .open = opener, .uptime = uptime, .limits = limits}).serve();
    });
    tell({{"kind", to_guard::kOwner},
          {"words", "a series"},
          {"bench", ""},
          {"log", log_at_.string()},
          {"listen", listen_at_.string()}});
  }
  /// Before the members of a derived class, which it uses, end.
  void end() {
    tell({{"kind", to_guard::kEnd}});
    guard_ = {};
  }

  void tell(const nlohmann::json& packet) { EXPECT_TRUE(send_guard_packet(ends_[0], packet)); }
  void tell_recipes(const std::string& port, const std::vector<HaltRecipe>& recipes) {
    nlohmann::json list = nlohmann::json::array();
    for (const HaltRecipe& recipe : recipes) list.push_back(to_json(recipe));
    tell({{"kind", to_guard::kRecipes}, {"name", port}, {"recipes", list}});
    next(to_owner::kTaken);
  }
  /// Opens a port. @return the stream to it
  std::unique_ptr<wire::ByteStream> open(const std::string& port) {
    tell(to_json(PortRequest{port, "a port", {}, "a series"}));
    return std::make_unique<wire::SocketStream>(next(to_owner::kOpened).descriptors.at(0).release(), port,
                                                clock);
  }

  /// The next packet of a kind; all packets but beats are kept in `told`.
  GuardPacket next(const std::string& kind) {
    const auto latest = std::chrono::steady_clock::now() + 20s;
    pollfd more{.fd = ends_[0], .events = POLLIN, .revents = 0};
    while (std::chrono::steady_clock::now() < latest && ::poll(&more, 1, 20'000) == 1) {
      GuardPacket packet = receive();
      const std::string found = kind_of(packet);
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
  /// The guard has read all packets that were sent, has answered those who asked, and has looked at a clock
  /// that stands. What it has told meanwhile is kept in `told`.
  void let_guard_look_once() {
    {
      // The tick under way may have begun before; one accepts, the next one answers, and ends with the
      // fourth.
      std::unique_lock lock(mutex_);
      EXPECT_TRUE(changed_.wait_for(lock, 20s, [this, begun = looks_] { return looks_ >= begun + 4; }));
    }
    pollfd more{.fd = ends_[0], .events = POLLIN, .revents = 0};
    while (::poll(&more, 1, 0) == 1 && !receive().json.empty()) continue;
  }
  /// As if the computer had been in suspension.
  void suspend(Clock::Duration time) {
    const std::lock_guard lock(mutex_);
    uptime_ += time;
  }

  /// The guard's main thread stands still at its next look at the uptime. Returns when it does.
  void freeze() {
    std::unique_lock lock(mutex_);
    is_frozen_ = true;
    changed_.wait(lock, [this] { return stands_; });
  }
  void thaw() {
    const std::lock_guard lock(mutex_);
    is_frozen_ = false;
    changed_.notify_all();
  }
  /// The thread that passes the owner's bytes on has asked once more whether it may.
  void let_it_ask_to_pass() {
    std::unique_lock lock(mutex_);
    const int before = asked_to_pass_;
    changed_.wait(lock, [&] { return asked_to_pass_ > before + 1; });
  }

  AheadClock clock;
  std::shared_ptr<sim::SimBench> world = std::make_shared<sim::SimBench>(sim::BenchTruth{}, clock.now());
  std::vector<std::string> told;
  int beats = 0;
  std::filesystem::path listen_at_;  ///< Where the guard answers others; empty: nowhere.
  std::filesystem::path log_at_;     ///< Its log; empty: none.

 private:
  /// Empty: the connection has ended.
  static std::string kind_of(const GuardPacket& packet) {
    return packet.json.is_object() ? packet.json.value("kind", "") : "";
  }
  GuardPacket receive() {
    GuardPacket packet = receive_guard_packet(ends_[0]).value_or(GuardPacket{});
    const std::string kind = kind_of(packet);
    if (kind == to_owner::kBeat)
      ++beats;
    else
      told.push_back(kind);
    return packet;
  }
  Clock::Duration uptime_seen_by(bool guard) {
    std::unique_lock lock(mutex_);
    if (guard) {
      ++looks_;
      stands_ = is_frozen_;
      changed_.notify_all();
      changed_.wait(lock, [this] { return !is_frozen_; });
      stands_ = false;
    } else {
      ++asked_to_pass_;
      changed_.notify_all();
    }
    return uptime_;
  }

  std::array<int, 2> ends_{};
  std::mutex mutex_;  ///< Guards what follows, but for the thread.
  std::condition_variable changed_;
  Clock::Duration uptime_ = 1h;
  bool is_frozen_ = false, stands_ = false;
  int asked_to_pass_ = 0, looks_ = 0;
  std::jthread guard_;
};

/// A guard with the limits that it has in use, whose time passes only as the test moves it. The port of its
/// stage cannot be opened.
class GuardLimitsTest : public GuardedTest {
 protected:
  GuardLimitsTest() {
    listen_at_ = folder / "guard";
    log_at_ = folder / "motion.log";
    clock.stop();
    begin([this](const PortRequest& request) -> std::unique_ptr<wire::ByteStream> {
      clock.watch_this_thread();
      ++attempts;
      if (!holders.empty()) throw wire::PortHeld(request.port, "in use", holders);
      throw InstrumentError(request.port, Fault::kCannotOpen, "unplugged");
    });
  }
  ~GuardLimitsTest() override { end(); }

  void beat(std::array<bool, 2> may_move, bool chamber) { tell(to_json(OwnerBeat{may_move, chamber, ""})); }
  bool was_told(const char* kind) const { return std::ranges::find(told, kind) != told.end(); }
  /// Moves time ahead to a limit, where nothing may be told yet, and beyond.
  /// @return the packet that is told beyond it
  nlohmann::json told_beyond(Clock::Duration limit, const char* kind) {
    clock.move_ahead(limit);
    let_guard_look_once();
    EXPECT_FALSE(was_told(kind)) << kind << " at the limit itself";
    clock.move_ahead(Clock::Duration(1));
    return next(kind).json;
  }
  /// Its guard has left an axis in motion.
  void leave_x_in_motion() {
    HaltRecipe recipe;
    recipe.axes = {true, false};
    tell_recipes("stage", {recipe});
    nlohmann::json take_over = to_json(PortRequest{"stage", "a port", {}, "a series"});
    take_over["kind"] = to_guard::kTakeOver;
    tell(take_over);
    EXPECT_FALSE(next(to_owner::kHalted).json.at("confirmed").get<bool>());
  }

  /// An answer to another program than the owner.
  nlohmann::json answer_to(const Descriptor& client, const nlohmann::json& question) {
    EXPECT_TRUE(send_guard_packet(client.number(), question));
    let_guard_look_once();
    if (!wait_until_readable(client.number(), 0ms)) return {};
    return receive_guard_packet(client.number()).value_or(GuardPacket{}).json;
  }
  /// "what" of each entry of the log, with its axes; the guard has ended.
  std::vector<std::string> logged() {
    end();
    std::vector<std::string> entries;
    std::ifstream log(log_at_);
    for (std::string line; std::getline(log, line);) {
      const nlohmann::json entry = nlohmann::json::parse(line);
      std::string words = entry.at("what").get<std::string>();
      for (const nlohmann::json& axis : entry.value("axes", nlohmann::json::array()))
        words += " " + axis.get<std::string>();
      if (entry.contains("text")) words += ": " + entry.at("text").get<std::string>();
      entries.push_back(words);
    }
    return entries;
  }
  /// Whether the guard takes the port for one in the hands of a guard whose program is dead.
  bool is_held_after_death() {
    tell(to_json(PortRequest{"stage", "a port", {}, "a series"}));
    return next(to_owner::kFailed).json.value("held_by_guard", false);
  }

  test::TemporaryFolder folder;
  std::atomic<int> attempts = 0;          ///< To open the port.
  std::vector<wire::PortHolder> holders;  ///< Who has the port open.
};

TEST_F(GuardLimitsTest, AfterMoreThanASecondWithoutABeatItHaltsEitherAxis) {
  beat({false, true}, false);
  let_guard_look_once();
  EXPECT_THAT(told_beyond(1s, to_owner::kHalting).at("why").get<std::string>(),
              HasSubstr("did not give a sign of life for 1.0 s while an axis was moving"));
}

TEST_F(GuardLimitsTest, AnAxisAtRestNeedsNoBeats) {
  beat({true, false}, false);
  beat({}, false);
  let_guard_look_once();
  clock.move_ahead(24h);
  let_guard_look_once();
  EXPECT_FALSE(was_told(to_owner::kHalting));
}

TEST_F(GuardLimitsTest, AfterMoreThanAMinuteWithoutABeatItLeavesTheChamberOnce) {
  beat({}, true);
  let_guard_look_once();
  EXPECT_THAT(told_beyond(1min, to_owner::kHalting).at("why").get<std::string>(),
              HasSubstr("did not give a sign of life for 60.0 s"));
  told.clear();
  clock.move_ahead(1min);
  let_guard_look_once();
  EXPECT_FALSE(was_told(to_owner::kHalting));
}

TEST_F(GuardLimitsTest, ItGivesABeatEachTenthOfASecond) {
  let_guard_look_once();
  beats = 0;
  for (int k = 0; k < 3; ++k) {
    clock.move_ahead(100ms - Clock::Duration(1));
    let_guard_look_once();
    EXPECT_EQ(beats, k);
    clock.move_ahead(Clock::Duration(1));
    let_guard_look_once();
    EXPECT_EQ(beats, k + 1);
  }
}

TEST_F(GuardLimitsTest, ItTriesToHaltEachSecondAndGivesUpAfterMoreThanTenMinutes) {
  leave_x_in_motion();
  clock.move_ahead(1s - Clock::Duration(1));
  clock.let_watched_thread_look();
  EXPECT_EQ(attempts, 1);
  clock.move_ahead(Clock::Duration(1));
  clock.let_watched_thread_look();
  EXPECT_EQ(attempts, 2);
  tell({{"kind", to_guard::kEnd}});
  let_guard_look_once();
  EXPECT_TRUE(told_beyond(10min, to_owner::kEnds).at("given_up").get<bool>());
}

TEST_F(GuardLimitsTest, EightOthersMayAskAtOnce) {
  let_guard_look_once();
  std::vector<Descriptor> clients;
  for (int k = 0; k < 9; ++k) {
    clients.push_back(connect_to(listen_at_, ChannelKind::kPackets));
    EXPECT_EQ(answer_to(clients.back(), {{"kind", "status"}}).is_object(), k < 8) << k + 1;
  }
  clients.erase(clients.begin());
  for (int look = 0; look < 2; ++look) let_guard_look_once();
  EXPECT_TRUE(wait_until_readable(clients.back().number(), 0ms));
}

TEST_F(GuardLimitsTest, OthersAreToldTheStateOfEachAxisAndMayHaltThem) {
  let_guard_look_once();
  const Descriptor client = connect_to(listen_at_, ChannelKind::kPackets);
  const auto state_of = [&](const char* axis) {
    const nlohmann::json axes = answer_to(client, {{"kind", "status"}}).at("axes");
    return axes.at(axis).at("state").get<std::string>();
  };
  EXPECT_EQ(state_of("x"), axis_state::kNotMoved);
  beat({true, false}, false);
  EXPECT_EQ(state_of("x"), axis_state::kMayMove);
  EXPECT_EQ(state_of("z"), axis_state::kNotMoved);
  beat({false, true}, false);
  EXPECT_EQ(state_of("x"), axis_state::kAtRest);
  EXPECT_EQ(state_of("z"), axis_state::kMayMove);
  const nlohmann::json halted = answer_to(client, {{"kind", "halt"}, {"by", "A. B."}});
  EXPECT_EQ(halted.at("halted"), "stopped by A. B.");
  EXPECT_EQ(halted.at("owner"), "a series");
  EXPECT_EQ(halted.at("owner_alive"), true);
  EXPECT_TRUE(was_told(to_owner::kHalting));
  // After a halt no beat makes them move, until a port is opened again.
  beat({true, false}, false);
  EXPECT_EQ(state_of("x"), axis_state::kAtRest);
  EXPECT_FALSE(is_held_after_death());
  beat({true, false}, false);
  EXPECT_EQ(state_of("x"), axis_state::kMayMove);
}

TEST_F(GuardLimitsTest, OthersAreToldThatAnAxisCannotBeReached) {
  leave_x_in_motion();
  const Descriptor client = connect_to(listen_at_, ChannelKind::kPackets);
  const nlohmann::json axes = answer_to(client, {{"kind", "status"}}).at("axes");
  EXPECT_EQ(axes.at("x").at("state"), axis_state::kUnreachable);
  EXPECT_THAT(axes.at("x").at("detail").get<std::string>(), HasSubstr("unplugged"));
  EXPECT_EQ(axes.at("z").at("state"), axis_state::kNotMoved);
  tell({{"kind", to_guard::kEnd}});
  let_guard_look_once();
  clock.move_ahead(11min);
  EXPECT_TRUE(next(to_owner::kEnds).json.at("given_up").get<bool>());
}

TEST_F(GuardLimitsTest, ThatWhichIsNoPacketEndsOnlyTheConnectionOfItsSender) {
  let_guard_look_once();
  const Descriptor client = connect_to(listen_at_, ChannelKind::kPackets);
  EXPECT_TRUE(answer_to(client, {{"kind", "status"}}).is_object());
  const std::string bytes = "\xc1 is no MessagePack";
  ASSERT_EQ(::send(client.number(), bytes.data(), bytes.size(), 0), static_cast<ssize_t>(bytes.size()));
  let_guard_look_once();
  EXPECT_TRUE(wait_until_readable(client.number(), 0ms));
  EXPECT_FALSE(receive_guard_packet(client.number())) << "the end of the connection";
  const Descriptor another = connect_to(listen_at_, ChannelKind::kPackets);
  EXPECT_TRUE(answer_to(another, {{"kind", "status"}}).is_object());
}

TEST_F(GuardLimitsTest, ItsLogNamesWhatMovedAndWhy) {
  beat({true, true}, false);
  beat({true, true}, false);
  beat({true, false}, false);
  let_guard_look_once();
  EXPECT_THAT(logged(), ElementsAre("began", "moves X", "moves Z", "at rest Z",
                                    "halting: a series has ended while an axis was moving", "ended"));
}

TEST_F(GuardLimitsTest, ItsLogNamesWhatWasNotHalted) {
  leave_x_in_motion();
  tell({{"kind", to_guard::kEnd}});
  let_guard_look_once();
  clock.move_ahead(11min);
  EXPECT_TRUE(next(to_owner::kEnds).json.at("given_up").get<bool>());
  const std::vector<std::string> entries = logged();
  ASSERT_EQ(entries.size(), 5U);
  EXPECT_EQ(entries[1], "halting: stage: the guard before this one is gone");
  for (const std::size_t k : {2U, 4U})
    EXPECT_THAT(entries[k], AllOf(HasSubstr("not halted X: stage: axis X: did not acknowledge the halt"),
                                  HasSubstr("unplugged")));
  EXPECT_EQ(entries[3], "died: a series has ended before the halt was confirmed");
}

TEST_F(GuardLimitsTest, AtTheEndOfItsOwnerNothingIsHaltedThatIsAtRest) {
  beat({true, false}, false);
  beat({}, false);
  EXPECT_THAT(logged(), ElementsAre("began", "moves X", "at rest X", "ended"));
}

TEST_F(GuardLimitsTest, AskedByItsOwnerItHaltsAndSaysWhy) {
  tell({{"kind", to_guard::kHalt}, {"why", "Ctrl-C"}});
  EXPECT_EQ(next(to_owner::kHalting).json.at("why"), "Ctrl-C");
}

// A socket of a guard has the number of the program that started it, here that of the test's own parent.
TEST_F(GuardLimitsTest, APortIsHeldAfterDeathByAGuardWithoutASocket) {
  const std::string own = std::to_string(::getpid());
  holders = {{own, "another program"}};
  EXPECT_FALSE(is_held_after_death());
  holders = {{own, "another program"}, {own, "abcal-guard"}};
  EXPECT_TRUE(is_held_after_death());
  std::ofstream(folder / fmt::format("abcal-guard-{}9-1", ::getppid()));
  std::ofstream(folder / fmt::format("another-{}-1", ::getppid()));
  EXPECT_TRUE(is_held_after_death());
  std::ofstream(folder / fmt::format("abcal-guard-{}-1", ::getppid()));
  EXPECT_FALSE(is_held_after_death());
}

/// A port that keeps what is written.
class KeepingStream final : public wire::ByteStream {
 public:
  KeepingStream(Clock& clock, std::atomic<int>& written) : clock_(clock), written_(written) {}
  void write(std::string_view bytes) override { written_ += static_cast<int>(bytes.size()); }
  wire::ReceivedBytes read_until(Clock::Instant deadline) override {
    clock_.sleep_until(deadline);
    return {};
  }
  void discard_input() override {}
  std::string name() const override { return "a port"; }

 private:
  Clock& clock_;
  std::atomic<int>& written_;
};

/// It passes bytes to a port.
class GuardedBytesTest : public GuardedTest {
 protected:
  GuardedBytesTest() {
    begin([this](const PortRequest&) { return std::make_unique<KeepingStream>(clock, written); });
  }
  ~GuardedBytesTest() override { end(); }

  std::atomic<int> written = 0;
};

TEST_F(GuardedBytesTest, WhileItsMainThreadStandsForASecondNoByteOfTheOwnerPasses) {
  const std::unique_ptr<wire::ByteStream> port = open("stage");
  freeze();
  suspend(1s);
  port->write("MOV");
  let_it_ask_to_pass();
  EXPECT_EQ(written, 0);
  suspend(-Clock::Duration(1));
  const auto latest = std::chrono::steady_clock::now() + 20s;
  while (written == 0 && std::chrono::steady_clock::now() < latest) std::this_thread::yield();
  EXPECT_EQ(written, 3);
  thaw();
}

/// It drives a chamber.
class GuardedChamberTest : public GuardedTest {
 protected:
  GuardedChamberTest() {
    begin([this](const PortRequest&) {
      return std::make_unique<sim::FirmwareStream>(std::make_shared<sim::WeissFirmware>(world), clock);
    });
  }
  ~GuardedChamberTest() override { end(); }

  /// A sign of life.
  void beat(bool has_set_point) { tell(to_json(OwnerBeat{{}, has_set_point, "the temperature"})); }

  /// Opens the chamber, sets 60 degC, and tells the guard how to leave it.
  void drive_to_60(ChamberPolicy policy) {
    std::vector<std::unique_ptr<wire::ByteStream>> streams;
    streams.push_back(open("chamber"));
    for (const ChamberDriver& driver : chamber_drivers())
      if (driver.name == "weiss_simserv")
        chamber = driver.make(std::move(streams), clock, {.model = "simserv"});
    chamber->identify();
    chamber->set_temperature(60.0, std::nullopt);
    chamber->run();
    if (const auto recipe = chamber->rest_recipe(policy)) tell_recipes("chamber", {*recipe});
    told.clear();
  }
  double set_degc() const { return world->commanded_chamber().target_degc; }

  std::unique_ptr<ThermalChamber> chamber;
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

/// The port of a controller, which a test unplugs.
class PluggedStream final : public wire::ByteStream {
 public:
  PluggedStream(std::shared_ptr<wire::ByteStream> inner, const std::atomic<bool>& is_plugged)
      : inner_(std::move(inner)), is_plugged_(is_plugged) {}

  void write(std::string_view bytes) override {
    require();
    inner_->write(bytes);
  }
  wire::ReceivedBytes read_until(Clock::Instant deadline) override {
    require();
    return inner_->read_until(deadline);
  }
  void discard_input() override { inner_->discard_input(); }
  std::string name() const override { return inner_->name(); }

 private:
  void require() const {
    if (!is_plugged_) throw InstrumentError("stage", Fault::kLinkLost, "unplugged");
  }
  std::shared_ptr<wire::ByteStream> inner_;
  const std::atomic<bool>& is_plugged_;
};

/// It moves a stage.
class GuardedStageTest : public GuardedTest {
 protected:
  GuardedStageTest() {
    // The beats are those of a test on a busy machine; their limit is tested in tests/survival/hang.
    begin(
        [this](const PortRequest& request) {
          if (!is_plugged) throw InstrumentError(request.port, Fault::kCannotOpen, "unplugged");
          return std::make_unique<PluggedStream>(port, is_plugged);
        },
        {.beat = 1h, .chamber_beat = 1h, .own_beat = 100ms, .give_up = 10min});
  }
  ~GuardedStageTest() override { end(); }

  /// Opens the stage and turns X.
  void turn_x() {
    turn_x(open("stage"));
    told.clear();
  }
  void turn_x(std::unique_ptr<wire::ByteStream> stream) {
    std::vector<std::unique_ptr<wire::ByteStream>> streams;
    streams.push_back(std::move(stream));
    stage = stage_variant("pi_gcs").make(std::move(streams), clock);
    stage->identify();
    stage->home(StageAxis::kX);
    while (stage->motion_state(StageAxis::kX) == MotionState::kMoving) clock.sleep_until(clock.now() + 10ms);
    tell_recipes("stage", stage->halt_recipes());
    beat(true);
    stage->move_to(StageAxis::kX, Angle::degrees(170.0));
    ASSERT_TRUE(x_moves());
  }
  void beat(bool x_may_move) { tell(to_json(OwnerBeat{{x_may_move, false}, false, "the stage"})); }
  bool x_moves() const { return world->moving(StageAxis::kX, clock.now()); }

  std::atomic<bool> is_plugged = true;
  std::shared_ptr<wire::ByteStream> port =
      std::make_shared<sim::FirmwareStream>(std::make_shared<sim::PiGcsFirmware>(world), clock);
  std::unique_ptr<RotationStage> stage;
};

TEST_F(GuardedStageTest, AfterMoreThanASecondWithoutLookingItHalts) {
  turn_x();
  suspend(1s);
  let_guard_look();
  EXPECT_TRUE(told.empty()) << told.front();
  EXPECT_TRUE(x_moves());
  suspend(1s + Clock::Duration(1));
  EXPECT_THAT(next(to_owner::kHalting).json.at("why").get<std::string>(),
              HasSubstr("stood still for 1.0 s while an axis was moving"));
  EXPECT_TRUE(next(to_owner::kHalted).json.at("confirmed").get<bool>());
  EXPECT_FALSE(x_moves());
}

/// Its owner takes a guard that gives no beats for one that hangs.
TEST_F(GuardedStageTest, AfterTheEndOfItsOwnerItGivesBeatsUntilAllIsAtRest) {
  turn_x();
  is_plugged = false;
  EXPECT_FALSE(next(to_owner::kHalted).json.at("confirmed").get<bool>());
  tell({{"kind", to_guard::kEnd}});
  let_guard_look();
  EXPECT_TRUE(x_moves());
  is_plugged = true;
  EXPECT_TRUE(next(to_owner::kHalted).json.at("confirmed").get<bool>());
  EXPECT_FALSE(x_moves());
  EXPECT_FALSE(next(to_owner::kEnds).json.at("given_up").get<bool>());
}

TEST_F(GuardedStageTest, AfterTenMinutesItGivesUpAndSaysSo) {
  turn_x();
  is_plugged = false;
  next(to_owner::kHalted);
  tell({{"kind", to_guard::kEnd}});
  let_guard_look();
  clock.move_ahead(5min);
  let_guard_look();
  EXPECT_THAT(told, Not(Contains(to_owner::kEnds)));
  clock.move_ahead(6min);
  EXPECT_TRUE(next(to_owner::kEnds).json.at("given_up").get<bool>());
}

TEST_F(GuardedStageTest, APortThatIsLostAtRestKeepsNoOwnerFromItsEnd) {
  turn_x();
  stage->halt();
  beat(false);
  let_guard_look();
  is_plugged = false;
  let_guard_look();
  beat(true);  // Its command does not reach the stage.
  tell({{"kind", to_guard::kEnd}});
  EXPECT_FALSE(next(to_owner::kEnds).json.at("given_up").get<bool>());
}

/// The guard before it was killed while the port was gone.
TEST_F(GuardedStageTest, HaltsWhatAnotherGuardHasLeft) {
  turn_x(std::make_unique<PluggedStream>(port, is_plugged));
  is_plugged = false;
  nlohmann::json take_over = to_json(PortRequest{"stage", "a port", {}, "a series"});
  take_over["kind"] = to_guard::kTakeOver;
  tell(take_over);
  EXPECT_FALSE(next(to_owner::kHalted).json.at("confirmed").get<bool>());
  EXPECT_TRUE(x_moves());
  is_plugged = true;
  EXPECT_TRUE(next(to_owner::kHalted).json.at("confirmed").get<bool>());
  EXPECT_FALSE(x_moves());
}

}  // namespace
}  // namespace abcal
