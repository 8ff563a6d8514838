#include "app/results/analysis/agreement.h"

#include <cmath>
#include <vector>

#include "protocol/estimators/shared/objection.h"
#include "protocol/quantities/output_names.h"
#include "protocol/quantities/quantity_groups.h"

namespace abcal {
namespace {

/// An ABC result of a run and the joint one share readings, so that their difference is less than the root of
/// both variances: a sound run exceeds this for one of nine outputs in 1700 runs at most.
constexpr double kLargestApart = 4.0;

}  // namespace

Apart apart(const CalibrationResult& one, const CalibrationResult& other) {
  Apart most{.estimator = one.estimator, .in_u = 0.0, .output = {}};
  const std::vector<NamedQuantity> of_one = outputs(one), of_other = outputs(other);
  for (std::size_t i = kOfMatrix; i < of_other.size(); ++i) {
    const Quantity &a = of_one[i].quantity, &b = of_other[i].quantity;
    const double in_u =
        std::abs(a.value - b.value) / std::hypot(a.standard_uncertainty, b.standard_uncertainty);
    if (in_u > most.in_u) most = {one.estimator, in_u, of_other[i].name};
  }
  return most;
}

void object_to_disagreement(const Apart& apart, const std::string& run, CalibrationResult& joint) {
  if (!(apart.in_u > kLargestApart)) return;
  if (run.empty()) {
    object_to(joint,
              Message("the {estimator} result of the same readings differs from this one by {times:.1f} "
                      "times the uncertainty in {output}: the item or the stage does what the model does "
                      "not have",
                      apart.estimator, apart.in_u, apart.output));
  } else {
    object_to(joint, Message("{run}: its {estimator} result differs from that of all runs by "
                             "{times:.1f} times the uncertainty in {output}",
                             run, apart.estimator, apart.in_u, apart.output));
  }
}

}  // namespace abcal
