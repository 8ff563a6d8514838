#include "app/studies/robustness/scenario.h"

#include <cmath>
#include <numbers>

#include "drivers/text/names.h"
#include "protocol/uncertainty/normal_probability.h"
#include "sim/counter_noise.h"

namespace abcal {
namespace {

using Eigen::Vector3d;
using Change = std::function<void(ScenarioBench&, ScenarioDraw&)>;

/// Whole run, first to last angle, in seconds: the circles and their closing angles.
double run_time_s(const ScenarioBench& b) {
  return (3 * (b.steps + b.faces) - 1) * b.angle_period_s;
}

Change both(Change first, Change second) {
  return [first = std::move(first), second = std::move(second)](ScenarioBench& b, ScenarioDraw& draw) {
    first(b, draw);
    second(b, draw);
  };
}

/// Both axes tilt by `urad` at `order` cycles a turn: a tilt of constant size whose direction rotates.
Change round_wobble(int order, double urad) {
  return [=](ScenarioBench& b, ScenarioDraw& draw) {
    for (sim::AxisTruth* axis : {&b.truth.x, &b.truth.z}) {
      const double phase = 2.0 * std::numbers::pi * draw.uniform();
      const double turning = draw.sign();
      axis->wobble.push_back({order, urad * std::cos(phase), -urad * std::sin(phase),
                              turning * urad * std::sin(phase), turning * urad * std::cos(phase)});
    }
  };
}

/// The tilt oscillates in one direction: bent ways, not a bent axle.
Change flat_wobble(int order, double urad) {
  return [=](ScenarioBench& b, ScenarioDraw& draw) {
    for (sim::AxisTruth* axis : {&b.truth.x, &b.truth.z}) {
      const double phase = 2.0 * std::numbers::pi * draw.uniform();
      const double direction = 2.0 * std::numbers::pi * draw.uniform();
      axis->wobble.push_back(
          {order, urad * std::cos(phase) * std::cos(direction), urad * std::sin(phase) * std::cos(direction),
           urad * std::cos(phase) * std::sin(direction), urad * std::sin(phase) * std::sin(direction)});
    }
  };
}

Change drawn_wobble(double urad) {
  return [=](ScenarioBench& b, ScenarioDraw&) {
    b.truth.x.wobble_sd_urad = urad;
    b.truth.z.wobble_sd_urad = urad;
  };
}

/// A smooth step error of one order, of random phase.
Change smooth_error(int order, double deg) {
  return [=](ScenarioBench& b, ScenarioDraw& draw) {
    for (sim::AxisTruth* axis : {&b.truth.x, &b.truth.z}) {
      const double phase = 2.0 * std::numbers::pi * draw.uniform();
      axis->harmonics.push_back(
          {order, Angle::degrees(deg * std::sin(phase)), Angle::degrees(deg * std::cos(phase))});
    }
  };
}

Change drawn_smooth(double deg) {
  return [=](ScenarioBench& b, ScenarioDraw&) {
    b.truth.x.smooth_error_sd = Angle::degrees(deg);
    b.truth.z.smooth_error_sd = Angle::degrees(deg);
  };
}

Change white_steps(double deg) {
  return [=](ScenarioBench& b, ScenarioDraw&) {
    b.truth.x.step_error_sd = Angle::degrees(deg);
    b.truth.z.step_error_sd = Angle::degrees(deg);
  };
}

/// One vector of the item's truth gets `size` of random sign in each output, times the scale.
Change item(Vector3d sim::OutputTruth::*what, double size, bool in_response_units) {
  return [=](ScenarioBench& b, ScenarioDraw& draw) {
    (static_cast<sim::OutputTruth&>(b.truth).*what) = draw.signs(size * (in_response_units ? b.scale : 1.0));
  };
}

Change cross_terms(double size) {
  return [=](ScenarioBench& b, ScenarioDraw& draw) {
    for (auto* cross :
         {&b.truth.cross_ab, &b.truth.cross_ac, &b.truth.cross_bc, &b.truth.cross_bb, &b.truth.cross_cc})
      *cross = draw.normals(size);
  };
}

/// A sine whose period is the run divided by `cycles`, of random phase.
Change sine_drift(double size, double cycles) {
  return [=](ScenarioBench& b, ScenarioDraw& draw) {
    b.truth.sinusoidal_drift = draw.signs(size * b.scale);
    b.truth.sinusoidal_drift_period_s = run_time_s(b) / cycles;
    b.truth.sinusoidal_drift_phase = Angle::degrees(360.0 * draw.uniform());
  };
}

Change exponential_drift(double size) {
  return [=](ScenarioBench& b, ScenarioDraw& draw) {
    b.truth.exponential_drift = draw.signs(size * b.scale);
    b.truth.exponential_drift_s = run_time_s(b) / 6.0;
  };
}

Change gain_step(double size) {
  return [=](ScenarioBench& b, ScenarioDraw& draw) {
    b.truth.gain_step = draw.signs(size);
    b.truth.gain_step_at_s = 0.85 * run_time_s(b);  // late in experiment 3
  };
}

/// Noise that remembers its last value by `correlation` at the next angle, in place of white noise.
Change autoregressive(double correlation) {
  return [=](ScenarioBench& b, ScenarioDraw&) {
    b.truth.correlated_noise = b.noise;
    b.truth.correlated_noise_s = -b.angle_period_s / std::log(correlation);
    b.noise = 0.0;
  };
}

Change plain(const std::function<void(ScenarioBench&)>& what) {
  return [=](ScenarioBench& b, ScenarioDraw&) { what(b); };
}

/// The load bends the platform: a turn by (direction of up) x sag in its own coordinates, whose elements are
/// `urad` with random signs.
Change sag(double urad) {
  return [=](ScenarioBench& b, ScenarioDraw& draw) { b.truth.sag_urad = draw.signs(urad); };
}

/// The floor tilts by `urad` over the run, about a random horizontal direction.
Change floor_tilt(double urad) {
  return [=](ScenarioBench& b, ScenarioDraw& draw) {
    const double direction = 2.0 * std::numbers::pi * draw.uniform();
    b.truth.floor_tilt_x_urad = urad * std::cos(direction);
    b.truth.floor_tilt_y_urad = urad * std::sin(direction);
  };
}

/// Every effect of the table drawn from `share` of its stated size; k2 and k3, whose statement is wide on
/// purpose, from 1e-3.
Change everything(double share) {
  return [=](ScenarioBench& b, ScenarioDraw& draw) {
    const EffectSizes sizes = b.stated;
    const double one = share * b.scale;
    for (sim::AxisTruth* axis : {&b.truth.x, &b.truth.z}) {
      axis->wobble_sd_urad = share * sizes.wobble_urad;
      axis->smooth_error_sd = sizes.step_smooth * share;
    }
    b.truth.drift_1 = draw.normals(one * sizes.drift);
    b.truth.drift_2 = draw.normals(one * sizes.drift);
    b.truth.drift_3 = draw.normals(one * sizes.drift);
    b.truth.sensitivity_drift = draw.normals(share * sizes.sensitivity_drift);
    b.truth.hysteresis = draw.normals(one * sizes.hysteresis);
    b.truth.k2 = draw.normals(1e-3 * share / b.scale);
    b.truth.k3 = draw.normals(1e-3 * share / (b.scale * b.scale));
    b.truth.k4 = draw.normals(share * sizes.nonlinearity / std::pow(b.scale, 3));
    b.truth.k5 = draw.normals(share * sizes.nonlinearity / std::pow(b.scale, 4));
    b.truth.asymmetry = draw.normals(share * sizes.nonlinearity);
    cross_terms(share * sizes.nonlinearity)(b, draw);
  };
}

void add_stage_scenarios(std::vector<Scenario>& list) {
  using enum ScenarioKind;
  list.push_back({"wobble-5", "axes wobble by 5 urad, 1/rev, going round", kWithin, round_wobble(1, 5.0)});
  list.push_back({"wobble-20", "axes wobble by 20 urad, 1/rev, going round", kWithin, round_wobble(1, 20.0)});
  list.push_back({"wobble-50", "axes wobble by 50 urad, 1/rev, going round", kWithin, round_wobble(1, 50.0)});
  list.push_back(
      {"wobble-flat-2", "axes nod by 50 urad, 2/rev, in one direction", kWithin, flat_wobble(2, 50.0)});
  list.push_back({"wobble-drawn", "each coefficient of the wobble to 3/rev drawn from 50 urad", kWithin,
                  drawn_wobble(50.0)});
  list.push_back({"wobble-4", "axes wobble by 20 urad, 4/rev: beyond the model's orders", kBeyond,
                  round_wobble(4, 20.0)});
  list.push_back({"smooth-1", "smooth step error of 0.005 degrees, 1/rev", kWithin, smooth_error(1, 0.005)});
  list.push_back({"smooth-2", "smooth step error of 0.005 degrees, 2/rev", kWithin, smooth_error(2, 0.005)});
  list.push_back({"smooth-4", "smooth step error of 0.005 degrees, 4/rev", kWithin, smooth_error(4, 0.005)});
  list.push_back({"smooth-8", "smooth step error of 0.005 degrees, 8/rev: beyond the model's orders", kBeyond,
                  smooth_error(8, 0.005)});
  list.push_back({"smooth-drawn",
                  "each coefficient of the smooth step errors to 6/rev drawn from 0.004 degrees", kWithin,
                  drawn_smooth(0.004)});
  list.push_back({"smooth-only", "smooth step errors without white ones", kWithin,
                  both(drawn_smooth(0.004), white_steps(0.0))});
  list.push_back({"steps-double", "white step errors twice as large as stated", kBeyond, white_steps(0.016)});
  list.push_back(
      {"sag-20", "a load above the platform bends it by 20 urad", kWithin, plain([](ScenarioBench& b) {
         b.truth.sag_urad = {0.0, 0.0, 20.0};
       })});
  list.push_back({"sag-off-axis", "an off-centre load bends the platform by 20 urad", kBeyond,
                  plain([](ScenarioBench& b) {
                    b.truth.sag_urad = {20.0, 10.0, 20.0};
                  })});
  list.push_back({"sag-50", "an off-centre load bends the platform by 50 urad about each of its directions",
                  kBeyond, sag(50.0)});
  list.push_back({"floor-tilt", "the floor tilts by 20 urad during the run", kBeyond, floor_tilt(20.0)});
  list.push_back({"floor-tilt-50", "the floor tilts by 50 urad during the run", kBeyond, floor_tilt(50.0)});
  list.push_back({"floor-tilt-quiet", "the floor tilts by 50 urad during a run with a third of the noise",
                  kBeyond, both(floor_tilt(50.0), plain([](ScenarioBench& b) {
                                  b.noise /= 3.0;
                                  b.stated_noise /= 3.0;
                                }))});
  list.push_back({"mount-creep", "the mount creeps by 20 urad, mostly in the first third of the run", kBeyond,
                  [](ScenarioBench& b, ScenarioDraw& draw) {
                    b.truth.mount_creep_urad = draw.signs(20.0 / std::sqrt(3.0));
                    b.truth.mount_creep_s = run_time_s(b) / 6.0;
                  }});
}

void add_drift_scenarios(std::vector<Scenario>& list) {
  using enum ScenarioKind;
  using Truth = sim::OutputTruth;
  list.push_back({"drift-2", "quadratic drift of 3e-5", kWithin, item(&Truth::drift_2, 3e-5, true)});
  list.push_back({"drift-3", "cubic drift of 3e-5", kWithin, item(&Truth::drift_3, 3e-5, true)});
  list.push_back(
      {"drift-sine", "sinusoidal drift of 1e-5, 1.3 cycles a run", kWithin, sine_drift(1e-5, 1.3)});
  list.push_back({"drift-sine-fast", "sinusoidal drift of 1e-5, 6 cycles a run: beyond the polynomials",
                  kBeyond, sine_drift(1e-5, 6.0)});
  list.push_back({"drift-sine-3", "sinusoidal drift of 1e-5, 3 cycles a run, not stated", kBeyond,
                  sine_drift(1e-5, 3.0)});
  list.push_back({"drift-sine-stated",
                  "sinusoidal drift of 3e-5, 2 to 6 cycles a run, cyclic_drift stated as its rms", kWithin,
                  [](ScenarioBench& b, ScenarioDraw& draw) {
                    constexpr double kSize = 3e-5;
                    b.stated.cyclic_drift = kSize / std::numbers::sqrt2;
                    sine_drift(kSize, 2.0 + 4.0 * draw.uniform())(b, draw);
                  }});
  list.push_back({"drift-exponential", "exponential drift of 5e-5 that ends in the first third", kWithin,
                  exponential_drift(5e-5)});
  list.push_back({"sensitivity-drift", "the sensitivity drifts by 3e-5", kWithin,
                  item(&Truth::sensitivity_drift, 3e-5, false)});
  list.push_back(
      {"gain-step-small", "the gain changes by 2e-5 late in experiment 3", kBeyond, gain_step(2e-5)});
  list.push_back({"random-walk", "random walk of 2e-5 over the run", kWithin,
                  plain([](ScenarioBench& b) { b.truth.random_walk = 2e-5 * b.scale; })});
  list.push_back({"random-walk-large", "random walk of 1e-4 over the run", kBeyond,
                  plain([](ScenarioBench& b) { b.truth.random_walk = 1e-4 * b.scale; })});
  list.push_back({"flicker", "flicker noise of 1e-5", kWithin,
                  plain([](ScenarioBench& b) { b.truth.flicker_noise = 1e-5 * b.scale; })});
  list.push_back({"ar1-0.9", "noise correlated from angle to angle, 0.9, in place of white noise", kWithin,
                  autoregressive(0.9)});
  list.push_back({"ar1-0.5", "noise correlated from angle to angle, 0.5, in place of white noise", kWithin,
                  autoregressive(0.5)});
  list.push_back({"noise-double", "white noise twice as large as stated", kBeyond,
                  plain([](ScenarioBench& b) { b.noise *= 2.0; })});
  list.push_back({"noise-half", "white noise half as large as stated", kWithin,
                  plain([](ScenarioBench& b) { b.noise *= 0.5; })});
}

void add_item_scenarios(std::vector<Scenario>& list) {
  using enum ScenarioKind;
  using Truth = sim::OutputTruth;
  list.push_back({"k2-k3", "k2 and k3 of 1e-3", kWithin,
                  both(item(&Truth::k2, 1e-3, false), item(&Truth::k3, 1e-3, false))});
  list.push_back({"k2-k3-large", "k2 and k3 of 5e-3", kWithin,
                  both(item(&Truth::k2, 5e-3, false), item(&Truth::k3, 5e-3, false))});
  list.push_back({"k4", "fourth order of 1e-4", kWithin, item(&Truth::k4, 1e-4, false)});
  list.push_back({"k5", "fifth order of 1e-4", kWithin, item(&Truth::k5, 1e-4, false)});
  list.push_back(
      {"asymmetry", "scale for + and - differs: |a| of 1e-4", kWithin, item(&Truth::asymmetry, 1e-4, false)});
  list.push_back({"cross-ab", "cross term a_u a_v of 1e-5", kWithin, item(&Truth::cross_ab, 1e-5, false)});
  list.push_back({"cross-all", "every cross term drawn from 1e-4", kWithin, cross_terms(1e-4)});
  list.push_back({"hysteresis", "hysteresis of 1e-5", kWithin, item(&Truth::hysteresis, 1e-5, true)});
  list.push_back({"hysteresis-3", "hysteresis of 3e-5", kBeyond, item(&Truth::hysteresis, 3e-5, true)});
  list.push_back({"tilted-item", "axes far from square (0.3) with k3 of 2e-3", kWithin,
                  [](ScenarioBench& b, ScenarioDraw& draw) {
                    for (int j = 0; j < 3; ++j) {
                      for (int k = 0; k < 3; ++k)
                        b.truth.sensitivity_matrix(j, k) += j == k ? 0.0 : 0.3 * draw.sign();
                    }
                    b.truth.k3 = draw.signs(2e-3);
                  }});
}

void add_whole_scenarios(std::vector<Scenario>& list) {
  using enum ScenarioKind;
  list.push_back(
      {"everything-half", "every effect drawn from half its default size", kWithin, everything(0.5)});
  list.push_back({"everything", "every effect drawn from its default size", kWithin, everything(1.0)});
  list.push_back({"everything-24", "the same, 3 x 24 angles", kWithin,
                  both(plain([](ScenarioBench& b) { b.steps = 24; }), everything(1.0))});
  list.push_back(
      {"stated-published", "only the published model's effects, with three orders of drift, stated and drawn",
       kWithin,
       both(plain([](ScenarioBench& b) { b.stated = without_further_effects(b.stated); }), everything(1.0))});
  list.push_back({"stated-wobble-20",
                  "wobble of 20 urad, smooth steps and drifts stated and drawn, no non-linearity beyond k3",
                  kWithin,
                  both(plain([](ScenarioBench& b) {
                         b.stated.wobble_urad = 20.0;
                         b.stated.nonlinearity = b.stated.hysteresis = 0.0;
                       }),
                       everything(1.0))});
  list.push_back(
      {"sound-24", "a sound bench, 3 x 24 angles", kWithin, plain([](ScenarioBench& b) { b.steps = 24; })});
  list.push_back(
      {"sound-12", "a sound bench, 3 x 12 angles", kWithin, plain([](ScenarioBench& b) { b.steps = 12; })});
  list.push_back({"counts", "a sound bench whose output is in counts, 4096 for 1 g", kWithin,
                  plain([](ScenarioBench& b) {
                    b.scale = 4096.0;
                    b.truth.sensitivity_matrix *= b.scale;
                    b.truth.offset *= b.scale;
                    b.truth.drift_1 *= b.scale;
                    b.noise *= b.scale;
                    b.stated_noise *= b.scale;
                  })});
  list.push_back({"no-uncertainty", "a sound bench whose means state no uncertainty", kWithin,
                  plain([](ScenarioBench& b) { b.stated_noise = 0.0; })});
}

void add_wrong_scenarios(std::vector<Scenario>& list) {
  using enum ScenarioKind;
  using Truth = sim::OutputTruth;
  const EffectSizes sizes;
  list.push_back(
      {"wobble-x5", "wobble five times as large as stated", kWrong, drawn_wobble(5.0 * sizes.wobble_urad)});
  list.push_back({"smooth-x5", "smooth step errors five times as large as stated", kWrong,
                  drawn_smooth(5.0 * sizes.step_smooth.deg())});
  list.push_back({"cross-x5", "cross terms five times as large as stated", kWrong,
                  cross_terms(5.0 * sizes.nonlinearity)});
  list.push_back({"drift-2-x10", "quadratic drift ten times as large as stated", kWrong,
                  item(&Truth::drift_2, 10.0 * sizes.drift, true)});
  list.push_back({"sensitivity-drift-x10", "drift of the sensitivity ten times as large as stated", kWrong,
                  item(&Truth::sensitivity_drift, 10.0 * sizes.sensitivity_drift, false)});
  list.push_back({"k4-x10", "fourth order ten times as large as stated", kWrong,
                  item(&Truth::k4, 10.0 * sizes.nonlinearity, false)});
  list.push_back({"k5-x10", "fifth order ten times as large as stated", kWrong,
                  item(&Truth::k5, 10.0 * sizes.nonlinearity, false)});
  list.push_back({"asymmetry-x10", "|a| ten times as large as stated", kWrong,
                  item(&Truth::asymmetry, 10.0 * sizes.nonlinearity, false)});
  list.push_back({"hysteresis-x10", "hysteresis ten times as large as stated", kWrong,
                  item(&Truth::hysteresis, 10.0 * sizes.hysteresis, true)});
  list.push_back({"steps-quarter", "step errors stated four times too small, smooth ones present", kWrong,
                  [](ScenarioBench& b, ScenarioDraw&) {
                    b.stated.step = Angle::degrees(0.002);
                    b.stated.step_smooth = Angle::degrees(0.001);
                    b.stated.sources = {{"step_deg", "stated"}, {"step_smooth_deg", "stated"}};
                    b.truth.x.smooth_error_sd = b.truth.z.smooth_error_sd = Angle::degrees(0.004);
                  }});
  list.push_back({"alignment-x10", "alignment ten times as large as stated", kWrong,
                  [](ScenarioBench& b, ScenarioDraw& draw) {
                    b.stated.alignment = Angle::degrees(0.0008);
                    b.stated.sources = {{"alignment_deg", "stated"}};
                    const Eigen::Vector3d alignment = draw.signs(std::sin(Angle::degrees(0.008).rad()));
                    b.truth.zx = alignment.x();
                    b.truth.zy = alignment.y();
                    b.truth.xz = alignment.z();
                  }});
  list.push_back({"alignment-tenth", "alignment stated ten times too small", kWrong,
                  [](ScenarioBench& b, ScenarioDraw&) {
                    b.stated.alignment = Angle::degrees(0.0008);
                    b.stated.sources = {{"alignment_deg", "stated"}};
                  }});
  list.push_back({"gain-step", "the gain changes by 0.2 % late in experiment 3", kWrong, gain_step(2e-3)});
  list.push_back({"warm-up", "the offsets move by 1e-2 in the first tenth of the run", kWrong,
                  [](ScenarioBench& b, ScenarioDraw& draw) {
                    b.truth.exponential_drift = draw.signs(1e-2 * b.scale);
                    b.truth.exponential_drift_s = run_time_s(b) / 30.0;
                  }});
}

/// A number for a name (FNV-1a), so that a scenario keeps its benches when others are added.
std::uint64_t key_of(std::string_view name) {
  std::uint64_t key = 14695981039346656037ULL;
  for (const char c : name) key = (key ^ static_cast<unsigned char>(c)) * 1099511628211ULL;
  return key;
}

/// A sound bench: only the effects of the simplest model.
ScenarioBench sound_bench(ScenarioDraw& draw) {
  ScenarioBench b;
  const EffectSizes sizes;
  for (int j = 0; j < 3; ++j) {
    for (int k = 0; k < 3; ++k)
      b.truth.sensitivity_matrix(j, k) = (j == k ? 1.0 : 0.0) + 0.02 * draw.normal();
  }
  b.truth.offset = draw.normals(0.02);
  b.truth.drift_1 = draw.normals(2e-5);
  const double alignment = std::sin(sizes.alignment.rad());
  b.truth.zx = alignment * draw.normal();
  b.truth.zy = alignment * draw.normal();
  b.truth.xz = alignment * draw.normal();
  for (sim::AxisTruth* axis : {&b.truth.x, &b.truth.z}) {
    axis->initial_turn_error = sizes.initial_turn * draw.normal();
    axis->mean_step_error = sizes.zero * draw.normal();
    axis->step_error_sd = sizes.step;
  }
  return b;
}

constexpr auto kKinds = names<ScenarioKind>(
    {{ScenarioKind::kWithin, "within"}, {ScenarioKind::kBeyond, "beyond"}, {ScenarioKind::kWrong, "wrong"}});

}  // namespace

std::string_view to_string(ScenarioKind kind) {
  return kKinds.of(kind, "wrong");
}

ScenarioDraw::ScenarioDraw(std::uint64_t seed, std::uint64_t scenario, std::uint64_t bench)
    : seed_(seed), scenario_(scenario), bench_(bench) {}

double ScenarioDraw::normal() {
  if (left_ == 0) {
    block_ = sim::normal_numbers(seed_, sim::NoiseStream::kScenario, {scenario_, bench_, next_++, 0});
    left_ = block_.size();
  }
  return block_[--left_];
}

double ScenarioDraw::uniform() {
  return normal_below(-normal());
}

std::uint64_t ScenarioDraw::seed_for_the_world() {
  return static_cast<std::uint64_t>(uniform() * 0x1p52);
}

const std::vector<Scenario>& robustness_scenarios() {
  static const std::vector<Scenario> scenarios = [] {
    std::vector<Scenario> list;
    list.push_back({"sound", "a sound bench: the effects of the simplest model", ScenarioKind::kWithin,
                    [](ScenarioBench&, ScenarioDraw&) {}});
    add_stage_scenarios(list);
    add_drift_scenarios(list);
    add_item_scenarios(list);
    add_whole_scenarios(list);
    add_wrong_scenarios(list);
    return list;
  }();
  return scenarios;
}

ScenarioBench draw_bench(const Scenario& scenario, std::uint64_t seed, std::uint64_t bench) {
  ScenarioDraw draw(seed, key_of(scenario.name), bench);
  ScenarioBench b = sound_bench(draw);
  b.truth.seed = draw.seed_for_the_world();
  scenario.change(b, draw);
  b.truth.noise = b.noise;
  b.truth.stands_in_second_face = b.faces == 2;
  b.truth.span_s = run_time_s(b);
  return b;
}

}  // namespace abcal
