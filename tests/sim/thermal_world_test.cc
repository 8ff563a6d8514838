#include "sim/thermal_world.h"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>

namespace abcal::sim {
namespace {

constexpr double kAirLagS = 100.0, kItemLagS = 400.0;

struct World {
  Clock::Instant start{};
  ThermalWorld world{{.air_lag_s = kAirLagS, .item_lag_s = kItemLagS, .self_heating_degc = 3.0}, 23.0, start};
  Clock::Instant at(double t_s) const { return start + from_seconds(t_s); }
  void go(double degc, double t_s, std::optional<double> rate = std::nullopt) {
    world.command({.target_degc = degc, .rate_k_per_min = rate, .running = true}, at(t_s));
  }
};

TEST(ThermalWorldTest, AirAndItemFollowWithTheirLags) {
  World w;
  w.go(83.0, 0.0);
  EXPECT_NEAR(w.world.air(w.at(kAirLagS)), 83.0 - 60.0 * std::exp(-1.0), 1e-9);
  // Small steps of both equations.
  double air = 23.0, item = 26.0;
  constexpr double kStep = 0.01;
  for (int n = 0; n < 50'000; ++n) {
    const double air_before = air;
    air += kStep * (83.0 - air) / kAirLagS;
    item += kStep * (0.5 * (air + air_before) + 3.0 - item) / kItemLagS;
  }
  EXPECT_NEAR(w.world.item(w.at(500.0)), item, 2e-3);
  EXPECT_NEAR(w.world.item(w.at(20'000.0)), 86.0, 1e-6) << "warmer by its self-heating";
}

TEST(ThermalWorldTest, ARampMovesTheSetPointAndAPauseLetsTheAirGo) {
  World w;
  w.go(83.0, 0.0, 1.0);
  EXPECT_NEAR(w.world.set_point(w.at(1800.0)), 53.0, 1e-9);
  EXPECT_NEAR(w.world.air(w.at(1800.0)), 53.0 - kAirLagS / 60.0, 0.01) << "a ramp is followed a lag late";
  EXPECT_NEAR(w.world.air(w.at(10'000.0)), 83.0, 1e-6);
  w.world.command({.target_degc = 83.0, .rate_k_per_min = 1.0, .running = true, .paused = true},
                  w.at(10'000.0));
  EXPECT_NEAR(w.world.air(w.at(10'000.0 + 20.0 * kAirLagS)), 23.0 + 60.0 * std::exp(-1.0), 1e-3);
  EXPECT_THROW(w.go(0.0, 1.0), std::invalid_argument);
}

TEST(ThermalWorldTest, TheHysteresisRemembersWhereTheItemCameFrom) {
  World w;
  EXPECT_EQ(w.world.hysteresis(w.at(0.0)), 0.0);
  w.go(60.0, 0.0);
  EXPECT_NEAR(w.world.hysteresis(w.at(8000.0)), 1.0, 1e-6);
  w.go(23.0, 8000.0);
  EXPECT_NEAR(w.world.hysteresis(w.at(16'000.0)), -1.0, 1e-6);
  EXPECT_NEAR(w.world.hysteresis(w.at(8000.0)), 1.0, 1e-6) << "the past may be asked about";
}

TEST(ThermalWorldTest, DryAirIsDry) {
  World w;
  EXPECT_LT(w.world.humidity_percent(w.at(0.0)), 0.2);
  w.go(-40.0, 0.0);
  EXPECT_LT(w.world.humidity_percent(w.at(20'000.0)), 20.0);
}

}  // namespace
}  // namespace abcal::sim
