#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "abcal/export.h"

namespace abcal::v1 {
struct CompareChoices {
  std::string estimator = {};  ///< Estimator of runs and CSVs; empty: that of each run.
  bool shared_stage = false;   ///< All were measured on one stage: its type B is subtracted.
  bool any_item = false;       ///< Results of different items may be compared.
  std::string group_by = {};   ///< "day", "stage" or a label of the runs; empty: no groups.
};

/// Whether results of one item agree.
class Comparison {
 public:
  bool agree() const;
  /// One sentence for each result but the first.
  std::vector<std::string> why() const;
  /// Largest |E_n| of each result against the first.
  std::vector<double> largest_e_n() const;
  std::string to_json() const;  ///< JSON of `abcal compare --json`, schema abcal.compare/1.
  std::string to_text() const;

  struct Data;
  explicit Comparison(std::shared_ptr<const Data> data) : data_(std::move(data)) {}

 private:
  std::shared_ptr<const Data> data_;
};

/// Run files, CSVs of averaged readings and certificates (DCC XML), two at least: the first against the
/// others.
/// @throws std::invalid_argument results that cannot be compared, one measurement twice; std::runtime_error
/// for a file that cannot be read
Comparison compare(const std::vector<std::filesystem::path>& files, const CompareChoices& choices = {});

}  // namespace abcal::v1
