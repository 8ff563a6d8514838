#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "abcal/record.h"
#include "abcal/values.h"

namespace abcal::v1 {
/// Whether numbers may be used.
enum class Usability {
  kNotUsable,  ///< No result: nothing may be read from the numbers.
  kDoubtful,   ///< Solved, but something contradicts the model or the stated uncertainty.
  kUsable,
};

/// Contribution of one effect to the uncertainty, as the joint estimator estimated and tested it.
struct EffectFound {
  std::string name;           ///< "wobble of X"
  std::string key;            ///< Key of its size: "wobble_urad"
  double times_stated = 0.0;  ///< Root mean square of its unknowns over their stated standard uncertainty.
  double probability = 1.0;   ///< Probability of a departure this large if the statement is right.
  bool agrees = true;
};

/// Quantities of one kind in a result, as the program describes them in every output.
struct QuantityGroup {
  std::string key;                   ///< "intrinsic_angle": as in JSON and HDF5.
  std::string heading;               ///< "Intrinsic angles"
  std::string meaning;               ///< "between UV, VW, WU"
  std::string kind;                  ///< "output", "stage", "accelerometer", "motion"
  std::string frame;                 ///< Whose axes: "item" (free of the mounting), "platter", "stage".
  std::vector<std::string> symbols;  ///< The symbols of the values, row by row.
  Values values;
};

/// The result of the estimator "abc" by the formula of the paper (Geist & Gaitan 2021, Eqs. 5 to 10), not
/// corrected for k2 and k3: what another laboratory's ABC result is compared with. Type B covers alignment,
/// turns, zeros and step errors of the stage, as in the paper, and no other effect.
struct Published {
  Values sensitivity_matrix;  ///< Shapes and units as in Result.
  Values offset;
  Values intrinsic_sensitivity;
  Values intrinsic_angle;
  Covariance covariance;
  Covariance covariance_intrinsic;
};

/// The result of one estimator on one record. Cheap to copy, never changed.
class Result {
 public:
  std::string estimator() const;
  Usability usability() const;
  std::string verdict() const;  ///< "usable", "doubtful", "not_usable"
  std::string why() const;      ///< One sentence: the reason for the verdict.
  std::string response_unit() const;
  std::vector<std::string> notes() const;  ///< Sentences that a reader should see together with the verdict.

  const Values& sensitivity_matrix() const;  ///< 3 x 3, rows u v w, columns x y z; R/g_loc. Empty for norm.
  const Values& offset() const;              ///< 3: u v w; R
  const Values& intrinsic_sensitivity() const;  ///< 3: u v w; R/g_loc
  const Values& intrinsic_angle() const;        ///< 3: uv vw wu; degree
  /// Covariance of the twelve outputs: s row by row, then O. Empty for norm.
  const Covariance& covariance() const;
  /// Covariance of the nine outputs that do not depend on the mounting: intrinsic sensitivities and angles,
  /// offsets.
  const Covariance& covariance_intrinsic() const;
  /// Every quantity of the result, also those that have no function of their own here.
  const std::vector<QuantityGroup>& quantities() const;
  /// Effects tested by the joint estimator; empty for the others.
  std::vector<EffectFound> effects() const;
  /// The joint estimator's alignment Zx, Zy, Xz (1); empty for the others.
  Values alignment() const;

  /// The published result; nothing for estimators other than "abc".
  const std::optional<Published>& published() const;

  /// JSON text equal to that of `abcal analyse --json`, schema abcal.result/1.
  std::string to_json() const;
  /// For people, as `abcal analyse` prints it, without colours.
  std::string to_text() const;
  /// For notebooks and pages: one HTML element with verdict, values with their expanded uncertainties and a
  /// figure (SVG), without ids.
  std::string to_html() const;

  struct Data;
  explicit Result(std::shared_ptr<const Data> data) : data_(std::move(data)) {}

 private:
  std::shared_ptr<const Data> data_;
};

/// Names of the estimators: "abc", "joint", "norm".
std::vector<std::string> estimators();

/// @param estimator  empty: the one chosen before the first angle, "abc" if none was recorded
/// @throws std::invalid_argument for a name that is not in estimators(). A record that the estimator refuses
/// is not an error: its result is not usable, and why() gives the reason.
Result analyse(const Record& record, const std::string& estimator = {});

/// The joint results of the items of a measurement, from one fit of all its runs, as `abcal analyse FILE...`:
/// one for each item, as it is mounted in its first run.
/// @param files  a measurement file (`abcal combine`), or run files
/// @throws std::invalid_argument for runs of other items or stages, a run twice, or a run that was changed
std::vector<Result> analyse_measurement(const std::vector<std::filesystem::path>& files);

/// How the joint estimator is run, for studies; the defaults are analyse(record, "joint").
struct JointChoices {
  bool nonlinearity = true;   ///< k2 and k3 are unknowns; false: zero exactly.
  bool drift = true;          ///< Drift of offset and sensitivity.
  bool mean_step = true;      ///< false: the axis zeros are exact.
  bool noise_process = true;  ///< false: the noise is white.
};
Result analyse_joint(const Record& record, const JointChoices& choices);

}  // namespace abcal::v1
