#pragma once

#include <optional>
#include <vector>

#include "drivers/instrument/clock.h"
#include "sim/bench_truth.h"

namespace abcal::sim {

/// A command to the chamber.
struct ChamberCommand {
  double target_degc = 23.0;
  std::optional<double> rate_k_per_min{};  ///< Ramp from the present air temperature; absent: at once.
  bool running = false;                    ///< False: the air goes to the temperature of the room.
  bool paused = false;                     ///< Neither heats nor cools: the same as not running.
};

/// Temperatures of the chamber's air and of the item in it: air follows the set point, the item follows the
/// air, each with a lag of first order; the item is warmer by its self-heating. Exact between commands; a
/// function of time and of the commands so far. Not thread-safe.
class ThermalWorld {
 public:
  /// @param room_degc  where air and item are at the start; the item already with its self-heating
  ThermalWorld(const ChamberTruth& truth, double room_degc, Clock::Instant start);

  /// In order of time.
  void command(const ChamberCommand& command, Clock::Instant t);
  /// Whether anything was ever commanded: without a chamber the room rules.
  bool in_use() const { return segments_.size() > 1; }
  const ChamberCommand& commanded() const { return segments_.back().command; }

  double set_point(Clock::Instant t) const;  ///< The one that moves during a ramp.
  double air(Clock::Instant t) const;
  double item(Clock::Instant t) const;
  double humidity_percent(Clock::Instant t) const;
  /// From -1 (after cooling) to 1 (after warming), with a transition over the width of the hysteresis.
  double hysteresis(Clock::Instant t) const;

 private:
  struct State {
    double air = 0.0, item = 0.0;
  };
  struct Segment {
    Clock::Instant start;
    ChamberCommand command;
    State state;          ///< At the start.
    double play = 0.0;    ///< Middle of the play of the hysteresis, at the start.
    double ramp_s = 0.0;  ///< Duration of the ramp of the set point, from state.air on.
  };
  const Segment& segment_at(Clock::Instant t) const;
  /// State of both lags for a set point p + q t, from `from` on.
  State after(const State& from, double p, double q, double seconds, double lag_s) const;
  State state_in(const Segment& segment, double seconds) const;
  double goal(const Segment& segment) const;
  double air_lag_s(const Segment& segment) const;
  double play_in(const Segment& segment, double seconds) const;
  double moved_play(double play, double item) const;

  ChamberTruth truth_;
  double room_degc_;
  std::vector<Segment> segments_;
  struct Memo {
    const Segment* segment = nullptr;
    long steps = 0;
    double play = 0.0;
  };
  mutable Memo memo_;
};

}  // namespace abcal::sim
