#pragma once

#include <optional>
#include <vector>

#include "protocol/plan/run_config.h"
#include "protocol/record/run_record.h"

namespace abcal {

// Common steps of all imports of averaged readings whose experiment, n and alpha are known.

/// The default orientation turned as the experiment requires (docs/theory/model.md), modulo a full turn.
void set_commanded_angles(DwellRecord& dwell);

/// The last angle of a circle that repeats the first one a full turn later is its closing angle.
void mark_closing_angles(std::vector<DwellRecord>& dwells);

/// Each experiment requires three different angles.
std::vector<Problem> too_few_angles(const std::vector<DwellRecord>& dwells);

/// N and D as the angles show them.
void infer_steps(RunRecord& record);

/// Averaged readings as arrays, one row an angle: experiment, desired angle and outputs of row i.
struct RecordRows {
  std::vector<int> experiment;  ///< 1, 2 or 3; n counts the rows of each from 1, those of two faces
                                ///< in turn: 1, 3, 5, ... and 2, 4, 6, ....
  std::vector<double> alpha_deg;
  std::vector<Eigen::Vector3d> mean;    ///< R
  std::vector<Eigen::Vector3d> u_mean;  ///< R; empty: not known.
  std::vector<double> time_s;           ///< Empty: not known.
  std::vector<int> face;                ///< 1 or 2 (protocol/plan/faces.h); empty: all rows are of face 1.
};

/// A record of them; everything else has its default.
/// @param source  names the arrays in messages
/// @throws std::invalid_argument with every problem: sizes that differ, numbers that are not finite, too few
/// angles
RunRecord record_of_rows(const RecordRows& rows, const std::string& source);

}  // namespace abcal
