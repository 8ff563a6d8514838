#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <stop_token>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/studies/robustness/robustness_study.h"

namespace abcal {

/// One kind of measurement whose intervals are tested (docs/effects.md, "Truths that are drawn").
struct CalibrationKind {
  std::string name;
  std::string words;
  int steps = 24;
  int readings = 200;
  double noise = 1e-4;  ///< That of a reading, relative to the sensitivity.
  int faces = 1;
  int items = 1;
  bool at_a_rate = false;
  std::string_view estimator = "joint";
  bool stated_u = true;  ///< The readings carry their uncertainty.
  bool play = false;     ///< The hysteresis of all benches follows play; else that of every second one.
  /// The item is as quiet as its noise: drifts of 1e-5 and a hysteresis of 1e-6 are stated.
  bool quiet_item = false;
  bool fixed_size = false;  ///< One item, near unit, with linear effects only: its ranks must be flat.
  /// Text of a bench file, whose benches these are; empty: they follow from the above.
  std::string bench_file{};
};
const std::vector<CalibrationKind>& calibration_kinds();

/// Why intervals of a group may be too wide in a kind.
struct KnownWide {
  std::string_view kind, group, reason;
};
const std::vector<KnownWide>& known_wide();

struct CalibrationOptions {
  int benches = 200;
  std::vector<std::string> kinds;  ///< Names; empty: all.
  /// Name and text of a bench file: the only kind is that of its measurement.
  std::optional<std::pair<std::string, std::string>> bench_file;
  std::uint64_t seed = 1;
  int threads = 1;
  std::stop_token stop;
  std::function<void(int done, int planned)> progress;  ///< Called by one thread at a time.
};

/// The group (output_group_names()) of one of the 18 outputs: s row by row, O, intrinsic s, phi.
std::size_t group_of_output(std::size_t output);

/// Bins of the ranks of the truth in its distribution.
inline constexpr std::size_t kRankBins = 20;
/// Probabilities of the intervals that are tested.
inline constexpr std::array<double, 3> kTestedProbabilities{0.5, 0.9544997361036416, 0.99};

/// The scores of one group of outputs: z = Phi^-1(F(error / u)), with F of Student's t of the output's
/// degrees of freedom.
struct GroupScores {
  std::size_t count = 0;
  double rms_z = 0.0;
  double low = 0.0, high = 0.0;  ///< Limits of rms_z from resampled benches, 2.5 % and 97.5 %.
  double above = 1.0;  ///< Probability of an rms_z as large if that of all benches is at most kMostZ.
  double below = 1.0;  ///< Probability of one as small if that of all benches is at least kLeastZ.
  std::array<double, kTestedProbabilities.size()> coverage{};
  /// Probability of a coverage as small as this one if the intervals hold, from resampled benches.
  std::array<double, kTestedProbabilities.size()> too_small{};
  double rms_u = 0.0;  ///< Relative to the sensitivity; phi: degrees.
  bool operator==(const GroupScores&) const = default;
};

/// Limits of rms_z.
inline constexpr double kMostZ = 1.08, kLeastZ = 0.92, kNeverBelowZ = 0.80;
/// Largest share of sound benches that may be called doubtful.
inline constexpr double kMostDoubtful = 0.02;

struct KindOutcome {
  CalibrationKind kind;
  int benches = 0;
  int no_result = 0;                   ///< Benches with an item without a result.
  int doubtful = 0;                    ///< Benches with an item whose result is not usable as it is.
  double doubtful_limit = 0.0;         ///< 99 % upper bound of the share.
  std::map<std::string, int> reasons;  ///< Checks that failed, with the benches in which they did.
  std::array<GroupScores, kOutputGroups> all, usable;
  /// How often the truth had each rank in its distribution, of all benches: s row by row, O, intrinsic s,
  /// phi.
  std::array<std::array<int, kRankBins>, 18> ranks{};
  std::vector<std::string> failures;  ///< Limits that the kind does not keep; empty: it passes.
  std::vector<std::string> remarks;   ///< Listed deviations on the safe side.
};

struct CalibrationStudy {
  int benches = 0;
  std::uint64_t seed = 0;
  bool interrupted = false;
  std::vector<KindOutcome> kinds;
  bool passed() const;
};

/// Whole simulated runs on benches that are drawn from what their bench file states; the same for any number
/// of threads.
/// @throws std::invalid_argument an unknown kind, no benches, no threads. BenchError a bench file that is
/// wrong
CalibrationStudy run_calibration_study(const CalibrationOptions& options);

/// How often runs notice one effect that is larger than stated.
struct PowerRow {
  std::string kind;      ///< As CalibrationKind::name.
  std::string_view key;  ///< As EffectSizeKey::key.
  double stated = 0.0, drawn = 0.0;
  int benches = 0, doubtful = 0;
  std::array<GroupScores, kOutputGroups> usable;  ///< Scores of the others.
};

struct PowerStudy {
  int benches = 0;
  std::uint64_t seed = 0;
  bool interrupted = false;
  std::vector<PowerRow> rows;
};

/// Runs on benches of which one effect is drawn 3 and 10 times as large as stated; where it is stated as 0,
/// from sizes of 1e-6 to 1e-4 (of the sensitivity or a radian). Kinds: "24-1000", and "rate" for the effects
/// of motion, or those of the options.
/// @throws std::invalid_argument as run_calibration_study()
PowerStudy run_power_study(const CalibrationOptions& options);

std::string power_text(const PowerStudy& study);
/// Schema abcal.power-study/1.
nlohmann::ordered_json power_json(const PowerStudy& study);

std::string calibration_text(const CalibrationStudy& study);
/// Schema abcal.calibration-study/1.
nlohmann::ordered_json calibration_json(const CalibrationStudy& study);

}  // namespace abcal
