#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/plan/effect_sizes.h"
#include "sim/bench_truth.h"

namespace abcal {

/// Requirement on the verdicts of a scenario.
enum class ScenarioKind {
  kWithin,  ///< Inside the stated sizes: most runs are to be usable, and their intervals hold.
  kBeyond,  ///< Not in the model, or larger than stated: where a run is called usable its intervals hold.
  kWrong,   ///< So far beyond the stated size that a run must not be called usable.
};

/// "within", "beyond", "wrong".
std::string_view to_string(ScenarioKind kind);

/// One simulated bench: its truth, and the statements of its bench file.
struct ScenarioBench {
  sim::BenchTruth truth;
  EffectSizes stated;
  int steps = 72;              ///< N
  int faces = 1;               ///< 1 or 2 (protocol/plan/faces.h).
  double noise = 1e-5;         ///< R, white noise of a mean.
  double stated_noise = 1e-5;  ///< R, stated with a mean; 0: none is stated.
  double scale = 1.0;          ///< Response units per g_loc of a near-unit item.
  double angle_period_s = 12.0;
};

/// Random numbers of one bench of one scenario: a function of seed, scenario and bench alone.
class ScenarioDraw {
 public:
  ScenarioDraw(std::uint64_t seed, std::uint64_t scenario, std::uint64_t bench);

  double normal();
  double uniform();  ///< 0 to 1.
  double sign() { return uniform() < 0.5 ? -1.0 : 1.0; }
  Eigen::Vector3d normals(double size) { return size * Eigen::Vector3d(normal(), normal(), normal()); }
  /// Three signs: an effect of one size in each output.
  Eigen::Vector3d signs(double size) { return size * Eigen::Vector3d(sign(), sign(), sign()); }
  std::uint64_t seed_for_the_world();

 private:
  std::uint64_t seed_, scenario_, bench_, next_ = 0;
  std::array<double, 4> block_{};
  std::size_t left_ = 0;
};

/// A way in which a bench differs from the one that the plainest model assumes.
struct Scenario {
  std::string name;   ///< "wobble-20"
  std::string words;  ///< "axes wobble by 20 urad once a turn"
  ScenarioKind kind = ScenarioKind::kWithin;
  std::function<void(ScenarioBench&, ScenarioDraw&)> change;  ///< Changes a sound bench.
};

/// All scenarios, in the order of the table.
const std::vector<Scenario>& robustness_scenarios();

/// A sound bench (alignment, turns, zeros and white step errors drawn from the default sizes; a near-unit
/// item, linear, with a slow linear drift of 2e-5), changed by the scenario.
/// The random numbers follow from the scenario's name, the seed and the bench's number.
ScenarioBench draw_bench(const Scenario& scenario, std::uint64_t seed, std::uint64_t bench);

}  // namespace abcal
