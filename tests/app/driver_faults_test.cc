// Every driver of the registry over its simulated instrument, in simulated time, on a link that goes wrong:
// at every command of every call. Whatever happens, a call ends in time, and either with the right answer or
// with the right fault in words; and once the link is sound again, no answer is that of an earlier question.

#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <functional>
#include <set>

#include "app/measure/bench/make_firmware.h"
#include "app/system/real_clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/microstrain_mip/codec.h"
#include "drivers/pi_gcs/stage.h"
#include "drivers/registry.h"
#include "drivers/vectornav/codec.h"
#include "drivers/wire/open_stream.h"
#include "drivers/xsens_mti/codec.h"
#include "drivers/zaber_ascii/stage.h"
#include "sim/faults.h"
#include "sim/firmware/firmware_stream.h"
#include "sim/sim_clock.h"
#include "tests/app/stage_variants.h"
#include "tests/drivers/wire/pseudo_terminal.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;
using sim::FaultKind;
using testing::HasSubstr;

/// The longest that a call may last, whatever the link does.
constexpr Clock::Duration kDeadline = 15s;
/// Deadline of a voltmeter: it may still be measuring, so that its scan and then its identity are waited for.
constexpr Clock::Duration kVoltmeterDeadline = 17s;

// ---- Expected behaviour of a driver

/// One way in which a link goes wrong.
struct Trouble {
  std::string name;
  FaultKind kind;
  bool once = false;  ///< Ends with the next command (or after a second); else it lasts.
  enum class Outcome { kRight, kFault, kEither } outcome = Outcome::kEither;
  std::set<Fault> faults{};   ///< Permitted faults.
  bool damages = false;       ///< Without checksums, damaged bytes may pass for a sound reply.
  Clock::Duration delay{};    ///< Delay of kLateReply.
  bool late_refusal = false;  ///< A refusal comes, and late: it is the answer to its own command only.
};

const std::vector<Trouble>& troubles() {
  using enum Trouble::Outcome;
  const std::set<Fault> damage{Fault::kBadFrame, Fault::kNoReply, Fault::kWrongIdentity};
  std::set<Fault> refusal = damage;
  refusal.insert({Fault::kRefused, Fault::kOutOfTravel, Fault::kNotReady});
  static const std::vector<Trouble> all{
      {"Silence", FaultKind::kSilence, false, kFault, {Fault::kNoReply}},
      {"SilenceOnce", FaultKind::kSilence, true, kEither, {Fault::kNoReply}},
      {"Garbage", FaultKind::kGarbage, false, kEither, damage, true},
      {"GarbageOnce", FaultKind::kGarbage, true, kEither, damage, true},
      {"FlippedBits", FaultKind::kFlippedBits, false, kEither, damage, true},
      {"FlippedBitsOnce", FaultKind::kFlippedBits, true, kEither, damage, true},
      {"DroppedBytes", FaultKind::kDroppedBytes, false, kEither, damage, true},
      {"DroppedBytesOnce", FaultKind::kDroppedBytes, true, kEither, damage, true},
      {"SplitFrame", FaultKind::kSplitFrame, false, kRight},
      {"SlowLink", FaultKind::kLateReply, false, kRight, {}, false, 200ms},
      {"LateReplyOnceBy1s", FaultKind::kLateReply, true, kEither, {Fault::kNoReply}, false, 1100ms},
      {"LateReplyOnceBy2s", FaultKind::kLateReply, true, kEither, {Fault::kNoReply}, false, 2100ms},
      {"LateReplyOnceBy7s", FaultKind::kLateReply, true, kEither, {Fault::kNoReply}, false, 7s},
      {"LateReplies", FaultKind::kLateReply, false, kFault, {Fault::kNoReply}, false, 20s},
      {"RefusalOnce", FaultKind::kReplacedReply, true, kEither, refusal, true},
      {"LateRefusalOnceBy1s", FaultKind::kReplacedReply, true, kEither, refusal, true, 1100ms, true},
      {"LateRefusalOnceBy2s", FaultKind::kReplacedReply, true, kEither, refusal, true, 2100ms, true},
      {"LateRefusalOnceBy7s", FaultKind::kReplacedReply, true, kEither, refusal, true, 7s, true},
      {"Unplugged", FaultKind::kUnplug, false, kFault, {Fault::kLinkLost}},
  };
  return all;
}

/// Properties of a driver's protocol.
struct Nature {
  bool checksums = false;
  /// The instrument streams unasked from power-on; its driver can work without answers.
  bool talks_by_itself = false;
  /// The driver itself measures the rate of the readings when it is started.
  bool measures_rate = false;
  Clock::Duration deadline = kDeadline;
  /// A refusal by the instrument of some command; empty: no refusal fits at any time.
  std::string refusal{};
};

Nature nature_of(const std::string& driver, Clock::Instant now = {}) {
  if (driver == "pi_gcs") return {.refusal = "23\n"};
  if (driver == "pi_gcs_chain") return {.refusal = "0 2 23\n"};
  if (driver == "newport_esp") {
    // With the controller's time, in steps of 0.4 ms since it was switched on.
    return {.refusal = fmt::format("7, {}, PARAMETER OUT OF RANGE\r\n", now.time_since_epoch() / 400us)};
  }
  if (driver == "newport_xps") return {.refusal = "-22,GroupMoveAbsolute(Group1.Pos,1),EndOfAPI"};
  if (driver.starts_with("zaber_ascii")) return {.checksums = true};
  if (driver == "microstrain_mip")
    return {.checksums = true, .refusal = mip::make_packet(0x0C, {mip::make_field(0xF1, "\x0F\x03")})};
  if (driver == "vectornav")
    return {.checksums = true, .refusal = vectornav::make_message("VNERR,07", vectornav::Checksum::kCrc16)};
  if (driver == "xsens_mti") return {.checksums = true, .refusal = xbus::make_message(xbus::kError, "\x04")};
  if (driver == "scpi_voltmeter" || driver == "scpi_single")
    return {.measures_rate = true, .deadline = kVoltmeterDeadline, .refusal = "-222,\"Data out of range\"\n"};
  if (driver == "mavlink") return {.checksums = true};
  if (driver == "witmotion") return {.checksums = true, .talks_by_itself = true, .measures_rate = true};
  if (driver == "text_line") return {.talks_by_itself = true, .measures_rate = true};
  return {};  // An unknown protocol is taken to have no checksums and no refusals.
}

// ---- A driver and its instrument

struct Answer {
  bool nothing = false;  ///< No error and no value, e.g. no reading, no halt.
  std::string wrong{};   ///< A wrong statement of the instrument.
};

/// A driver over its simulated instrument; `Unplugged` and the like happen on links().
class Rig {
 public:
  virtual ~Rig() = default;

  virtual std::vector<std::string> calls() const = 0;
  /// Prepares the instrument for this call.
  virtual void prepare(const std::string& call) = 0;
  /// Makes the call, and compares its answer with the truth. @throws InstrumentError
  virtual Answer make(const std::string& call) = 0;
  /// Questions that must be answered rightly once the link is sound again.
  virtual std::vector<std::function<Answer()>> questions() = 0;

  sim::SimClock& clock() { return clock_; }
  const std::vector<sim::FaultyStream*>& links() const { return links_; }

 protected:
  std::vector<std::unique_ptr<wire::ByteStream>> open(const BenchConfig& config,
                                                      const std::vector<InstrumentPort>& ports) {
    std::vector<std::unique_ptr<wire::ByteStream>> streams;
    for (const InstrumentPort& port : ports) {
      auto link = std::make_unique<sim::FaultyStream>(
          std::make_unique<sim::FirmwareStream>(make_firmware(config, port, world_), clock_,
                                                "port of " + port.name),
          clock_, std::vector<sim::WireFault>{});
      links_.push_back(link.get());
      streams.push_back(std::move(link));
    }
    return streams;
  }

  sim::SimClock clock_;
  std::shared_ptr<sim::SimBench> world_;
  std::vector<sim::FaultyStream*> links_;
};

class StageRig final : public Rig {
 public:
  explicit StageRig(const StageVariant& variant) {
    world_ = std::make_shared<sim::SimBench>(sim::BenchTruth());
    const BenchConfig config = variant.config();
    const auto description = variant.settings().description;
    searches_ = !description || !description->home.empty();
    stage_ = variant.make(
        open(config, connections_of(stage_ports(config.stage).at(0), variant.driver->connections)), clock_);
  }

  std::vector<std::string> calls() const override {
    std::vector<std::string> all{
        "identify", "move_to", "motion_state at rest", "motion_state on the way", "encoder_angle", "halt"};
    if (searches_) all.emplace_back("home");
    return all;
  }

  void prepare(const std::string& call) override {
    stage_->identify();
    for (const StageAxis axis : kStageAxes) stage_->home(axis);
    wait_until_stopped();
    stage_->move_to(StageAxis::kX, Angle::degrees(30.0));
    stage_->move_to(StageAxis::kZ, Angle::degrees(-45.0));
    wait_until_stopped();
    info_ = stage_->identify();
    if (call == "halt" || call == "motion_state on the way") {
      stage_->move_to(StageAxis::kX, Angle::degrees(200.0));
      stage_->motion_state(StageAxis::kX);
    }
  }

  Answer make(const std::string& call) override {
    if (call == "identify") return identify();
    if (call == "encoder_angle") return encoder_angle(StageAxis::kZ);
    if (call == "home") {
      stage_->home(StageAxis::kX);
      return right_if(std::abs(world_->commanded_angle(StageAxis::kX, clock_.now()).deg() - 30.0) > 1e-3 ||
                          world_->moving(StageAxis::kX, clock_.now()),
                      "X does not search for its reference");
    }
    if (call == "move_to") {
      stage_->move_to(StageAxis::kZ, Angle::degrees(10.0));
      const double target = world_->target(StageAxis::kZ, clock_.now()).deg();
      return right_if(std::abs(target - 10.0) < 1e-3, fmt::format("Z moves to {}, not to 10 deg", target));
    }
    if (call == "halt") {
      const bool halted = stage_->halt();
      if (!halted) return {.nothing = true};
      return right_if(!world_->moving(StageAxis::kX, clock_.now()), "X moves on");
    }
    return motion_state(StageAxis::kX);
  }

  std::vector<std::function<Answer()>> questions() override {
    while (world_->moving(StageAxis::kX, clock_.now()) || world_->moving(StageAxis::kZ, clock_.now()))
      clock_.sleep_until(clock_.now() + 10ms);
    return {[this] { return encoder_angle(StageAxis::kX); },
            [this] { return motion_state(StageAxis::kZ); },
            [this] { return encoder_angle(StageAxis::kZ); },
            [this] { return motion_state(StageAxis::kX); },
            [this] { return identify(); },
            [this] { return encoder_angle(StageAxis::kX); }};
  }

 private:
  static Answer right_if(bool right, const std::string& else_wrong) {
    return right ? Answer{} : Answer{.wrong = else_wrong};
  }

  void wait_until_stopped() {
    for (const StageAxis axis : kStageAxes)
      while (stage_->motion_state(axis) == MotionState::kMoving) clock_.sleep_until(clock_.now() + 50ms);
  }

  Answer identify() {
    const StageInfo info = stage_->identify();
    const auto same_axis = [&](std::size_t k) {
      const StageAxisInfo &a = info.axes[k], &b = info_.axes[k];
      return a.stage_name == b.stage_name && a.travel_min == b.travel_min && a.travel_max == b.travel_max &&
             a.resolution == b.resolution && a.speed_deg_per_s == b.speed_deg_per_s;
    };
    const bool same = info.maker == info_.maker && info.model == info_.model &&
                      info.serial_number == info_.serial_number && info.firmware == info_.firmware &&
                      same_axis(0) && same_axis(1);
    return right_if(same, fmt::format("it is a {} (SN {}), not a {} (SN {}), or an axis is another",
                                      info.model, info.serial_number, info_.model, info_.serial_number));
  }

  Answer encoder_angle(StageAxis axis) {
    const double said = stage_->encoder_angle(axis).deg();
    const double is = world_->encoder_angle(axis, clock_.now()).deg();
    return right_if(std::abs(said - is) < 2e-3,
                    fmt::format("{} is at {} deg, not {}", to_string(axis), is, said));
  }

  Answer motion_state(StageAxis axis) {
    const bool moved = world_->moving(axis, clock_.now());
    const MotionState said = stage_->motion_state(axis);
    const bool moves = world_->moving(axis, clock_.now());
    if (said == MotionState::kStopped) return right_if(!moves, "it moves");
    return right_if(moved, "it stands still");
  }

  std::unique_ptr<RotationStage> stage_;
  StageInfo info_;
  bool searches_ = true;  ///< A search of the reference is commanded.
};

class AccelerometerRig final : public Rig {
 public:
  explicit AccelerometerRig(const AccelerometerDriver& driver) : nature_(nature_of(driver.name)) {
    sim::BenchTruth truth;
    truth.offset = {kFirst, 0.5, -0.25};
    truth.drift_per_hour = {3600.0 * kPerSecond, 0.0, 0.0};
    world_ = std::make_shared<sim::SimBench>(truth);
    BenchConfig config;
    config.items.front().accelerometer.driver = driver.name;
    config.items.front().accelerometer.baud = 115200;
    AccelerometerSettings settings;
    settings.rate_hz = config.items.front().accelerometer.settings.rate_hz =
        driver.name.starts_with("scpi") ? 2.0 : 50.0;
    settings.integration_plc = 0.02;
    settings.link_bytes_per_s = 11520.0;
    on_demand_ = driver.name.starts_with("scpi");
    accelerometer_ = driver.make(open(config, accelerometer_ports(config, 1)), clock_, settings);
  }

  std::vector<std::string> calls() const override { return {"identify", "start", "next", "stop"}; }

  void prepare(const std::string& call) override {
    info_ = accelerometer_->identify();
    if (call == "next" || call == "stop") {
      accelerometer_->start();
      accelerometer_->next(clock_.now() + 1s);
    }
  }

  Answer make(const std::string& call) override {
    if (call == "identify") return identify();
    if (call == "start") {
      accelerometer_->start();
      return {};
    }
    if (call == "next") return next();
    accelerometer_->stop();
    return {};
  }

  std::vector<std::function<Answer()>> questions() override {
    return {[this] { return identify(); },
            [this] {
              const Clock::Instant begin = clock_.now();
              accelerometer_->start();
              Answer answer = next();
              // A board that receives no commands may also deliver lines from before the start.
              if (answer.wrong.empty() && !nature_.talks_by_itself && made_ < begin)
                answer.wrong = "a reading from before the start";
              return answer;
            },
            [this] {
              accelerometer_->discard_pending();
              const Clock::Instant begin = clock_.now();
              Answer answer = next();
              if (answer.wrong.empty() && on_demand_ && made_ < begin)
                answer.wrong = "a reading of an earlier scan";
              return answer;
            }};
  }

 private:
  static constexpr double kFirst = -3.0;
  static constexpr double kPerSecond = 0.02;
  static constexpr double kTolerance = 6e-4;  // WitMotion: steps of 16/32768.

  Answer identify() {
    const AccelerometerInfo info = accelerometer_->identify();
    const bool same = info.maker == info_.maker && info.model == info_.model &&
                      info.serial_number == info_.serial_number && info.output_unit == info_.output_unit &&
                      (info.firmware == info_.firmware || nature_.talks_by_itself);
    if (same) return {};
    return {.wrong = fmt::format("it is a {} (SN {}), not a {} (SN {})", info_.model, info_.serial_number,
                                 info.model, info.serial_number)};
  }

  Answer next() {
    const auto reading = accelerometer_->next(clock_.now() + 1s);
    if (!reading) return {.nothing = true};
    made_ = world_->start() + from_seconds((reading->output.x() - kFirst) / kPerSecond);
    const Clock::Duration resolution = from_seconds(kTolerance / kPerSecond);
    // Axis z feels gravity: 1 g_loc at rest.
    if (std::abs(reading->output.y() - 0.5) > kTolerance || std::abs(reading->output.z() - 0.75) > kTolerance)
      return {.wrong =
                  fmt::format("v, w are 0.5, 0.75, not {}, {}", reading->output.y(), reading->output.z())};
    if (made_ > reading->arrival + resolution || reading->arrival > clock_.now())
      return {.wrong = fmt::format("u = {} is of a time that has not come", reading->output.x())};
    made_ += resolution;
    return {};
  }

  const Nature nature_;
  bool on_demand_ = false;
  std::unique_ptr<Accelerometer> accelerometer_;
  AccelerometerInfo info_;
  Clock::Instant made_;  ///< Latest time at which the last reading was made.
};

std::unique_ptr<Rig> make_rig(const std::string& driver) {
  for (const StageVariant& stage : stage_variants())
    if (stage.name == driver) return std::make_unique<StageRig>(stage);
  for (const AccelerometerDriver& accelerometer : accelerometer_drivers())
    if (accelerometer.name == driver) return std::make_unique<AccelerometerRig>(accelerometer);
  throw std::invalid_argument("no driver is called \"" + driver + "\"");
}

std::vector<std::string> driver_names() {
  std::vector<std::string> names = names_of_stage_variants();
  for (const AccelerometerDriver& driver : accelerometer_drivers()) names.push_back(driver.name);
  return names;
}

// ---- All of them

class DriverFaults : public testing::TestWithParam<std::tuple<std::string, Trouble>> {
 protected:
  const std::string& driver() const { return std::get<0>(GetParam()); }
  const Trouble& trouble() const { return std::get<1>(GetParam()); }

  /// How many commands a call sends on each link if all goes well.
  std::vector<std::size_t> commands_of(const std::string& call) const {
    const auto rig = make_rig(driver());
    rig->prepare(call);
    std::vector<std::size_t> before, sent;
    for (const auto* link : rig->links()) before.push_back(link->writes());
    const Answer answer = rig->make(call);
    EXPECT_TRUE(answer.wrong.empty() && !answer.nothing) << answer.wrong;
    for (std::size_t k = 0; k < before.size(); ++k) sent.push_back(rig->links()[k]->writes() - before[k]);
    return sent;
  }

  bool is_stage() const {
    return std::any_of(stage_variants().begin(), stage_variants().end(),
                       [this](const StageVariant& one) { return one.name == driver(); });
  }

  /// Examines a call with a trouble that begins at its `at`-th command on this link; 0: when it is made.
  void examine(const std::string& call, std::size_t link, std::size_t at) {
    SCOPED_TRACE(fmt::format("{} from command {} of {} on (link {})", trouble().name, at, call, link));
    const auto rig = make_rig(driver());
    rig->prepare(call);
    sim::FaultyStream& faulty = *rig->links()[link];
    sim::WireFault fault{.kind = trouble().kind,
                         .text = nature_of(driver(), rig->clock().now()).refusal,
                         .delay = trouble().delay};
    if (at > 0) {
      fault.at_write = faulty.writes() + at;
      if (trouble().once) fault.for_writes = 1;
    } else {
      fault.at = rig->clock().now();
      if (trouble().once) fault.until = *fault.at + 1s;
    }
    faulty.add(fault);
    if (trouble().late_refusal) {
      fault.kind = FaultKind::kLateReply;
      faulty.add(fault);
    }

    const Clock::Instant begin = rig->clock().now();
    try {
      check_answer(call, link, at, rig->make(call));
    } catch (const InstrumentError& error) {
      check_error(call, error);
    }
    const Clock::Duration took = rig->clock().now() - begin;
    EXPECT_LE(took, nature_.deadline) << "it took " << to_seconds(took) << " s";
    longest_ = std::max(longest_, took);
    faulty.clear();
    check_recovery(*rig, faulty);
  }

  void check_answer(const std::string& call, std::size_t link, std::size_t at, const Answer& answer) {
    using enum Trouble::Outcome;
    EXPECT_TRUE(answer.wrong.empty() || (trouble().damages && !nature_.checksums)) << answer.wrong;
    EXPECT_FALSE(answer.nothing && trouble().outcome == kRight);
    // An instrument that streams unasked has been heard before, and a stop on the way out has no reply. The
    // start of a motion is seen on the first connection, even if the reply to its command is lost.
    const bool may_be_right =
        (nature_.talks_by_itself && at > 1) || call == "stop" || (is_stage() && link > 0);
    EXPECT_TRUE(answer.nothing || trouble().outcome != kFault || may_be_right) << "no error";
  }

  void check_error(const std::string& call, const InstrumentError& error) {
    EXPECT_NE(trouble().outcome, Trouble::Outcome::kRight) << error.what();
    // A damaged reply that passes for a sound one may say anything.
    const bool may_be_any = trouble().damages && !nature_.checksums;
    const bool wrong_rate = call == "start" && nature_.measures_rate &&
                            (trouble().damages || trouble().kind == FaultKind::kLateReply) &&
                            (error.fault() == Fault::kImplausible || error.fault() == Fault::kRefused);
    EXPECT_TRUE(may_be_any || wrong_rate || trouble().faults.contains(error.fault())) << error.what();
    EXPECT_EQ(error.fault() == Fault::kLinkLost, trouble().kind == FaultKind::kUnplug) << error.what();
    EXPECT_THAT(error.what(), HasSubstr(error.instrument()));
    EXPECT_THAT(error.what(), HasSubstr(error.detail()));
    EXPECT_GT(error.detail().english().size(), 10U) << error.what();
    EXPECT_THAT(error.instrument(), testing::ContainsRegex("port of|SN|ESP301|^stage .+ .+"));
    if (error.fault() == Fault::kRefused) ++refused_;
  }

  /// No question is answered wrongly. Once nothing is in transit any more, a question is answered at the
  /// second try at the latest.
  void check_recovery(Rig& rig, const sim::FaultyStream& faulty) {
    // Bytes still under way arrive among the questions.
    if (const auto due = faulty.next_due()) rig.clock().sleep_until(*due - 1ms);
    std::size_t number = 0;
    for (const auto& question : rig.questions()) {
      SCOPED_TRACE(fmt::format("question {} after it", ++number));
      std::string error;
      bool answered = false;
      for (int attempts = 0; attempts < 2 && !answered;) {
        if (!faulty.next_due()) ++attempts;
        const Clock::Instant begin = rig.clock().now();
        try {
          const Answer answer = question();
          EXPECT_EQ(answer.wrong, "");
          answered = !answer.nothing;
        } catch (const InstrumentError& thrown) {
          error = thrown.what();
          // Nothing was asked that the instrument refuses: such an error is a late answer to something else.
          const bool may_refuse = nature_.measures_rate || (trouble().damages && !trouble().late_refusal);
          EXPECT_TRUE(thrown.fault() != Fault::kRefused || may_refuse) << error;
        }
        EXPECT_LE(rig.clock().now() - begin, nature_.deadline);
      }
      EXPECT_TRUE(answered) << error;
    }
  }

  const Nature nature_ = nature_of(driver());
  Clock::Duration longest_{};
  int refused_ = 0;
};

void PrintTo(const Trouble& trouble, std::ostream* out) {
  *out << trouble.name;
}

TEST_P(DriverFaults, EveryCallEndsInTimeWithTheRightAnswerOrTheRightFault) {
  std::size_t cases = 0;
  for (const std::string& call : make_rig(driver())->calls()) {
    const std::vector<std::size_t> commands = commands_of(call);
    for (std::size_t link = 0; link < commands.size(); ++link) {
      // A connection for motions that this call does not use.
      if (is_stage() && link > 0 && commands[link] == 0) continue;
      for (std::size_t at = 0; at <= commands[link]; ++at, ++cases) {
        examine(call, link, at);
        if (HasFatalFailure()) return;
      }
    }
  }
  EXPECT_TRUE(refused_ > 0 || trouble().kind != FaultKind::kReplacedReply || trouble().late_refusal ||
              nature_.refusal.empty());
  RecordProperty("cases", static_cast<int>(cases));
  RecordProperty("longest_ms", static_cast<int>(1e3 * to_seconds(longest_)));
}

INSTANTIATE_TEST_SUITE_P(All, DriverFaults,
                         testing::Combine(testing::ValuesIn(driver_names()), testing::ValuesIn(troubles())),
                         [](const auto& pair) {
                           return std::get<0>(pair.param) + "_" + std::get<1>(pair.param).name;
                         });

// ---- Failures that are no fault of the wire

/// All connections to the simulated controller of a stage.
std::vector<std::unique_ptr<wire::ByteStream>> simulated_streams(const BenchConfig& config, std::size_t count,
                                                                 const std::shared_ptr<sim::SimBench>& world,
                                                                 Clock& clock) {
  std::vector<std::unique_ptr<wire::ByteStream>> streams;
  for (const InstrumentPort& port : connections_of(stage_ports(config.stage).at(0), count))
    streams.push_back(std::make_unique<sim::FirmwareStream>(make_firmware(config, port, world), clock));
  return streams;
}

class StageRefusals : public testing::TestWithParam<std::string> {};

TEST_P(StageRefusals, ARefusedMoveIsSaidInTheControllersWords) {
  const StageVariant& stage = stage_variant(GetParam());
  sim::SimClock clock;
  const auto world = std::make_shared<sim::SimBench>(sim::BenchTruth());
  const auto driver =
      stage.make(simulated_streams(stage.config(), stage.driver->connections, world, clock), clock);
  for (const StageAxis axis : kStageAxes) {
    driver->home(axis);
    while (driver->motion_state(axis) == MotionState::kMoving) clock.sleep_until(clock.now() + 50ms);
  }
  world->inject({.kind = FaultKind::kRefusedMove, .at = clock.now(), .axis = StageAxis::kZ});
  try {
    driver->move_to(StageAxis::kZ, Angle::degrees(10.0));
    ADD_FAILURE() << "a move that was refused was accepted";
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kRefused) << error.what();
    EXPECT_GT(error.detail().english().size(), 10U) << error.what();
  }
  EXPECT_NEAR(driver->encoder_angle(StageAxis::kZ).deg(), 0.0, 1e-3);
  driver->move_to(StageAxis::kX, Angle::degrees(10.0));
  EXPECT_NEAR(world->target(StageAxis::kX, clock.now()).deg(), 10.0, 1e-3);
}

INSTANTIATE_TEST_SUITE_P(EachStage, StageRefusals, testing::ValuesIn(names_of_stage_variants()),
                         [](const auto& name) { return name.param; });

/// A link on which nothing gets to the controller for a while.
class DeafStream final : public wire::ByteStream {
 public:
  DeafStream(std::unique_ptr<wire::ByteStream> inner, const Clock& clock)
      : inner_(std::move(inner)), clock_(clock) {}

  void write(std::string_view bytes) override {
    if (clock_.now() >= deaf_until) return inner_->write(bytes);
    swallowed.emplace_back(bytes);
  }
  wire::ReceivedBytes read_until(Clock::Instant deadline) override { return inner_->read_until(deadline); }
  void discard_input() override { inner_->discard_input(); }
  std::size_t dropped_bytes() const override { return inner_->dropped_bytes(); }
  std::string name() const override { return inner_->name(); }

  Clock::Instant deaf_until{};
  std::vector<std::string> swallowed;

 private:
  std::unique_ptr<wire::ByteStream> inner_;
  const Clock& clock_;
};

class StageHalts : public testing::TestWithParam<std::string> {
 protected:
  static Clock::Duration deadline() {
    if (GetParam().starts_with("pi_gcs")) return pi_gcs::kHaltDeadline;
    if (GetParam().starts_with("zaber_ascii")) return zaber_ascii::kHaltDeadline;
    return kDeadline;
  }
};

TEST_P(StageHalts, AreRepeatedUntilTheControllerHears) {
  const StageVariant& stage = stage_variant(GetParam());
  sim::SimClock clock;
  const auto world = std::make_shared<sim::SimBench>(sim::BenchTruth());
  auto streams = simulated_streams(stage.config(), stage.driver->connections, world, clock);
  auto link = std::make_unique<DeafStream>(std::move(streams[0]), clock);
  DeafStream& deaf = *link;
  streams[0] = std::move(link);
  const auto driver = stage.make(std::move(streams), clock);
  driver->identify();
  for (const StageAxis axis : kStageAxes) {
    driver->home(axis);
    while (driver->motion_state(axis) == MotionState::kMoving) clock.sleep_until(clock.now() + 50ms);
  }
  const double far_deg = stage.wraps ? 150.0 : 300.0;
  for (const StageAxis axis : kStageAxes) driver->move_to(axis, Angle::degrees(far_deg));

  const Clock::Instant begin = clock.now();
  deaf.deaf_until = begin + 600ms;
  EXPECT_TRUE(driver->halt());
  ASSERT_FALSE(deaf.swallowed.empty());
  // The stop is repeated, with queries of the motion in between.
  EXPECT_GE(std::count(deaf.swallowed.begin(), deaf.swallowed.end(), deaf.swallowed.front()), 2);
  EXPECT_LE(clock.now() - begin, deadline());
  for (const StageAxis axis : kStageAxes) EXPECT_FALSE(world->moving(axis, clock.now()));

  // A controller that never receives anything is sent the stop until the deadline.
  for (const StageAxis axis : kStageAxes) driver->move_to(axis, Angle::degrees(-far_deg));
  deaf.swallowed.clear();
  deaf.deaf_until = Clock::Instant::max();
  const Clock::Instant again = clock.now();
  EXPECT_FALSE(driver->halt());
  EXPECT_GE(std::count(deaf.swallowed.begin(), deaf.swallowed.end(), deaf.swallowed.front()), 2);
  EXPECT_LE(clock.now() - again, deadline());
}

INSTANTIATE_TEST_SUITE_P(EachStage, StageHalts, testing::ValuesIn(names_of_stage_variants()),
                         [](const auto& name) { return name.param; });

TEST(TwoProgramsOnOnePort, TheSecondIsToldWhoHoldsIt) {
  const test::PseudoTerminal terminal;
  // Another program: takes the port, says so, and waits for the end of its input.
  std::array<int, 2> to_child{}, from_child{};
  ASSERT_EQ(::pipe2(to_child.data(), O_CLOEXEC), 0);
  ASSERT_EQ(::pipe2(from_child.data(), O_CLOEXEC), 0);
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    ::close(to_child[1]);
    const int fd = ::open(terminal.path().c_str(), O_RDWR | O_NOCTTY);
    const char locked = fd >= 0 && ::flock(fd, LOCK_EX | LOCK_NB) == 0 ? 'y' : 'n';
    char ignored = 0;
    const bool told = ::write(from_child[1], &locked, 1) == 1;
    const bool ended = ::read(to_child[0], &ignored, 1) == 0;
    ::_exit(told && ended ? 0 : 1);
  }
  char locked = 'n';
  ASSERT_EQ(::read(from_child[0], &locked, 1), 1);
  ASSERT_EQ(locked, 'y');

  RealClock clock;
  const auto check = [&](const std::string& driver, const SerialDefaults& serial) {
    SCOPED_TRACE(driver);
    const Clock::Instant begin = clock.now();
    try {
      wire::open_stream(terminal.path(), {.path = {}, .baud = serial.baud, .rts_cts = serial.rts_cts}, clock);
      ADD_FAILURE() << "a port that another program holds was opened";
    } catch (const InstrumentError& error) {
      EXPECT_EQ(error.fault(), Fault::kCannotOpen);
      EXPECT_EQ(error.instrument(), terminal.path());
      EXPECT_THAT(error.what(), HasSubstr("held by another program: pid " + std::to_string(child)));
    }
    EXPECT_LE(clock.now() - begin, kDeadline);
  };
  for (const StageDriver& driver : stage_drivers()) check(driver.name, driver.serial);
  for (const AccelerometerDriver& driver : accelerometer_drivers()) check(driver.name, driver.serial);

  ::close(to_child[1]);
  int status = -1;
  EXPECT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  for (const int fd : {to_child[0], from_child[0], from_child[1]}) ::close(fd);
}

}  // namespace
}  // namespace abcal
