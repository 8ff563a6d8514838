#include "app/measure/session/mounting_series.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "app/bench_file/not_real.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/mountings.h"

namespace abcal {
namespace {

/// "u", "-v": the output that points along an axis of the platter.
std::string output_along(const Eigen::Matrix3d& directions, Eigen::Index axis) {
  Eigen::Index output = 0;
  directions.col(axis).cwiseAbs().maxCoeff(&output);
  return fmt::format("{}{}", directions(output, axis) < 0.0 ? "-" : "", "uvw"[output]);
}

}  // namespace

std::vector<SeriesMounting> mountings_of_series(const BenchConfig& config, int count) {
  if (config.has_several_items())
    throw std::invalid_argument(
        fmt::format("mountings: the bench has {} items; required: one", config.items.size()));
  const BenchItemConfig& item = config.items.front();
  const Eigen::Matrix3d first = mounting_matrix(item.expected.mounting).value();
  if (!mounting_words(first) || first.determinant() < 0.0)
    throw std::invalid_argument(
        fmt::format("[item] mounting is \"{}\"; required for the first mounting of a series: right-handed, "
                    "along the axes of the platter, as \"-y x z\"",
                    item.expected.mounting));
  const bool is_simulated = std::ranges::count(simulated_instruments(config), "accelerometer") > 0;
  std::vector<SeriesMounting> out;
  for (const Eigen::Matrix3d& turn : mounting_turns(count)) {
    SeriesMounting& one = out.emplace_back();
    one.words = turn_in_words(turn);
    one.mounting = mounting_words(first * turn.transpose()).value();
    one.is_simulated = is_simulated;
    one.bench = config;
    BenchItemConfig& mounted = one.bench.items.front();
    mounted.expected.mounting = one.mounting;
    if (!is_simulated) continue;
    mounted.simulation.sensitivity_matrix *= turn.transpose();
    for (ChangeConfig& change : one.bench.changes) change.truth.sensitivity_matrix *= turn.transpose();
    one.bench.simulation.run += out.size() - 1;
  }
  return out;
}

std::string mounting_drawing(const std::string& mounting) {
  const Eigen::Matrix3d directions = mounting_matrix(mounting).value();
  return fmt::format(
      "    z: {}   (up)\n"
      "    |   y: {}\n"
      "    |  /\n"
      "    | /\n"
      "    |/______ x: {}   (along the X axis)\n",
      output_along(directions, 2), output_along(directions, 1), output_along(directions, 0));
}

MountingJudgement judge_series_mounting(const std::vector<PoseReading>& poses, const MountingSearch& search,
                                        const std::string& required) {
  const LearnedMounting learned = learn_mounting(poses, search);
  if (learned.sign_z < 0)
    return {false,
            "gravity shows a mirror image: the outputs are left-handed, or Z counts the other way than "
            "[stage.z] sign says"};
  if (learned.mounting == required)
    return {true, fmt::format("gravity shows u, v, w along \"{}\", as required, within {:.1f} degrees",
                              required, learned.tilt.deg())};
  const Eigen::Matrix3d missing =
      mounting_matrix(required).value().transpose() * mounting_matrix(learned.mounting).value();
  return {false, fmt::format("gravity shows u, v, w along \"{}\"; required: \"{}\": it is still to be {}",
                             learned.mounting, required, turn_in_words(missing))};
}

}  // namespace abcal
