#include "protocol/run/experiment_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "protocol/run/dwell.h"
#include "protocol/run/plausibility.h"

namespace abcal {
namespace {

/// Longest sleep or wait for bytes between two looks at the stop token.
constexpr Clock::Duration kSlice = std::chrono::milliseconds(20);
/// An axis that the controller calls stopped may still creep into the window; after this it will not.
constexpr double kStoppedOutsideWindowS = 1.0;
/// Fewest readings from which it is concluded that the outputs do not follow the stage.
constexpr std::int64_t kStuckReadings = 8;
/// Between two looks at the temperature while the run waits for it.
constexpr Clock::Duration kTemperatureInterval = std::chrono::seconds(5);
/// Parts of the time for which outputs and temperature must be stable.
constexpr double kStabilityWindows = 10.0;
/// What may pass: the angle is measured again.
constexpr std::uint32_t kMayPass = kFlagNotQuiet | kFlagStuck | kFlagOutsideWindow;
constexpr std::size_t kStoredSpreads = 15;
/// A short window sees less than a whole swing of a slow ring-down: the dwell that it lets begin must stay
/// within spread_factor. Noise of the usual spread, and of twice that, still passes.
constexpr double kQuietPart = 0.75;
/// Between two attempts to open a port that vanished.
constexpr Clock::Duration kReconnectInterval = std::chrono::milliseconds(500);

std::string describe(const PlannedAngle& angle) {
  return fmt::format("experiment {}, alpha = {} deg", angle.experiment, angle.alpha.deg());
}

class Runner {
 public:
  Runner(const RunInstruments& instruments, const std::vector<PlannedAngle>& plan,
         const ProtocolConfig& protocol, const LimitsConfig& limits, RunTiming already_spent, RunFile& file,
         RunObserver& observer, const std::stop_token& stop)
      : stage_(instruments.stage),
        accelerometer_(instruments.accelerometer),
        clock_(instruments.clock),
        reconnector_(instruments.reconnector),
        plan_(plan),
        protocol_(protocol),
        limits_(limits),
        file_(file),
        observer_(observer),
        stop_(stop),
        already_spent_(already_spent),
        timing_(already_spent) {}

  RunTiming run(const RunProgress& so_far) {
    started_ = clock_.now();
    measured_ = so_far.measured;
    last_ = so_far.last;
    throw_if_stopped();
    tolerances_ = so_far.tolerances;
    expected_ = so_far.expected;
    first_temperature_degc_ = so_far.first_temperature_degc;
    stage_info_ = stage_.identify();
    accelerometer_info_ = accelerometer_.identify();
    nominal_ = nominal_response(expected_, accelerometer_info_.output_unit, so_far.g_loc_mps2);
    bool anew = !measured_.empty();
    bool warm = false;
    while (true) {
      try {
        for (const StageAxis axis : kStageAxes) reference(axis, anew);
        accelerometer_.start();
        if (!std::exchange(warm, true)) {
          warm_up();
          wait_until_stable();
        }
        learn_the_noise();
        if (last_) measure_again(*last_);
        measure_the_rest();
        park();
        accelerometer_.stop();
        return timing();
      } catch (const InstrumentError& error) {
        if (error.fault() != Fault::kLinkLost || reconnector_ == nullptr || stop_.stop_requested()) throw;
        anew = wait_for_reconnection(error);
      }
    }
  }

  std::string where() const { return where_; }

 private:
  Clock::UtcTime utc() const { return clock_.utc_now(); }

  void throw_if_stopped() const {
    if (stop_.stop_requested()) throw RunInterrupted("stopped by the operator");
  }

  void wait_until(Clock::Instant instant) {
    for (Clock::Instant now = clock_.now(); now < instant; now = clock_.now()) {
      throw_if_stopped();
      clock_.sleep_until(std::min(instant, now + kSlice));
    }
    throw_if_stopped();
  }

  std::string stage_name() const { return "stage " + stage_info_.model; }
  std::string accelerometer_name() const { return "accelerometer " + accelerometer_info_.model; }

  /// @param anew Also where the controller still knows its reference: it may have been turned by hand since.
  void reference(StageAxis axis, bool anew) {
    if (stage_info_.axes[index(axis)].referenced && !anew) return;
    where_ = fmt::format("referencing axis {}", to_string(axis));
    observer_.phase(0, RunPhase::kHoming);
    const Clock::Instant begin = clock_.now();
    stage_.home(axis);
    const Clock::Instant deadline = clock_.now() + from_seconds(protocol_.homing_timeout_s);
    while (stage_.motion_state(axis) == MotionState::kMoving) {
      if (clock_.now() > deadline) {
        throw InstrumentError(
            stage_name(), Fault::kStalled,
            fmt::format("axis {} still searches its reference after {} s (homing_timeout_s)", to_string(axis),
                        protocol_.homing_timeout_s));
      }
      wait_until(clock_.now() + from_seconds(protocol_.poll_interval_s));
    }
    stage_info_ = stage_.identify();
    if (!stage_info_.axes[index(axis)].referenced) {
      throw InstrumentError(stage_name(), Fault::kNotReady,
                            fmt::format("axis {} stopped without finding its reference", to_string(axis)));
    }
    timing_.moving_s += to_seconds(clock_.now() - begin);
  }

  void measure_the_rest() {
    for (std::size_t position = 0; position < plan_.size(); ++position) {
      if (measured_.contains(position)) continue;
      hold(position);
      Measured measured = measure(position);
      commit(position, measured);
    }
  }

  /// Waits until what was unplugged is back, and makes sure that it is the same.
  /// @return whether the stage must be referenced anew: it was the one, and may have lost its supply.
  bool wait_for_reconnection(const InstrumentError& lost) {
    if (++replugs_ > limits_.max_replugs) {
      throw InstrumentError(
          lost.instrument(), Fault::kLinkLost,
          fmt::format("{}; ports have vanished {} times in this run; required: at most {} ([limits] "
                      "max_replugs). Mend the cable, the plug or the hub before going on",
                      lost.detail(), replugs_, limits_.max_replugs));
    }
    bool stage_lost = reconnector_->stage_lost();
    const std::string who = stage_lost ? stage_name() : accelerometer_name();
    // What stands still stays still meanwhile, also where the accelerometer was lost while the stage moved.
    // Where a port of the stage is gone, the axis on the other one, if there is one, is halted.
    const HaltReport halted = stage_.halt_axes();
    note_stage_events();
    note("lost", fmt::format("the port of {} is gone: {} ({}); {}; waiting up to {} s for it to come back",
                             who, lost.detail(), where_,
                             halted.all_halted() ? std::string("the stage is halted") : in_words(halted),
                             protocol_.replug_timeout_s));
    observer_.phase(measured_.size(), RunPhase::kReconnecting);
    const Clock::Instant deadline = clock_.now() + from_seconds(protocol_.replug_timeout_s);
    while (true) {
      wait_until(clock_.now() + kReconnectInterval);
      stage_lost =
          stage_lost || reconnector_->stage_lost();  // Found out only now, on a hub that both are on.
      try {
        reconnector_->reconnect();
        recognise();
        break;
      } catch (const InstrumentError& error) {
        const bool may_come = error.fault() == Fault::kCannotOpen || error.fault() == Fault::kLinkLost ||
                              error.fault() == Fault::kNoReply;  // Its firmware may still be starting.
        if (!may_come || stop_.stop_requested()) throw;
        if (clock_.now() < deadline) continue;
        note("lost", fmt::format("the last attempt to open it again: {}", error.what()));
        throw InstrumentError(who, Fault::kLinkLost,
                              fmt::format("{}; it did not come back within {} s (replug_timeout_s)",
                                          lost.detail(), protocol_.replug_timeout_s));
      }
    }
    if (!stage_.halt()) {
      throw InstrumentError(stage_name(), Fault::kNoReply,
                            "it is back, but does not acknowledge the halt: stop it by its own switch");
    }
    at_ = {};
    note(kReconnectedEvent, fmt::format("{} is back; the run goes on{}", who,
                                        stage_lost ? " when the axes are referenced anew" : ""));
    return stage_lost;
  }

  /// The instruments on the ports that came back must be those that went.
  void recognise() {
    const auto require_same = [](const std::string& name, const std::string& before, const std::string& now) {
      if (before == now) return;
      throw InstrumentError(
          name, Fault::kWrongIdentity,
          fmt::format("\"{}\" came back; required: the one that was unplugged, \"{}\"", now, before));
    };
    const StageInfo stage = stage_.identify();
    require_same(stage_name(), stage_info_.model + " SN " + stage_info_.serial_number,
                 stage.model + " SN " + stage.serial_number);
    const AccelerometerInfo accelerometer = accelerometer_.identify();
    require_same(accelerometer_name(), accelerometer_info_.model + " SN " + accelerometer_info_.serial_number,
                 accelerometer.model + " SN " + accelerometer.serial_number);
    stage_info_ = stage;
  }

  /// Into the run file, and before the person.
  void note_stage_events() {
    for (const StageEvent& event : stage_.take_events()) note(event.kind, event.text);
  }

  void note(std::string_view kind, const std::string& text) {
    file_.append_event(format_utc(utc()), kind, text);
    observer_.notice(text);
  }

  void warm_up() {
    if (!(protocol_.warm_up_s > 0.0)) return;
    where_ = "warming up";
    observer_.phase(0, RunPhase::kWarmingUp);
    const Clock::Instant begin = clock_.now();
    wait_until(begin + from_seconds(protocol_.warm_up_s));
    timing_.settling_s += to_seconds(clock_.now() - begin);
  }

  /// Until outputs and temperature stand still for stability_s.
  void wait_until_stable() {
    if (!(protocol_.stability_s > 0.0)) return;
    where_ = "waiting for outputs and temperature to be stable";
    observer_.phase(0, RunPhase::kWarmingUp);
    const Clock::Instant begin = clock_.now();
    const double wanted = accelerometer_info_.rate_hz * protocol_.stability_s / kStabilityWindows;
    std::vector<StabilityWindow> windows;
    std::vector<Reading> readings;
    accelerometer_.discard_pending();
    do {
      if (to_seconds(clock_.now() - begin) > protocol_.stability_s + protocol_.stability_timeout_s) {
        throw InstrumentError(
            accelerometer_name(), Fault::kImplausible,
            fmt::format(
                "not stable for {} s within {} s (stability_s, stability_timeout_s); required: outputs "
                "within {:.2g} of their norm, temperature within {:.2g} degC ([limits] stability, "
                "stability_degc). Let it warm up, keep draughts away",
                protocol_.stability_s, protocol_.stability_timeout_s, stability_limit(limits_, tolerances_),
                stability_limit_degc(limits_, tolerances_)));
      }
      readings.clear();
      while (static_cast<double>(readings.size()) < std::max(wanted, 10.0)) {
        readings.push_back(next_reading());
      }
      const DwellStatistics window = dwell_statistics(readings, accelerometer_info_);
      windows.push_back(
          {to_seconds(clock_.now() - begin), window.mean, window.u_mean, window.temperature_degc});
    } while (!is_stable(windows, protocol_.stability_s, limits_, tolerances_));
    note("stable",
         fmt::format("outputs and temperature are stable after {:.0f} s", to_seconds(clock_.now() - begin)));
    timing_.settling_s += to_seconds(clock_.now() - begin);
  }

  std::size_t window_size() const {
    const int readings = readings_per_dwell(protocol_, accelerometer_info_.rate_hz);
    return static_cast<std::size_t>(std::clamp(readings / 4, 10, 50));
  }

  /// The spread of readings while the stage stands still: what later angles must come down to. Waits for a
  /// ring-down of the last motion to end: until the spread of five windows is no longer below that of the
  /// five before.
  void learn_the_noise() {
    where_ = "waiting for the accelerometer to be quiet before the first angle";
    const Clock::Instant begin = clock_.now();
    accelerometer_.discard_pending();
    const Clock::Instant last = begin + from_seconds(protocol_.settle_s + protocol_.quiet_timeout_s);
    constexpr std::size_t kGroup = 5;
    std::vector<Eigen::Vector3d> spreads;
    std::vector<Reading> window;
    while (true) {
      window.clear();
      while (window.size() < window_size()) window.push_back(next_reading());
      spreads.push_back(spread_of(window));
      if (spreads.size() < 2 * kGroup) continue;
      Eigen::Vector3d earlier = Eigen::Vector3d::Zero();
      Eigen::Vector3d later = Eigen::Vector3d::Zero();
      for (std::size_t k = 0; k < kGroup; ++k) {
        later += spreads[spreads.size() - 1 - k];
        earlier += spreads[spreads.size() - 1 - kGroup - k];
      }
      if ((later.array() >= 0.8 * earlier.array()).all() || clock_.now() >= last) {
        spreads_.push_back(later / static_cast<double>(kGroup));
        break;
      }
    }
    timing_.settling_s += to_seconds(clock_.now() - begin);
  }

  /// Waits between two angles while a person wants it.
  void hold(std::size_t position) {
    if (!observer_.hold_wanted()) return;
    where_ = "held before " + describe(plan_[position]);
    file_.append_event(format_utc(utc()), "held", where_);
    observer_.phase(position, RunPhase::kHolding);
    while (observer_.hold_wanted()) wait_until(clock_.now() + kSlice);
    file_.append_event(format_utc(utc()), "continued", describe(plan_[position]));
  }

  /// Moves one axis and waits until the controller says stopped and the encoder stays inside the window.
  /// @return when it was first found stopped there.
  Clock::Instant move_and_wait(StageAxis axis, Angle target, Angle window, int polls) {
    const std::size_t k = index(axis);
    const Angle from = stage_.encoder_angle(axis);
    const double speed = stage_info_.axes[k].speed_deg_per_s;
    const double expected_s = speed > 0.0 ? std::abs((target - from).deg()) / speed : 0.0;
    stage_.move_to(axis, target);
    // From here on: a person who turns the stage by hand takes as long as it takes.
    const Clock::Instant begin = clock_.now();
    const Clock::Instant deadline = begin + from_seconds(expected_s + protocol_.motion_timeout_s);
    int inside = 0;
    std::optional<Clock::Instant> stopped_inside;
    std::optional<Clock::Instant> stopped_outside;
    while (true) {
      const bool stopped = stage_.motion_state(axis) == MotionState::kStopped;
      const Clock::Instant now = clock_.now();
      if (!stopped) {
        inside = 0;
        stopped_inside.reset();
        stopped_outside.reset();
      } else {
        const Angle encoder = stage_.encoder_angle(axis);
        // Written so that an encoder that says "not a number" is outside.
        if (std::abs((encoder - target).deg()) <= window.deg()) {
          if (!stopped_inside) stopped_inside = now;
          stopped_outside.reset();
          if (++inside >= polls) break;
        } else {
          inside = 0;
          stopped_inside.reset();
          if (!stopped_outside) stopped_outside = now;
          if (to_seconds(now - *stopped_outside) > kStoppedOutsideWindowS) {
            throw InstrumentError(
                stage_name(), Fault::kStalled,
                fmt::format(
                    "axis {} stopped at {:.5f} deg, commanded {:.5f} deg; required: within {} deg "
                    "(position_window_deg). Check for a missed step, a limit switch or a cable that pulls",
                    to_string(axis), encoder.deg(), target.deg(), window.deg()));
          }
        }
      }
      if (now > deadline) {
        throw InstrumentError(
            stage_name(), Fault::kStalled,
            fmt::format(
                "axis {} is still moving {:.1f} s after the command to {:.5f} deg, encoder at {:.5f} deg "
                "(motion_timeout_s = {} beyond the {:.1f} s the move needs)",
                to_string(axis), to_seconds(now - begin), target.deg(), stage_.encoder_angle(axis).deg(),
                protocol_.motion_timeout_s, expected_s));
      }
      wait_until(now + from_seconds(protocol_.poll_interval_s));
    }
    return *stopped_inside;
  }

  /// Brings an axis to an angle, always from below: a worm drive has backlash.
  std::optional<Clock::Instant> bring(StageAxis axis, Angle target) {
    std::optional<Angle>& at = at_[index(axis)];
    if (at && *at == target) return std::nullopt;
    if (!at) at = stage_.encoder_angle(axis);
    if (protocol_.approach > Angle{} && target < *at + protocol_.position_window) {
      const Angle below = target - protocol_.approach;
      move_and_wait(axis, below, std::max(protocol_.position_window, protocol_.approach * 0.5), 1);
    }
    at.reset();  // Until it has arrived, nothing is known.
    const Clock::Instant stopped =
        move_and_wait(axis, target, protocol_.position_window, protocol_.window_polls);
    at = target;
    return stopped;
  }

  Reading next_reading() {
    const Clock::Instant begin = clock_.now();
    const Clock::Instant deadline = begin + from_seconds(protocol_.reading_timeout_s);
    while (true) {
      throw_if_stopped();
      const Clock::Instant now = clock_.now();
      if (auto reading = accelerometer_.next(std::min(deadline, now + kSlice))) return *std::move(reading);
      if (clock_.now() >= deadline) {
        throw InstrumentError(
            accelerometer_name(), Fault::kNoReply,
            fmt::format("no reading for {} s (reading_timeout_s); {} came before. Check its cable, "
                        "its supply and that no other program has stopped it",
                        protocol_.reading_timeout_s, accelerometer_.health().readings));
      }
    }
  }

  /// Waits out the settle time and then for the accelerometer to be quiet.
  /// @return false if it was not quiet at the longest wait.
  bool settle(Clock::Instant stopped) {
    const double rate = accelerometer_info_.rate_hz;
    const double window_s = rate > 0.0 ? static_cast<double>(window_size()) / rate : 0.0;
    const Clock::Instant settled = stopped + from_seconds(protocol_.settle_s);
    wait_until(settled - from_seconds(window_s));
    accelerometer_.discard_pending();
    std::vector<Reading> window;
    const Clock::Instant last = settled + from_seconds(protocol_.quiet_timeout_s);
    while (true) {
      window.clear();
      while (window.size() < window_size()) window.push_back(next_reading());
      wait_until(settled);
      if (is_quiet(window, usual_spread(), kQuietPart * limits_.spread_factor,
                   accelerometer_info_.resolution.value_or(0.0))) {
        return true;
      }
      if (clock_.now() >= last) return false;
    }
  }

  /// Median spread of the latest dwells; nothing before the first.
  std::optional<Eigen::Vector3d> usual_spread() const {
    if (spreads_.empty()) return std::nullopt;
    Eigen::Vector3d median;
    for (int j = 0; j < 3; ++j) {
      std::vector<double> values;
      for (const Eigen::Vector3d& spread : spreads_) values.push_back(spread[j]);
      const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
      std::nth_element(values.begin(), middle, values.end());
      median[j] = *middle;
    }
    return median;
  }

  struct Measured {
    DwellRecord dwell;
    std::vector<StoredReading> readings;
  };

  /// After an interruption: the last angle must read as it did.
  void measure_again(const RunProgress::LastAngle& last) {
    Measured measured = measure(last.position);
    const Eigen::Vector3d change = measured.dwell.mean - last.dwell.mean;
    const Eigen::Vector3d explained = explained_change(last.dwell, measured.dwell, tolerances_);
    for (int j = 0; j < 3; ++j) {
      if (std::abs(change[j]) <= explained[j]) continue;
      throw InstrumentError(
          accelerometer_name(), Fault::kImplausible,
          fmt::format(
              "output {} at {} reads {:.7g} now and read {:.7g} before the interruption, a change of {:.2g}; "
              "required: at most {:.2g}, which noise, drift and the stage's tolerances explain. The "
              "accelerometer has moved on the stage, or the stage's reference has: begin a new run",
              "uvw"[j], describe(plan_[last.position]), measured.dwell.mean[j], last.dwell.mean[j],
              std::abs(change[j]), explained[j]));
    }
    measured.dwell.flags |= kFlagRepeated;
    commit(last.position, measured);
  }

  /// Measures an angle; again where what went wrong may pass.
  Measured measure(std::size_t position) {
    std::uint32_t marks = kFlagNone;
    std::optional<Clock::Instant> patience;  // for the temperature
    for (int left = limits_.repeats;;) {
      Measured measured = measure_once(position);
      DwellRecord& dwell = measured.dwell;
      dwell.flags |= marks;
      if ((dwell.flags & kFlagTemperature) != 0U && limits_.temperature_wait_s > 0.0) {
        if (!patience) patience = clock_.now() + from_seconds(limits_.temperature_wait_s);
        wait_for_temperature(dwell.temperature_degc, *patience);
        marks |= kFlagHeld;
        continue;
      }
      if ((dwell.flags & kMayPass) == 0U) return measured;
      const bool left_window = (dwell.flags & kFlagOutsideWindow) != 0U;
      if (left-- == 0) {
        if (!left_window) return measured;
        throw InstrumentError(
            stage_name(), Fault::kStalled,
            fmt::format(
                "it does not stay at {}: X at {:.5f} deg, commanded {:.5f} deg; Z at {:.5f} deg, "
                "commanded {:.5f} deg; required: within {} deg (position_window_deg). Check for missed "
                "steps, a motor that is switched off or a cable that pulls",
                describe(plan_[position]), dwell.encoder_x->deg(), dwell.commanded_x.deg(),
                dwell.encoder_z->deg(), dwell.commanded_z.deg(), protocol_.position_window.deg()));
      }
      note("repeated",
           fmt::format("{}: {}; it is measured again", where_, describe_flags(dwell.flags & kMayPass)));
      if (left_window) at_ = {};
      marks |= kFlagRepeated;
    }
  }

  /// Stands still until the temperature is back inside its limits.
  void wait_for_temperature(std::optional<double> temperature_degc, Clock::Instant deadline) {
    const auto excess = [&] {
      return temperature_excess(temperature_degc, first_temperature_degc_, limits_, tolerances_);
    };
    const Clock::Instant begin = clock_.now();
    note("temperature", fmt::format("{}: {}; waiting for it to be back", where_, excess().value_or("")));
    observer_.phase(measured_.size(), RunPhase::kTemperature);
    while (const auto why = excess()) {
      if (clock_.now() >= deadline) {
        throw InstrumentError(accelerometer_name(), Fault::kImplausible,
                              fmt::format("{}; it did not come back within {} s (temperature_wait_s)", *why,
                                          limits_.temperature_wait_s));
      }
      wait_until(std::min(deadline, clock_.now() + kTemperatureInterval));
      accelerometer_.discard_pending();
      std::vector<Reading> window;
      while (window.size() < window_size()) window.push_back(next_reading());
      temperature_degc = dwell_statistics(window, accelerometer_info_).temperature_degc;
    }
    note("temperature",
         fmt::format("the temperature is back after {:.0f} s", to_seconds(clock_.now() - begin)));
    timing_.settling_s += to_seconds(clock_.now() - begin);
  }

  Measured measure_once(std::size_t position) {
    const PlannedAngle& angle = plan_[position];
    where_ = describe(angle);
    observer_.phase(position, RunPhase::kMoving);
    const Clock::Instant begin = clock_.now();
    const auto stopped_x = bring(StageAxis::kX, angle.x);
    const auto stopped_z = bring(StageAxis::kZ, angle.z);
    const Clock::Instant stopped = std::max(stopped_x.value_or(begin), stopped_z.value_or(begin));

    observer_.phase(position, RunPhase::kSettling);
    const bool quiet = settle(stopped);

    observer_.phase(position, RunPhase::kDwelling);
    accelerometer_.discard_pending();
    const bool inside_before =
        inside_window(angle, stage_.encoder_angle(StageAxis::kX), stage_.encoder_angle(StageAxis::kZ));
    const Clock::Instant dwell_begin = clock_.now();
    const auto wanted = static_cast<std::size_t>(readings_per_dwell(protocol_, accelerometer_info_.rate_hz));
    const std::uint64_t lost_before = accelerometer_.health().lost_readings;
    std::vector<Reading> readings;
    readings.reserve(wanted);
    while (readings.size() < wanted) readings.push_back(next_reading());
    const Clock::Instant dwell_end = clock_.now();
    timing_.moving_s += to_seconds(stopped - begin);
    timing_.settling_s += to_seconds(dwell_begin - stopped);
    timing_.dwelling_s += to_seconds(dwell_end - dwell_begin);

    DwellStatistics statistics = dwell_statistics(readings, accelerometer_info_);
    const auto lost_unseen = static_cast<std::int64_t>(accelerometer_.health().lost_readings - lost_before);
    statistics.lost = std::max(statistics.lost, lost_unseen);
    check(angle, statistics, readings.size());

    DwellRecord dwell;
    dwell.experiment = angle.experiment;
    dwell.n = angle.n;
    dwell.closing = angle.closing;
    dwell.alpha = angle.alpha;
    dwell.commanded_x = angle.x;
    dwell.commanded_z = angle.z;
    dwell.encoder_x = stage_.encoder_angle(StageAxis::kX);
    dwell.encoder_z = stage_.encoder_angle(StageAxis::kZ);
    dwell.time_s =
        already_spent_.total_s() + to_seconds((dwell_begin - started_) + (dwell_end - dwell_begin) / 2);
    dwell.settle_time_s = to_seconds(dwell_begin - stopped);
    dwell.count = statistics.count;
    dwell.lost = statistics.lost;
    dwell.mean = statistics.mean;
    dwell.spread = statistics.spread;
    dwell.u_mean = statistics.u_mean;
    dwell.temperature_degc = statistics.temperature_degc;
    dwell.flags = statistics.flags;
    if (statistics.lost > 0) dwell.flags |= kFlagLostReadings;
    const double resolution = accelerometer_info_.resolution.value_or(0.0);
    if (!quiet || is_shaken(statistics, usual_spread(), resolution, limits_)) dwell.flags |= kFlagNotQuiet;
    if (!inside_before || !inside_window(angle, *dwell.encoder_x, *dwell.encoder_z)) {
      dwell.flags |= kFlagOutsideWindow;
    }
    if (is_stuck(statistics, usual_spread(), resolution)) dwell.flags |= kFlagStuck;
    if (temperature_excess(dwell.temperature_degc, first_temperature_degc_, limits_, tolerances_)) {
      dwell.flags |= kFlagTemperature;
    }
    if (nominal_ && norm_is_wrong(dwell.mean, *nominal_, limits_)) dwell.flags |= kFlagNorm;

    std::vector<StoredReading> stored;
    stored.reserve(readings.size());
    for (const Reading& reading : readings) {
      stored.push_back({reading.sequence, already_spent_.total_s() + to_seconds(reading.arrival - started_),
                        reading.output, reading.temperature_degc});
    }
    return {std::move(dwell), std::move(stored)};
  }

  void commit(std::size_t position, Measured& measured) {
    DwellRecord& dwell = measured.dwell;
    if (!measured_.contains(position)) compare_with_gravity(position, dwell);
    file_.append_dwell(position, dwell, measured.readings, timing());
    if (dwell.flags != kFlagNone) {
      const std::string text = fmt::format("{}: {}", where_, describe_flags(dwell.flags));
      note("flag", text);
    }
    previous_mean_ = dwell.mean;
    if (!first_temperature_degc_) first_temperature_degc_ = dwell.temperature_degc;
    if (spreads_.size() == kStoredSpreads) spreads_.erase(spreads_.begin());
    spreads_.push_back(dwell.spread);
    if (!measured_.insert(position).second) return;  // A check of what is there already.
    observer_.dwell(position, dwell);
    if (can_be_compared_with(dwell)) last_ = {position, dwell};
  }

  bool inside_window(const PlannedAngle& angle, Angle encoder_x, Angle encoder_z) const {
    const double window = protocol_.position_window.deg();
    return std::abs((encoder_x - angle.x).deg()) <= window && std::abs((encoder_z - angle.z).deg()) <= window;
  }

  /// At the last angle of an experiment: what the circle says of unit and full scale.
  void compare_with_gravity(std::size_t position, DwellRecord& dwell) {
    if (!circle_.empty() && circle_.back().experiment != dwell.experiment) circle_.clear();
    circle_.push_back(dwell);
    const bool last =
        position + 1 == plan_.size() || plan_[position + 1].experiment != plan_[position].experiment;
    if (!last || !nominal_ || dwell.experiment == 0) return;
    if (const auto excess = full_scale_excess(circle_, *nominal_, expected_)) {
      dwell.flags |= kFlagNorm;
      note("full scale", *excess);
    }
  }

  /// Readings that cannot be true end the run; they are not averaged into a number that looks right.
  void check(const PlannedAngle& angle, const DwellStatistics& statistics, std::size_t taken) const {
    const auto total = static_cast<double>(taken);
    if (static_cast<double>(statistics.not_finite) > 0.5 * total) {
      throw InstrumentError(
          accelerometer_name(), Fault::kImplausible,
          fmt::format("{} of {} readings at {} are not finite numbers; check the instrument's "
                      "output settings and its health",
                      statistics.not_finite, taken, describe(angle)));
    }
    const double made = total + static_cast<double>(statistics.lost);
    if (static_cast<double>(statistics.lost) > limits_.max_lost_fraction * made) {
      throw InstrumentError(
          accelerometer_name(), Fault::kImplausible,
          fmt::format("{} of {} readings were lost at {}; required: at most {:.0f} % "
                      "([limits] max_lost_fraction). Check the cable, the baud rate and the load "
                      "of this computer",
                      statistics.lost, made, describe(angle), 100.0 * limits_.max_lost_fraction));
    }
    // Exactly the same three numbers at two poses: the output does not follow the stage.
    if (previous_mean_ && statistics.count >= kStuckReadings && statistics.spread.isZero(0.0) &&
        statistics.mean == *previous_mean_) {
      throw InstrumentError(
          accelerometer_name(), Fault::kImplausible,
          fmt::format("all {} readings at {} are ({}, {}, {}), the same as at the angle before: the "
                      "output is stuck",
                      taken, describe(angle), statistics.mean[0], statistics.mean[1], statistics.mean[2]));
    }
  }

  void park() {
    where_ = "parking the stage";
    observer_.phase(plan_.size(), RunPhase::kParking);
    const Clock::Instant begin = clock_.now();
    try {
      for (const StageAxis axis : kStageAxes) bring(axis, Angle{});
    } catch (const InstrumentError& error) {
      // All angles are measured: the run is complete even so, but the person must know.
      const bool acknowledged = stage_.halt();
      const std::string text =
          fmt::format("all angles are measured, but the stage could not be parked: {}{}", error.what(),
                      acknowledged ? "" : "; it did not acknowledge the halt");
      note("park failed", text);
    }
    timing_.moving_s += to_seconds(clock_.now() - begin);
  }

  /// The time spent so far; overhead is what no motion, settling or dwell accounts for.
  RunTiming timing() const {
    RunTiming timing = timing_;
    const double measured = timing.moving_s + timing.settling_s + timing.dwelling_s;
    const double all = already_spent_.total_s() + to_seconds(clock_.now() - started_);
    timing.overhead_s = std::max(0.0, all - measured);
    return timing;
  }

  RotationStage& stage_;
  Accelerometer& accelerometer_;
  Clock& clock_;
  Reconnector* reconnector_;
  const std::vector<PlannedAngle>& plan_;
  const ProtocolConfig& protocol_;
  const LimitsConfig& limits_;
  RunFile& file_;
  RunObserver& observer_;
  const std::stop_token& stop_;
  RunTiming already_spent_;
  RunTiming timing_;
  Clock::Instant started_;
  StageInfo stage_info_;
  AccelerometerInfo accelerometer_info_;
  std::array<std::optional<Angle>, 2> at_;  ///< Where each axis was brought last; nothing: not known.
  ExpectedItem expected_;
  std::optional<double> nominal_;  ///< R for one g_loc.
  std::optional<double> first_temperature_degc_;
  std::vector<DwellRecord> circle_;  ///< Of the experiment under way.
  std::optional<Eigen::Vector3d> previous_mean_;
  std::vector<Eigen::Vector3d> spreads_;
  std::set<std::size_t> measured_;
  std::optional<RunProgress::LastAngle> last_;
  Tolerances tolerances_;
  int replugs_ = 0;
  std::string where_ = "starting";
};

}  // namespace

bool can_be_compared_with(const DwellRecord& dwell) {
  return (dwell.flags & (kFlagStuck | kFlagClipped | kFlagNotFinite)) == 0U;
}

Eigen::Vector3d explained_change(const DwellRecord& before, const DwellRecord& after,
                                 const Tolerances& tolerances) {
  constexpr double kOneInAMillion = 4.9;  // standard uncertainties, two-sided
  const Eigen::Vector3d none = Eigen::Vector3d::Zero();
  const Eigen::Vector3d u_before = before.u_mean.value_or(none), u_after = after.u_mean.value_or(none);
  // The response to gravity is at most the norm of the outputs, offsets aside; turning by a small angle
  // changes it by that times the angle. The reference and the step are found anew each time: both differ
  // twice.
  const double response = std::max(before.mean.norm(), after.mean.norm());
  const double turned = std::hypot(tolerances.zero.rad(), tolerances.step.rad()) * std::numbers::sqrt2;
  const double stage = response * std::hypot(turned, tolerances.drift);
  return kOneInAMillion *
         (u_before.array().square() + u_after.array().square() + stage * stage).sqrt().matrix();
}

std::string_view to_string(RunPhase phase) {
  switch (phase) {
    case RunPhase::kHoming:
      return "referencing";
    case RunPhase::kWarmingUp:
      return "warming up";
    case RunPhase::kHolding:
      return "held";
    case RunPhase::kMoving:
      return "moving";
    case RunPhase::kSettling:
      return "settling";
    case RunPhase::kDwelling:
      return "reading";
    case RunPhase::kTemperature:
      return "waiting for the temperature";
    case RunPhase::kReconnecting:
      return "waiting for a port to come back";
    case RunPhase::kParking:
      return "parking";
  }
  return "";
}

RunTiming run_experiments(const RunInstruments& instruments, const std::vector<PlannedAngle>& plan,
                          const RunProgress& so_far, const ProtocolConfig& protocol,
                          const LimitsConfig& limits, RunFile& file, RunObserver& observer,
                          const std::stop_token& stop) {
  Runner runner(instruments, plan, protocol, limits, so_far.spent, file, observer, stop);
  std::string reason;
  std::optional<InstrumentError> instrument_error;
  bool by_operator = false;
  try {
    return runner.run(so_far);
  } catch (const RunInterrupted& error) {
    reason = error.what();
    by_operator = true;
  } catch (const InstrumentError& error) {
    // A halt from another thread makes the exchange under way fail: that is the operator's stop, not a fault.
    by_operator = stop.stop_requested();
    reason = by_operator ? "stopped by the operator" : error.what();
    instrument_error = error;
  } catch (const std::exception& error) {
    reason = error.what();
  }
  const HaltReport halted = instruments.stage.halt_axes();
  instruments.accelerometer.stop();
  const std::string where = runner.where();
  std::string text = fmt::format("{} ({})", reason, where);
  text += halted.all_halted() ? "; the stage is halted"
                              : fmt::format(
                                    "; the stage did not acknowledge the halt ({}): stop it by its own "
                                    "switch",
                                    in_words(halted));
  try {
    for (const StageEvent& event : instruments.stage.take_events())
      file.append_event(format_utc(instruments.clock.utc_now()), event.kind, event.text);
    file.set_state(RunState::kInterrupted, format_utc(instruments.clock.utc_now()), text);
  } catch (const RunFileError& error) {
    text += fmt::format("; the reason could not be stored ({})", error.what());
  }
  if (by_operator) throw RunInterrupted(text);
  if (instrument_error) {
    throw InstrumentError(instrument_error->instrument(), instrument_error->fault(),
                          instrument_error->detail() + text.substr(reason.size()));
  }
  throw RunFileError(text);
}

}  // namespace abcal
