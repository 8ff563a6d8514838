#include "protocol/uncertainty/joint_trials.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "protocol/estimators/joint/line_response.h"
#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/estimators/shared/voltmeter.h"
#include "protocol/linear/products.h"
#include "protocol/uncertainty/random_shapes.h"

namespace abcal {
namespace {

/// Trials that one product of matrices serves. A divisor of the block of run_monte_carlo(), so that a trial
/// is always at the same place of its batch.
constexpr std::size_t kBatch = 50;
constexpr double kFewestDegrees = 3.0;
/// Steps of the minimisation: the first leaves what is of second order, the second less than 1e-3 u.
constexpr int kSteps = 2;

OutputVector outputs_of_line(const Vector12& line) {
  Eigen::Matrix3d s;
  for (Eigen::Index j = 0; j < 3; ++j) s.row(j) = line.segment<3>(3 * j).transpose();
  return to_vector(outputs_of(s, line.tail<3>()));
}

/// V^-1 times residuals that are whitened already, as by_step' of each angle needs it.
ReadingRows weighted(const NoiseWhitener& whitener, const ReadingRows& whitened) {
  ReadingRows out = whitened;
  whitener.whiten_transposed(out);
  return out;
}

}  // namespace

Eigen::Vector3d degrees_of_dwell(const DwellRecord& dwell) {
  Eigen::Vector3d out = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
  if (dwell.count < 2 || !dwell.u_mean) return out;
  for (Eigen::Index j = 0; j < 3; ++j) {
    const double u = (*dwell.u_mean)(j);
    if (!(u > 0.0)) continue;
    const double effective = std::min(static_cast<double>(dwell.count), std::pow(dwell.spread(j) / u, 2));
    out(j) = effective < 1.0 ? 0.0 : std::max(kFewestDegrees, effective - 1.0);
  }
  return out;
}

JointTrials::JointTrials(const ItemFit& own, const RunRecord& record, std::uint64_t seed)
    : own_(own),
      model_(*own.solution->model),
      sizes_(record.tolerances),
      seed_(seed),
      hysteresis_(model_.hysteresis_unknowns()) {
  question_ = {own.options.noise_process, own.options.white_known,
               static_cast<double>(model_.residual().size())};
  units_ = units_of_line(model_.unit());
  result_ = own.solution->fit.line;
  for (const DwellRecord* dwell : own.data.dwells)
    degrees_.push_back(own.options.white_known
                           ? degrees_of_dwell(*dwell)
                           : Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity()));
  prior_mean_ = model_.value() - model_.from_prior();
  for (const EffectUnknown& unknown : model_.unknowns())
    shapes_.push_back(is_measured(own.options.measured_alignment, unknown.effect)
                          ? Shape::kNormal
                          : sizes_.shape_of(unknown.key));
  start_ = solve_at(model_, {.step_sd = model_.step_sd()});
  start_root_ = start_.normal.covariance_root();
  start_angles_ = model_.noise_at_angles(Eigen::Vector3d::Ones());
  for (const NoiseCandidate& candidate : noise_candidates(question_)) add(candidate);
}

void JointTrials::add(const NoiseCandidate& candidate) {
  Linear linear;
  AtNoise& at = linear.at = solve_at(model_, assumed_noise(model_, own_.solution->white, candidate));
  linear.constant = at.log_likelihood + 0.5 * at.chi2;
  linear.root = at.normal.covariance_root();
  Rows12 rows = model_.line_rows();
  if (candidate.tau > 0.0) {
    // As in effect_fit(): the mean of the process over the run belongs to the offset.
    linear.mean_weights = at.whitener->covariance_with_mean();
    at.whitener->whiten(linear.mean_weights);
    rows.bottomRows<3>() -= transposed_product_by_rows(linear.mean_weights, at.whitened_jacobian);
  }
  linear.line_root = transposed_product(linear.root, rows.transpose());
  linear_.emplace(candidate, std::move(linear));
}

void JointTrials::draw_effects(RandomStream& stream, JointDraw& draw) const {
  draw.value = model_.value();
  for (std::size_t i = 0; i < shapes_.size(); ++i) {
    const EffectUnknown& unknown = model_.unknowns()[i];
    if (!std::isfinite(unknown.prior_sd)) continue;  // s and O: those of the fitted item
    draw.value(static_cast<Eigen::Index>(i)) =
        unknown.prior_mean + unknown.prior_sd * standard_draw(shapes_[i], stream);
  }
  draw.steps.assign(model_.angles(), 0.0);
  if (!(model_.step_sd() > 0.0)) return;
  const Shape shape = sizes_.shape_of("step_deg");
  // All have the stated size; the fit assumes a larger one at some angles out of caution.
  for (std::size_t n = 0; n < draw.steps.size(); ++n)
    draw.steps[n] = model_.step_sd() * standard_draw(shape, stream) / model_.step_factor(n);
}

void JointTrials::draw_noise(RandomStream& stream, JointDraw& draw) const {
  const EffectSolution& solution = *own_.solution;
  std::size_t chosen = 0;
  for (double left = stream.uniform(); chosen + 1 < solution.weights.size(); ++chosen)
    if ((left -= solution.weights[chosen]) < 0.0) break;
  const AssumedNoise& noise = solution.noises[chosen];
  Eigen::Vector3d white = noise.white;
  if (!own_.options.white_known) {
    // The posterior of a variance that nu residuals estimated.
    for (Eigen::Index j = 0; j < 3; ++j) {
      const double nu = std::max(kFewestDegrees, solution.white.redundancy(j));
      white(j) *= std::sqrt(nu / chi2_draw(nu, stream));
    }
  }
  const std::vector<NoiseAtAngle> angles = model_.stated_noise_at_angles(white);
  const NoiseProcess process = model_.process_of(noise.tau, noise.rho);
  draw.noise.resize(3 * static_cast<Eigen::Index>(angles.size()));
  Eigen::Vector3d state = Eigen::Vector3d::Zero();
  for (std::size_t n = 0; n < angles.size(); ++n) {
    const double decay = n > 0 ? std::exp(-angles[n].distance / noise.rho) : 0.0;
    for (Eigen::Index j = 0; j < 3; ++j) {
      const double nu = degrees_[n](j);
      const double z = nu > 0.0 ? student_t_draw(nu, stream) : standard_draw(Shape::kRectangular, stream);
      if (noise.tau > 0.0)
        state(j) = decay * state(j) + std::sqrt(1.0 - decay * decay) * process.tau(j) * stream.normal();
      draw.noise(3 * static_cast<Eigen::Index>(n) + j) = std::sqrt(angles[n].white(j)) * z + state(j);
    }
    draw.process_mean += state / static_cast<double>(angles.size());
  }
}

JointDraw JointTrials::draw(std::uint64_t trial) const {
  JointDraw draw;
  RandomStream effects(seed_, StreamPurpose::kEffects, trial);
  RandomStream noise(seed_, StreamPurpose::kReadings, trial);
  draw_effects(effects, draw);
  draw.came_from = model_.came_from_at(draw.value, draw.steps);
  draw_noise(noise, draw);
  if (!states_voltmeter(sizes_)) return draw;
  Eigen::Matrix3d s;
  for (Eigen::Index j = 0; j < 3; ++j) s.row(j) = result_.segment<3>(3 * j).transpose();
  draw.by_voltmeter = effect_of_gain(s, result_.tail<3>(), sizes_) *
                      standard_draw(sizes_.shape_of("voltmeter_gain"), effects);
  for (Eigen::Index j = 0; j < 3; ++j)
    draw.by_voltmeter(9 + j) += sizes_.voltmeter_offset * s.row(j).norm() *
                                standard_draw(sizes_.shape_of("voltmeter_offset"), effects);
  return draw;
}

Eigen::VectorXd JointTrials::readings_of(const JointDraw& draw) const {
  return model_.readings_at(draw.value, draw.steps, draw.came_from) + draw.noise;
}

Vector12 JointTrials::truth_of(const JointDraw& draw) const {
  Vector12 truth = model_.line_values_at(draw.value);
  truth.tail<3>() += draw.process_mean;
  return truth.cwiseProduct(units_);
}

/// @param line  the estimate (R)
OutputVector JointTrials::error_of(const JointDraw& draw, const Vector12& line) const {
  return outputs_of_line(line + draw.by_voltmeter) - outputs_of_line(truth_of(draw));
}

/// The trials of one batch, from the readings to the estimates.
class JointTrials::Batch {
 public:
  Batch(const JointTrials& trials, std::uint64_t first, std::size_t count)
      : of_(trials), count_(static_cast<Eigen::Index>(count)) {
    for (std::size_t b = 0; b < count; ++b) {
      draws_.push_back(of_.draw(first + b));
      values_.push_back(draws_.back().value);
      steps_.push_back(draws_.back().steps);
    }
    signs_.resize(count);
    sign_columns_ = ReadingRows::Zero(of_.model_.residual().size(), 3 * count_);
    for (std::size_t b = 0; b < count; ++b) take_signs(b, draws_[b].came_from);
    // From the truth, where the misfit is the noise.
    residual_.resize(of_.model_.residual().size(), count_);
    for (int i = 0; i < kSteps; ++i) {
      for (std::size_t b = 0; b < count; ++b) {
        if (i > 0 && !of_.hysteresis_.empty()) take_signs(b, of_.model_.mean_signs_at(values_[b], steps_[b]));
        set_residual(b,
                     of_.readings_of(draws_[b]) - of_.model_.readings_at(values_[b], steps_[b], signs_[b]));
      }
      step();
    }
  }

  OutputVector error(std::size_t b) {
    const auto at = static_cast<Eigen::Index>(b);
    const ProbableNoises found = probable_noises(of_.question_, [&](const NoiseCandidate& candidate) {
      const BatchAnswer& answer = answer_of(candidate);
      return NoiseLikelihood{answer.log_likelihood(at), answer.chi2(at)};
    });
    Vector12 line = of_.model_.line_values_at(values_[b]);
    for (const ProbableNoise& one : found.noises)
      line += std::exp(one.log_weight) * answer_of(one.noise).line.col(at);
    return of_.error_of(draws_[b], line.cwiseProduct(of_.units_));
  }

 private:
  /// The residual of a trial with the eliminated step errors not in the model.
  void set_residual(std::size_t b, const Eigen::VectorXd& misfit) {
    auto column = residual_.col(static_cast<Eigen::Index>(b));
    column = misfit;
    for (std::size_t n = 0; n < steps_[b].size(); ++n)
      column.segment<3>(3 * static_cast<Eigen::Index>(n)) += of_.start_angles_[n].by_step * steps_[b][n];
  }

  /// Unknowns less their prior means, of each trial.
  Eigen::MatrixXd from_priors() const {
    Eigen::MatrixXd out(of_.prior_mean_.size(), count_);
    for (Eigen::Index b = 0; b < count_; ++b)
      out.col(b) = values_[static_cast<std::size_t>(b)] - of_.prior_mean_;
    return out;
  }

  /// The normal equations of the trials, solved.
  struct Solved {
    Eigen::MatrixXd rooted;         ///< Unknowns x trials: R times it is the change of the unknowns.
    Eigen::RowVectorXd fall;        ///< Fall of chi2.
    Eigen::RowVectorXd growth;      ///< Growth of the logarithm of the normal matrix's determinant.
    ReadingRows whitened_of_signs;  ///< sign_columns_, whitened; empty: no hysteresis.
  };

  /// Solves N change = J' V^-1 residual - P (value - prior), with the derivatives at the solution of the run,
  /// but by the hysteresis with the signs of each trial. These change columns of J by E = sign_columns_, and
  /// N by U M U' with U = [S, J' V^-1 E], where S selects the unknowns of the hysteresis, and M^-1 = [0, 1;
  /// 1, -E' V^-1 E] (Woodbury's identity).
  Solved solve(const AtNoise& at, const Eigen::MatrixXd& root, const ReadingRows& whitened) const {
    Eigen::MatrixXd right = transposed_product_by_rows(at.whitened_jacobian, whitened);
    right -= scaled_rows(of_.model_.prior_weight(), from_priors());
    Solved out;
    out.growth = Eigen::RowVectorXd::Zero(count_);
    const std::vector<Eigen::Index>& hysteresis = of_.hysteresis_;
    if (hysteresis.empty()) {
      out.rooted = transposed_product(root, right);
      out.fall = out.rooted.colwise().squaredNorm();
      return out;
    }
    out.fall.resize(count_);
    ReadingRows& columns = out.whitened_of_signs = sign_columns_;
    at.whitener->whiten(columns);
    for (Eigen::Index b = 0; b < count_; ++b) {
      for (Eigen::Index j = 0; j < 3; ++j)
        right(hysteresis[static_cast<std::size_t>(j)], b) += columns.col(3 * b + j).dot(whitened.col(b));
    }
    out.rooted = transposed_product(root, right);
    const Eigen::MatrixXd linked =
        transposed_product(root, transposed_product_by_rows(at.whitened_jacobian, columns));
    // U in units of the stated size, so that the elements of the inner matrix are comparable.
    const double size = of_.model_.unknowns()[static_cast<std::size_t>(hysteresis.front())].prior_sd;
    Eigen::Matrix<double, Eigen::Dynamic, 6> update(root.cols(), 6);
    for (std::size_t j = 0; j < 3; ++j)
      update.col(static_cast<Eigen::Index>(j)) = root.row(hysteresis[j]).transpose() / size;
    for (Eigen::Index b = 0; b < count_; ++b) {
      const auto own = columns.middleCols<3>(3 * b);
      update.rightCols<3>() = size * linked.middleCols<3>(3 * b);
      Eigen::Matrix<double, 6, 6> inner = update.transpose() * update;
      inner.topRightCorner<3, 3>() += Eigen::Matrix3d::Identity();
      inner.bottomLeftCorner<3, 3>() += Eigen::Matrix3d::Identity();
      inner.bottomRightCorner<3, 3>() -= size * size * own.transpose() * own;
      const Eigen::PartialPivLU<Eigen::Matrix<double, 6, 6>> factor(inner);
      const Eigen::Matrix<double, 6, 1> along = update.transpose() * out.rooted.col(b);
      const Eigen::Matrix<double, 6, 1> taken = factor.solve(along);
      out.fall(b) = out.rooted.col(b).squaredNorm() - along.dot(taken);
      out.growth(b) = std::log(std::abs(factor.determinant()));
      out.rooted.col(b) -= update * taken;
    }
    return out;
  }

  /// Effect on whitened readings (3 N x trials) of what the trials' signs change in the columns of J.
  ReadingRows by_signs(const ReadingRows& columns, const Eigen::MatrixXd& change) const {
    ReadingRows out = ReadingRows::Zero(columns.rows(), count_);
    for (Eigen::Index b = 0; b < count_; ++b) {
      for (Eigen::Index j = 0; j < 3; ++j)
        out.col(b) += change(of_.hysteresis_[static_cast<std::size_t>(j)], b) * columns.col(3 * b + j);
    }
    return out;
  }

  /// Takes the signs of the present estimates.
  void take_signs(std::size_t b, std::vector<Eigen::Vector3d> signs) {
    const std::vector<Eigen::Vector3d>& of_run = of_.model_.signs().mean;
    for (std::size_t n = 0; n < signs.size(); ++n) {
      for (Eigen::Index j = 0; j < 3; ++j)
        sign_columns_(3 * static_cast<Eigen::Index>(n) + j, 3 * static_cast<Eigen::Index>(b) + j) =
            signs[n](j) - of_run[n](j);
    }
    signs_[b] = std::move(signs);
  }

  /// One step of the minimisation, with the derivatives at the solution of the run.
  void step() {
    const AtNoise& at = of_.start_;
    ReadingRows whitened = residual_;
    at.whitener->whiten(whitened);
    const Solved solved = solve(at, of_.start_root_, whitened);
    const Eigen::MatrixXd change = product(of_.start_root_, solved.rooted);
    whitened -= times(at.whitened_jacobian, change);
    residual_ -= times(of_.model_.jacobian(), change);
    if (!of_.hysteresis_.empty()) {
      whitened -= by_signs(solved.whitened_of_signs, change);
      residual_ -= by_signs(sign_columns_, change);
    }
    const ReadingRows left = weighted(*at.whitener, whitened);
    const double variance = of_.model_.step_sd() * of_.model_.step_sd();
    for (Eigen::Index b = 0; b < count_; ++b) {
      const auto k = static_cast<std::size_t>(b);
      values_[k] += change.col(b);
      for (std::size_t n = 0; n < steps_[k].size(); ++n)
        steps_[k][n] = variance * of_.start_angles_[n].by_step.dot(
                                      left.col(b).segment<3>(3 * static_cast<Eigen::Index>(n)));
    }
  }

  const BatchAnswer& answer_of(const NoiseCandidate& candidate) {
    const auto known = answers_.find(candidate);
    if (known != answers_.end()) return known->second;
    const Linear& linear = of_.linear_.at(candidate);
    ReadingRows whitened = residual_;
    linear.at.whitener->whiten(whitened);
    const Eigen::MatrixXd priors = from_priors();
    const Solved solved = solve(linear.at, linear.root, whitened);
    BatchAnswer answer;
    answer.chi2 = whitened.colwise().squaredNorm();
    answer.chi2 += priors.cwiseProduct(scaled_rows(of_.model_.prior_weight(), priors)).colwise().sum();
    answer.chi2 -= solved.fall;
    answer.log_likelihood = linear.constant - 0.5 * (answer.chi2.array() + solved.growth.array());
    answer.line = transposed_product(linear.line_root, solved.rooted);
    if (linear.mean_weights.size() > 0) {
      if (!of_.hysteresis_.empty())
        whitened -= by_signs(solved.whitened_of_signs, product(linear.root, solved.rooted));
      answer.line.bottomRows<3>() += transposed_product_by_rows(linear.mean_weights, whitened);
    }
    return answers_.emplace(candidate, std::move(answer)).first->second;
  }

  const JointTrials& of_;
  Eigen::Index count_;
  std::vector<JointDraw> draws_;
  std::vector<Eigen::VectorXd> values_;
  std::vector<std::vector<double>> steps_;
  std::vector<std::vector<Eigen::Vector3d>> signs_;  ///< For the hysteresis, of the estimates.
  /// 3 N x 3 for each trial: by how much its signs differ from those of the run, column by column.
  ReadingRows sign_columns_;
  ReadingRows residual_;  ///< 3 N x trials
  std::map<NoiseCandidate, BatchAnswer> answers_;
};

void JointTrials::operator()(std::uint64_t first, std::size_t count, double* out) const {
  for (std::size_t begin = 0; begin < count; begin += kBatch) {
    const std::size_t size = std::min(kBatch, count - begin);
    Batch batch(*this, first + begin, size);
    for (std::size_t b = 0; b < size; ++b) {
      const OutputVector error = batch.error(b);
      for (Eigen::Index k = 0; k < kStudyOutputs; ++k)
        out[static_cast<std::size_t>(k) * count + begin + b] = error(k);
    }
  }
}

OutputVector JointTrials::solved_in_full(std::uint64_t trial) const {
  const JointDraw drawn = draw(trial);
  const Eigen::VectorXd made = readings_of(drawn);
  std::vector<EffectReading> readings = own_.data.readings;
  for (std::size_t n = 0; n < readings.size(); ++n)
    readings[n].value = made.segment<3>(3 * static_cast<Eigen::Index>(n)).cwiseProduct(model_.unit());
  const EffectFit fit = effect_fit(readings, own_.options);
  if (!fit.converged) return OutputVector::Constant(std::numeric_limits<double>::quiet_NaN());
  return error_of(drawn, fit.line);
}

}  // namespace abcal
