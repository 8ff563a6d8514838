#include "sim/firmware/thorlabs_apt_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/firmware/reply_queue.h"

namespace abcal::sim {
namespace {

constexpr Clock::Duration kShortestHoming = std::chrono::milliseconds(200);
constexpr Clock::Duration kPartialKept = std::chrono::milliseconds(50);
constexpr unsigned kHostAddress = 0x01;
constexpr unsigned kRackAddress = 0x11;
constexpr unsigned kUnitAddress = 0x50;
constexpr double kAbruptDeceleration = 1e5;  // deg/s2

// Little endian, by hand: the host's own order does not matter.
unsigned u8(std::string_view bytes, std::size_t at) {
  return static_cast<unsigned char>(bytes.at(at));
}
unsigned u16(std::string_view bytes, std::size_t at) {
  return u8(bytes, at) + 256U * u8(bytes, at + 1);
}
std::int32_t i32(std::string_view bytes, std::size_t at) {
  return static_cast<std::int32_t>(u16(bytes, at) + 65536U * u16(bytes, at + 2));
}
std::string put(std::uint32_t value, std::size_t size) {
  std::string bytes;
  for (; size > 0; --size, value /= 256U) bytes.push_back(static_cast<char>(value % 256U));
  return bytes;
}
std::string put_signed(double value) {
  constexpr double kLowest = -2147483648.0;
  constexpr double kHighest = 2147483647.0;
  return put(
      static_cast<std::uint32_t>(static_cast<std::int32_t>(std::clamp(std::round(value), kLowest, kHighest))),
      4);
}
std::string padded(std::string text, std::size_t width) {
  text.resize(width, '\0');
  return text;
}

/// Status messages without being asked, ten times a second. Without "server alive" (0492) from the host for
/// kUpdatesWithoutAck of them the controller stops [unverified against a device].
constexpr Clock::Duration kUpdatePeriod = std::chrono::milliseconds(100);
constexpr unsigned kUpdatesWithoutAck = 50;

constexpr double kOnAndOnDegrees = 3600.0;  // Range of the counter of a fine encoder.
constexpr double kJogStepDegrees = 5.0;
constexpr unsigned kContinuousJog = 1;
constexpr unsigned kSingleJog = 2;
constexpr unsigned kForward = 1;
constexpr unsigned kReverse = 2;
constexpr unsigned kReverseLimitSwitch = 1;
constexpr unsigned kLimitSwitchIgnored = 1;
constexpr unsigned kLimitSwitchMakes = 2;
constexpr unsigned kProfiledStop = 2;

enum MessageId : unsigned {
  kSetJog = 0x0416,
  kSetLimitSwitches = 0x0423,
  kSetHoming = 0x0440,
  kSetRelativeMove = 0x0445,
  kSetAbsoluteMove = 0x0450,
};

/// Parameters that are only stored: set by one message, requested by the next, reported by the third.
struct KeptParameters {
  unsigned set;
  unsigned size;  ///< With the channel; 0: a message without data, whose second parameter is the value.
};
constexpr auto kKept = std::to_array<KeptParameters>({
    {0x0213, 0},              // digital outputs
    {0x0409, 6},              // encoder counter
    {kSetJog, 22},            //
    {kSetLimitSwitches, 16},  //
    {0x0426, 6},              // power at rest and moving
    {0x043A, 6},              // backlash
    {kSetHoming, 14},         //
    {kSetRelativeMove, 6},    //
    {kSetAbsoluteMove, 6},    //
    {0x04A0, 20},             // loop of a DC motor
    {0x04B0, 26},             // potentiometer
    {0x04B3, 4},              // lights
    {0x04B6, 16},             // buttons
    {0x04D4, 18},             // current loop
    {0x04D7, 28},             // position loop
    {0x04DA, 14},             // output of the motor
    {0x04E0, 12},             // windows of tracking and settling
    {0x04E3, 12},             // profile
    {0x04E6, 20},             // joystick
    {0x04E9, 18},             // settled current loop
    {0x04F4, 4},              // bow index
    {0x0500, 0},              // trigger
});
}  // namespace

class ThorlabsAptFirmware::Controller final : public Firmware {
 public:
  Controller(std::shared_ptr<SimBench> bench, ThorlabsAptSettings settings, UnservedCommands& unserved);

  void receive(std::string_view bytes, Clock::Instant now) override;
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;
  void session_starts() override {
    received_.clear();
    replies_.clear();
  }

 private:
  enum class Motion { kNone, kHoming, kMove, kJog };
  struct Axis {
    unsigned address = 0;  ///< 0: not here.
    bool enabled = true;
    bool homed = false;
    Motion motion = Motion::kNone;
    bool stopping = false;
    std::optional<Clock::Instant> homing_until;
    double offset_deg = 0.0;  ///< Controller angle = zero + sign * protocol angle + offset.
    std::int32_t least_velocity = 0;
    std::int32_t acceleration = 0;
    std::int32_t velocity = 0;
    std::map<unsigned, std::string> kept;
    std::optional<Clock::Instant> next_update;  ///< Absent: no status without being asked.
    unsigned unacknowledged_updates = 0;
  };
  struct Command {
    unsigned id;
    unsigned first;  ///< First parameter of a message without data.
    unsigned second;
    std::string data;
    std::string bytes;  ///< The whole message.
  };

  bool unit() const { return settings_.model.starts_with("K10CR") || settings_.model.starts_with("KDC"); }
  const AxisTruth& truth(std::size_t k) const { return bench_->stage().axis(kStageAxes[k]); }
  double controller_deg(std::size_t k, Angle protocol) const;
  Angle protocol_angle(std::size_t k, double controller) const;
  double counts(std::size_t k) const;
  std::uint32_t status_bits(std::size_t k) const;
  std::string status(std::size_t k) const;
  void advance();
  void take_messages();
  void take(unsigned destination, const Command& command);
  void take_common(unsigned destination, const Command& command);
  bool take_setting(std::size_t k, const Command& command);
  bool take_motion(std::size_t k, const Command& command);
  bool take_kept(std::size_t k, const Command& command);
  void take_updates(unsigned destination, const Command& command);
  bool updates_are_due(std::size_t k) const;
  void send_update(std::size_t k);
  std::string kept_parameters(std::size_t k, const KeptParameters& parameters) const;
  std::string kept_parameters(std::size_t k, unsigned set) const;
  void jog(std::size_t k, unsigned direction);
  void move(std::size_t k, double target_deg);
  void stop(std::size_t k, bool abruptly);
  void send(unsigned id, unsigned source, const std::string& data);
  void send_short(unsigned id, unsigned source, unsigned first, unsigned second);
  void set_limits(std::size_t k);

  std::shared_ptr<SimBench> bench_;
  ThorlabsAptSettings settings_;
  UnservedCommands& unserved_;
  std::array<Axis, 2> axes_;
  bool reports_ends_of_motions_ = true;
  std::string received_;
  Clock::Instant last_byte_;
  ReplyQueue replies_;
  Clock::Instant now_;
};

ThorlabsAptFirmware::Controller::Controller(std::shared_ptr<SimBench> bench, ThorlabsAptSettings settings,
                                            UnservedCommands& unserved)
    : bench_(std::move(bench)),
      settings_(std::move(settings)),
      unserved_(unserved),
      last_byte_(bench_->start()),
      now_(bench_->start()) {
  for (std::size_t k = 0; k < 2; ++k) {
    if (settings_.sign[k] != 1 && settings_.sign[k] != -1)
      throw std::invalid_argument(
          fmt::format("simulated APT controller: sign is {}, required: +1 or -1", settings_.sign[k]));
    const std::string& name = settings_.axis_names[k];
    if (name.empty()) continue;
    const int number = name[0] - '0';
    if (number < 1 || number > 9 || (unit() && number != 1))
      throw std::invalid_argument(
          fmt::format("simulated APT controller {}: an axis is named \"{}\", required: {}", settings_.model,
                      name, unit() ? "1" : "a bay from 1 to 9"));
    axes_[k].address = unit() ? kUnitAddress : 0x20U + static_cast<unsigned>(number);
    const MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
    const double factor = settings_.counts_per_degree * settings_.velocity_per_count_s;
    // A world may turn faster than the counter of a real stage can represent.
    axes_[k].velocity = static_cast<std::int32_t>(std::min(limits.speed_deg_per_s * factor, 2147483647.0));
    axes_[k].acceleration = static_cast<std::int32_t>(limits.acceleration_deg_per_s2);
    axes_[k].offset_deg = -controller_deg(k, bench_->target(kStageAxes[k], now_));  // Reads 0 until homed.
  }
  if (axes_[0].address == axes_[1].address)
    throw std::invalid_argument(fmt::format(
        "simulated APT controller {}: both axes are at one place, required: two", settings_.model));
}

double ThorlabsAptFirmware::Controller::controller_deg(std::size_t k, Angle protocol) const {
  return settings_.zero[k].deg() + axes_[k].offset_deg + settings_.sign[k] * protocol.deg();
}

Angle ThorlabsAptFirmware::Controller::protocol_angle(std::size_t k, double controller) const {
  return Angle::degrees(settings_.sign[k] * (controller - settings_.zero[k].deg() - axes_[k].offset_deg));
}

double ThorlabsAptFirmware::Controller::counts(std::size_t k) const {
  return controller_deg(k, bench_->encoder_angle(kStageAxes[k], now_)) * settings_.counts_per_degree;
}

/// Applies all changes up to now_.
void ThorlabsAptFirmware::Controller::advance() {
  for (std::size_t k = 0; k < 2; ++k) {
    Axis& a = axes_[k];
    const StageAxis which = kStageAxes[k];
    if (a.address == 0) continue;
    if (bench_->fault_at(FaultKind::kLostReference, now_, which)) a.homed = false;
    if (a.homing_until) a.homing_until = std::max(*a.homing_until, bench_->motion_end(which, now_));
    if (a.homing_until && now_ >= *a.homing_until && !a.stopping) {
      a.homing_until.reset();
      a.motion = Motion::kNone;
      a.homed = true;
      if (reports_ends_of_motions_) send_short(0x0444, a.address, 1, 0);
    }
    if (a.motion != Motion::kNone && !a.homing_until && !bench_->moving(which, now_)) {
      a.motion = Motion::kNone;
      const unsigned id = std::exchange(a.stopping, false) ? 0x0466 : 0x0464;
      if (reports_ends_of_motions_) send(id, a.address, status(k));
    }
    while (updates_are_due(k) && *a.next_update <= now_) send_update(k);
  }
}

bool ThorlabsAptFirmware::Controller::updates_are_due(std::size_t k) const {
  return axes_[k].next_update && axes_[k].unacknowledged_updates < kUpdatesWithoutAck;
}

/// After a pause without "server alive" there is one message, not all those that were left out.
void ThorlabsAptFirmware::Controller::send_update(std::size_t k) {
  Axis& a = axes_[k];
  send(settings_.servo ? 0x0491 : 0x0481, a.address, status(k));
  *a.next_update += kUpdatePeriod;
  if (settings_.servo) ++a.unacknowledged_updates;
}

/// Starts and ends the status messages without being asked, of one axis or of all.
void ThorlabsAptFirmware::Controller::take_updates(unsigned destination, const Command& command) {
  for (Axis& a : axes_) {
    if (a.address == 0 || (destination != kRackAddress && destination != a.address)) continue;
    a.unacknowledged_updates = 0;
    switch (command.id) {
      case 0x0011:
        a.next_update = now_ + kUpdatePeriod;
        break;
      case 0x0012:
        a.next_update.reset();
        break;
      default:  // 0492, "server alive"
        if (a.next_update) a.next_update = std::max(*a.next_update, now_);
    }
  }
}

std::uint32_t ThorlabsAptFirmware::Controller::status_bits(std::size_t k) const {
  const Axis& a = axes_[k];
  const StageAxis which = kStageAxes[k];
  std::uint32_t bits = 1U << 28U | 1U << 8U;  // power, connected
  if (a.enabled) bits |= 1U << 31U;
  if (a.homed) bits |= 1U << 10U;
  if (a.homing_until) bits |= 1U << 9U;
  const bool moves = bench_->moving(which, now_);
  if (moves) {
    const bool forward =
        settings_.sign[k] * (bench_->target(which, now_) - bench_->encoder_angle(which, now_)).deg() > 0.0;
    const unsigned kind = a.motion == Motion::kJog ? 6U : 4U;
    bits |= 1U << (kind + (forward ? 0U : 1U));
  }
  if (settings_.servo) bits |= 1U << 12U | (moves ? 0U : 1U << 13U);
  return bits;
}

/// Channel, position, then velocity and a reserved word (servo) or the encoder, and the bits.
std::string ThorlabsAptFirmware::Controller::status(std::size_t k) const {
  const std::string position = put_signed(counts(k));
  return put(1, 2) + position + (settings_.servo ? put(0, 4) : position) + put(status_bits(k), 4);
}

void ThorlabsAptFirmware::Controller::send(unsigned id, unsigned source, const std::string& data) {
  replies_.push(put(id, 2) + put(static_cast<std::uint32_t>(data.size()), 2) + put(kHostAddress | 0x80U, 1) +
                    put(source, 1) + data,
                now_ + settings_.reply_delay);
}

void ThorlabsAptFirmware::Controller::send_short(unsigned id, unsigned source, unsigned first,
                                                 unsigned second) {
  replies_.push(put(id, 2) + put(first, 1) + put(second, 1) + put(kHostAddress, 1) + put(source, 1),
                now_ + settings_.reply_delay);
}

// Messages.

void ThorlabsAptFirmware::Controller::receive(std::string_view bytes, Clock::Instant now) {
  if (now - last_byte_ > kPartialKept) received_.clear();
  last_byte_ = now;
  now_ = std::max(now_, now);
  advance();
  received_ += bytes;
  take_messages();
}

void ThorlabsAptFirmware::Controller::take_messages() {
  constexpr std::size_t kHeader = 6;
  while (received_.size() >= kHeader) {
    const unsigned destination = u8(received_, 4);
    const bool has_data = destination >= 0x80U;
    const std::size_t size = kHeader + (has_data ? u16(received_, 2) : 0U);
    if (received_.size() < size) return;
    Command command{u16(received_, 0), u8(received_, 2), u8(received_, 3),
                    received_.substr(kHeader, size - kHeader), received_.substr(0, size)};
    received_.erase(0, size);
    take(destination & 0x7FU, command);
  }
}

void ThorlabsAptFirmware::Controller::take(unsigned destination, const Command& command) {
  const bool to_rack = destination == kRackAddress && !unit();
  const auto axis = std::find_if(axes_.begin(), axes_.end(),
                                 [&](const Axis& a) { return a.address != 0 && a.address == destination; });
  if (!to_rack && axis == axes_.end()) return;  // For another module.
  constexpr std::array kUpdates{0x0011U, 0x0012U, 0x0492U};
  if (std::find(kUpdates.begin(), kUpdates.end(), command.id) != kUpdates.end())
    return take_updates(destination, command);
  if (command.id == 0x046BU || command.id == 0x046CU) {
    reports_ends_of_motions_ = command.id == 0x046CU;
    return;
  }
  // Disconnect, flash programming, identify, acknowledgement; settings are kept without being saved (04B9).
  constexpr std::array kUnanswered{0x0002U, 0x0017U, 0x0018U, 0x0223U, 0x0482U, 0x04B9U};
  if (std::find(kUnanswered.begin(), kUnanswered.end(), command.id) != kUnanswered.end()) return;
  if (command.id == 0x0005U || command.id == 0x0060U) return take_common(destination, command);
  if (axis != axes_.end()) {
    const auto k = static_cast<std::size_t>(axis - axes_.begin());
    if (take_motion(k, command) || take_setting(k, command) || take_kept(k, command)) return;
  }
  unserved_.note(fmt::format("{:04X}", command.id), "not emulated: no answer", command.bytes);
}

void ThorlabsAptFirmware::Controller::take_common(unsigned destination, const Command& command) {
  if (command.id == 0x0060U) {  // The bays in use; here they are counted from 0.
    const bool used = std::any_of(axes_.begin(), axes_.end(),
                                  [&](const Axis& a) { return a.address == 0x21U + command.first; });
    return send_short(0x0061, destination, command.first, used ? 1 : 2);
  }
  const unsigned channels = destination == kRackAddress ? 2 : 1;
  const auto serial = static_cast<std::uint32_t>(std::strtoul(settings_.serial_number.c_str(), nullptr, 10));
  send(0x0006, destination,
       put(serial, 4) + padded(settings_.model, 8) + put(settings_.servo ? 44 : 16, 2) +
           std::string{4, 0, 2, 0} + padded("simulated by abcal", 48) + std::string(12, '\0') + put(1, 2) +
           put(0, 2) + put(channels, 2));
}

bool ThorlabsAptFirmware::Controller::take_setting(std::size_t k, const Command& c) {
  Axis& a = axes_[k];
  switch (c.id) {
    case 0x0210:
      a.enabled = c.second == 1;
      return true;
    case 0x0211:
      send_short(0x0212, a.address, 1, a.enabled ? 1 : 2);
      return true;
    case 0x0410:
      if (c.data.size() == 6)
        a.offset_deg +=
            i32(c.data, 2) / settings_.counts_per_degree - counts(k) / settings_.counts_per_degree;
      return true;
    case 0x0411:
      send(0x0412, a.address, put(1, 2) + put_signed(counts(k)));
      return true;
    case 0x040A:
      send(0x040B, a.address, put(1, 2) + put_signed(counts(k)));
      return true;
    case 0x0413:
      if (c.data.size() != 14 || i32(c.data, 10) <= 0 || i32(c.data, 6) <= 0) return true;
      a.least_velocity = i32(c.data, 2);
      a.acceleration = i32(c.data, 6);
      a.velocity = i32(c.data, 10);
      set_limits(k);
      return true;
    case 0x0414:
      send(0x0415, a.address,
           put(1, 2) + put_signed(a.least_velocity) + put_signed(a.acceleration) + put_signed(a.velocity));
      return true;
    case 0x042B:  // analogue inputs, open: 0 V
      send(0x042C, a.address, put(0, 4));
      return true;
    case 0x0686:  // factory settings
      a.kept.clear();
      return true;
    case 0x0429:
      send(0x042A, a.address, put(1, 2) + put(status_bits(k), 4));
      return true;
    case 0x0480:
      send(0x0481, a.address, status(k));
      return true;
    case 0x0490:
      send(0x0491, a.address, status(k));
      return true;
    case 0x04F1:
      if (settings_.servo)
        send(0x04F2, a.address,
             put(1, 2) + put(0, 4) + padded(settings_.stage, 16) + put(12345, 4) +
                 put_signed(settings_.counts_per_degree) + std::string(44, '\0'));
      return true;
    default:
      return false;
  }
}

bool ThorlabsAptFirmware::Controller::take_motion(std::size_t k, const Command& c) {
  Axis& a = axes_[k];
  switch (c.id) {
    case 0x0443:
      // The home switch lies where a homed axis reads 0.
      a.homed = a.stopping = false;
      a.offset_deg = 0.0;
      a.motion = Motion::kHoming;
      a.homing_until = now_ + kShortestHoming;
      bench_->move(kStageAxes[k], protocol_angle(k, 0.0), now_);
      return true;
    case 0x0453: {  // Without data: to the place that was set before.
      const std::string to = c.data.empty() ? kept_parameters(k, kSetAbsoluteMove) : c.data;
      if (to.size() == 6) move(k, i32(to, 2) / settings_.counts_per_degree);
      return true;
    }
    case 0x0448: {
      const std::string by = c.data.empty() ? kept_parameters(k, kSetRelativeMove) : c.data;
      if (by.size() == 6) move(k, (counts(k) + i32(by, 2)) / settings_.counts_per_degree);
      return true;
    }
    case 0x046A:
      jog(k, c.second);
      return true;
    case 0x0457:
      move(k, counts(k) / settings_.counts_per_degree +
                  (c.second == kForward ? kOnAndOnDegrees : -kOnAndOnDegrees));
      a.motion = Motion::kJog;
      return true;
    case 0x0465:
      stop(k, c.second == 1);
      return true;
    default:
      return false;
  }
}

/// The value that was set, else that of a new controller [unverified against a device].
std::string ThorlabsAptFirmware::Controller::kept_parameters(std::size_t k,
                                                             const KeptParameters& parameters) const {
  const Axis& a = axes_[k];
  if (const auto found = a.kept.find(parameters.set); found != a.kept.end()) return found->second;
  if (parameters.size == 0) return std::string(1, '\0');
  const std::string channel = put(1, 2);
  switch (parameters.set) {
    case kSetJog:
      return channel + put(kSingleJog, 2) + put_signed(kJogStepDegrees * settings_.counts_per_degree) +
             put_signed(0) + put_signed(a.acceleration) + put_signed(a.velocity) + put(kProfiledStop, 2);
    case kSetLimitSwitches: {
      const unsigned kind = unit() ? kLimitSwitchIgnored : kLimitSwitchMakes;
      return channel + put(kind, 2) + put(kind, 2) + put(0, 8) + put(kLimitSwitchIgnored, 2);
    }
    case kSetHoming:
      return channel + put(kReverse, 2) + put(kReverseLimitSwitch, 2) + put_signed(a.velocity) +
             put_signed(0);
    default:
      return channel + std::string(parameters.size - 2, '\0');
  }
}

std::string ThorlabsAptFirmware::Controller::kept_parameters(std::size_t k, unsigned set) const {
  return kept_parameters(k, *std::find_if(kKept.begin(), kKept.end(),
                                          [&](const KeptParameters& each) { return each.set == set; }));
}

bool ThorlabsAptFirmware::Controller::take_kept(std::size_t k, const Command& c) {
  Axis& a = axes_[k];
  for (const KeptParameters& each : kKept) {
    if (c.id == each.set) {
      if (each.size == 0 && c.data.empty()) a.kept[each.set] = put(c.second, 1);
      if (each.size > 0 && c.data.size() == each.size) a.kept[each.set] = c.data;
      return true;
    }
    if (c.id == each.set + 1) {
      const std::string value = kept_parameters(k, each);
      if (each.size == 0) {
        send_short(each.set + 2, a.address, 1, u8(value, 0));
      } else {
        send(each.set + 2, a.address, value);
      }
      return true;
    }
  }
  return false;
}

/// Moves by one step or continuously, by the parameters of jogging.
void ThorlabsAptFirmware::Controller::jog(std::size_t k, unsigned direction) {
  if (direction != kForward && direction != kReverse) return;
  const std::string parameters = kept_parameters(k, kSetJog);
  const double step = u16(parameters, 2) == kContinuousJog ? kOnAndOnDegrees
                                                           : i32(parameters, 4) / settings_.counts_per_degree;
  move(k, counts(k) / settings_.counts_per_degree + (direction == kForward ? step : -step));
  if (axes_[k].motion == Motion::kMove) axes_[k].motion = Motion::kJog;
}

void ThorlabsAptFirmware::Controller::set_limits(std::size_t k) {
  MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
  limits.speed_deg_per_s = axes_[k].velocity / (settings_.counts_per_degree * settings_.velocity_per_count_s);
  bench_->set_motion_limits(kStageAxes[k], limits);
}

void ThorlabsAptFirmware::Controller::move(std::size_t k, double target_deg) {
  Axis& a = axes_[k];
  if (!a.enabled || bench_->fault_at(FaultKind::kRefusedMove, now_, kStageAxes[k])) {
    const std::string words =
        a.enabled ? "The move was refused (scripted fault)" : "The channel is not enabled";
    return send(0x0081, a.address, put(0x0453, 2) + put(4, 2) + padded(words, 64));
  }
  a.homing_until.reset();
  a.stopping = false;
  a.motion = Motion::kMove;
  bench_->move(kStageAxes[k], protocol_angle(k, target_deg), now_);
}

void ThorlabsAptFirmware::Controller::stop(std::size_t k, bool abruptly) {
  Axis& a = axes_[k];
  const StageAxis which = kStageAxes[k];
  const MotionLimits limits = bench_->motion_limits(which);
  MotionLimits abrupt = limits;
  if (abruptly) abrupt.deceleration_deg_per_s2 = kAbruptDeceleration;
  bench_->set_motion_limits(which, abrupt);
  bench_->halt(which, now_);
  bench_->set_motion_limits(which, limits);
  a.homing_until.reset();
  a.stopping = true;
  a.motion = a.motion == Motion::kNone ? Motion::kMove : a.motion;
}

std::string ThorlabsAptFirmware::Controller::transmit(Clock::Instant now) {
  now_ = std::max(now_, now);
  advance();
  return replies_.take(now);
}

std::optional<Clock::Instant> ThorlabsAptFirmware::Controller::next_due() const {
  auto due = replies_.next_due();
  for (std::size_t k = 0; k < 2; ++k) {
    if (updates_are_due(k)) due = due ? std::min(*due, *axes_[k].next_update) : *axes_[k].next_update;
    if (axes_[k].motion == Motion::kNone) continue;
    Clock::Instant end = bench_->motion_end(kStageAxes[k], now_);
    if (end == Clock::Instant::max()) continue;
    if (axes_[k].homing_until) end = std::max(end, *axes_[k].homing_until);
    due = due ? std::min(*due, end) : end;
  }
  return due;
}

ThorlabsAptFirmware::ThorlabsAptFirmware(std::shared_ptr<SimBench> bench, ThorlabsAptSettings settings) {
  encase(std::make_unique<Controller>(std::move(bench), std::move(settings), unserved()));
}

}  // namespace abcal::sim
