#include "protocol/estimators/joint/size_evidence.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"

namespace abcal {
namespace {

/// The alternative to a statement: a size this many times as large.
constexpr double kTimes = 10.0;
/// A direction whose variance the run reduces by less than this share of the prior's has no evidence.
constexpr double kTold = 1e-9;

/// The unknowns of one key.
struct KeyUnknowns {
  std::string key;
  std::vector<Eigen::Index> unknowns;
};

std::vector<KeyUnknowns> unknowns_by_key(const EffectModel& model) {
  std::vector<KeyUnknowns> out;
  for (std::size_t i = 0; i < model.unknowns().size(); ++i) {
    const EffectUnknown& unknown = model.unknowns()[i];
    if (!std::isfinite(unknown.prior_sd)) continue;
    auto found = std::find_if(out.begin(), out.end(),
                              [&](const KeyUnknowns& of_key) { return of_key.key == unknown.key; });
    if (found == out.end()) found = out.insert(out.end(), {unknown.key, {}});
    found->unknowns.push_back(static_cast<Eigen::Index>(i));
  }
  return out;
}

/// The logarithm by which the density of the readings changes, at one noise, if the sizes of these unknowns
/// are kTimes as large. In the directions in which prior and posterior covariance are both diagonal: with the
/// posterior variance k of a direction over the prior's and the estimate z over the prior's standard
/// deviation, the readings' own estimate z/(1 - k) has the variance k/(1 - k) in addition to the prior's.
double larger_at(const EffectModel& model, const AtNoise& at, const Eigen::MatrixXd& root,
                 const std::vector<Eigen::Index>& unknowns) {
  const auto count = static_cast<Eigen::Index>(unknowns.size());
  Eigen::VectorXd estimate(count);
  Eigen::MatrixXd rows(count, root.cols());
  const Eigen::VectorXd from_prior = model.from_prior() + at.change;
  for (Eigen::Index i = 0; i < count; ++i) {
    const Eigen::Index from = unknowns[static_cast<std::size_t>(i)];
    const double prior = model.unknowns()[static_cast<std::size_t>(from)].prior_sd;
    estimate(i) = from_prior(from) / prior;
    rows.row(i) = root.row(from) / prior;
  }
  const SymmetricEigen eigen = symmetric_eigen(covariance_of_root(rows));
  double log_ratio = 0.0;
  for (Eigen::Index i = 0; i < count; ++i) {
    const double told = 1.0 - eigen.values(i);
    if (told < kTold) continue;
    const double wider = 1.0 + (kTimes * kTimes - 1.0) * told;
    const double z = eigen.vectors.col(i).dot(estimate);
    log_ratio += -0.5 * std::log(wider) + 0.5 * z * z / told * (1.0 - 1.0 / wider);
  }
  return log_ratio;
}

}  // namespace

std::vector<SizeEvidence> size_evidence(const EffectModel& model, const NoiseSearch& search) {
  std::vector<Eigen::MatrixXd> roots;
  for (const AtNoise& point : search.points) roots.push_back(point.normal.covariance_root());
  std::vector<SizeEvidence> out;
  const std::vector<KeyUnknowns> keys = unknowns_by_key(model);
  for (const KeyUnknowns& of_key : keys) {
    std::vector<double> logs;
    for (std::size_t i = 0; i < search.points.size(); ++i)
      logs.push_back(search.log_weights[i] + larger_at(model, search.points[i], roots[i], of_key.unknowns));
    out.push_back({of_key.key, kTimes, log_of_sum(logs)});
  }
  if (!(model.step_sd() > 0.0)) return out;
  const AtNoise steps = solve_at(model, {.white = search.white.white, .step_sd = kTimes * model.step_sd()});
  const double of_steps = steps.log_likelihood - search.log_evidence;
  out.push_back({"step_deg", kTimes, of_steps});
  const Eigen::MatrixXd root = steps.normal.covariance_root();
  for (const KeyUnknowns& of_key : keys) {
    if (of_key.key == "step_smooth_deg")
      out.push_back(
          {"step_deg, step_smooth_deg", kTimes, of_steps + larger_at(model, steps, root, of_key.unknowns)});
  }
  return out;
}

}  // namespace abcal
