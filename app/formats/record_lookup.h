#pragma once

#include <functional>
#include <stdexcept>
#include <string>

namespace abcal {

/// A calibrated value of a record of the laboratory, valid on the day.
struct RecordedValue {
  double value = 0.0;
  double expanded_uncertainty = 0.0;
  double coverage_factor = 2.0;
  std::string unit;
  /// Provenance stored in the run: record, equipment, issuer, dates, value with U and k.
  std::string source;
};

/// Reason why a record does not give a value: the finding and the requirement.
class RecordProblem : public std::runtime_error {
 public:
  RecordProblem(const std::string& found, std::string required)
      : std::runtime_error(found), required_(std::move(required)) {}
  const std::string& required() const { return required_; }

 private:
  std::string required_;
};

/// Finds a value in a record by their names. @throws RecordProblem
using RecordLookup = std::function<RecordedValue(const std::string& record, const std::string& value)>;

}  // namespace abcal
