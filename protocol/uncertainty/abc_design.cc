#include "protocol/uncertainty/abc_design.h"

#include <cmath>
#include <stdexcept>
#include <string>

#include "protocol/linear/pivoted_qr.h"
#include "protocol/plan/faces.h"

namespace abcal {

namespace {

// Smallest over largest pivot of [sin, cos, 1] below which A, B and C cannot be distinguished with useful
// accuracy: 72 even steps give 0.71, angles that cover only 20 degrees 2e-3.
constexpr double kSmallestReciprocalCondition = 1e-2;

RotationFit fit_of(const std::vector<Angle>& alpha, std::size_t experiment) {
  const auto who = "experiment " + std::to_string(experiment + 1) + ": ";
  if (alpha.size() < 3) {
    throw std::invalid_argument(who + std::to_string(alpha.size()) +
                                " angles, at least 3 are needed to find A, B and C");
  }
  const auto n = static_cast<Eigen::Index>(alpha.size());
  RotationFit fit;
  fit.alpha = alpha;
  fit.sin_alpha.resize(n);
  fit.cos_alpha.resize(n);
  Eigen::MatrixX3d design(n, 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Angle angle = alpha[static_cast<std::size_t>(i)];
    if (!std::isfinite(angle.deg())) throw std::invalid_argument(who + "an angle that is not finite");
    const SinCos sc = sincos(angle);
    fit.sin_alpha(i) = sc.sin;
    fit.cos_alpha(i) = sc.cos;
    design.row(i) << sc.sin, sc.cos, 1.0;
  }
  const PivotedQr qr(design);
  const Eigen::Vector3d pivots = qr.pivots();
  if (!(pivots.minCoeff() >= kSmallestReciprocalCondition * pivots.maxCoeff())) {
    throw std::invalid_argument(who + "its " + std::to_string(n) +
                                " angles do not determine A, B and C: they cover too little of the circle");
  }
  fit.weights = qr.solve(Eigen::MatrixXd::Identity(n, n)).transpose();
  return fit;
}

}  // namespace

AbcDesign AbcDesign::uniform(int steps, Angle step) {
  if (steps < 3) {
    throw std::invalid_argument("number of steps = " + std::to_string(steps) + ", at least 3 are needed");
  }
  std::vector<Angle> alpha;
  for (int n = 0; n < steps; ++n) alpha.push_back(step * n);
  return of_angles({alpha, alpha, alpha});
}

AbcDesign AbcDesign::of_record(const RunRecord& record) {
  std::array<std::vector<Angle>, 3> alpha;
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.closing) continue;
    if (dwell.experiment < 1 || dwell.experiment > 3) {
      throw std::invalid_argument(record.source + ": experiment " + std::to_string(dwell.experiment) +
                                  ", experiments are 1, 2, 3");
    }
    alpha[static_cast<std::size_t>(dwell.experiment - 1)].push_back(
        angle_in_face_1(dwell.experiment, dwell.face, dwell.alpha));
  }
  try {
    return of_angles(alpha);
  } catch (const std::invalid_argument& problem) {
    throw std::invalid_argument(record.source + ": " + problem.what());
  }
}

AbcDesign AbcDesign::of_angles(const std::array<std::vector<Angle>, 3>& alpha) {
  AbcDesign design;
  for (std::size_t i = 0; i < 3; ++i) design.experiments_[i] = fit_of(alpha[i], i);
  return design;
}

Eigen::Vector4d AbcDesign::share(int experiment, Eigen::Index n) const {
  const RotationFit& fit = experiments_.at(static_cast<std::size_t>(experiment - 1));
  const double a = fit.weights(n, 0), b = fit.weights(n, 1), c = fit.weights(n, 2);
  // s_jx = -(A2 + A3)/2, s_jy = (A1 - B3)/2, s_jz = (B1 + B2)/2, O_j = (C1 + C2 + C3)/3
  // (docs/theory/abc_protocol.md).
  switch (experiment) {
    case 1:
      return {0.0, a / 2.0, b / 2.0, c / 3.0};
    case 2:
      return {-a / 2.0, 0.0, b / 2.0, c / 3.0};
    default:
      return {-a / 2.0, -b / 2.0, 0.0, c / 3.0};
  }
}

int AbcDesign::readings() const {
  std::size_t total = 0;
  for (const RotationFit& fit : experiments_) total += fit.alpha.size();
  return static_cast<int>(total);
}

}  // namespace abcal
