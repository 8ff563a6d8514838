#include "protocol/uncertainty/joint_trials.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "protocol/estimators/joint/line_response.h"
#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/estimators/shared/side_by_side.h"
#include "protocol/estimators/shared/voltmeter.h"
#include "protocol/linear/products.h"
#include "protocol/uncertainty/random_shapes.h"

namespace abcal {
namespace {

/// V^-1 X from L X.
ReadingRows weighted(const NoiseWhitener& whitener, ReadingRows whitened) {
  whitener.whiten_transposed(whitened);
  return whitened;
}

}  // namespace

JointTrials::JointTrials(const ItemFit& own, const RunRecord& record, std::uint64_t seed, TruthFrom truth)
    : own_(own),
      draws_(own, record),
      model_(draws_.model()),
      seed_(seed),
      hysteresis_(model_.hysteresis_unknowns()) {
  if (!hysteresis_.empty())
    hysteresis_size_ = model_.unknowns()[static_cast<std::size_t>(hysteresis_.front())].prior_sd;
  question_ = {own.options.noise_process, own.options.white_known,
               static_cast<double>(model_.residual().size())};
  prior_mean_ = model_.value() - model_.from_prior();
  for (const EffectUnknown& unknown : model_.unknowns())
    shapes_.push_back(is_measured(own.options.measured_alignment, unknown.effect)
                          ? Shape::kNormal
                          : draws_.sizes().shape_of(unknown.key));
  start_ = linear_at({.step_sd = model_.step_sd()});
  jacobian_ = PanelMatrix(model_.jacobian());
  line_rows_ = model_.line_rows();
  find_by_step();
  if (truth == TruthFrom::kPosterior) find_posterior();
  const std::vector<NoiseCandidate> candidates = noise_candidates(question_);
  linear_.resize(candidates.size());
  for (std::size_t i = 0; i < candidates.size(); ++i) number_of_.emplace(candidates[i], i);
  side_by_side(candidates.size(), [&](std::size_t i) {
    linear_[i] = linear_at(assumed_noise(model_, own_.solution->white, candidates[i]));
  });
}

JointTrials::Linear JointTrials::linear_at(const AssumedNoise& noise) const {
  AtNoise at = solve_at(model_, noise);
  Linear linear;
  linear.constant = at.log_likelihood + 0.5 * at.chi2;
  const Eigen::MatrixXd root = at.normal.covariance_root();
  const Eigen::Index unknowns = root.cols(), readings = at.whitened_jacobian.rows();
  Rows12 rows = model_.line_rows();
  Eigen::MatrixXd from_data = Eigen::MatrixXd::Zero(unknowns + 3, readings + unknowns);
  if (noise.tau > 0.0) {
    // As in effect_fit(): the mean of the process over the run belongs to the offset.
    linear.has_process = true;
    ReadingRows with_mean = at.whitener->covariance_with_mean();
    at.whitener->whiten(with_mean);
    rows.bottomRows<3>() -= transposed_product_by_rows(with_mean, at.whitened_jacobian);
    from_data.bottomLeftCorner(3, readings) = weighted(*at.whitener, std::move(with_mean)).transpose();
  }
  from_data.topLeftCorner(unknowns, readings) =
      weighted(*at.whitener, times_upper(at.whitened_jacobian, root)).transpose();
  from_data.topRightCorner(unknowns, unknowns) = -scaled_columns(root.transpose(), model_.prior_weight());
  linear.from_data = PanelMatrix(from_data);
  linear.root = PanelMatrix(root);
  linear.line = PanelMatrix(transposed_product(root, rows.transpose()).transpose());
  for (Eigen::Index i = 0; i < unknowns && !hysteresis_.empty(); ++i)
    linear.selected.push_back({root(hysteresis_[0], i), root(hysteresis_[1], i), root(hysteresis_[2], i)});
  linear.whitener = std::move(at.whitener);
  return linear;
}

void JointTrials::find_by_step() {
  const Eigen::Vector3d white = Eigen::Vector3d::Ones();
  const double variance = model_.step_sd() * model_.step_sd();
  for (const NoiseAtAngle& angle : model_.noise_at_angles(white)) {
    Eigen::Matrix3d v = variance * angle.by_step * angle.by_step.transpose();
    v.diagonal() += angle.white;
    by_step_.push_back(angle.by_step);
    step_by_residual_.push_back(variance * v.llt().solve(angle.by_step));
  }
}

void JointTrials::find_posterior() {
  const std::vector<AssumedNoise>& noises = own_.solution->noises;
  posterior_.resize(noises.size());
  side_by_side(noises.size(), [&](std::size_t i) {
    const AtNoise at = solve_at(model_, noises[i]);
    posterior_[i] = {model_.value() + at.change, at.normal.covariance_root()};
  });
}

void JointTrials::draw_unknowns(const Posterior& posterior, RandomStream& stream, JointDraw& draw) const {
  Eigen::VectorXd independent(posterior.root.cols());
  for (double& one : independent) one = stream.normal();
  draw.value = posterior.mean + product_with_vector(posterior.root, independent);
  draw.stated = prior_mean_;
  for (std::size_t i = 0; i < shapes_.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    const double size = model_.unknowns()[i].prior_sd;
    if (std::isfinite(size)) draw.stated(at) = draw.value(at) + size * standard_draw(shapes_[i], stream);
  }
}

void JointTrials::draw_effects(RandomStream& stream, JointDraw& draw) const {
  draw.value = model_.value();
  draw.stated = prior_mean_;
  for (std::size_t i = 0; i < shapes_.size(); ++i) {
    const EffectUnknown& unknown = model_.unknowns()[i];
    if (!std::isfinite(unknown.prior_sd)) continue;  // s and O: those of the fitted item
    draw.value(static_cast<Eigen::Index>(i)) =
        unknown.prior_mean + unknown.prior_sd * standard_draw(shapes_[i], stream);
  }
}

void JointTrials::draw_steps(RandomStream& stream, JointDraw& draw) const {
  draw.steps.assign(model_.angles(), 0.0);
  if (!(model_.step_sd() > 0.0)) return;
  const Shape shape = draws_.sizes().shape_of("step_deg");
  // All have the stated size; the fit assumes a larger one at some angles out of caution.
  for (std::size_t n = 0; n < draw.steps.size(); ++n)
    draw.steps[n] = model_.step_sd() * standard_draw(shape, stream) / model_.step_factor(n);
}

JointDraw JointTrials::draw(std::uint64_t trial) const {
  JointDraw draw;
  RandomStream effects(seed_, StreamPurpose::kEffects, trial);
  RandomStream noise(seed_, StreamPurpose::kReadings, trial);
  const std::size_t chosen = draws_.choose_noise(noise);
  if (posterior_.empty()) {
    draw_effects(effects, draw);
  } else {
    draw_unknowns(posterior_[chosen], effects, draw);
  }
  draw_steps(effects, draw);
  draws_.draw_signs(effects, draw);
  draws_.draw_noise(chosen, noise, draw);
  draw.by_voltmeter = draws_.draw_voltmeter(effects);
  return draw;
}

Vector12 JointTrials::truth_of(const JointDraw& draw) const {
  Vector12 truth = model_.line_values_at(draw.value);
  truth.tail<3>() += draw.process_mean;
  return truth.cwiseProduct(draws_.units());
}

/// @param line  the estimate (R)
OutputVector JointTrials::error_of(const JointDraw& draw, const Vector12& line) const {
  return outputs_of_line(line + draw.by_voltmeter) - outputs_of_line(truth_of(draw));
}

/// Trials from the readings to the estimates, several side by side. It keeps its memory from one batch to the
/// next.
class JointTrials::Batch {
 public:
  explicit Batch(const JointTrials& trials)
      : of_(trials),
        readings_(static_cast<std::size_t>(of_.model_.residual().size())),
        unknowns_(static_cast<std::size_t>(of_.model_.value().size())),
        data_(readings_ + unknowns_),
        signs_(readings_),
        elements_(kTrialsTogether),
        rooted_(of_.start_.from_data.padded_rows()),
        linked_(3 * of_.start_.from_data.padded_rows()),
        products_(kWhitenedProducts),
        hysteresis_products_(kHysteresisProducts),
        taken_(6),
        along_(3),
        line_(of_.start_.line.padded_rows()),
        change_(of_.start_.root.padded_rows()),
        moved_(of_.jacobian_.padded_rows()),
        answers_(of_.linear_.size()) {}

  void make(std::uint64_t first, std::size_t count) {
    draws_.clear();
    for (Answer& answer : answers_) answer.known = false;
    for (std::size_t b = 0; b < count; ++b) draws_.push_back(of_.draw(first + b));
    estimates_.resize(count);
    for (std::size_t b = 0; b < count; ++b) {
      estimates_[b] = {draws_[b].value, draws_[b].steps};
      take_signs(b, draws_[b].came_from);
      set_data(b, draws_[b].noise);
    }
    // From the truth, where the misfit is the noise: what is left is of second order.
    step();
    for (std::size_t b = 0; b < count; ++b) {
      const auto& [value, steps] = estimates_[b];
      const std::vector<Eigen::Vector3d> signs = signs_of_estimate(b);
      set_data(b, of_.draws_.readings_of(draws_[b]) - of_.model_.readings_at(value, steps, signs));
      take_signs(b, signs);
    }
    find_lines();
  }

  OutputVector error(std::size_t b) {
    const ProbableNoises found = probable_noises(of_.question_, [&](const NoiseCandidate& candidate) {
      const Answer& answer = answer_of(candidate);
      return NoiseLikelihood{answer.log_likelihood[b], answer.chi2[b]};
    });
    Vector12 line = lines_[b];
    for (const ProbableNoise& one : found.noises)
      line += std::exp(one.log_weight) * answer_of(one.noise).line.col(static_cast<Eigen::Index>(b));
    return of_.error_of(draws_[b], line.cwiseProduct(of_.draws_.units()));
  }

 private:
  struct Estimate {
    Eigen::VectorXd value;
    std::vector<double> steps;
  };
  /// Results of the trials (columns) at one noise.
  struct Answer {
    bool known = false;
    std::array<double, kTrialsTogether> log_likelihood{}, chi2{};
    Eigen::Matrix<double, 12, static_cast<int>(kTrialsTogether)> line;
  };

  /// The signs that the estimator takes at its own solution, unless they are given to it.
  std::vector<Eigen::Vector3d> signs_of_estimate(std::size_t b) const {
    if (of_.hysteresis_.empty()) return draws_[b].came_from;
    if (of_.own_.options.signs) return of_.own_.options.signs->mean;
    return of_.model_.mean_signs_at(estimates_[b].value, estimates_[b].steps);
  }

  /// The residual with the eliminated step errors not in the model, and the unknowns less their prior means.
  void set_data(std::size_t b, const Eigen::VectorXd& misfit) {
    const auto& [value, steps] = estimates_[b];
    for (std::size_t n = 0; n < steps.size(); ++n) {
      for (std::size_t j = 0; j < 3; ++j)
        data_.at(3 * n + j, b) = misfit(static_cast<Eigen::Index>(3 * n + j)) +
                                 of_.by_step_[n](static_cast<Eigen::Index>(j)) * steps[n];
    }
    double of_priors = 0.0;
    for (std::size_t i = 0; i < unknowns_; ++i) {
      const auto at = static_cast<Eigen::Index>(i);
      const double distance = value(at) - draws_[b].stated(at);
      data_.at(readings_ + i, b) = distance;
      of_priors += of_.model_.prior_weight()(at) * distance * distance;
    }
    chi2_of_priors_[b] = of_priors;
  }

  void take_signs(std::size_t b, const std::vector<Eigen::Vector3d>& signs) {
    if (of_.hysteresis_.empty()) return;
    const std::vector<Eigen::Vector3d>& of_run = of_.model_.signs().mean;
    for (std::vector<ReadingElement>& one : elements_[b]) one.clear();
    for (std::size_t n = 0; n < signs.size(); ++n) {
      for (std::size_t j = 0; j < 3; ++j) {
        const auto output = static_cast<Eigen::Index>(j);
        const double difference = signs[n](output) - of_run[n](output);
        signs_.at(3 * n + j, b) = difference;
        if (difference != 0.0) elements_[b][j].push_back({3 * n + j, difference});
      }
    }
  }

  /// Solves N change = J' V^-1 residual - P (value - prior), with the derivatives at the solution of the run,
  /// but by the hysteresis with the signs of each trial. These change columns of J by E (signs_: column j has
  /// the rows of output j), and N by U M U' with U = [S, J' V^-1 E], where S selects the unknowns of the
  /// hysteresis, and M^-1 = [0, 1; 1, -E' V^-1 E] (Woodbury's identity).
  ///
  /// Leaves the change in rooted_ (R times it is the change of the unknowns), and further rows for the mean
  /// of the process; the fall of chi2 in fall_, the growth of the logarithm of N's determinant in growth_.
  void solve(const Linear& linear) {
    multiply(linear.from_data, data_, rooted_);
    growth_.fill(0.0);
    if (of_.hysteresis_.empty()) {
      whitened_products(*linear.whitener, data_, nullptr, products_);
      squares(rooted_, unknowns_, fall_.data());
      return;
    }
    whitened_products(*linear.whitener, data_, &signs_, products_);
    multiply_elements(linear.from_data, elements_, linked_);
    const std::size_t stride = linear.from_data.padded_rows();
    hysteresis_products(linear.selected, linked_, stride, products_.row(1), rooted_, hysteresis_products_);
    for (std::size_t b = 0; b < draws_.size(); ++b) take_hysteresis_of(b);
    take_hysteresis(linear.selected, linked_, stride, taken_, rooted_, along_);
  }

  void take_hysteresis_of(std::size_t b) {
    const auto of = [&](std::size_t i) { return hysteresis_products_.at(i, b); };
    // U in units of the stated size, so that the elements of the inner matrix are comparable.
    const double size = of_.hysteresis_size_;
    Eigen::Matrix<double, 6, 6> inner;
    Eigen::Matrix<double, 6, 1> along;
    const auto each = [](std::size_t i) { return static_cast<Eigen::Index>(i); };
    std::size_t pair = 0;
    for (std::size_t j = 0; j < 3; ++j) {
      along(each(j)) = of(kSelectedRooted + j) / size;
      along(each(3 + j)) = of(kLinkedRooted + j) * size;
      for (std::size_t k = 0; k < 3; ++k)
        inner(each(j), each(3 + k)) = inner(each(3 + k), each(j)) =
            of(kSelectedLinked + 3 * j + k) + (j == k ? 1.0 : 0.0);
      for (std::size_t k = 0; k <= j; ++k, ++pair) {
        inner(each(j), each(k)) = inner(each(k), each(j)) = of(kSelectedSelected + pair) / (size * size);
        inner(each(3 + j), each(3 + k)) = inner(each(3 + k), each(3 + j)) =
            size * size * (of(kLinkedLinked + pair) - products_.at(4 + pair, b));
      }
    }
    const Eigen::PartialPivLU<Eigen::Matrix<double, 6, 6>> factor(inner);
    const Eigen::Matrix<double, 6, 1> taken = factor.solve(along);
    fall_[b] = of(kRootedSquared) - along.dot(taken);
    growth_[b] = std::log(std::abs(factor.determinant()));
    for (std::size_t j = 0; j < 3; ++j) {
      taken_.at(j, b) = taken(each(j)) / size;
      taken_.at(3 + j, b) = taken(each(3 + j)) * size;
    }
  }

  void find_change() {
    solve(of_.start_);
    multiply(of_.start_.root, rooted_, change_);
  }

  /// The line response is not linear (products of s and k2, k3, ...): its derivatives serve from the solution
  /// at the noise of the minimisation to those at other noises.
  void find_lines() {
    find_change();
    lines_.resize(draws_.size());
    Eigen::VectorXd change(static_cast<Eigen::Index>(unknowns_));
    for (std::size_t b = 0; b < draws_.size(); ++b) {
      for (std::size_t i = 0; i < unknowns_; ++i) change(static_cast<Eigen::Index>(i)) = change_.at(i, b);
      lines_[b] = of_.model_.line_values_at(estimates_[b].value + change) - of_.line_rows_ * change;
    }
  }

  /// One step of the minimisation at the noise where it starts.
  void step() {
    find_change();
    multiply(of_.jacobian_, change_, moved_);
    for (std::size_t b = 0; b < draws_.size(); ++b) {
      auto& [value, steps] = estimates_[b];
      for (std::size_t i = 0; i < unknowns_; ++i) value(static_cast<Eigen::Index>(i)) += change_.at(i, b);
      for (std::size_t n = 0; n < steps.size(); ++n) {
        double step = 0.0;
        for (std::size_t j = 0; j < 3; ++j) {
          const std::size_t row = 3 * n + j;
          double left = data_.at(row, b) - moved_.at(row, b);
          if (!of_.hysteresis_.empty())
            left -= signs_.at(row, b) * change_.at(static_cast<std::size_t>(of_.hysteresis_[j]), b);
          step += of_.step_by_residual_[n](static_cast<Eigen::Index>(j)) * left;
        }
        steps[n] = step;
      }
    }
  }

  const Answer& answer_of(const NoiseCandidate& candidate) {
    const std::size_t number = of_.number_of_.at(candidate);
    Answer& answer = answers_[number];
    if (answer.known) return answer;
    answer.known = true;
    const Linear& linear = of_.linear_[number];
    solve(linear);
    multiply(linear.line, rooted_, line_);
    for (std::size_t b = 0; b < draws_.size(); ++b) {
      answer.chi2[b] = products_.at(0, b) + chi2_of_priors_[b] - fall_[b];
      answer.log_likelihood[b] = linear.constant - 0.5 * (answer.chi2[b] + growth_[b]);
      for (std::size_t k = 0; k < 12; ++k)
        answer.line(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(b)) = line_.at(k, b);
      if (!linear.has_process) continue;
      for (std::size_t k = 0; k < 3; ++k)
        answer.line(static_cast<Eigen::Index>(9 + k), static_cast<Eigen::Index>(b)) += process_mean(k, b);
    }
    return answer;
  }

  /// Mean of the process over the run, from what the readings leave; of output k.
  double process_mean(std::size_t k, std::size_t b) const {
    double mean = rooted_.at(unknowns_ + k, b);
    if (of_.hysteresis_.empty()) return mean;
    const std::size_t stride = of_.start_.from_data.padded_rows();
    for (std::size_t j = 0; j < 3; ++j) mean -= along_.at(j, b) * linked_.at(j * stride + unknowns_ + k, b);
    return mean;
  }

  const JointTrials& of_;
  std::size_t readings_, unknowns_;  ///< 3 N, and the number of the unknowns.
  std::vector<JointDraw> draws_;
  std::vector<Estimate> estimates_;
  std::vector<Vector12> lines_;  ///< Line response less the change to the solution by its derivatives.
  TrialRows data_;               ///< Residual; below it the unknowns less their prior means.
  TrialRows signs_;              ///< By how much the signs of the trials differ from those of the run (3 N).
  std::vector<ReadingElements> elements_;  ///< Those of signs_ that are not zero.
  TrialRows rooted_, linked_, products_, hysteresis_products_, taken_, along_, line_, change_, moved_;
  std::array<double, kTrialsTogether> chi2_of_priors_{}, growth_{};
  alignas(64) std::array<double, kTrialsTogether> fall_{};
  std::vector<Answer> answers_;
};

void JointTrials::operator()(std::uint64_t first, std::size_t count, double* out) const {
  Batch batch(*this);
  for (std::size_t begin = 0; begin < count; begin += kTrialsTogether) {
    const std::size_t size = std::min(kTrialsTogether, count - begin);
    batch.make(first + begin, size);
    for (std::size_t b = 0; b < size; ++b) {
      const OutputVector error = batch.error(b);
      for (Eigen::Index k = 0; k < kStudyOutputs; ++k)
        out[static_cast<std::size_t>(k) * count + begin + b] = error(k);
    }
  }
}

OutputVector JointTrials::solved_in_full(std::uint64_t trial) const {
  if (!posterior_.empty()) throw std::logic_error("effect_fit() takes no statements of a trial");
  const JointDraw drawn = draw(trial);
  const EffectFit fit = effect_fit(draws_.effect_readings_of(drawn), own_.options);
  if (!fit.converged) return OutputVector::Constant(std::numeric_limits<double>::quiet_NaN());
  return error_of(drawn, fit.line);
}

}  // namespace abcal
