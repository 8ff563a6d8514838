#include "sim/firmware/newport_esp_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <map>
#include <numbers>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/text/names.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "sim/firmware/reply_queue.h"

namespace abcal::sim {
namespace {

// Error codes (docs/protocols/newport_esp.md). Errors of an axis are 100 * axis + code.
constexpr int kEmergencyStop = 4;
constexpr int kNoSuchCommand = 6;
constexpr int kOutOfRange = 7;
constexpr int kAxisOutOfRange = 9;
constexpr int kNoProgram = 35;
constexpr int kNotAllowed = 27;
constexpr int kAxisMissing = 37;
constexpr int kParameterMissing = 38;
enum AxisError : int {
  kPositiveHardwareLimit = 4,
  kNegativeHardwareLimit = 5,
  kPositiveSoftwareLimit = 6,
  kNegativeSoftwareLimit = 7,
  kNotConnected = 8,
  kFeedbackFault = 9,
  kMaxVelocity = 10,
  kMaxAcceleration = 11,
  kMotorNotEnabled = 13,
  kHomingAborted = 20,
  kNotDuringHoming = 30,
};

constexpr std::size_t kErrorMemory = 10;
constexpr std::size_t kLongestLine = 80;
constexpr int kPrograms = 100;
constexpr std::size_t kLongestProgram = 1000;  // lines
constexpr double kTargetPassed = 1e-9;         // deg, by which WP sees a position as reached
constexpr Clock::Duration kShortestHoming = std::chrono::milliseconds(200);
constexpr double kAbruptDeceleration = 1e5;  // deg/s2
// Error times count these [unverified against a device].
constexpr Clock::Duration kServoCycle = std::chrono::microseconds(400);

/// Degrees in one unit of SN; 0: not an angle.
double degrees_per_unit(int unit, double resolution_deg) {
  switch (unit) {
    case 0:
    case 1:
      return resolution_deg;  // encoder counts, motor steps
    case 7:
      return 1.0;
    case 8:
      return 0.9;  // grad
    case 9:
      return 180.0 / std::numbers::pi;
    case 10:
      return 0.18 / std::numbers::pi;  // mrad
    case 11:
      return 0.00018 / std::numbers::pi;  // urad
    default:
      return 0.0;
  }
}

constexpr auto kErrorTexts = names<int>({{0, "NO ERROR DETECTED"},
                                         {kEmergencyStop, "EMERGENCY STOP ACTIVATED"},
                                         {kNoSuchCommand, "COMMAND DOES NOT EXIST"},
                                         {kOutOfRange, "PARAMETER OUT OF RANGE"},
                                         {kAxisOutOfRange, "AXIS NUMBER OUT OF RANGE"},
                                         {kNotAllowed, "COMMAND NOT ALLOWED"},
                                         {kNoProgram, "PROGRAM DOES NOT EXIST"},
                                         {kAxisMissing, "AXIS NUMBER MISSING"},
                                         {kParameterMissing, "COMMAND PARAMETER MISSING"}});
constexpr auto kAxisErrorTexts = names<int>({{kPositiveHardwareLimit, "POSITIVE HARDWARE LIMIT EXCEEDED"},
                                             {kNegativeHardwareLimit, "NEGATIVE HARDWARE LIMIT EXCEEDED"},
                                             {kPositiveSoftwareLimit, "POSITIVE SOFTWARE LIMIT EXCEEDED"},
                                             {kNegativeSoftwareLimit, "NEGATIVE SOFTWARE LIMIT EXCEEDED"},
                                             {kNotConnected, "MOTOR / STAGE NOT CONNECTED"},
                                             {kFeedbackFault, "FEEDBACK SIGNAL FAULT DETECTED"},
                                             {kMaxVelocity, "MAXIMUM VELOCITY EXCEEDED"},
                                             {kMaxAcceleration, "MAXIMUM ACCELERATION EXCEEDED"},
                                             {kMotorNotEnabled, "MOTOR NOT ENABLED"},
                                             {kHomingAborted, "HOMING ABORTED"},
                                             {kNotDuringHoming, "COMMAND NOT ALLOWED DURING HOMING"}});

std::string_view text_of(int error) {
  return error < 100 ? kErrorTexts.of(error, "ERROR") : kAxisErrorTexts.of(error % 100, "AXIS ERROR");
}

using pieces::is_digit;

bool is_letter(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}
char upper(char c) {
  return c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
}
/// Thrown by a command that is refused; ends up in the memory of errors.
struct Refusal {
  int code;
};

/// A parameter: a number, or '?' for the value.
double number(std::string_view text) {
  if (text.empty()) throw Refusal{kParameterMissing};
  const auto value = pieces::number<double>(text.starts_with('+') ? text.substr(1) : text);
  if (!value || !std::isfinite(*value)) throw Refusal{kOutOfRange};
  return *value;
}

int whole_number(std::string_view text, int lowest, int highest) {
  const double value = number(text);
  if (value != std::floor(value) || value < lowest || value > highest) throw Refusal{kOutOfRange};
  return static_cast<int>(value);
}

std::string decimal(double value) {
  const std::string text = fmt::format("{:.5f}", value);
  return text == "-0.00000" ? "0.00000" : text;
}

}  // namespace

class NewportEspFirmware::Controller final : public Firmware {
 public:
  Controller(std::shared_ptr<SimBench> bench, NewportEspSettings settings, UnservedCommands& unserved);

  void receive(std::string_view bytes, Clock::Instant now) override;
  void session_starts() override {
    line_.clear();
    replies_.clear();
  }
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;
  void power(bool on, Clock::Instant now) override;
  std::optional<unsigned> line_speed() const override { return settings_.baud; }

 private:
  /// One command of a line.
  struct Command {
    unsigned axis = 0;  ///< 0: none given.
    std::string_view parameter;
    bool asks() const { return parameter == "?"; }
  };
  using Run = std::optional<std::string> (Controller::*)(const Command&);

  struct Axis {
    bool motor_on = false;
    std::optional<Clock::Instant> homing_until;
    bool presets_when_homed = true;
    std::optional<int> limit_ahead;  ///< The hardware limit that the move under way will run into.
    double offset_deg = 0.0;         ///< Controller angle = zero + sign * protocol angle + offset.
    double preset_deg = 0.0;         ///< SH
    double target_deg = 0.0;
    double soft_min_deg = 0.0;  ///< SL, SR
    double soft_max_deg = 0.0;
    double base_speed = 0.0;
    double jerk = 0.0;
    double abrupt_deceleration = kAbruptDeceleration;
    int unit = 7;
    std::map<std::string, double, std::less<>> kept;  ///< Settings that are kept and nothing else.
  };
  /// A setting that does nothing here: hosts read it, set it and read it again.
  struct Kept {
    double initial;
    double lowest;
    double highest;
    bool whole = false;
    bool angle = false;  ///< In the axis' unit.
  };
  struct Error {
    int code;
    Clock::Instant time;
  };

  static const std::map<std::string, Run, std::less<>>& commands();
  static const std::map<std::string, Kept, std::less<>>& kept_settings();
  std::optional<std::string> keep(std::string_view name, const Kept& kept, const Command& c);

  // Lines.
  void take_line(const std::string& line);
  void run_line(std::string_view line);
  void run_command(std::string_view text);
  void send(const std::string& text);
  void update();
  void remember(int code);
  Error take_error();

  // Axes.
  std::size_t index_of(const Command& command) const;  ///< Index into the settings' arrays.
  unsigned number_of(std::size_t k) const;
  std::vector<std::size_t> one_or_all(const Command& command) const;
  Axis& axis(const Command& command) { return axes_[index_of(command)]; }
  int axis_error(std::size_t k, int code) const { return static_cast<int>(100 * number_of(k)) + code; }
  const AxisTruth& truth(std::size_t k) const { return bench_->stage().axis(kStageAxes[k]); }
  double unit(std::size_t k) const {
    return degrees_per_unit(axes_[k].unit, truth(k).encoder_resolution.deg());
  }
  double controller_deg(std::size_t k, Angle protocol) const;
  Angle protocol_angle(std::size_t k, double controller) const;
  std::pair<double, double> hardware_travel(std::size_t k) const;
  bool in_motion(std::size_t k) const;
  void refuse_while_homing(std::size_t k) const;
  void start_move(std::size_t k, double target_deg);
  void stop(std::size_t k, bool abruptly);
  std::optional<std::string> in_units(std::size_t k, double degrees) const {
    return decimal(degrees / unit(k));
  }

  // Commands.
  std::optional<std::string> version(const Command&) { return settings_.version; }
  std::optional<std::string> stage_id(const Command& c);
  std::optional<std::string> motor_on(const Command& c);
  std::optional<std::string> motor_off(const Command& c);
  std::optional<std::string> position(const Command& c);
  std::optional<std::string> target(const Command& c);
  std::optional<std::string> speed_now(const Command& c);
  std::optional<std::string> move_absolute(const Command& c);
  std::optional<std::string> move_relative(const Command& c);
  std::optional<std::string> motion_done(const Command& c);
  std::optional<std::string> stop_motion(const Command& c);
  std::optional<std::string> abort_motion(const Command& c);
  std::optional<std::string> origin(const Command& c);
  std::optional<std::string> define_position(const Command& c);
  std::optional<std::string> home_preset(const Command& c);
  std::optional<std::string> speed(const Command& c);
  std::optional<std::string> max_speed(const Command& c);
  std::optional<std::string> base_speed(const Command& c);
  std::optional<std::string> acceleration(const Command& c);
  std::optional<std::string> deceleration(const Command& c);
  std::optional<std::string> max_acceleration(const Command& c);
  std::optional<std::string> abrupt_deceleration(const Command& c);
  std::optional<std::string> jerk(const Command& c);
  std::optional<std::string> units(const Command& c);
  std::optional<std::string> left_limit(const Command& c);
  std::optional<std::string> right_limit(const Command& c);
  std::optional<std::string> limit_configuration(const Command& c);
  std::optional<std::string> hardware_status(const Command& c);
  std::optional<std::string> feedback_configuration(const Command& c);
  std::optional<std::string> encoder_resolution(const Command& c);
  std::optional<std::string> full_step(const Command& c);
  std::optional<std::string> microsteps(const Command& c);
  std::optional<std::string> wait_for_stop(const Command& c);
  std::optional<std::string> wait_time(const Command& c);
  std::optional<std::string> error_code(const Command&) { return std::to_string(take_error().code); }
  std::optional<std::string> error_message(const Command&);
  std::optional<std::string> keypad_lock(const Command& c);
  std::optional<std::string> save(const Command&) { return std::nullopt; }
  std::optional<std::string> move_on(const Command& c);
  std::optional<std::string> move_to_limit(const Command& c);
  std::optional<std::string> wait_for_position(const Command& c);
  std::optional<std::string> speed_wanted(const Command& c);
  std::optional<std::string> torque_reduction(const Command& c);
  std::optional<std::string> controller_status(const Command&);
  std::optional<std::string> system_configuration(const Command&) { return "0H"; }
  std::optional<std::string> reset(const Command&);
  std::optional<std::string> update_servo(const Command&) { return std::nullopt; }
  std::optional<std::string> enter_program(const Command& c);
  std::optional<std::string> quit_program(const Command&);
  std::optional<std::string> run_program(const Command& c);
  std::optional<std::string> erase_program(const Command& c);
  int program_number(const Command& c) const;
  double toward(const Command& c, double negative, double positive) const;
  void power_on();

  double& limit_of(const Command& c, bool left);

  std::shared_ptr<SimBench> bench_;
  NewportEspSettings settings_;
  UnservedCommands& unserved_;
  std::array<Axis, 2> axes_;
  std::map<int, std::vector<std::string>> programs_;
  std::optional<int> entered_program_;  ///< Lines go into it rather than being run.
  std::array<unsigned, 2> numbers_{};   ///< Axis numbers of X and Z; 0: not here.
  ReplyQueue replies_;
  std::string line_;
  std::deque<std::string> waiting_lines_;  ///< Behind a WS or WT.
  std::optional<Clock::Instant> waits_until_;
  std::deque<Error> errors_;
  Clock::Instant silent_until_;
  int keypad_lock_ = 0;
  Clock::Instant now_;
};

NewportEspFirmware::Controller::Controller(std::shared_ptr<SimBench> bench, NewportEspSettings settings,
                                           UnservedCommands& unserved)
    : bench_(std::move(bench)),
      settings_(std::move(settings)),
      unserved_(unserved),
      silent_until_(bench_->start()),
      now_(bench_->start()) {
  for (std::size_t k = 0; k < 2; ++k) {
    if (settings_.sign[k] != 1 && settings_.sign[k] != -1)
      throw std::invalid_argument(
          fmt::format("simulated ESP controller: sign is {}, required: +1 or -1", settings_.sign[k]));
    const std::string& name = settings_.axis_names[k];
    if (name.empty()) continue;
    const auto value = pieces::number<unsigned>(name);
    if (!value || *value < 1 || *value > settings_.axes)
      throw std::invalid_argument(
          fmt::format("simulated ESP controller: an axis is named \"{}\", required: a number from 1 to {}",
                      name, settings_.axes));
    numbers_[k] = *value;
  }
  if (numbers_[0] == numbers_[1])
    throw std::invalid_argument(fmt::format(
        "simulated ESP controller: both axes are named \"{}\", required: two numbers", numbers_[0]));
  power_on();
}

void NewportEspFirmware::Controller::power_on() {
  for (std::size_t k = 0; k < 2; ++k) {
    Axis& a = axes_[k] = Axis{};
    a.offset_deg = -controller_deg(k, bench_->target(kStageAxes[k], now_));  // Reads 0 until it is homed.
    const double low = settings_.zero[k].deg() + settings_.sign[k] * truth(k).travel_min.deg();
    const double high = settings_.zero[k].deg() + settings_.sign[k] * truth(k).travel_max.deg();
    a.soft_min_deg = std::min(low, high);
    a.soft_max_deg = std::max(low, high);
  }
}

const std::map<std::string, NewportEspFirmware::Controller::Run, std::less<>>&
NewportEspFirmware::Controller::commands() {
  using C = Controller;
  static const std::map<std::string, Run, std::less<>> table{
      {"AB", &C::abort_motion},
      {"AC", &C::acceleration},
      {"AE", &C::abrupt_deceleration},
      {"AG", &C::deceleration},
      {"AU", &C::max_acceleration},
      {"DH", &C::define_position},
      {"DP", &C::target},
      {"DV", &C::speed_wanted},
      {"EP", &C::enter_program},
      {"EX", &C::run_program},
      {"FR", &C::full_step},
      {"ID", &C::stage_id},
      {"JK", &C::jerk},
      {"LC", &C::keypad_lock},
      {"MD", &C::motion_done},
      {"MF", &C::motor_off},
      {"MO", &C::motor_on},
      {"MT", &C::move_to_limit},
      {"MV", &C::move_on},
      {"OR", &C::origin},
      {"PA", &C::move_absolute},
      {"PH", &C::hardware_status},
      {"PR", &C::move_relative},
      {"QD", &C::update_servo},
      {"QP", &C::quit_program},
      {"QR", &C::torque_reduction},
      {"QS", &C::microsteps},
      {"RS", &C::reset},
      {"SH", &C::home_preset},
      {"SL", &C::left_limit},
      {"SM", &C::save},
      {"SN", &C::units},
      {"SR", &C::right_limit},
      {"ST", &C::stop_motion},
      {"SU", &C::encoder_resolution},
      {"TB", &C::error_message},
      {"TE", &C::error_code},
      {"TP", &C::position},
      {"TS", &C::controller_status},
      {"TV", &C::speed_now},
      {"UF", &C::update_servo},
      {"VA", &C::speed},
      {"VB", &C::base_speed},
      {"VE", &C::version},
      {"VU", &C::max_speed},
      {"WP", &C::wait_for_position},
      {"WS", &C::wait_for_stop},
      {"WT", &C::wait_time},
      {"XX", &C::erase_program},
      {"ZB", &C::feedback_configuration},
      {"ZH", &C::limit_configuration},
      {"ZU", &C::system_configuration},
  };
  return table;
}

/// The initial values belong to no particular stage [unverified against a device].
const std::map<std::string, NewportEspFirmware::Controller::Kept, std::less<>>&
NewportEspFirmware::Controller::kept_settings() {
  static const std::map<std::string, Kept, std::less<>> table{
      {"AF", {.initial = 0.0, .lowest = 0.0, .highest = 1e9}},
      {"FE", {.initial = 1.0, .lowest = 0.0, .highest = 360.0, .angle = true}},
      {"FP", {.initial = 5.0, .lowest = 0.0, .highest = 7.0, .whole = true}},
      {"JH", {.initial = 10.0, .lowest = 0.0, .highest = 1e4, .angle = true}},
      {"JW", {.initial = 1.0, .lowest = 0.0, .highest = 1e4, .angle = true}},
      {"KD", {.initial = 500.0, .lowest = 0.0, .highest = 1e9}},
      {"KI", {.initial = 100.0, .lowest = 0.0, .highest = 1e9}},
      {"KP", {.initial = 450.0, .lowest = 0.0, .highest = 1e9}},
      {"KS", {.initial = 1000.0, .lowest = 0.0, .highest = 1e9}},
      {"OH", {.initial = 10.0, .lowest = 0.0, .highest = 1e4, .angle = true}},
      {"QI", {.initial = 1.0, .lowest = 0.0, .highest = 3.0}},
      {"QM", {.initial = 1.0, .lowest = 0.0, .highest = 4.0, .whole = true}},
      {"QV", {.initial = 24.0, .lowest = 0.0, .highest = 60.0}},
      {"TJ", {.initial = 1.0, .lowest = 1.0, .highest = 6.0, .whole = true}},
  };
  return table;
}

std::optional<std::string> NewportEspFirmware::Controller::keep(std::string_view name, const Kept& kept,
                                                                const Command& c) {
  const std::size_t k = index_of(c);
  auto& values = axes_[k].kept;
  const auto found = values.find(name);
  const double scale = kept.angle ? unit(k) : 1.0;
  if (c.asks()) {
    const double value = (found == values.end() ? kept.initial : found->second) / scale;
    return kept.whole ? fmt::format("{:.0f}", value) : decimal(value);
  }
  const double value = number(c.parameter) * scale;
  if (value < kept.lowest || value > kept.highest || (kept.whole && value != std::floor(value)))
    throw Refusal{kOutOfRange};
  values.insert_or_assign(std::string(name), value);
  return std::nullopt;
}

// Lines.

void NewportEspFirmware::Controller::receive(std::string_view bytes, Clock::Instant now) {
  now_ = now;
  update();
  for (const char c : bytes) {
    if (c == '\r') {
      if (line_.size() > kLongestLine) {
        remember(kNoSuchCommand);
        line_.clear();
      }
      take_line(std::exchange(line_, {}));
    } else if (c != '\n' && line_.size() <= kLongestLine) {  // One more than the longest: too long.
      line_.push_back(c);
    }
  }
}

void NewportEspFirmware::Controller::take_line(const std::string& line) {
  if (entered_program_) {
    std::string name(pieces::trimmed(line));
    std::transform(name.begin(), name.end(), name.begin(), upper);
    if (name == "QP" || name == "QP;") {
      entered_program_.reset();
    } else if (programs_[*entered_program_].size() < kLongestProgram) {
      programs_[*entered_program_].push_back(line);
    }
  } else if (waits_until_) {
    waiting_lines_.push_back(line);
  } else {
    run_line(line);
  }
}

void NewportEspFirmware::Controller::run_line(std::string_view line) {
  while (!line.empty()) {
    const std::size_t end = std::min(line.find(';'), line.size());
    run_command(pieces::trimmed(line.substr(0, end)));
    line.remove_prefix(std::min(end + 1, line.size()));
    if (waits_until_ && !line.empty()) {
      waiting_lines_.push_front(std::string(line));
      return;
    }
  }
}

void NewportEspFirmware::Controller::run_command(std::string_view text) {
  if (text.empty()) return;
  Command command;
  std::size_t at = 0;
  while (at < text.size() && is_digit(text[at]))
    command.axis = std::min(command.axis * 10 + static_cast<unsigned>(text[at++] - '0'), 999U);
  const bool axis_given = at > 0;
  while (at < text.size() && text[at] == ' ') ++at;
  if (at + 2 > text.size() || !is_letter(text[at]) || !is_letter(text[at + 1]))
    return remember(kNoSuchCommand);
  const std::string name{upper(text[at]), upper(text[at + 1])};
  command.parameter = pieces::trimmed(text.substr(at + 2));
  const auto found = commands().find(name);
  const auto kept = kept_settings().find(name);
  if (found == commands().end() && kept == kept_settings().end()) {
    unserved_.note(name, "not emulated: error 6, no answer", text);
    return remember(kNoSuchCommand);
  }
  // The number before a program command is the program's, not an axis'.
  const bool of_a_program = name == "EP" || name == "EX" || name == "XX";
  if (!of_a_program && axis_given && (command.axis < 1 || command.axis > settings_.axes))
    return remember(kAxisOutOfRange);
  try {
    const auto reply =
        kept != kept_settings().end() ? keep(name, kept->second, command) : (this->*found->second)(command);
    if (reply) send(*reply);
  } catch (const Refusal& refusal) {
    remember(refusal.code);
  }
}

void NewportEspFirmware::Controller::send(const std::string& text) {
  replies_.push(text + settings_.line_end, std::max(now_, silent_until_) + settings_.reply_delay);
}

void NewportEspFirmware::Controller::remember(int code) {
  if (errors_.size() >= kErrorMemory) errors_.pop_front();
  errors_.push_back({code, now_});
  if (settings_.unsolicited_errors && code >= 35 && code <= 42) send(fmt::format("E{}", code));
}

NewportEspFirmware::Controller::Error NewportEspFirmware::Controller::take_error() {
  if (errors_.empty()) return {0, now_};
  const Error error = errors_.front();
  errors_.pop_front();
  return error;
}

/// Applies all changes up to now_.
void NewportEspFirmware::Controller::update() {
  for (std::size_t k = 0; k < 2; ++k) {
    Axis& a = axes_[k];
    const StageAxis which = kStageAxes[k];
    if (a.homing_until) a.homing_until = std::max(*a.homing_until, bench_->motion_end(which, now_));
    if (a.homing_until && now_ >= *a.homing_until) {
      a.homing_until.reset();
      if (a.presets_when_homed) {
        a.offset_deg += a.preset_deg - controller_deg(k, bench_->target(which, now_));
        a.target_deg = a.preset_deg;
      }
    }
    if (a.limit_ahead && !bench_->moving(which, now_)) {
      remember(axis_error(k, *a.limit_ahead));
      a.limit_ahead.reset();
      a.motor_on = false;
      a.target_deg = controller_deg(k, bench_->target(which, now_));
      silent_until_ = bench_->motion_end(which, now_) + settings_.silence_after_limit;
    }
    if (a.motor_on && bench_->fault_at(FaultKind::kLostReference, now_, which)) {
      a.motor_on = false;
      remember(axis_error(k, kFeedbackFault));
    }
  }
}

std::string NewportEspFirmware::Controller::transmit(Clock::Instant now) {
  // Lines that waited are run at the time for which they waited.
  while (waits_until_ && *waits_until_ <= now) {
    now_ = std::max(now_, *waits_until_);
    waits_until_.reset();
    update();
    while (!waits_until_ && !waiting_lines_.empty()) {
      const std::string line = std::move(waiting_lines_.front());
      waiting_lines_.pop_front();
      run_line(line);
    }
  }
  return replies_.take(now);
}

std::optional<Clock::Instant> NewportEspFirmware::Controller::next_due() const {
  const auto due = replies_.next_due();
  if (!waits_until_ || *waits_until_ == Clock::Instant::max()) return due;
  return due ? std::min(*due, *waits_until_) : *waits_until_;
}

// Axes.

std::size_t NewportEspFirmware::Controller::index_of(const Command& command) const {
  if (command.axis == 0) throw Refusal{kAxisMissing};
  for (std::size_t k = 0; k < 2; ++k)
    if (numbers_[k] == command.axis) return k;
  throw Refusal{static_cast<int>(100 * command.axis) + kNotConnected};
}

unsigned NewportEspFirmware::Controller::number_of(std::size_t k) const {
  return numbers_[k];
}

std::vector<std::size_t> NewportEspFirmware::Controller::one_or_all(const Command& command) const {
  if (command.axis != 0) return {index_of(command)};
  std::vector<std::size_t> all;
  for (std::size_t k = 0; k < 2; ++k)
    if (numbers_[k] != 0) all.push_back(k);
  return all;
}

double NewportEspFirmware::Controller::controller_deg(std::size_t k, Angle protocol) const {
  return settings_.zero[k].deg() + axes_[k].offset_deg + settings_.sign[k] * protocol.deg();
}

Angle NewportEspFirmware::Controller::protocol_angle(std::size_t k, double controller) const {
  return Angle::degrees(settings_.sign[k] * (controller - settings_.zero[k].deg() - axes_[k].offset_deg));
}

std::pair<double, double> NewportEspFirmware::Controller::hardware_travel(std::size_t k) const {
  const double a = controller_deg(k, truth(k).travel_min);
  const double b = controller_deg(k, truth(k).travel_max);
  return {std::min(a, b), std::max(a, b)};
}

bool NewportEspFirmware::Controller::in_motion(std::size_t k) const {
  return axes_[k].homing_until.has_value() || bench_->moving(kStageAxes[k], now_);
}

void NewportEspFirmware::Controller::refuse_while_homing(std::size_t k) const {
  if (axes_[k].homing_until) throw Refusal{axis_error(k, kNotDuringHoming)};
}

void NewportEspFirmware::Controller::start_move(std::size_t k, double target_deg) {
  Axis& a = axes_[k];
  refuse_while_homing(k);
  if (!a.motor_on) throw Refusal{axis_error(k, kMotorNotEnabled)};
  // Targets are typed in decimals, so a limit counts as exceeded only by more than one encoder step.
  const double step = truth(k).encoder_resolution.deg();
  if (target_deg > a.soft_max_deg + step) throw Refusal{axis_error(k, kPositiveSoftwareLimit)};
  if (target_deg < a.soft_min_deg - step) throw Refusal{axis_error(k, kNegativeSoftwareLimit)};
  if (bench_->fault_at(FaultKind::kRefusedMove, now_, kStageAxes[k])) throw Refusal{kNotAllowed};
  a.limit_ahead.reset();
  const auto [lowest, highest] = hardware_travel(k);
  if (target_deg > highest + step) a.limit_ahead = kPositiveHardwareLimit;
  if (target_deg < lowest - step) a.limit_ahead = kNegativeHardwareLimit;
  a.target_deg = std::clamp(target_deg, lowest, highest);
  bench_->move(kStageAxes[k], protocol_angle(k, a.target_deg), now_);
}

void NewportEspFirmware::Controller::stop(std::size_t k, bool abruptly) {
  const StageAxis which = kStageAxes[k];
  Axis& a = axes_[k];
  if (std::exchange(a.homing_until, std::nullopt)) remember(axis_error(k, kHomingAborted));
  a.limit_ahead.reset();
  if (!bench_->moving(which, now_)) return;
  const MotionLimits limits = bench_->motion_limits(which);
  MotionLimits abrupt = limits;
  if (abruptly) abrupt.deceleration_deg_per_s2 = a.abrupt_deceleration;
  bench_->set_motion_limits(which, abrupt);
  bench_->halt(which, now_);
  bench_->set_motion_limits(which, limits);
  a.target_deg = controller_deg(k, bench_->target(which, now_));
}

// Commands. A set command answers nothing.

std::optional<std::string> NewportEspFirmware::Controller::stage_id(const Command& c) {
  const std::size_t k = index_of(c);
  return fmt::format("{}, SN{}", settings_.stage_models[k],
                     k == 0 ? settings_.serial_number : settings_.z_serial_number);
}

std::optional<std::string> NewportEspFirmware::Controller::motor_on(const Command& c) {
  if (c.asks()) return axis(c).motor_on ? "1" : "0";
  for (const std::size_t k : one_or_all(c)) axes_[k].motor_on = true;
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::motor_off(const Command& c) {
  if (c.asks()) return axis(c).motor_on ? "1" : "0";
  for (const std::size_t k : one_or_all(c)) {
    stop(k, true);
    axes_[k].motor_on = false;
  }
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::position(const Command& c) {
  const std::size_t k = index_of(c);
  return in_units(k, controller_deg(k, bench_->encoder_angle(kStageAxes[k], now_)));
}

std::optional<std::string> NewportEspFirmware::Controller::target(const Command& c) {
  const std::size_t k = index_of(c);
  return in_units(k, axes_[k].target_deg);
}

std::optional<std::string> NewportEspFirmware::Controller::speed_now(const Command& c) {
  // Measured by the encoder over one servo cycle, as in the controller itself.
  const std::size_t k = index_of(c);
  const Angle turned = bench_->commanded_angle(kStageAxes[k], now_) -
                       bench_->commanded_angle(kStageAxes[k], std::max(bench_->start(), now_ - kServoCycle));
  return in_units(k, settings_.sign[k] * turned.deg() / to_seconds(kServoCycle));
}

std::optional<std::string> NewportEspFirmware::Controller::move_absolute(const Command& c) {
  const std::size_t k = index_of(c);
  if (c.asks()) return in_units(k, axes_[k].target_deg);
  start_move(k, number(c.parameter) * unit(k));
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::move_relative(const Command& c) {
  const std::size_t k = index_of(c);
  start_move(k, axes_[k].target_deg + number(c.parameter) * unit(k));
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::motion_done(const Command& c) {
  return in_motion(index_of(c)) ? "0" : "1";
}

std::optional<std::string> NewportEspFirmware::Controller::stop_motion(const Command& c) {
  // For an axis without a stage there is nothing to stop, and no error: hosts count the axes this way.
  if (c.axis != 0 && c.axis != numbers_[0] && c.axis != numbers_[1]) return std::nullopt;
  for (const std::size_t k : one_or_all(c)) stop(k, false);
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::abort_motion(const Command& c) {
  for (const std::size_t k : one_or_all(c)) stop(k, true);
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::origin(const Command& c) {
  const std::size_t k = index_of(c);
  Axis& a = axes_[k];
  const int mode = c.parameter.empty()
                       ? 1
                       : whole_number(c.parameter, 0, 6);  // Without number: 1 [unverified against a device]
  refuse_while_homing(k);
  if (!a.motor_on) throw Refusal{axis_error(k, kMotorNotEnabled)};
  double where = a.offset_deg;  // The home switch is where a homed axis reads 0.
  switch (mode) {
    case 0:
      where = 0.0;  // the position that reads 0
      break;
    case 3:
    case 5:
      where = hardware_travel(k).second;
      break;
    case 4:
    case 6:
      where = hardware_travel(k).first;
      break;
    default:
      break;
  }
  a.presets_when_homed = mode != 0;
  a.target_deg = where;
  bench_->move(kStageAxes[k], protocol_angle(k, where), now_);
  a.homing_until = now_ + kShortestHoming;
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::define_position(const Command& c) {
  const std::size_t k = index_of(c);
  Axis& a = axes_[k];
  if (c.asks()) return in_units(k, a.preset_deg);
  const double value = c.parameter.empty() ? 0.0 : number(c.parameter) * unit(k);
  if (in_motion(k)) throw Refusal{kNotAllowed};
  a.offset_deg += value - controller_deg(k, bench_->target(kStageAxes[k], now_));
  a.target_deg = value;
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::home_preset(const Command& c) {
  const std::size_t k = index_of(c);
  if (c.asks()) return in_units(k, axes_[k].preset_deg);
  axes_[k].preset_deg = number(c.parameter) * unit(k);
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::speed(const Command& c) {
  const std::size_t k = index_of(c);
  MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
  if (c.asks()) return in_units(k, limits.speed_deg_per_s);
  const double value = number(c.parameter) * unit(k);
  refuse_while_homing(k);
  if (value <= 0.0) throw Refusal{kOutOfRange};
  if (value > settings_.max_speed_deg_per_s) throw Refusal{axis_error(k, kMaxVelocity)};
  limits.speed_deg_per_s = value;
  bench_->set_motion_limits(kStageAxes[k], limits);
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::max_speed(const Command& c) {
  const std::size_t k = index_of(c);
  if (!c.asks()) throw Refusal{kNotAllowed};  // The stage's own.
  return in_units(k, settings_.max_speed_deg_per_s);
}

std::optional<std::string> NewportEspFirmware::Controller::base_speed(const Command& c) {
  const std::size_t k = index_of(c);
  if (c.asks() || c.parameter.empty()) return in_units(k, axes_[k].base_speed);
  const double value = number(c.parameter) * unit(k);
  if (value < 0.0 || value > settings_.max_speed_deg_per_s) throw Refusal{kOutOfRange};
  axes_[k].base_speed = value;  // Used by stepping motors only: no effect here.
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::acceleration(const Command& c) {
  const std::size_t k = index_of(c);
  MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
  if (c.asks()) return in_units(k, limits.acceleration_deg_per_s2);
  const double value = number(c.parameter) * unit(k);
  if (value <= 0.0) throw Refusal{kOutOfRange};
  if (value > settings_.max_acceleration_deg_per_s2) throw Refusal{axis_error(k, kMaxAcceleration)};
  limits.acceleration_deg_per_s2 = value;
  bench_->set_motion_limits(kStageAxes[k], limits);
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::deceleration(const Command& c) {
  const std::size_t k = index_of(c);
  MotionLimits limits = bench_->motion_limits(kStageAxes[k]);
  if (c.asks()) return in_units(k, limits.deceleration_deg_per_s2);
  const double value = number(c.parameter) * unit(k);
  if (value <= 0.0) throw Refusal{kOutOfRange};
  if (value > settings_.max_acceleration_deg_per_s2) throw Refusal{axis_error(k, kMaxAcceleration)};
  limits.deceleration_deg_per_s2 = value;
  bench_->set_motion_limits(kStageAxes[k], limits);
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::max_acceleration(const Command& c) {
  const std::size_t k = index_of(c);
  if (!c.asks()) throw Refusal{kNotAllowed};
  return in_units(k, settings_.max_acceleration_deg_per_s2);
}

std::optional<std::string> NewportEspFirmware::Controller::abrupt_deceleration(const Command& c) {
  const std::size_t k = index_of(c);
  if (c.asks()) return in_units(k, axes_[k].abrupt_deceleration);
  const double value = number(c.parameter) * unit(k);
  if (value <= 0.0) throw Refusal{kOutOfRange};
  axes_[k].abrupt_deceleration = value;
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::jerk(const Command& c) {
  const std::size_t k = index_of(c);
  if (c.asks()) return in_units(k, axes_[k].jerk);
  axes_[k].jerk = number(c.parameter) * unit(k);  // The simulated motion has none.
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::units(const Command& c) {
  const std::size_t k = index_of(c);
  if (c.asks()) return std::to_string(axes_[k].unit);
  const int wanted = whole_number(c.parameter, 0, 11);
  // A length is not a unit for a rotation stage; the reaction of a real controller is not known.
  if (degrees_per_unit(wanted, truth(k).encoder_resolution.deg()) == 0.0) throw Refusal{kOutOfRange};
  axes_[k].unit = wanted;
  return std::nullopt;
}

double& NewportEspFirmware::Controller::limit_of(const Command& c, bool left) {
  Axis& a = axis(c);
  return left ? a.soft_min_deg : a.soft_max_deg;
}

std::optional<std::string> NewportEspFirmware::Controller::left_limit(const Command& c) {
  const std::size_t k = index_of(c);
  if (c.asks()) return in_units(k, limit_of(c, true));
  limit_of(c, true) = number(c.parameter) * unit(k);
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::right_limit(const Command& c) {
  const std::size_t k = index_of(c);
  if (c.asks()) return in_units(k, limit_of(c, false));
  limit_of(c, false) = number(c.parameter) * unit(k);
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::limit_configuration(const Command& c) {
  index_of(c);
  return c.asks() ? std::optional<std::string>("24H") : std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::hardware_status(const Command&) {
  unsigned limits = 0;
  unsigned homes = 0;
  for (std::size_t k = 0; k < 2; ++k) {
    if (numbers_[k] == 0) continue;
    const double at = controller_deg(k, bench_->commanded_angle(kStageAxes[k], now_));
    const auto [lowest, highest] = hardware_travel(k);
    const unsigned bit = numbers_[k] - 1;
    if (at >= highest) limits |= 1U << bit;
    if (at <= lowest) limits |= 1U << (8 + bit);
    if (bench_->commanded_angle(kStageAxes[k], now_) == protocol_angle(k, axes_[k].offset_deg))
      homes |= 1U << bit;
  }
  return fmt::format("{:X}H, {:X}H", limits, homes);
}

std::optional<std::string> NewportEspFirmware::Controller::feedback_configuration(const Command& c) {
  index_of(c);
  return c.asks() ? std::optional<std::string>("300H") : std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::encoder_resolution(const Command& c) {
  const std::size_t k = index_of(c);
  if (!c.asks() && !c.parameter.empty()) throw Refusal{kNotAllowed};  // The stage cannot be changed.
  return fmt::format("{}", truth(k).encoder_resolution.deg() / unit(k));
}

std::optional<std::string> NewportEspFirmware::Controller::full_step(const Command& c) {
  const std::size_t k = index_of(c);
  if (!c.asks() && !c.parameter.empty()) throw Refusal{kNotAllowed};  // The stage cannot be changed.
  return fmt::format("{}", truth(k).encoder_resolution.deg() * 100.0 / unit(k));
}

std::optional<std::string> NewportEspFirmware::Controller::microsteps(const Command& c) {
  index_of(c);
  if (!c.asks() && !c.parameter.empty()) throw Refusal{kNotAllowed};
  return "100";
}

std::optional<std::string> NewportEspFirmware::Controller::wait_for_stop(const Command& c) {
  const double ms = c.parameter.empty() ? 0.0 : number(c.parameter);
  if (ms < 0.0 || ms > 60000.0) throw Refusal{kOutOfRange};
  Clock::Instant until = now_;
  for (const std::size_t k : one_or_all(c)) {
    if (axes_[k].homing_until) until = std::max(until, *axes_[k].homing_until);
    until = std::max(until, bench_->motion_end(kStageAxes[k], now_));
  }
  waits_until_ = until == Clock::Instant::max() ? until : until + from_seconds(ms / 1000.0);
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::wait_time(const Command& c) {
  const double ms = number(c.parameter);
  if (ms < 0.0 || ms > 60000.0) throw Refusal{kOutOfRange};
  waits_until_ = now_ + from_seconds(ms / 1000.0);
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::error_message(const Command&) {
  const Error error = take_error();
  return fmt::format("{}, {}, {}", error.code, (error.time - bench_->start()) / kServoCycle,
                     text_of(error.code));
}

std::optional<std::string> NewportEspFirmware::Controller::keypad_lock(const Command& c) {
  if (c.asks()) return std::to_string(keypad_lock_);
  keypad_lock_ = whole_number(c.parameter, 0, 2);
  return std::nullopt;
}

/// The end of the travel that "+" or "-" points to.
double NewportEspFirmware::Controller::toward(const Command& c, double negative, double positive) const {
  if (c.parameter.empty()) throw Refusal{kParameterMissing};
  if (c.parameter == "+") return positive;
  if (c.parameter == "-") return negative;
  throw Refusal{kOutOfRange};
}

/// Moves until it is stopped or reaches its software limit.
std::optional<std::string> NewportEspFirmware::Controller::move_on(const Command& c) {
  const std::size_t k = index_of(c);
  if (c.asks()) return in_motion(k) ? "1" : "0";
  const auto [lowest, highest] = hardware_travel(k);
  start_move(k, toward(c, std::max(axes_[k].soft_min_deg, lowest), std::min(axes_[k].soft_max_deg, highest)));
  return std::nullopt;
}

/// Moves to the limit switch, which is not an error here.
std::optional<std::string> NewportEspFirmware::Controller::move_to_limit(const Command& c) {
  const std::size_t k = index_of(c);
  if (c.asks()) return in_motion(k) ? "0" : "1";
  refuse_while_homing(k);
  if (!axes_[k].motor_on) throw Refusal{axis_error(k, kMotorNotEnabled)};
  const auto [lowest, highest] = hardware_travel(k);
  axes_[k].limit_ahead.reset();
  axes_[k].target_deg = toward(c, lowest, highest);
  bench_->move(kStageAxes[k], protocol_angle(k, axes_[k].target_deg), now_);
  return std::nullopt;
}

/// Blocks the line until the axis is there; returns at once if it is not moving there.
std::optional<std::string> NewportEspFirmware::Controller::wait_for_position(const Command& c) {
  const std::size_t k = index_of(c);
  const double wanted = number(c.parameter) * unit(k);
  const StageAxis which = kStageAxes[k];
  const Clock::Instant end = bench_->motion_end(which, now_);
  const auto ahead = [&](Clock::Instant t) {
    const double way = axes_[k].target_deg - wanted;
    const double left = controller_deg(k, bench_->commanded_angle(which, t)) - wanted;
    const bool at_the_end = std::abs(way) <= kTargetPassed;
    return std::abs(left) > kTargetPassed && (at_the_end || (left > 0.0) != (way > 0.0));
  };
  if (!bench_->moving(which, now_) || end == Clock::Instant::max() || !ahead(now_)) return std::nullopt;
  // The motion goes one way: halve the time until the servo cycle is found.
  Clock::Instant before = now_;
  Clock::Instant after = end;
  while (after - before > kServoCycle) {
    const Clock::Instant middle = before + (after - before) / 2;
    (ahead(middle) ? before : after) = middle;
  }
  waits_until_ = after;
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::speed_wanted(const Command& c) {
  const std::size_t k = index_of(c);
  return in_units(k, in_motion(k) ? bench_->motion_limits(kStageAxes[k]).speed_deg_per_s : 0.0);
}

/// "1000, 50": after how many ms at rest to how many per cent.
std::optional<std::string> NewportEspFirmware::Controller::torque_reduction(const Command& c) {
  auto& kept = axis(c).kept;
  if (c.asks()) return fmt::format("{:.0f},{:.0f}", kept["QR"], 100.0 - kept["QR%"]);
  const auto parts = pieces::split(c.parameter, ',');
  if (parts.size() != 2) throw Refusal{kParameterMissing};
  const int time_ms = whole_number(pieces::trimmed(parts[0]), 0, 60000);
  const int per_cent = whole_number(pieces::trimmed(parts[1]), 0, 100);
  kept["QR"] = time_ms;
  kept["QR%"] = 100.0 - per_cent;
  return std::nullopt;
}

/// One character: bits 0 to 3 axes 1 to 4 in motion, bit 4 motor power [unverified against a device].
std::optional<std::string> NewportEspFirmware::Controller::controller_status(const Command&) {
  unsigned bits = 0x40;
  for (std::size_t k = 0; k < 2; ++k) {
    if (numbers_[k] == 0) continue;
    if (in_motion(k) && numbers_[k] <= 4) bits |= 1U << (numbers_[k] - 1);
    if (axes_[k].motor_on) bits |= 0x10U;
  }
  return std::string(1, static_cast<char>(bits));
}

/// State after switching off and on: motors off, positions from 0, no errors. Programs stay.
std::optional<std::string> NewportEspFirmware::Controller::reset(const Command&) {
  for (std::size_t k = 0; k < 2; ++k)
    if (numbers_[k] != 0) stop(k, true);
  errors_.clear();
  waiting_lines_.clear();
  waits_until_.reset();
  power_on();
  return std::nullopt;
}

void NewportEspFirmware::Controller::power(bool on, Clock::Instant now) {
  now_ = now;
  update();
  session_starts();
  entered_program_.reset();
  if (!on) {
    for (std::size_t k = 0; k < 2; ++k)
      if (numbers_[k] != 0) stop(k, true);
  } else {
    reset({});
  }
}

int NewportEspFirmware::Controller::program_number(const Command& c) const {
  const int program = c.axis != 0 ? static_cast<int>(c.axis)
                                  : whole_number(pieces::split(c.parameter, ',').front(), 1, kPrograms);
  if (program > kPrograms) throw Refusal{kOutOfRange};
  return program;
}

std::optional<std::string> NewportEspFirmware::Controller::enter_program(const Command& c) {
  const int program = program_number(c);
  programs_[program].clear();
  entered_program_ = program;
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::quit_program(const Command&) {
  entered_program_.reset();
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::run_program(const Command& c) {
  const auto found = programs_.find(program_number(c));
  if (found == programs_.end()) throw Refusal{kNoProgram};
  for (const std::string& line : found->second) {
    std::string text = line;
    std::transform(text.begin(), text.end(), text.begin(), upper);
    // A program that runs programs might never end.
    if (text.find("EX") != std::string::npos) throw Refusal{kNotAllowed};
  }
  waiting_lines_.insert(waiting_lines_.begin(), found->second.begin(), found->second.end());
  if (!waits_until_) waits_until_ = now_;
  return std::nullopt;
}

std::optional<std::string> NewportEspFirmware::Controller::erase_program(const Command& c) {
  if (programs_.erase(program_number(c)) == 0) throw Refusal{kNoProgram};
  return std::nullopt;
}

NewportEspFirmware::NewportEspFirmware(std::shared_ptr<SimBench> bench, NewportEspSettings settings) {
  encase(std::make_unique<Controller>(std::move(bench), std::move(settings), unserved()));
}

}  // namespace abcal::sim
