#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "protocol/record/run_file.h"

namespace abcal {

/// Operator of a bench, and the evidence for the name.
struct RunOperator {
  std::string name;               ///< Empty: not stated.
  std::string register_identity;  ///< Register that this person is logged in to; empty: stated, not verified.

  bool verified() const { return !register_identity.empty(); }
  bool operator==(const RunOperator&) const = default;
};

/// Remark shown with a name that has not been verified.
inline constexpr std::string_view kNotVerified = "stated, not verified";

/// The label of a run that holds the register's calibrations as they were when it began, as JSON.
inline constexpr const char* kCalibrationsLabel = "laboratory.calibrations";

/// Notes in the event log of a run who operates from now on. Does nothing if no operator is stated.
void note_operator(RunFile& file, const RunOperator& who, const std::string& utc);

/// The operators of a run, each once, in order of their first event. Older runs have only the name of their
/// bench file.
std::vector<RunOperator> operators_of(const StoredRun& run);

/// "Operator N. N." or "Operator N. N. (stated, not verified)"; several are joined.
std::string describe(const std::vector<RunOperator>& operators);

}  // namespace abcal
