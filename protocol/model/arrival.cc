#include "protocol/model/arrival.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "protocol/model/effects.h"

namespace abcal {
namespace {

/// Changes this many times their standard uncertainty beyond a limit stay beyond it in every further solution
/// or trial.
constexpr double kBeyondDoubt = 10.0;
constexpr double kTurn = 2.0 * std::numbers::pi;

AngleHarmonics harmonics(double angle) {
  return AngleHarmonics::of(std::sin(angle), std::cos(angle));
}

StagePose pose_on(const ReadingArrival& reading, const StageLeg& leg, double angle) {
  StagePose pose;
  pose.experiment = reading.experiment;
  pose.face = reading.face;
  (leg.about_x ? pose.x : pose.z) = harmonics(angle);
  (leg.about_x ? pose.z : pose.x) = harmonics(leg.other);
  return pose;
}

/// Probability that a normal variable of mean 0 and standard deviation 1 is below a value, and its density.
double below(double x) {
  return 0.5 * std::erfc(-x / std::numbers::sqrt2);
}
double density(double x) {
  return std::exp(-0.5 * x * x) / std::sqrt(kTurn);
}

/// Mean sign of a change with a standard uncertainty.
double mean_sign(double change, double u) {
  if (!(u > 0.0)) return static_cast<double>((change > 0.0) - (change < 0.0));
  return std::erf(change / (std::numbers::sqrt2 * u));
}

/// Mean sign of an output that had the mean sign `before`, after a change. Within the width it turns round
/// somewhere: so far it has done so by the share of the width that the change is.
double after_swing(double before, double change, double width, double u) {
  if (!(width > 0.0)) return mean_sign(change, u);
  const double mean = change / width, sd = u / width;
  if (!(sd > 0.0)) {
    const double turned = std::clamp(mean, -1.0, 1.0);
    return turned + (1.0 - std::abs(turned)) * before;
  }
  const double low = (-1.0 - mean) / sd, middle = -mean / sd, high = (1.0 - mean) / sd;
  const auto part = [&](double from, double to) {
    return mean * (below(to) - below(from)) + sd * (density(from) - density(to));
  };
  const double up = part(middle, high) + below(-high), down = -part(low, middle) + below(low);
  return up - down + (1.0 - up - down) * before;
}

/// Angles of the extrema of each output between the ends of a leg, in the order of the motion.
std::array<std::vector<double>, 3> extrema(const ReadingArrival& reading, const StageLeg& leg,
                                           const ArrivalSigns::Responses& responses) {
  // About a fixed axis each response is a sine, with a constant: three angles determine it.
  constexpr double kThird = kTurn / 3.0;
  Eigen::Vector3d cosine = Eigen::Vector3d::Zero(), sine = Eigen::Vector3d::Zero();
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d y = responses(pose_on(reading, leg, kThird * k));
    cosine += y * std::cos(kThird * k);
    sine += y * std::sin(kThird * k);
  }
  std::array<std::vector<double>, 3> out;
  const double low = std::min(leg.from, leg.to), high = std::max(leg.from, leg.to);
  for (Eigen::Index j = 0; j < 3; ++j) {
    std::vector<double>& angles = out.at(static_cast<std::size_t>(j));
    const double phase = std::atan2(sine(j), cosine(j));
    for (double k = std::ceil((low - phase) / std::numbers::pi); phase + k * std::numbers::pi < high; ++k)
      if (phase + k * std::numbers::pi > low) angles.push_back(phase + k * std::numbers::pi);
    if (leg.to < leg.from) std::ranges::reverse(angles);
  }
  return out;
}

}  // namespace

/// Follows one output along the way, from extremum to extremum.
class ArrivalSigns::Follower {
 public:
  void forget() {
    turns_.clear();
    direction_ = 0;
    known_ = false;
  }
  /// @param to  place of the pose
  void go(std::size_t to, double y) {
    if (turns_.empty()) {
      turns_.push_back(to);
      now_ = to;
      y_ = y;
      return;
    }
    const double change = y - y_;
    const int direction = (change > 0.0) - (change < 0.0);
    if (direction != 0) known_ = true;
    if (direction != 0 && direction_ != 0 && direction != direction_) {
      turns_.push_back(now_);
      // Earlier ones have no effect if those that follow are large, which is usually the case.
      constexpr std::size_t kKept = 8;
      if (turns_.size() > kKept) turns_.erase(turns_.begin());
    }
    if (direction != 0) direction_ = direction;
    now_ = to;
    y_ = y;
  }
  void arrive(Deciding& deciding) const {
    deciding.known = known_;
    for (std::size_t k = 0; k < turns_.size(); ++k)
      deciding.swings.push_back({turns_[k], k + 1 < turns_.size() ? turns_[k + 1] : now_, 0.0});
  }

 private:
  std::vector<std::size_t> turns_;  ///< Places of the start, and of the extrema since.
  std::size_t now_ = 0;
  double y_ = 0.0;
  int direction_ = 0;
  bool known_ = false;
};

/// The responses at the poses on the way, each computed once, when it is asked for.
class ArrivalSigns::AtPoses {
 public:
  AtPoses(const std::vector<StagePose>& poses, const Responses& responses)
      : poses_(poses), responses_(responses), known_(poses.size(), 0), values_(3 * poses.size()) {}
  double change(const Known& known, int output) { return at(known.to, output) - at(known.from, output); }

 private:
  double at(std::size_t pose, int output) {
    Eigen::Map<Eigen::Vector3d> value(&values_[3 * pose]);
    if (known_[pose] == 0) value = responses_(poses_[pose]);
    known_[pose] = 1;
    return value(output);
  }
  const std::vector<StagePose>& poses_;
  const Responses& responses_;
  std::vector<char> known_;
  std::vector<double> values_;
};

ArrivalSigns::ArrivalSigns(std::vector<ReadingArrival> readings, double width)
    : readings_(std::move(readings)), width_(width) {}

void ArrivalSigns::find(const Responses& responses) {
  deciding_.assign(readings_.size(), {});
  poses_.assign(1, {});
  const auto place_of = [&](const StagePose& pose) {
    poses_.push_back(pose);
    return poses_.size() - 1;
  };
  std::array<Follower, 3> followers;
  Known whole;  // That of the last motion; it stays where the stage does not move.
  for (std::size_t n = 0; n < readings_.size(); ++n) {
    const ReadingArrival& reading = readings_[n];
    if (!reading.arrival.since_reading_before)
      for (Follower& follower : followers) follower.forget();
    for (const StageLeg& leg : reading.arrival.legs) {
      const StagePose from = pose_on(reading, leg, leg.from), to = pose_on(reading, leg, leg.to);
      const std::size_t from_place = place_of(from), to_place = place_of(to);
      const Eigen::Vector3d at_from = responses(from), at_to = responses(to);
      const std::array<std::vector<double>, 3> turning = extrema(reading, leg, responses);
      for (std::size_t j = 0; j < 3; ++j) {
        const auto output = static_cast<Eigen::Index>(j);
        followers.at(j).go(from_place, at_from(output));
        for (const double angle : turning.at(j)) {
          const StagePose pose = pose_on(reading, leg, angle);
          followers.at(j).go(place_of(pose), responses(pose)(output));
        }
        followers.at(j).go(to_place, at_to(output));
      }
      whole = {from_place, to_place, 0.0};
    }
    for (std::size_t j = 0; j < 3; ++j) {
      Deciding& deciding = deciding_[n].at(j);
      followers.at(j).arrive(deciding);
      deciding.whole = whole;
    }
  }
}

void ArrivalSigns::take_uncertainties(const Responses& responses, const Uncertainty& uncertainty,
                                      double certain) {
  AtPoses at(poses_, responses);
  for (std::array<Deciding, 3>& outputs : deciding_) {
    for (int j = 0; j < 3; ++j) {
      Deciding& deciding = outputs.at(static_cast<std::size_t>(j));
      if (!deciding.known) continue;
      const auto change = [&](Known& known) {
        const double size = at.change(known, j);
        known.u = std::abs(size) > certain ? 0.0 : uncertainty({poses_[known.from], poses_[known.to]}, j);
        return size;
      };
      const double whole = change(deciding.whole);
      // From the newest back to one that has its sign.
      for (auto swing = deciding.swings.rbegin(); swing != deciding.swings.rend(); ++swing) {
        const double size = change(*swing);
        if (std::abs(size) - width_ <= kBeyondDoubt * swing->u) continue;
        const bool newest = swing == deciding.swings.rbegin();
        deciding.swings.erase(deciding.swings.begin(), std::prev(swing.base()));
        if (newest && whole * size > 0.0 && std::abs(whole) > kBeyondDoubt * deciding.whole.u)
          deciding.certain = size > 0.0 ? 1 : -1;
        break;
      }
    }
  }
}

double ArrivalSigns::direction_of_arrival(const Deciding& deciding, AtPoses& responses, int output) const {
  double sign = 0.0;
  for (const Known& swing : deciding.swings)
    sign = after_swing(sign, responses.change(swing, output), width_, swing.u);
  return sign;
}

std::vector<Eigen::Vector3d> ArrivalSigns::mean(const Responses& responses) const {
  std::vector<Eigen::Vector3d> out(readings_.size(), Eigen::Vector3d::Zero());
  AtPoses at(poses_, responses);
  for (std::size_t n = 0; n < deciding_.size(); ++n) {
    for (int j = 0; j < 3; ++j) {
      const Deciding& deciding = deciding_[n].at(static_cast<std::size_t>(j));
      if (!deciding.known) continue;
      if (deciding.certain != 0) {
        out[n](j) = deciding.certain;
        continue;
      }
      out[n](j) = 0.5 * (direction_of_arrival(deciding, at, j) +
                         mean_sign(at.change(deciding.whole, j), deciding.whole.u));
    }
  }
  return out;
}

std::vector<Eigen::Vector3d> ArrivalSigns::of_one_item(const Responses& responses, SignRule rule) const {
  std::vector<Eigen::Vector3d> out(readings_.size(), Eigen::Vector3d::Ones());
  AtPoses at(poses_, responses);
  for (std::size_t n = 0; n < deciding_.size(); ++n) {
    for (int j = 0; j < 3; ++j) {
      const Deciding& deciding = deciding_[n].at(static_cast<std::size_t>(j));
      if (deciding.certain != 0) {
        out[n](j) = deciding.certain;
        continue;
      }
      if (!deciding.known) continue;
      if (rule == SignRule::kLastMotion) {
        out[n](j) = mean_sign(at.change(deciding.whole, j), 0.0);
        continue;
      }
      for (const Known& swing : deciding.swings)
        out[n](j) = after_swing(out[n](j), at.change(swing, j), width_, 0.0);
    }
  }
  return out;
}

double turning_width(const EffectSizes& sizes) {
  return 10.0 * sizes.hysteresis;
}

std::vector<Eigen::Vector3d> signs_by_sizes(std::vector<ReadingArrival> readings, const Eigen::Matrix3d& rows,
                                            const EffectSizes& sizes) {
  const StageInputs perfect = StageInputs::Zero();
  const auto responses = [&](const StagePose& pose) -> Eigen::Vector3d {
    return rows * gravity_alone(pose, perfect);
  };
  const double step = step_prior(sizes);
  const auto uncertainty = [&](const ResponseChange& change, int output) {
    const Eigen::RowVector3d row = rows.row(output);
    const Eigen::Matrix<double, 1, kStageInputs> to = row * gravity_at(change.to, perfect).by_input;
    const Eigen::Matrix<double, 1, kStageInputs> from = row * gravity_at(change.from, perfect).by_input;
    const int moving = moving_angle_input(change.to.experiment);
    double variance = step * step * (to(moving) * to(moving) + from(moving) * from(moving));
    for (const StageEffect& effect : stage_effects()) {
      if (effect.in_motion || effect.face > change.to.face) continue;
      const double prior = effect.prior(sizes);
      for (int i = 0; i < effect.count && prior > 0.0; ++i) {
        const StageShare there = effect.share(change.to, i), here = effect.share(change.from, i);
        const double by = to(there.input) * there.value + to(there.second_input) * there.second_value -
                          from(here.input) * here.value - from(here.second_input) * here.second_value;
        variance += by * by * prior * prior;
      }
    }
    return std::sqrt(variance);
  };
  ArrivalSigns signs(std::move(readings), turning_width(sizes));
  signs.find(responses);
  constexpr double kCertain = 0.2;
  signs.take_uncertainties(responses, uncertainty, kCertain);
  return signs.mean(responses);
}

}  // namespace abcal
