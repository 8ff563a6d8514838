#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "abcal/record.h"
#include "abcal/result.h"
#include "abcal/values.h"

namespace abcal::v1 {
/// Called now and then with the trials made and planned (0: not known), by one thread at a time. False ends
/// the study, which then reports the trials made so far.
using Progress = std::function<bool(std::uint64_t done, std::uint64_t planned)>;

struct MonteCarloChoices {
  std::uint64_t trials = 200'000;  ///< 0: as many as `digits` significant digits of u require.
  int digits = 2;                  ///< 1 or 2
  std::uint64_t seed = 1;
  unsigned threads = 0;                             ///< 0: one for each processor; the result is the same.
  std::optional<double> resolution = std::nullopt;  ///< Smallest step of the output, response unit.
  Progress progress = {};
};

/// Type B and type A uncertainty of a record's result by Monte Carlo (JCGM 101), with the whole budget
/// combined.
class MonteCarloStudy {
 public:
  std::uint64_t trials() const;
  bool interrupted() const;
  /// The 18 outputs, combined: s row by row, O, intrinsic sensitivities, intrinsic angles (degree).
  const Covariance& covariance() const;
  /// 18 x 2: probabilistically symmetric 95.45 % coverage intervals of the errors, low and high.
  const Eigen::MatrixXd& coverage_interval() const;
  std::vector<std::string> warnings() const;
  std::string to_json() const;  ///< JSON of `abcal uncertainty --json`, schema abcal.study/1.

  struct Data;
  explicit MonteCarloStudy(std::shared_ptr<const Data> data) : data_(std::move(data)) {}

 private:
  std::shared_ptr<const Data> data_;
};

/// @throws std::invalid_argument for choices out of range; std::runtime_error if the record cannot be
/// analysed
MonteCarloStudy monte_carlo(const Record& record, const MonteCarloChoices& choices = {});

/// Names of the simulations of Geist & Gaitan (2021): "1" ... "6", "abc1", "abc1-harmonic", "abc2".
std::vector<std::string> simulation_sets();

/// One of them. @param trials  0: as many as in the paper
/// @return JSON as `abcal simulate SET --json`, schema abcal.study/1
std::string simulation_set(const std::string& set, std::uint64_t trials = 0, std::uint64_t seed = 1,
                           unsigned threads = 0);

}  // namespace abcal::v1
