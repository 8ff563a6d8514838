#pragma once

#include <Eigen/Core>
#include <array>
#include <compare>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "protocol/plan/effect_sizes.h"

namespace abcal {

/// Source of what a record of the stage states, in budgets and lists of sources.
inline constexpr const char* kStageRecordSource = "record of the stage";

/// An angle of one axis, modulo a turn.
struct AxisAngle {
  char axis = 'X';                ///< 'X' or 'Z'.
  std::int64_t microdegrees = 0;  ///< 0 to 359 999 999.
  auto operator<=>(const AxisAngle&) const = default;
  double degrees() const { return 1e-6 * static_cast<double>(microdegrees); }
};

/// The angle of the axis that moves at a commanded angle of experiment 1, 2 or 3.
AxisAngle visited_angle(int experiment, Angle alpha);

/// "fine map of X at 35 degrees".
std::string name_of_map(const AxisAngle& angle);

/// The errors of a stage that it repeats, with all their covariances: its alignment, zeros, initial turns,
/// smooth step errors and wobble (protocol/model/effects.h), and the further step error of each axis at each
/// angle of its fine map.
struct StageState {
  std::vector<std::string> names;  ///< EffectUnknown::name of each unknown of the table: "Zx", ...
  std::vector<AxisAngle> angles;   ///< Angles of the fine map, ascending; they follow the names.
  Eigen::VectorXd mean;            ///< 1, radian
  Eigen::MatrixXd covariance;

  Eigen::Index size() const { return static_cast<Eigen::Index>(names.size() + angles.size()); }
  /// Place of an unknown; -1: it has none.
  Eigen::Index place_of(std::string_view name) const;
  Eigen::Index place_of(const AxisAngle& angle) const;
  /// "wobble of X, cos 1/rev, direction 2"; "fine map of X at 35 degrees".
  std::string name_of(Eigen::Index place) const;
};

/// Parts of the errors of a stage that it does not repeat.
enum class RepeatPart {
  kStep,    ///< Step error of a visit.
  kHoming,  ///< F_X, F_Z in a run.
  kFloor,   ///< Zx, Zy, Xz in a run.
  kTurn,    ///< d2, d3 and those of the second face in a run.
};
inline constexpr std::size_t kRepeatParts = 4;
inline constexpr std::array<RepeatPart, kRepeatParts> kAllRepeatParts{RepeatPart::kStep, RepeatPart::kHoming,
                                                                      RepeatPart::kFloor, RepeatPart::kTurn};

/// The part that an unknown of the stage has, by its name; -1: it repeats.
int repeat_part_of(std::string_view unknown_name);
/// "step", "homing", "floor", "turn": as files and programs name it.
std::string_view to_string(RepeatPart part);
/// "step of a visit", "zeros, from homing to homing", ...
std::string_view in_words(RepeatPart part);
/// The stated size that limits it (radian).
double stated_size(const EffectSizes& sizes, RepeatPart part);

/// A standard deviation that is known with a posterior distribution: of what a stage does not repeat
/// (radian), or of its growth.
struct SizeFound {
  double most_probable = 0.0;
  double rms = 0.0;  ///< Root of its mean square: the standard deviation of future values.
  double lower = 0.0, upper = std::numeric_limits<double>::infinity();  ///< Bounds of 95 %.
  /// Logarithm of the posterior density of the logarithm of the size, up to a constant, at ascending sizes;
  /// linear between them. Empty: half-normal with the root mean square `rms`.
  std::vector<std::pair<double, double>> log_density = {};
};
using Repeatabilities = std::array<SizeFound, kRepeatParts>;

/// A half-normal distribution: nothing was measured.
SizeFound half_normal(double rms);
/// Before any run: half-normal distributions of the sizes that a bench states.
Repeatabilities stated_repeatabilities(const EffectSizes& sizes);

/// The stage that a record describes. Empty members are not known.
struct StageIdentity {
  std::string maker, model, serial_number, firmware;
  std::string axes;  ///< How the bench turns them: "X: zero 0 degrees; Z: zero 0 degrees".
};

/// A run that taught a record.
struct TeachingRun {
  std::string file, sha256;
  std::string item;      ///< Maker, model and serial number.
  std::string mounting;  ///< "as in the first run", "turned by 90 degrees about X".
};

/// Runs that taught a record together.
struct Learning {
  std::string utc;  ///< When the last of the runs began.
  std::string by;   ///< Who had it learned; empty: not stated.
  std::vector<TeachingRun> runs;
};

/// A stage as a measured standard (docs/stage_record.md).
struct StageRecord {
  StageIdentity identity;
  EffectSizes sizes;  ///< Those of the stage: before any run, and the unit of growth.
  StageState state;   ///< At the time of the last learning.
  Repeatabilities repeatabilities{};
  /// The state walks at random: each unknown by this share of its stated size in a month, by twice as much
  /// in four.
  SizeFound growth;
  std::vector<Learning> learnings;  ///< One at least, oldest first.
  std::string sha256;               ///< Hash of the file that it was read from; empty: none.

  const std::string& learned_utc() const { return learnings.back().utc; }
  int runs() const;
  /// Whether a run, by its SHA-256, taught it.
  bool was_taught_by(std::string_view run_sha256) const;
};

/// The state after some months: as the record's, less well known.
StageState state_after(const StageRecord& record, double months);
/// The time in which growth alone may change the stage by half of its stated sizes (upper bound of the
/// growth): after it a record contains little more than the statements.
double validity_months(const StageRecord& record);
/// Differences that show that a record belongs to another stage, in words; empty: none.
/// @param stage  as the bench has it; what is empty in either is not compared
std::vector<std::string> differences(const StageIdentity& record, const StageIdentity& stage);

}  // namespace abcal
