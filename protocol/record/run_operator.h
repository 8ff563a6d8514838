#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "protocol/record/run_file.h"

namespace abcal {

/// Who operates a bench, and how that is known.
struct RunOperator {
  std::string name;  ///< Empty: nobody said.
  std::string
      register_identity;  ///< Of the register that this person is logged in to; empty: stated, not verified.

  bool verified() const { return !register_identity.empty(); }
  bool operator==(const RunOperator&) const = default;
};

/// What stands beside a name that nobody verified, wherever it is shown.
inline constexpr std::string_view kNotVerified = "stated, not verified";

/// The label of a run that holds the register's calibrations as they were when it began, as JSON.
inline constexpr const char* kCalibrationsLabel = "laboratory.calibrations";

/// Says in the event log of a run who operates from now on. Does nothing where nobody said.
void note_operator(RunFile& file, const RunOperator& who, const std::string& utc);

/// The operators of a run, each once, in the order in which they came, as its events say. Runs of before have
/// only the name of their bench file.
std::vector<RunOperator> operators_of(const StoredRun& run);

/// "Operator N. N." or "Operator N. N. (stated, not verified)"; several are joined.
std::string describe(const std::vector<RunOperator>& operators);

}  // namespace abcal
