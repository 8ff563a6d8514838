#pragma once

#include <array>
#include <compare>
#include <functional>
#include <map>
#include <optional>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "app/results/planner/plan_prediction.h"

namespace abcal {

/// The angles of a circle that are tried. 12 is the least with which smooth step errors up to 6/rev leave no
/// floor under the uncertainties (docs/planning.md).
inline constexpr std::array<int, 11> kTriedSteps{12, 14, 16, 18, 20, 24, 30, 36, 45, 60, 72};
/// The angles of an experiment that are tried in two faces, half of them in each.
inline constexpr std::array<int, 5> kTriedInTwoFaces{12, 18, 24, 36, 72};
/// Fewer readings do not show their own correlation and spread.
inline constexpr int kLeastReadings = 20;
inline constexpr int kMostReadings = 1'000'000;

/// The plan of least duration, or the reasons why none reaches the wanted uncertainties.
struct FoundPlan {
  std::optional<PlanPrediction> plan;
  /// Without a plan: the group, the uncertainty with the longest dwells, and its largest contribution.
  std::vector<std::string> out_of_reach;
};

/// Searches for plans of one bench. Predictions are kept, so that further questions cost little.
class PlanSearch {
 public:
  /// @param progress  called after each prediction, and at the end, with the part of the present question
  /// that is done, from 0 to 1; may be empty
  explicit PlanSearch(PlanningBench bench, std::function<void(double part)> progress = {});

  /// Predictions that a question usually needs.
  static constexpr int kPredictionsOfBestWithin =
      static_cast<int>(kTriedSteps.size() + kTriedInTwoFaces.size());
  static constexpr int kPredictionsOfShortest = 6 * kPredictionsOfBestWithin;

  /// The shortest plan of kTriedSteps, or of kTriedInTwoFaces where the travel allows them, and any dwell
  /// whose predicted uncertainties are at most those wanted.
  FoundPlan shortest(const WantedValues& wanted);

  /// The best plan that takes at most this time: the one whose largest u over wanted is least.
  /// @return nothing if moves and settlings alone take longer for every plan
  std::optional<PlanPrediction> best_within(double duration_s, const WantedValues& wanted);

 private:
  /// The angles of a plan.
  struct Circles {
    int steps = 72;
    int faces = 1;
    auto operator<=>(const Circles&) const = default;
  };
  /// Tells the progress of the next circles of a question.
  /// @param tried  how many of `count` are done
  /// @param predictions  usual number of predictions of the question
  void begin_circles(std::size_t tried, std::size_t count, int predictions);
  /// All that are tried: one face first, so that two are chosen only where the request gains by them.
  std::vector<Circles> tried() const;
  const PlanPrediction& predicted(Circles circles, int readings);
  ProtocolConfig protocol(Circles circles, int readings) const;
  PlanDuration duration(Circles circles, int readings) const;
  /// The least number of readings with which this number of angles reaches the wanted uncertainties; absent:
  /// not even with kMostReadings.
  std::optional<int> least_readings(Circles circles, const WantedValues& wanted);
  /// The largest number of readings with which this number of angles takes at most this time; absent: too
  /// long even with kLeastReadings.
  std::optional<int> most_readings(Circles circles, double duration_s) const;

  PlanningBench bench_;
  std::function<void(double)> progress_;
  double part_ = 0.0, part_of_prediction_ = 0.0, end_of_circles_ = 0.0;
  std::map<std::pair<Circles, int>, PlanPrediction> predicted_;
};

/// Largest predicted over wanted of the groups for which something is wanted.
double worst_ratio(const PlannedValues& u, const WantedValues& wanted);

}  // namespace abcal
