#include "protocol/estimators/joint/tray_fit.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <optional>
#include <stdexcept>
#include <utility>

#include "protocol/estimators/joint/line_response.h"
#include "protocol/estimators/joint/step_strategy.h"
#include "protocol/estimators/shared/normal_matrix.h"
#include "protocol/estimators/shared/reading_kernels.h"
#include "protocol/estimators/shared/side_by_side.h"
#include "protocol/linear/products.h"
#include "protocol/linear/symmetric_eigen.h"

namespace abcal {
namespace {

/// Noises of an item that are less probable than this are left out of its average.
constexpr double kLeastWeight = 0.04;
/// Largest number of passes, each with a choice of noises.
constexpr int kNoisePasses = 3;

/// The linear problem of one item at one noise, its own unknowns eliminated. The common unknowns are those of
/// the stage, then the step errors of all angles.
struct Reduced {
  NormalMatrix own;
  Eigen::MatrixXd root;       ///< R: R R' is the covariance of the own unknowns, given the common ones.
  Eigen::MatrixXd link;       ///< D = R' N: own unknowns x common ones.
  Eigen::VectorXd own_right;  ///< R' b
  /// Diagonals of the normal matrix of all unknowns, without damping.
  Eigen::VectorXd own_diagonal, common_diagonal;
  Eigen::MatrixXd common;  ///< Normal matrix of the common unknowns from this item.
  Eigen::VectorXd right;
  double squares = 0.0;  ///< chi2 of the item's readings and own priors at the best own unknowns.
  std::optional<NoiseWhitener> whitener;  ///< Whitener of the noise without step errors.
};

/// The common unknowns solved for.
struct Common {
  NormalMatrix normal;
  Eigen::VectorXd right;
  Eigen::VectorXd change;
  double chi2 = 0.0;
};

/// One noise of an item: its index among those of the item's own fit, its probability given all readings, and
/// the line response with it.
struct Alternative {
  std::size_t noise = 0;
  double log_weight = 0.0;
  LineAtNoise line;
};

std::size_t best_of(const EffectSolution& own) {
  return static_cast<std::size_t>(std::max_element(own.weights.begin(), own.weights.end()) -
                                  own.weights.begin());
}

class Tray : public SumOfSquares {
 public:
  Tray(std::span<const TrayMember> members, std::span<const TrayAngle> angles);
  /// @return false: no convergence
  bool solve(int& iterations);
  TrayFit result();

  // The steps of the minimisation with one noise for each item.
  double cost() override;
  std::optional<double> solve_step(double damping, bool anew) override;
  void move() override;
  void move_back() override;

 private:
  EffectModel& model(std::size_t k) const { return *members_[k].own->model; }
  Eigen::Index own_count(std::size_t k) const { return model(k).layout().first_stage(); }
  const AssumedNoise& noise_of(std::size_t k) const { return members_[k].own->noises[noise_[k]]; }
  Eigen::Index common_count() const { return stage_count_ + step_count_; }

  void start();
  void move_models();
  double cost_of(std::size_t k) const;
  /// @param damping  relative addition to the diagonal of the normal matrix
  Reduced reduce(std::size_t k, const AssumedNoise& noise, double damping = 0.0) const;
  void add_steps_of(std::size_t k, const std::vector<NoiseAtAngle>& angles, Reduced& out) const;
  Common solve_common(const Eigen::MatrixXd& normal, const Eigen::VectorXd& right, double squares) const;
  void add_up(double damping);
  /// Solution of the common unknowns with another noise of item k; null: without that item.
  Common solve_with(std::size_t k, const Reduced* instead) const;
  Eigen::VectorXd own_change(std::size_t k, const Common& common) const;
  /// Derivatives of an item's line response by its own and the common unknowns (12 rows).
  struct Rows {
    Eigen::MatrixXd own_root, common;
    Vector12 start = Vector12::Zero();
    Covariance12 beyond = Covariance12::Zero();
    ReadingRows mean_weights;
  };
  Rows rows_of(std::size_t k, const AssumedNoise& noise, const Reduced& reduced) const;
  LineAtNoise line_of(std::size_t k, const AssumedNoise& noise, const Reduced& reduced,
                      const Common& common) const;
  void add_shares(std::size_t k, const Eigen::MatrixXd& of_own, const Eigen::MatrixXd& of_common,
                  LineAtNoise& line) const;
  ShareGroups groups_of(std::size_t k) const;
  void count_other_priors();
  void prepare_results();
  void weigh_noises(std::size_t k);
  EffectFit item_fit(std::size_t k) const;
  void fill_unknowns(std::size_t k, EffectFit& fit) const;
  void fill_stage(TrayFit& out) const;
  void fill_angle_errors(TrayFit& out) const;
  double given_others(std::size_t k) const;

  std::span<const TrayMember> members_;
  std::span<const TrayAngle> angles_;
  Eigen::Index stage_count_ = 0, step_count_ = 0;
  Eigen::VectorXd weight_;      ///< Weights of the priors of the common unknowns.
  Eigen::VectorXd from_prior_;  ///< Common unknowns minus their priors at the present point.
  /// The present point.
  struct Point {
    Eigen::VectorXd stage, steps;
    std::vector<Eigen::VectorXd> own;  ///< Unknowns of each item.
  };
  Point point_, before_;
  std::vector<std::size_t> noise_;  ///< Index of each member's noise among those of its own fit.
  std::vector<std::vector<Alternative>> alternatives_;  ///< For each member, its noise among them.
  std::vector<Reduced> reduced_;
  Eigen::MatrixXd normal_;  ///< Normal matrix of the common unknowns: priors and all items.
  Eigen::VectorXd right_;
  double squares_ = 0.0;
  Common common_;
  Eigen::MatrixXd common_covariance_;
  /// Contribution of the priors of an item's own unknowns to the common unknowns, and its sum over all items.
  std::vector<Eigen::MatrixXd> own_priors_;
  Eigen::MatrixXd sum_of_own_priors_;
};

Tray::Tray(std::span<const TrayMember> members, std::span<const TrayAngle> angles)
    : members_(members), angles_(angles) {
  if (members.empty()) throw std::invalid_argument("tray fit: no items");
  const EffectLayout& first = model(0).layout();
  for (std::size_t k = 0; k < members.size(); ++k) {
    const EffectLayout& layout = model(k).layout();
    if (layout.maps > 0)
      throw std::invalid_argument("tray fit: step errors that poses share are for the fit of one item");
    const bool same =
        std::equal(first.stage.begin(), first.stage.end(), layout.stage.begin(), layout.stage.end(),
                   [](const auto& a, const auto& b) { return a.effect == b.effect && a.index == b.index; });
    if (!same || model(k).step_sd() != model(0).step_sd())
      throw std::invalid_argument("tray fit: the items do not state the same stage");
  }
  stage_count_ = first.count() - first.first_stage();  // With the angles of the sweeps.
  step_count_ = model(0).step_sd() > 0.0 ? static_cast<Eigen::Index>(angles.size()) : 0;
  weight_.resize(common_count());
  weight_.head(stage_count_) = model(0).prior_weight().segment(own_count(0), stage_count_);
  weight_.tail(step_count_).setConstant(1.0 / (model(0).step_sd() * model(0).step_sd()));
  for (const TrayMember& member : members) noise_.push_back(best_of(*member.own));
  start();
}

/// Starts from the mean of the stage estimates of the items' own fits.
void Tray::start() {
  point_.stage = Eigen::VectorXd::Zero(stage_count_);
  point_.steps = Eigen::VectorXd::Zero(step_count_);
  Eigen::VectorXd seen = Eigen::VectorXd::Zero(step_count_);
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Eigen::VectorXd& value = model(k).value();
    point_.own.emplace_back(value.head(own_count(k)));
    point_.stage += value.segment(own_count(k), stage_count_) / static_cast<double>(members_.size());
    for (std::size_t n = 0; n < model(k).angles() && step_count_ > 0; ++n) {
      point_.steps(members_[k].angle[n]) += model(k).steps()[n];
      seen(members_[k].angle[n]) += 1.0;
    }
  }
  point_.steps = point_.steps.cwiseQuotient(seen.cwiseMax(1.0));
  move_models();
}

void Tray::move_models() {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Eigen::VectorXd value(own_count(k) + stage_count_);
    value << point_.own[k], point_.stage;
    std::vector<double> steps(model(k).angles(), 0.0);
    for (std::size_t n = 0; n < steps.size() && step_count_ > 0; ++n)
      steps[n] = point_.steps(members_[k].angle[n]);
    model(k).move_to(value, std::move(steps));
  }
  from_prior_.resize(common_count());
  from_prior_ << model(0).from_prior().segment(own_count(0), stage_count_), point_.steps;
}

double Tray::cost_of(std::size_t k) const {
  const AssumedNoise& noise = noise_of(k);
  ReadingRows left = model(k).misfit();
  NoiseWhitener(model(k).noise_at_angles(noise.white), 0.0, model(k).process_of(noise.tau, noise.rho))
      .whiten(left);
  const Eigen::Index own = own_count(k);
  return left.squaredNorm() +
         model(k).prior_weight().head(own).dot(model(k).from_prior().head(own).cwiseAbs2());
}

double Tray::cost() {
  if (!model(0).is_plausible()) return std::numeric_limits<double>::infinity();
  double out = weight_.dot(from_prior_.cwiseAbs2());
  for (std::size_t k = 0; k < members_.size(); ++k) out += cost_of(k);
  return out;
}

/// Adds F' V^-1 F, with F the derivatives by the step errors. With white noise it is diagonal.
void Tray::add_steps_of(std::size_t k, const std::vector<NoiseAtAngle>& angles, Reduced& out) const {
  if (step_count_ == 0) return;
  const std::vector<int>& angle = members_[k].angle;
  const auto count = static_cast<Eigen::Index>(angles.size());
  auto block = out.common.bottomRightCorner(step_count_, step_count_);
  if (out.whitener->mean_variance().isZero(0.0)) {
    for (std::size_t n = 0; n < angles.size(); ++n)
      block(angle[n], angle[n]) += angles[n].by_step.cwiseAbs2().cwiseQuotient(angles[n].white).sum();
    return;
  }
  ReadingRows weighted = ReadingRows::Zero(3 * count, count);
  for (Eigen::Index n = 0; n < count; ++n)
    weighted.block<3, 1>(3 * n, n) = angles[static_cast<std::size_t>(n)].by_step;
  out.whitener->whiten(weighted);
  out.whitener->whiten_transposed(weighted);
  for (Eigen::Index n = 0; n < count; ++n) {
    const Eigen::VectorXd row = transposed_product_by_rows_with_vector(
        weighted.middleRows<3>(3 * n), angles[static_cast<std::size_t>(n)].by_step);
    for (Eigen::Index m = 0; m < count; ++m)
      block(angle[static_cast<std::size_t>(n)], angle[static_cast<std::size_t>(m)]) += row(m);
  }
}

Reduced Tray::reduce(std::size_t k, const AssumedNoise& noise, double damping) const {
  const EffectModel& item = model(k);
  const Eigen::Index own = own_count(k);
  const Eigen::Index count = own + stage_count_;
  const std::vector<NoiseAtAngle> angles = item.noise_at_angles(noise.white);
  Reduced out;
  out.whitener.emplace(angles, 0.0, item.process_of(noise.tau, noise.rho));
  ReadingRows rows(item.jacobian().rows(), count + 1);
  rows << item.jacobian(), model(k).misfit();
  out.whitener->whiten(rows);
  const Eigen::MatrixXd products = products_of_columns(rows);
  out.whitener->whiten_transposed(rows);
  Eigen::MatrixXd by_angle = Eigen::MatrixXd::Zero(step_count_, count + 1);
  for (std::size_t n = 0; n < angles.size() && step_count_ > 0; ++n)
    by_angle.row(members_[k].angle[n]) +=
        angles[n].by_step.transpose() * rows.middleRows<3>(3 * static_cast<Eigen::Index>(n));

  const Eigen::VectorXd prior = item.prior_weight().head(own);
  const Eigen::VectorXd away = item.from_prior().head(own);
  Eigen::MatrixXd normal = products.topLeftCorner(own, own);
  normal.diagonal() += prior;
  out.own_diagonal = normal.diagonal();
  normal.diagonal() *= 1.0 + damping;
  out.own.compute(std::move(normal));
  out.root = out.own.covariance_root();
  Eigen::MatrixXd link(own, common_count());
  link << products.block(0, own, own, stage_count_), by_angle.leftCols(own).transpose();
  out.link = transposed_product(out.root, link);
  const Eigen::VectorXd own_right = products.col(count).head(own) - prior.cwiseProduct(away);
  out.own_right = transposed_product_with_vector(out.root, own_right);

  out.common = Eigen::MatrixXd::Zero(common_count(), common_count());
  out.common.topLeftCorner(stage_count_, stage_count_) = products.block(own, own, stage_count_, stage_count_);
  const auto crossed = by_angle.middleCols(own, stage_count_);
  out.common.bottomLeftCorner(step_count_, stage_count_) += crossed;
  out.common.topRightCorner(stage_count_, step_count_) += crossed.transpose();
  add_steps_of(k, angles, out);
  out.common_diagonal = out.common.diagonal();
  out.common.diagonal() *= 1.0 + damping;
  out.common -= products_of_columns(out.link);
  out.right.resize(common_count());
  out.right << products.col(count).segment(own, stage_count_), by_angle.col(count);
  out.right -= transposed_product_with_vector(out.link, out.own_right);
  out.squares = products(count, count) + prior.dot(away.cwiseAbs2()) - out.own_right.squaredNorm();
  return out;
}

Common Tray::solve_common(const Eigen::MatrixXd& normal, const Eigen::VectorXd& right, double squares) const {
  Common out;
  out.normal.compute(normal);
  out.right = right;
  out.change = out.normal.solve(right);
  out.chi2 = squares - right.dot(out.change);
  return out;
}

void Tray::add_up(double damping) {
  normal_ = (1.0 + damping) * weight_.asDiagonal().toDenseMatrix();
  right_ = -weight_.cwiseProduct(from_prior_);
  squares_ = weight_.dot(from_prior_.cwiseAbs2());
  for (const Reduced& item : reduced_) {
    normal_ += item.common;
    right_ += item.right;
    squares_ += item.squares;
  }
}

Common Tray::solve_with(std::size_t k, const Reduced* instead) const {
  const Reduced& now = reduced_[k];
  Eigen::MatrixXd normal = normal_ - now.common;
  Eigen::VectorXd right = right_ - now.right;
  double squares = squares_ - now.squares;
  if (instead != nullptr) {
    normal += instead->common;
    right += instead->right;
    squares += instead->squares;
  }
  return solve_common(normal, right, squares);
}

Eigen::VectorXd Tray::own_change(std::size_t k, const Common& common) const {
  const Reduced& item = reduced_[k];
  return product_with_vector(item.root, item.own_right - product_with_vector(item.link, common.change));
}

/// Solves first with the noise of each item's own fit, and again where all readings favour another one.
bool Tray::solve(int& iterations) {
  iterations = 0;
  for (int pass = 0; pass < kNoisePasses; ++pass) {
    const Minimum minimum = minimise(*this);
    iterations += minimum.iterations;
    if (!minimum.found) return false;
    prepare_results();
    bool changed = false;
    for (std::size_t k = 0; k < members_.size(); ++k) {
      const auto most = std::max_element(
          alternatives_[k].begin(), alternatives_[k].end(),
          [](const Alternative& a, const Alternative& b) { return a.log_weight < b.log_weight; });
      changed = changed || most->noise != noise_[k];
      if (pass + 1 < kNoisePasses) noise_[k] = most->noise;
    }
    if (!changed) break;
  }
  return true;
}

std::optional<double> Tray::solve_step(double damping, bool /*anew*/) {
  reduced_.resize(members_.size());
  side_by_side(members_.size(), [&](std::size_t k) { reduced_[k] = reduce(k, noise_of(k), damping); });
  for (const Reduced& item : reduced_) {
    if (!item.own.solvable()) return std::nullopt;
  }
  add_up(damping);
  common_ = solve_common(normal_, right_, squares_);
  if (!common_.normal.solvable() || !common_.change.allFinite()) return std::nullopt;
  const Eigen::VectorXd squares = common_.change.cwiseAbs2();
  double fall = common_.right.dot(common_.change) + damping * weight_.dot(squares);
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Reduced& item = reduced_[k];
    fall +=
        item.own_right.squaredNorm() + damping * (item.common_diagonal.dot(squares) +
                                                  item.own_diagonal.dot(own_change(k, common_).cwiseAbs2()));
  }
  return fall;
}

void Tray::move() {
  before_ = point_;
  for (std::size_t k = 0; k < members_.size(); ++k) point_.own[k] += own_change(k, common_);
  point_.stage += common_.change.head(stage_count_);
  point_.steps += common_.change.tail(step_count_);
  move_models();
}

void Tray::move_back() {
  point_ = before_;
  move_models();
}

Tray::Rows Tray::rows_of(std::size_t k, const AssumedNoise& noise, const Reduced& reduced) const {
  const EffectModel& item = model(k);
  const Eigen::Index own = own_count(k);
  Rows out;
  Rows12 of_line = item.line_rows();
  out.common = Eigen::MatrixXd::Zero(12, common_count());
  if (noise.tau > 0.0) {
    // The mean of the process over the run belongs to the offset.
    const std::vector<NoiseAtAngle> angles = item.noise_at_angles(noise.white);
    ReadingRows& weights = out.mean_weights = reduced.whitener->covariance_with_mean();
    reduced.whitener->whiten(weights);
    out.beyond.bottomRightCorner<3, 3>() = -products_of_columns(weights);
    out.beyond.bottomRightCorner<3, 3>().diagonal() += reduced.whitener->mean_variance();
    reduced.whitener->whiten_transposed(weights);
    out.start.tail<3>() = transposed_product_by_rows_with_vector(weights, model(k).misfit());
    of_line.bottomRows<3>() -= transposed_product_by_rows(weights, item.jacobian());
    for (std::size_t n = 0; n < angles.size() && step_count_ > 0; ++n)
      out.common.bottomRows<3>().col(stage_count_ + members_[k].angle[n]) -=
          weights.middleRows<3>(3 * static_cast<Eigen::Index>(n)).transpose() * angles[n].by_step;
  }
  out.common.leftCols(stage_count_) += of_line.middleCols(own, stage_count_);
  out.own_root = product(of_line.leftCols(own), reduced.root);
  out.common -= product(out.own_root, reduced.link);
  return out;
}

LineAtNoise Tray::line_of(std::size_t k, const AssumedNoise& noise, const Reduced& reduced,
                          const Common& common) const {
  const EffectModel& item = model(k);
  const Rows rows = rows_of(k, noise, reduced);
  LineAtNoise out;
  out.change = rows.start + product_with_vector(rows.own_root, reduced.own_right) +
               product_with_vector(rows.common, common.change);
  const Eigen::MatrixXd of_common = common.normal.solve_columns(rows.common.transpose());
  const Eigen::MatrixXd of_own =
      product(reduced.root, rows.own_root.transpose() - product(reduced.link, of_common));
  const Covariance12 covariance =
      covariance_of_root(rows.own_root) + product(rows.common, of_common) + rows.beyond;
  out.covariance = 0.5 * (covariance + covariance.transpose());
  add_shares(k, of_own, of_common, out);

  Eigen::MatrixXd response(own_count(k) + stage_count_, 12);
  response << of_own, of_common.topRows(stage_count_);
  out.gain = times(item.jacobian(), response);
  const std::vector<NoiseAtAngle> angles = item.noise_at_angles(noise.white);
  for (std::size_t n = 0; n < angles.size() && step_count_ > 0; ++n)
    out.gain.middleRows<3>(3 * static_cast<Eigen::Index>(n)) +=
        angles[n].by_step * of_common.row(stage_count_ + members_[k].angle[n]);
  reduced.whitener->whiten(out.gain);
  reduced.whitener->whiten_transposed(out.gain);
  if (noise.tau > 0.0) out.gain.rightCols<3>() += rows.mean_weights;
  add_share_of_signs(item, groups_of(k), out);
  return out;
}

/// The groups of the item's own budget, and one more: the own effects of the other items, which limit the
/// estimate of the stage.
ShareGroups Tray::groups_of(std::size_t k) const {
  ShareGroups out = share_groups(model(k));
  if (members_.size() < 2) return out;
  // It combines many sizes: the prior is 1 in units of each.
  EffectShare others{"effects of the other items", "", 0, 1.0, Covariance12::Zero()};
  for (std::size_t m = 0; m < members_.size(); ++m) {
    if (m != k)
      others.unknowns += static_cast<int>((model(m).prior_weight().head(own_count(m)).array() > 0.0).count());
  }
  out.groups.push_back(std::move(others));
  return out;
}

void Tray::count_other_priors() {
  sum_of_own_priors_ = Eigen::MatrixXd::Zero(common_count(), common_count());
  own_priors_.clear();
  for (std::size_t k = 0; k < members_.size(); ++k) {
    const Eigen::VectorXd sd_inverse = model(k).prior_weight().head(own_count(k)).cwiseSqrt();
    const ReadingRows of_priors = product(scaled_rows(sd_inverse, reduced_[k].root), reduced_[k].link);
    sum_of_own_priors_ += own_priors_.emplace_back(products_of_columns(of_priors));
  }
}

void Tray::add_shares(std::size_t k, const Eigen::MatrixXd& of_own, const Eigen::MatrixXd& of_common,
                      LineAtNoise& line) const {
  const ShareGroups groups = groups_of(k);
  line.shares.assign(groups.groups.size(), Covariance12::Zero());
  const Eigen::Index own = own_count(k);
  const auto add = [&](int group, double weight, const Eigen::RowVectorXd& row) {
    line.shares[static_cast<std::size_t>(group)].noalias() += weight * row.transpose() * row;
  };
  for (std::size_t i = 0; i < groups.of_unknown.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    if (groups.of_unknown[i] < 0) continue;
    add(groups.of_unknown[i], model(k).prior_weight()(at),
        at < own ? of_own.row(at) : of_common.row(at - own));
  }
  for (Eigen::Index a = 0; a < step_count_; ++a)
    add(groups.first_step + angles_[static_cast<std::size_t>(a)].experiment - 1, weight_(stage_count_ + a),
        of_common.row(stage_count_ + a));
  if (members_.size() < 2) return;
  line.shares.back() = carried_covariance(of_common.transpose(), sum_of_own_priors_ - own_priors_[k]);
}

/// The line response at the item's noise, and at every other noise that is probable by its own fit.
void Tray::weigh_noises(std::size_t k) {
  const EffectSolution& own = *members_[k].own;
  std::vector<Alternative>& out = alternatives_[k];
  out.clear();
  for (std::size_t i = 0; i < own.noises.size(); ++i) {
    const bool now = i == noise_[k];
    if (!now && !(own.weights[i] >= kLeastWeight)) continue;
    std::optional<Reduced> reduced;
    std::optional<Common> common;
    if (!now) {
      reduced = reduce(k, own.noises[i]);
      common = solve_with(k, &*reduced);
    }
    const Reduced& of_item = now ? reduced_[k] : *reduced;
    const Common& of_all = now ? common_ : *common;
    const double log_likelihood =
        -0.5 * (of_item.whitener->log_determinant() + of_item.own.log_determinant() +
                of_all.normal.log_determinant() + of_all.chi2);
    // Its prior probability is the posterior of the item's own fit without the likelihood of its readings.
    out.push_back({i, std::log(own.weights[i]) - own.log_likelihoods[i] + log_likelihood,
                   line_of(k, own.noises[i], of_item, of_all)});
  }
  double largest = out.front().log_weight;
  for (const Alternative& one : out) largest = std::max(largest, one.log_weight);
  double total = 0.0;
  for (const Alternative& one : out) total += std::exp(one.log_weight - largest);
  for (Alternative& one : out) one.log_weight -= largest + std::log(total);
}

void Tray::prepare_results() {
  common_covariance_ = common_.normal.covariance_root();
  common_covariance_ = products_of_columns(common_covariance_.transpose());
  count_other_priors();
  alternatives_.resize(members_.size());
  side_by_side(members_.size(), [&](std::size_t k) { weigh_noises(k); });
}

/// The item's fit from all readings, averaged over its probable noises. Its covariance is that at the chosen
/// noise plus the increase by the average (positive in every direction), so that the covariance of all items
/// together stays positive semidefinite.
EffectFit Tray::item_fit(std::size_t k) const {
  const EffectSolution& own = *members_[k].own;
  std::vector<LineAtNoise> lines;
  std::vector<double> weights;
  std::size_t at_noise = 0;
  for (const Alternative& one : alternatives_[k]) {
    if (one.noise == noise_[k]) at_noise = lines.size();
    lines.push_back(one.line);
    weights.push_back(std::exp(one.log_weight));
  }
  const LineAtNoise& at_best = lines[at_noise];
  EffectFit fit = own.fit;
  fit.degrees_of_freedom.setConstant(std::numeric_limits<double>::infinity());
  average_line(model(k), groups_of(k), lines, weights, fit);
  const SymmetricEigen added = symmetric_eigen(fit.covariance_line - at_best.covariance);
  fit.covariance_line =
      at_best.covariance +
      product_transposed(scaled_columns(added.vectors, added.values.cwiseMax(0.0)), added.vectors);
  fit.gain = at_best.gain;
  if (fit.noise.white_estimated) add_degrees_of_estimated_noise(model(k), own.white, fit.gain, fit);
  fill_unknowns(k, fit);
  restore_units(fit);
  return fit;
}

void Tray::fill_unknowns(std::size_t k, EffectFit& fit) const {
  const Reduced& reduced = reduced_[k];
  const Eigen::Index own = own_count(k);
  Eigen::VectorXd change(own + stage_count_);
  change << own_change(k, common_), common_.change.head(stage_count_);
  fit.value = model(k).value() + change;
  const Eigen::MatrixXd link = product(reduced.root, reduced.link);
  const Eigen::MatrixXd across = product(link, common_covariance_);
  fit.covariance.resize(own + stage_count_, own + stage_count_);
  fit.covariance.topLeftCorner(own, own) =
      covariance_of_root(reduced.root) + product_transposed(across, link);
  fit.covariance.topRightCorner(own, stage_count_) = -across.leftCols(stage_count_);
  fit.covariance.bottomLeftCorner(stage_count_, own) = -across.leftCols(stage_count_).transpose();
  fit.covariance.bottomRightCorner(stage_count_, stage_count_) =
      common_covariance_.topLeftCorner(stage_count_, stage_count_);
  for (std::size_t n = 0; n < fit.step_error.size() && step_count_ > 0; ++n) {
    const Eigen::Index at = members_[k].angle[n];
    fit.step_error[n] = point_.steps(at) + common_.change(stage_count_ + at);
    fit.u_step_error[n] = std::sqrt(common_covariance_(stage_count_ + at, stage_count_ + at));
  }
}

void Tray::fill_stage(TrayFit& out) const {
  EffectFit& stage = out.stage;
  const std::vector<EffectUnknown>& unknowns = model(0).unknowns();
  stage.unknowns.assign(unknowns.begin() + own_count(0), unknowns.end());
  stage.value = point_.stage + common_.change.head(stage_count_);
  stage.covariance = common_covariance_.topLeftCorner(stage_count_, stage_count_);
  for (Eigen::Index a = 0; a < step_count_; ++a) {
    stage.step_error.push_back(point_.steps(a) + common_.change(stage_count_ + a));
    stage.u_step_error.push_back(std::sqrt(common_covariance_(stage_count_ + a, stage_count_ + a)));
  }
  fill_angle_errors(out);
}

void Tray::fill_angle_errors(TrayFit& out) const {
  const auto count = static_cast<Eigen::Index>(angles_.size());
  const std::vector<EffectLayout::StageUnknown>& unknowns = model(0).layout().stage;
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(count, common_count());
  Eigen::MatrixXd mean = Eigen::MatrixXd::Zero(3, common_count());
  Eigen::Vector3d in_experiment = Eigen::Vector3d::Zero();
  for (Eigen::Index a = 0; a < count; ++a) {
    const TrayAngle& angle = angles_[static_cast<std::size_t>(a)];
    const StagePose pose = StagePose::of(angle.experiment, angle.face, angle.sin_alpha, angle.cos_alpha);
    const int moving = moving_angle_input(angle.experiment);
    for (std::size_t i = 0; i < unknowns.size(); ++i) {
      const StageShare share = unknowns[i].effect->share(pose, unknowns[i].index);
      if (share.input == moving) rows(a, static_cast<Eigen::Index>(i)) = share.value;
    }
    if (step_count_ > 0) rows(a, stage_count_ + a) = 1.0;
    mean.row(angle.experiment - 1) += rows.row(a);
    in_experiment(angle.experiment - 1) += 1.0;
  }
  for (Eigen::Index a = 0; a < count; ++a) {
    const int experiment = angles_[static_cast<std::size_t>(a)].experiment - 1;
    rows.row(a) -= mean.row(experiment) / in_experiment(experiment);
  }
  Eigen::VectorXd value(common_count());
  value << point_.stage, point_.steps;
  const Eigen::VectorXd error = product_with_vector(rows, value + common_.change);
  const Eigen::MatrixXd row_by_covariance = product(rows, common_covariance_);
  for (Eigen::Index a = 0; a < count; ++a) {
    out.angle_error.push_back(error(a));
    out.u_angle_error.push_back(std::sqrt(std::max(0.0, row_by_covariance.row(a).dot(rows.row(a)))));
  }
}

double Tray::given_others(std::size_t k) const {
  return common_.chi2 - solve_with(k, nullptr).chi2;
}

TrayFit Tray::result() {
  TrayFit out;
  out.chi2 = common_.chi2;
  const auto count = static_cast<Eigen::Index>(members_.size());
  Eigen::MatrixXd rows(12 * count, common_count());
  out.items.resize(members_.size());
  out.chi2_given_others.resize(members_.size());
  side_by_side(members_.size(), [&](std::size_t k) {
    rows.middleRows<12>(12 * static_cast<Eigen::Index>(k)) =
        scaled_rows(units_of_line(model(k).unit()), rows_of(k, noise_of(k), reduced_[k]).common);
    out.items[k] = item_fit(k);
    out.chi2_given_others[k] = given_others(k);
  });
  out.covariance = carried_covariance(rows, common_covariance_);
  for (Eigen::Index k = 0; k < count; ++k)
    out.covariance.block<12, 12>(12 * k, 12 * k) = out.items[static_cast<std::size_t>(k)].covariance_line;
  fill_stage(out);
  return out;
}

}  // namespace

TrayFit fit_tray(std::span<const TrayMember> members, std::span<const TrayAngle> angles) {
  Tray tray(members, angles);
  int iterations = 0;
  if (!tray.solve(iterations)) {
    TrayFit out;
    out.iterations = iterations;
    return out;
  }
  TrayFit out = tray.result();
  out.converged = true;
  out.iterations = iterations;
  return out;
}

}  // namespace abcal
