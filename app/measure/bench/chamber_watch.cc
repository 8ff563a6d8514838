#include "app/measure/bench/chamber_watch.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <utility>

#include "drivers/instrument/instrument_error.h"

namespace abcal {
namespace {

class WatchedStage final : public RotationStage {
 public:
  WatchedStage(std::unique_ptr<RotationStage> stage, ChamberWatch& watch)
      : stage_(std::move(stage)), watch_(watch) {}

  StageInfo identify() override { return stage_->identify(); }
  void home(StageAxis axis) override {
    watch_.poll();
    stage_->home(axis);
  }
  void move_to(StageAxis axis, Angle target) override {
    watch_.poll();
    stage_->move_to(axis, target);
  }
  void set_speed(StageAxis axis, std::optional<double> deg_per_s) override {
    stage_->set_speed(axis, deg_per_s);
  }
  MotionState motion_state(StageAxis axis) override {
    watch_.poll();
    return stage_->motion_state(axis);
  }
  Angle encoder_angle(StageAxis axis) override { return stage_->encoder_angle(axis); }
  bool halt() noexcept override { return stage_->halt(); }
  HaltReport halt_axes() noexcept override { return stage_->halt_axes(); }
  std::vector<HaltRecipe> halt_recipes() override { return stage_->halt_recipes(); }
  Clock::Duration reply_deadline() const override { return stage_->reply_deadline(); }
  std::vector<StageEvent> take_events() override { return stage_->take_events(); }

 private:
  std::unique_ptr<RotationStage> stage_;
  ChamberWatch& watch_;
};

class WatchedAccelerometer final : public Accelerometer {
 public:
  WatchedAccelerometer(std::unique_ptr<Accelerometer> accelerometer, ChamberWatch& watch)
      : accelerometer_(std::move(accelerometer)), watch_(watch) {}

  AccelerometerInfo identify() override { return accelerometer_->identify(); }
  std::map<std::string, std::string> correction_registers() override {
    return accelerometer_->correction_registers();
  }
  CorrectionRegisters* corrections() override { return accelerometer_->corrections(); }
  void start() override { accelerometer_->start(); }
  std::optional<Reading> next(Clock::Instant deadline) override {
    watch_.poll();
    return accelerometer_->next(deadline);
  }
  void discard_pending() override { accelerometer_->discard_pending(); }
  StreamHealth health() const override { return accelerometer_->health(); }
  void stop() noexcept override { accelerometer_->stop(); }

 private:
  std::unique_ptr<Accelerometer> accelerometer_;
  ChamberWatch& watch_;
};

}  // namespace

std::unique_ptr<RotationStage> watched_stage(std::unique_ptr<RotationStage> stage, ChamberWatch& watch) {
  return std::make_unique<WatchedStage>(std::move(stage), watch);
}

std::unique_ptr<Accelerometer> watched_accelerometer(std::unique_ptr<Accelerometer> accelerometer,
                                                     ChamberWatch& watch) {
  return std::make_unique<WatchedAccelerometer>(std::move(accelerometer), watch);
}

ChamberWatch::ChamberWatch(Replaceable<ThermalChamber>::Make make, Clock& clock, double poll_s)
    : chamber_("chamber", std::move(make)), clock_(clock), period_(from_seconds(poll_s)) {}

void ChamberWatch::give_up(const Message& detail, bool unreachable) {
  watching_ = false;
  unreachable_ = unreachable;
  trouble_ = detail;
  // Not kLinkLost, for which a run would wait until the port is back: the stage must stop now.
  throw InstrumentError("chamber " + info_.model, unreachable ? Fault::kNoReply : Fault::kNotReady, detail);
}

template <class Call>
auto ChamberWatch::reached(const Call& call) {
  try {
    return chamber_.guarded(call);
  } catch (const InstrumentError& error) {
    const bool gone = error.fault() == Fault::kNoReply || error.fault() == Fault::kLinkLost ||
                      error.fault() == Fault::kBadFrame || error.fault() == Fault::kCannotOpen;
    if (!gone) throw;
    give_up(Message("chamber unreachable, last set point {set_point}, it may be heating: {why}",
                    set_degc_ ? Message("{degc:g} degC", *set_degc_) : Message("not known"), error.detail()),
            true);
  }
}

ChamberInfo ChamberWatch::identify() {
  info_ = chamber_.guarded([](ThermalChamber& chamber) { return chamber.identify(); });
  trouble_.clear();
  unreachable_ = false;
  watching_ = true;
  looked_ = clock_.now() - period_;
  return info_;
}

void ChamberWatch::set_temperature(double degc, std::optional<double> rate_k_per_min) {
  // Noted before it is sent: a chamber that does not answer may have accepted it.
  set_degc_ = degc;
  const auto rate = info_.can_ramp ? rate_k_per_min : std::nullopt;
  reached([&](ThermalChamber& chamber) {
    chamber.set_temperature(degc, rate);
    chamber.run();
  });
}

void ChamberWatch::apply(ChamberPolicy policy, bool warm_enough) {
  end_pause();
  if (policy == ChamberPolicy::kHold) return;
  if (policy == ChamberPolicy::kOff && warm_enough) {
    reached([](ThermalChamber& chamber) { chamber.stop(); });
    return;
  }
  set_temperature(kAmbientDegc, std::nullopt);
}

ChamberReading ChamberWatch::read() {
  last_ = reached([](ThermalChamber& chamber) { return chamber.read(); });
  looked_ = clock_.now();
  return *last_;
}

bool ChamberWatch::end_pause() noexcept {
  wanted_pause_ = false;
  if (!paused_) return true;
  try {
    chamber_.guarded([](ThermalChamber& chamber) { return chamber.pause(false); });
    paused_ = false;
  } catch (...) {
    return false;
  }
  return true;
}

void ChamberWatch::poll() {
  if (!watching_) return;
  if (wanted_pause_ != paused_) {
    reached([&](ThermalChamber& chamber) { return chamber.pause(wanted_pause_); });
    paused_ = wanted_pause_;
  }
  if (clock_.now() - looked_ < period_) return;
  ChamberReading now;
  try {
    now = read();
  } catch (const InstrumentError& error) {
    if (unreachable_) throw;
    give_up(error.detail(), false);
  }
  if (now.door_open) give_up(Message("its door is open; close it before the series goes on"), false);
  if (!now.alarms.empty())
    give_up(Message("alarm: {alarms}; find its cause at the chamber before the series goes on",
                    fmt::format("{}", fmt::join(now.alarms, "; "))),
            false);
}

void ChamberWatch::reconnect() {
  chamber_.replace();
  identify();
}

}  // namespace abcal
