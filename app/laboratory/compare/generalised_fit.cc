#include "app/laboratory/compare/generalised_fit.h"

#include <Eigen/Cholesky>
#include <stdexcept>
#include <vector>

namespace abcal {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

GeneralisedFit generalised_fit(const MatrixXd& design, const VectorXd& values, const MatrixXd& covariance) {
  if (!(covariance.diagonal().array() > 0.0).all())
    throw std::invalid_argument("an uncertainty is not above 0; required: one for each value");
  // In units of each value's uncertainty, because quantities differ by powers of ten.
  const VectorXd unit = covariance.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LLT<MatrixXd> factor(unit.asDiagonal() * covariance * unit.asDiagonal());
  if (factor.info() != Eigen::Success)
    throw std::invalid_argument(
        "the covariances contradict one another (their matrix is not positive definite): a common part is "
        "larger than an uncertainty, or a stated matrix is wrong");
  const MatrixXd scaled = unit.asDiagonal() * design;
  const MatrixXd weighted = factor.solve(scaled);
  const MatrixXd information = scaled.transpose() * weighted;
  const VectorXd scale = information.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::LLT<MatrixXd> of_parameters(scale.asDiagonal() * information * scale.asDiagonal());
  if (!scale.allFinite() || of_parameters.info() != Eigen::Success)
    throw std::invalid_argument("a quantity has no result from which it could be determined");
  GeneralisedFit fit;
  fit.covariance = scale.asDiagonal() * of_parameters.solve(MatrixXd(scale.asDiagonal()));
  fit.map = fit.covariance * weighted.transpose() * unit.asDiagonal();
  fit.parameters = fit.map * values;
  const VectorXd residuals = unit.cwiseProduct(values - design * fit.parameters);
  fit.chi2 = residuals.dot(factor.solve(residuals));
  fit.degrees_of_freedom = static_cast<int>(design.rows() - design.cols());
  return fit;
}

GeneralisedFit generalised_mean(const VectorXd& values, const MatrixXd& covariance,
                                const Eigen::MatrixXi& chosen) {
  const Index p = chosen.cols();
  std::vector<Index> at;
  for (Index i = 0; i < chosen.rows(); ++i)
    for (Index q = 0; q < p; ++q)
      if (chosen(i, q) != 0) at.push_back(i * p + q);
  const auto m = static_cast<Index>(at.size());
  MatrixXd design = MatrixXd::Zero(m, p);
  for (Index k = 0; k < m; ++k) design(k, at[static_cast<std::size_t>(k)] % p) = 1.0;
  // Around the first value of each quantity: values may be large against their uncertainties.
  VectorXd origin = VectorXd::Zero(p);
  for (auto row = at.rbegin(); row != at.rend(); ++row) origin(*row % p) = values(*row);
  GeneralisedFit mean = generalised_fit(design, values(at) - design * origin, covariance(at, at));
  mean.parameters += origin;
  const MatrixXd weights = mean.map;
  mean.map = MatrixXd::Zero(p, values.size());
  mean.map(Eigen::all, at) = weights;
  return mean;
}

}  // namespace abcal
