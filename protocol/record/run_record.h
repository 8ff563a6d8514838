#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/angle.h"
#include "protocol/plan/limits.h"
#include "protocol/plan/run_config.h"
#include "protocol/plan/tolerances.h"

namespace abcal {

/// Observations at one angle. Bits, so that a run file holds them in one column.
enum DwellFlag : std::uint32_t {
  kFlagNone = 0,
  kFlagNotQuiet = 1U << 0,       ///< The accelerometer had not become quiet at the longest wait.
  kFlagLostReadings = 1U << 1,   ///< Readings were lost during the dwell.
  kFlagClipped = 1U << 2,        ///< An output was at full scale, or the instrument reported it.
  kFlagStuck = 1U << 3,          ///< An output did not change at all during the dwell.
  kFlagNotFinite = 1U << 4,      ///< Readings that were not finite were left out.
  kFlagOutsideWindow = 1U << 5,  ///< The encoder left the position window during the dwell.
  kFlagTemperature = 1U << 6,    ///< The temperature was outside its limit.
  kFlagRepeated = 1U << 7,       ///< The dwell was repeated (vibration, left window, replug, resume).
  kFlagHeld = 1U << 8,           ///< The run waited here for the temperature to be back inside its limits.
  kFlagNorm = 1U << 9,           ///< The norm of the readings is not that of local gravity.
};
inline constexpr std::uint32_t kAllFlags = 2U * kFlagNorm - 1U;

/// The words for the flags of one dwell, in a fixed order ("not quiet, lost readings"); empty for none.
Message describe_flags(std::uint32_t flags);

/// Why an angle was measured.
enum class DwellRole {
  kPlan,     ///< An angle of the plan, for the fits.
  kReturn,   ///< A pose of the plan to which the stage returns, to show a change of the item.
  kClosing,  ///< The extra angle that closes an experiment's circle; not part of the fits.
  kCheck,    ///< A check pose (experiment 0); or an angle measured again after an interruption, which does
             ///< not count.
};
std::string_view to_string(DwellRole role);
/// @return nothing for any other word
std::optional<DwellRole> dwell_role_from(std::string_view word);

/// How the stage passed an angle of a run at a constant rate.
struct DwellMotion {
  int sweep = 0;                ///< Number in its circle, from 1.
  double rate_deg_per_s = 0.0;  ///< There; below zero: towards lower angles.
  double acceleration_deg_per_s2 = 0.0;
  /// Standard uncertainty of the angles of the whole sweep, from the scatter of its encoder samples: of their
  /// mean, and of their course around the circle (rms).
  double u_angle_deg = 0.0;
};

/// One angle of one experiment: the command, the encoder angle, and the accelerometer's readings.
struct DwellRecord {
  int experiment = 0;    ///< 1, 2, 3 as in the paper.
  int n = 0;             ///< 1..N, the paper's index of the desired angle alpha(n).
  bool closing = false;  ///< The extra angle alpha = 360 degrees that shows drift; not part of the fits.
  DwellRole role = DwellRole::kPlan;  ///< kPlan with `closing` set means kClosing: RunFile stores it so.
  Angle alpha;                        ///< Desired rotation angle.
  Angle commanded_x, commanded_z;     ///< Angles of the plan: alpha or the held angle, by whole turns.
  std::optional<Angle> encoder_x, encoder_z;  ///< Absent for an imported CSV.
  /// Middle of the dwell, in true time from the beginning of the first session: pauses between sessions are
  /// in it. (In run files of version 2 they are not.)
  std::optional<double> time_s;
  double settle_time_s = 0.0;  ///< From stopped to the first reading used.
  std::int64_t count = 0;      ///< Readings averaged; 0: not known (CSV).
  std::int64_t lost = 0;       ///< Readings known to be lost during the dwell.
  Eigen::Vector3d mean =
      Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());  ///< r_u, r_v, r_w (R).
  Eigen::Vector3d spread = Eigen::Vector3d::Zero();  ///< Standard deviation of single readings (R).
  /// Standard uncertainty of the mean (R), autocorrelation taken into account. Absent for a CSV without it.
  std::optional<Eigen::Vector3d> u_mean;
  std::optional<double> temperature_degc;
  std::uint32_t flags = kFlagNone;
  int face = 1;                       ///< 1 or 2 (protocol/plan/faces.h).
  std::optional<DwellMotion> motion;  ///< Absent: at rest.
  /// Direction upwards at this pose in the axes of the item's mount, of length 1, as a table states it.
  std::optional<Eigen::Vector3d> up;
  std::size_t first_line = 0,
              last_line = 0;  ///< Lines of a table without angles, from 1; 0: of no such table.
};

/// One dwell at a check pose (protocol/plan/rotation_plan.h): its experiment is 0 and its n 1 or 2.
struct CheckDwell {
  DwellRecord dwell;
  std::size_t after = 0;  ///< Number of RunRecord::dwells measured before it.
};

/// Local gravity at the bench, with its source.
struct LocalGravity {
  double value_mps2 = 9.80665;
  double expanded_uncertainty_mps2 = 0.0;  ///< U = k u.
  double coverage_factor = 2.0;            ///< k.
  std::string source;                      ///< "survey NOAA 2021", "formula GRS80", ...

  bool operator==(const LocalGravity&) const = default;
};

/// A value measured otherwise, with its standard uncertainty (greater than 0).
struct MeasuredValue {
  double value = 0.0;
  double standard_uncertainty = std::numeric_limits<double>::quiet_NaN();
};

/// Alignment of the stage measured otherwise, e.g. by `abcal level`. Absent components are known from the
/// tolerances only.
struct MeasuredAlignment {
  std::optional<MeasuredValue> zx, zy, xz;  ///< 1
};

/// Whether the alignment of an effect ("Zx", "Zy", "Xz") was measured by other means.
inline bool is_measured(const MeasuredAlignment& alignment, std::string_view effect) {
  return (effect == "Zx" && alignment.zx) || (effect == "Zy" && alignment.zy) ||
         (effect == "Xz" && alignment.xz);
}

struct StageRecord;

/// The record of its stage that the analysis of a run uses (protocol/record/stage_record.h).
struct StageRecordInUse {
  std::shared_ptr<const StageRecord> record;  ///< Null: none.
  double age_months = 0.0;                    ///< From its last learning to the run.
};

/// Everything that the analysis may know of a run. A stored run, an imported CSV and a live run are all this.
struct RunRecord {
  std::string source;               ///< Its file, for messages.
  std::string response_unit = "R";  ///< Unit of the readings.
  LocalGravity g_loc;
  bool g_loc_known = false;  ///< False: a CSV without a bench file; results are per g_loc.
  Tolerances tolerances;
  LimitsConfig limits;
  ExpectedItem expected;
  std::optional<Angle> u_up;             ///< Standard uncertainty of each `up` about either axis across it.
  MeasuredAlignment measured_alignment;  ///< Data for the joint estimator.
  StageRecordInUse stage_record;         ///< Prior of the stage for the joint estimator, in place of sizes.
  /// Name of the estimator whose result is the result of the run, chosen before the first angle ("joint").
  /// Empty: not recorded.
  std::string estimator;
  Angle step = Angle::degrees(5.0);  ///< Desired rotation step D.
  int steps = 72;                    ///< N.
  /// From how far below every angle was reached; 0: from either side. Absent: not stated (CSV, files of
  /// before version 1.0).
  std::optional<Angle> approach;
  /// In which order the axes moved from angle to angle. Absent: not stated (CSV).
  std::optional<AxesOrder> axes_order;
  int continuations = 0;            ///< Number of times that the run was interrupted and continued.
  int reconnections = 0;            ///< Number of times that a port vanished and returned, and the run
                                    ///< continued.
  std::vector<DwellRecord> dwells;  ///< In the order of measurement, closing angles included.
  /// The file has no times and does not state that its rows are in the order of measurement.
  bool order_assumed = false;
  std::vector<CheckDwell> check_poses;  ///< In the order of measurement; empty where none were planned.
  std::vector<std::string> read_as;  ///< How a table was understood, in at most three lines; empty: no table.
};

/// Whether the dwells are at angles of experiments; false: of poses whose angles are not known.
bool has_angles(const RunRecord& record);

/// Whether a table states the directions of all its poses.
bool states_directions(const RunRecord& record);

/// Whether the backlash of the axes is part of the readings: the run states that angles were not approached
/// from below, and an axis turned both ways.
bool backlash_is_left(const RunRecord& record);

/// Whether angles that the stage passed at a constant rate are among the record's.
bool is_at_constant_rate(const RunRecord& record);

/// Whether dwells of the second face are among the record's.
bool has_two_faces(const RunRecord& record);

/// The dwells of a record with those at its check poses, in the order of measurement; they live in it.
std::vector<const DwellRecord*> dwells_in_time(const RunRecord& record);

}  // namespace abcal
