#pragma once

#include <array>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "app/results/planner/plan_prediction.h"

namespace abcal {

/// The angles of a circle that are tried. 12 is the least with which smooth step errors up to 6/rev leave no
/// floor under the uncertainties (docs/planning.md).
inline constexpr std::array<int, 11> kTriedSteps{12, 14, 16, 18, 20, 24, 30, 36, 45, 60, 72};
/// The angles of an experiment that are tried in two faces, half of them in each.
inline constexpr std::array<int, 5> kTriedInTwoFaces{12, 18, 24, 36, 72};
/// The rates of the sweeps that are tried (degree/s) where the stage reaches them, each with a third of it
/// for the way back: the loss of amplitude needs two rates that differ.
inline constexpr std::array<double, 4> kTriedRates{60.0, 40.0, 20.0, 10.0};
/// The numbers of sweeps of a circle that are tried, and the steps into which they are divided.
inline constexpr std::array<int, 2> kTriedSweeps{2, 4};
inline constexpr int kStepsOfSweeps = 36;
/// Fewer readings do not show their own correlation and spread.
inline constexpr int kLeastReadings = 20;
inline constexpr int kMostReadings = 1'000'000;

/// The plan of least duration, or the reasons why none reaches the wanted uncertainties.
struct FoundPlan {
  std::optional<PlanPrediction> plan;
  /// The readings at each angle with which the plan was checked by predict_plan(). Where that stated more
  /// than is wanted the plan has more of them, and its uncertainties are those of the Fisher information
  /// times `excess`.
  int readings_checked = 0;
  /// Uncertainties of the whole analysis over those by Fisher information, 1 where none is known to be
  /// larger.
  PlannedValues excess{};
  /// Without a plan: the group, the uncertainty with the longest dwells, and its largest contribution.
  std::vector<std::string> out_of_reach;
};

/// Searches for plans of one bench by Fisher information (PlannedCircles). A plan that is found is checked by
/// predict_plan(), whose uncertainties it has. Models are kept, so that further questions cost little.
class PlanSearch {
 public:
  /// The plans that are tried. A plan that turns has effects of motion, with their default sizes where the
  /// bench file does not state them: it is for a bench file that is read again, not for a BenchConfig whose
  /// plan is replaced.
  enum class Tried { kSteps, kStepsAndRates };
  /// @throws PlanError if the stage cannot reach the angles in one face
  explicit PlanSearch(PlanningBench bench, Tried tried = Tried::kStepsAndRates);
  PlanSearch(const PlanSearch&) = delete;
  PlanSearch& operator=(const PlanSearch&) = delete;

  /// The shortest plan of kTriedSteps, or of kTriedInTwoFaces and of kTriedRates where travel and stage allow
  /// them, and any dwell whose predicted uncertainties are at most those wanted.
  FoundPlan shortest(const WantedValues& wanted);

  bool tried_two_faces() const;
  bool tried_sweeps() const;

  /// The best plan that takes at most this time: the one whose largest u over wanted is least.
  /// @return nothing if moves and settlings alone take longer for every plan
  std::optional<PlanPrediction> best_within(double duration_s, const WantedValues& wanted);

 private:
  /// A dwell of circles that are tried.
  struct Choice {
    PlannedCircles* circles;
    int readings;
  };
  /// Adds circles to those that are tried if the travel allows them.
  void try_if_possible(const ProtocolConfig& protocol);
  /// The shortest by Fisher information and an excess over it, as in FoundPlan; absent: none.
  std::optional<Choice> shortest_choice(const WantedValues& wanted, const PlannedValues& excess);
  /// The least number of readings with which these circles reach the wanted uncertainties; absent: not even
  /// with `most`.
  static std::optional<int> least_readings(PlannedCircles& circles, const WantedValues& wanted,
                                           const PlannedValues& excess, int most);
  /// The largest number of readings with which these circles take at most this time; absent: too long even
  /// with kLeastReadings.
  static std::optional<int> most_readings(PlannedCircles& circles, double duration_s);

  PlanningBench bench_;
  std::deque<PlannedCircles>
      tried_;  ///< One face first, so that two are chosen only where the request gains by them.
};

/// Largest predicted over wanted of the groups for which something is wanted.
double worst_ratio(const PlannedValues& u, const WantedValues& wanted);

}  // namespace abcal
