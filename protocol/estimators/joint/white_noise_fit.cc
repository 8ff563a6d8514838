#include "protocol/estimators/joint/white_noise_fit.h"

#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "protocol/estimators/joint/noise_search.h"
#include "protocol/estimators/shared/normal_matrix.h"
#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/linear/products.h"

namespace abcal {
namespace {

/// Changes of the signs for the hysteresis, each with a minimisation of its own.
constexpr int kMostSigns = 5;

/// The three readings of one angle.
template <class Rows>
auto of_angle(Rows& rows, std::size_t n) {
  return rows.col(0).template segment<3>(3 * static_cast<Eigen::Index>(n));
}

class WhiteNoiseProblem : public SumOfSquares {
 public:
  explicit WhiteNoiseProblem(EffectModel& model) : model_(model) {
    weight_.resize(3 * static_cast<Eigen::Index>(model.angles()));
    take_noise();
  }

  /// Takes the signs for the hysteresis of the present point, and the noise with them.
  /// @return false: nothing changed
  bool take_signs() {
    const AtNoise here = solve_at(model_, {.step_sd = model_.step_sd()});
    if (!model_.take_signs(here.normal.covariance_root())) return false;
    take_noise();
    return true;
  }

  double cost() override {
    if (!model_.is_plausible()) return std::numeric_limits<double>::infinity();
    double out =
        weight_.dot(model_.misfit().cwiseAbs2()) + model_.prior_weight().dot(model_.from_prior().cwiseAbs2());
    if (!(model_.step_sd() > 0.0)) return out;
    for (const double step : model_.steps()) out += std::pow(step / model_.step_sd(), 2);
    return out;
  }

  std::optional<double> solve_step(double damping, bool anew) override {
    std::vector<NoiseAtAngle> angles = model_.noise_at_angles(Eigen::Vector3d::Ones());
    const std::vector<StepPrior> priors = step_priors(angles, damping);
    // A wider or narrower prior of a step error is equivalent to a larger or smaller derivative by it.
    std::vector<NoiseAtAngle> scaled = angles;
    for (std::size_t n = 0; n < priors.size(); ++n) scaled[n].by_step *= priors[n].sd / model_.step_sd();
    const NoiseWhitener whitener(scaled, model_.step_sd(), NoiseProcess{});
    if (anew) compute_normal(whitener, damping);
    if (!normal_.solvable()) return std::nullopt;

    ReadingRows residual = model_.misfit();
    for (std::size_t n = 0; n < priors.size(); ++n)
      of_angle(residual, n) += angles[n].by_step * (model_.steps()[n] - priors[n].mean);
    const Eigen::VectorXd before = weighted(whitener, residual);
    const Eigen::VectorXd right = transposed_product_by_rows_with_vector(model_.jacobian(), before) -
                                  model_.prior_weight().cwiseProduct(model_.from_prior());
    change_ = normal_.solve(right);
    residual -= model_.jacobian() * change_;
    const Eigen::VectorXd after = weighted(whitener, residual);

    double fall = right.dot(change_) + damping * diagonal_.dot(change_.cwiseAbs2());
    steps_ = model_.steps();
    for (std::size_t n = 0; n < priors.size(); ++n) {
      const auto best = [&](const Eigen::VectorXd& left) {
        return priors[n].mean + priors[n].sd * priors[n].sd * angles[n].by_step.dot(of_angle(left, n));
      };
      const double moved = best(after) - steps_[n];
      fall += std::pow((best(before) - steps_[n]) / priors[n].u, 2) + priors[n].damping * moved * moved;
      steps_[n] = best(after);
    }
    return fall;
  }

  void move() override {
    value_before_ = model_.value();
    steps_before_ = model_.steps();
    model_.move_to(value_before_ + change_, std::move(steps_));
  }

  void move_back() override { model_.move_to(value_before_, std::move(steps_before_)); }

  double reciprocal_condition() const { return normal_.reciprocal_condition(); }

 private:
  void take_noise() {
    const std::vector<NoiseAtAngle> angles = model_.noise_at_angles(Eigen::Vector3d::Ones());
    for (std::size_t n = 0; n < angles.size(); ++n) of_angle(weight_, n) = angles[n].white.cwiseInverse();
  }

  /// Prior of one step error, without the readings (radian). Damping keeps it near its present value.
  struct StepPrior {
    double mean = 0.0;
    double sd = 0.0;
    double u = 0.0;        ///< Standard deviation with the readings of its angle, the other unknowns given.
    double damping = 0.0;  ///< Addition to its diagonal element of the normal matrix (1/radian^2).
  };

  /// @return one for each step error that is eliminated
  std::vector<StepPrior> step_priors(const std::vector<NoiseAtAngle>& angles, double damping) const {
    std::vector<StepPrior> out;
    if (!(model_.step_sd() > 0.0)) return out;
    const double stated = 1.0 / (model_.step_sd() * model_.step_sd());
    for (std::size_t n = 0; n < angles.size(); ++n) {
      const double by_readings = angles[n].by_step.cwiseAbs2().cwiseQuotient(angles[n].white).sum();
      const double damped = damping * (stated + by_readings);
      out.push_back({damped * model_.steps()[n] / (stated + damped), 1.0 / std::sqrt(stated + damped),
                     1.0 / std::sqrt(stated + damped + by_readings), damped});
    }
    return out;
  }

  void compute_normal(const NoiseWhitener& whitener, double damping) {
    ReadingRows whitened = model_.jacobian();
    whitener.whiten(whitened);
    Eigen::MatrixXd normal = products_of_columns(whitened);
    normal.diagonal() += model_.prior_weight();
    diagonal_ = normal.diagonal();
    normal.diagonal() *= 1.0 + damping;
    normal_.compute(std::move(normal));
  }

  /// V^-1 times the residual.
  static Eigen::VectorXd weighted(const NoiseWhitener& whitener, ReadingRows residual) {
    whitener.whiten(residual);
    whitener.whiten_transposed(residual);
    return residual;
  }

  EffectModel& model_;
  Eigen::VectorXd weight_;  ///< 1/u^2 of each reading, relative units.
  NormalMatrix normal_;
  Eigen::VectorXd diagonal_;   ///< Diagonal of the normal matrix without damping.
  Eigen::VectorXd change_;     ///< Change of the unknowns in this step.
  std::vector<double> steps_;  ///< Step errors after this step.
  Eigen::VectorXd value_before_;
  std::vector<double> steps_before_;
};

}  // namespace

WhiteNoiseFit fit_with_white_noise(EffectModel& model) {
  WhiteNoiseProblem problem(model);
  WhiteNoiseFit out;
  out.minimum = minimise(problem);
  // An output along a rotation axis changes with the inclinations of the axes, which only the solution
  // determines.
  for (int pass = 0; pass < kMostSigns && out.minimum.found && problem.take_signs(); ++pass) {
    const int before = out.minimum.iterations;
    out.minimum = minimise(problem);
    out.minimum.iterations += before;
  }
  if (out.minimum.found) out.reciprocal_condition = problem.reciprocal_condition();
  return out;
}

}  // namespace abcal
