#include "protocol/estimators/norm/norm_model.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>

#include "protocol/estimators/shared/intrinsic_properties.h"
#include "protocol/estimators/shared/known_acs_fit.h"
#include "protocol/estimators/shared/unusable_data.h"
#include "protocol/linear/cholesky.h"
#include "protocol/linear/lu.h"
#include "protocol/linear/pivoted_qr.h"
#include "protocol/linear/products.h"

namespace abcal {
namespace {

constexpr Eigen::Index kBasic = 9;
using Basic = Eigen::Matrix<double, kBasic, 1>;
/// Rows and columns of the six elements of the upper triangular B; unknowns 6..8 are the offset.
constexpr std::array<Eigen::Index, 6> kRow{0, 0, 0, 1, 1, 2};
constexpr std::array<Eigen::Index, 6> kColumn{0, 1, 2, 1, 2, 2};
/// Reciprocal condition of the column-scaled design below which the nine unknowns cannot be separated.
constexpr double kSingular = 1e-9;
constexpr double kDegrees = 180.0 / std::numbers::pi;

UnusableData undetermined(std::size_t poses) {
  return UnusableData(fmt::format(
      "norm fit: {} poses do not determine the nine unknowns; poses all over the sphere are required",
      poses));
}

Eigen::Matrix3d upper(const Eigen::VectorXd& x) {
  Eigen::Matrix3d b = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < 6; ++i) b(kRow[i], kColumn[i]) = x(static_cast<Eigen::Index>(i));
  return b;
}

/// The quadric (r - O)' M (r - O) = 1 by linear least squares; without cross terms (axes at right angles)
/// where there are fewer poses than unknowns.
Basic start(std::span<const NormPose> poses) {
  const auto n = static_cast<Eigen::Index>(poses.size());
  const bool crossed = n >= kBasic;
  Eigen::MatrixXd design(n, crossed ? 9 : 6);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector3d& r = poses[static_cast<std::size_t>(i)].reading;
    design.row(i).head<3>() = r.cwiseAbs2().transpose();
    design.row(i).tail<3>() = 2.0 * r.transpose();
    if (crossed) design.row(i).segment<3>(3) << 2.0 * r.x() * r.y(), 2.0 * r.x() * r.z(), 2.0 * r.y() * r.z();
  }
  const PivotedQr qr(design);
  if (qr.rank_above(kSingular) < design.cols()) throw undetermined(poses.size());
  const Eigen::VectorXd p = qr.solve_vector(Eigen::VectorXd::Ones(n));
  Eigen::Matrix3d m = p.head<3>().asDiagonal();
  if (crossed) {
    m(0, 1) = m(1, 0) = p(3);
    m(0, 2) = m(2, 0) = p(4);
    m(1, 2) = m(2, 1) = p(5);
  }
  const Eigen::Vector3d offset = -solve_by_lu(m, p.tail<3>());
  const Eigen::Matrix3d unit = m / (1.0 + offset.dot(m * offset));
  const Eigen::LLT<Eigen::Matrix3d> llt(unit);
  if (llt.info() != Eigen::Success || !offset.allFinite()) throw undetermined(poses.size());
  const Eigen::Matrix3d b = llt.matrixU();
  Basic x;
  for (std::size_t i = 0; i < 6; ++i) x(static_cast<Eigen::Index>(i)) = b(kRow[i], kColumn[i]);
  x.tail<3>() = offset;
  return x;
}

/// Poses of one stated direction.
struct StatedDirection {
  Eigen::Matrix<double, 3, 2> across;  ///< Two axes across it, of length 1.
  std::vector<std::size_t> poses;
};

/// Degrees of freedom of a variance of some rows that their residuals give: with H their block of the hat
/// matrix, twice the squared mean of that estimate over its variance.
/// @param weighted  the rows; fitted: their product with the cofactor
double degrees_of_rows(const MatrixView& weighted, const MatrixView& fitted, double redundancy) {
  const Eigen::MatrixXd hat = transposed_product(fitted, weighted);
  const double squares =
      2.0 * redundancy - static_cast<double>(weighted.rows()) + hat.cwiseProduct(hat.transpose()).sum();
  return redundancy * redundancy / std::max(squares, 1e-12);
}

class NormProblem {
 public:
  NormProblem(std::span<const NormPose> poses, const NormModel& model) : poses_(poses), model_(model) {
    for (const ItemEffect& effect : item_effects()) {
      if (effect.in_motion || !is_fitted(effect, model.sizes, model.drift, model.nonlinearity)) continue;
      const double prior = effect.prior(model.sizes);
      for (int i = 0; i < effect.count; ++i) effects_.push_back({&effect, i, prior});
    }
    own_ = static_cast<Eigen::Index>(effects_.size());
    count_ = kBasic + 3 * own_;
    if (poses.empty() ||
        !std::ranges::all_of(poses, [](const NormPose& pose) { return pose.up.has_value(); }))
      return;
    constexpr double kSame = 1e-9;  // Directions nearer than this are one.
    std::map<std::array<long long, 3>, std::size_t> known;
    for (std::size_t i = 0; i < poses.size(); ++i) {
      const Eigen::Vector3d& up = *poses[i].up;
      std::array<long long, 3> key{};
      for (std::size_t k = 0; k < 3; ++k) key[k] = std::llround(up(static_cast<Eigen::Index>(k)) / kSame);
      const auto [place, is_new] = known.try_emplace(key, directions_.size());
      if (is_new) {
        const Eigen::Vector3d first = up.unitOrthogonal();
        directions_.emplace_back().across << first, up.cross(first);
      }
      directions_[place->second].poses.push_back(i);
    }
  }

  NormSolution solve(const Eigen::VectorXd& from) {
    NormSolution out;
    const auto n = static_cast<Eigen::Index>(poses_.size());
    out.unknowns = from.size() == count_ ? from : Eigen::VectorXd::Zero(count_);
    if (from.size() != count_)
      out.unknowns.head<kBasic>() = from.size() > 0 ? Basic(from.head<kBasic>())
                                    : is_directed() ? Basic::Zero()
                                                    : start(poses_);
    if (is_directed()) start_along_directions(out);
    const Eigen::Index rows = n + 2 * static_cast<Eigen::Index>(directions_.size());
    jacobian_.resize(rows, columns());
    by_reading_.resize(n, 3);
    residual_.resize(rows);
    variance_.resize(rows);
    out.direction.resize(poses_.size());
    bool converged = false;
    for (int iteration = 0; iteration < 50 && !converged; ++iteration) {
      evaluate(out);
      const Eigen::VectorXd change = step(out);
      if (iteration == 0 && !(reciprocal_condition(out) > kSingular)) throw undetermined(poses_.size());
      out.unknowns += change.head(count_);
      if (is_directed()) turn_by(change.tail<3>(), out.orientation->turn);
      if (!out.unknowns.allFinite()) break;
      const double size = out.unknowns.head<kBasic>().norm();
      converged = change.norm() <= 1e-13 * size * std::sqrt(static_cast<double>(kBasic)) ||
                  (iteration > 3 && change.norm() <= 1e-11 * size);
    }
    if (!converged)
      throw UnusableData("norm fit: did not converge; the readings are not those of gravity alone");
    finish(out);
    return out;
  }

 private:
  struct Own {
    const ItemEffect* effect;
    int index;
    double prior;
  };

  bool is_directed() const { return !directions_.empty(); }
  /// Columns of the design: the unknowns, then the turn of the mount.
  Eigen::Index columns() const { return count_ + (is_directed() ? 3 : 0); }
  Eigen::Index column(int output, Eigen::Index own) const { return kBasic + own_ * output + own; }

  static void turn_by(const Eigen::Vector3d& angles, Eigen::Matrix3d& turn) {
    if (const double size = angles.norm(); size > 0.0)
      turn = Eigen::AngleAxisd(size, angles / size).toRotationMatrix() * turn;
  }

  /// B, O and the turn of the linear solution.
  void start_along_directions(NormSolution& at) const {
    std::vector<Eigen::Vector3d> ups, readings;
    for (const NormPose& pose : poses_) {
      ups.push_back(*pose.up);
      readings.push_back(pose.reading);
    }
    const KnownAcsFit line = linear_fit_given_acs(ups, readings);
    const Eigen::Matrix3d& s = line.sensitivity_matrix;
    const Eigen::LLT<Eigen::Matrix3d> llt(Eigen::Matrix3d(s * s.transpose()).inverse());
    if (llt.info() != Eigen::Success) throw undetermined(poses_.size());
    const Eigen::Matrix3d b = llt.matrixU();
    for (std::size_t i = 0; i < 6; ++i) at.unknowns(static_cast<Eigen::Index>(i)) = b(kRow[i], kColumn[i]);
    at.unknowns.segment<3>(6) = line.offset;
    at.orientation.emplace().turn = (b * s).transpose();
  }

  /// Linear response y, the reading z without the effects of the item: z = y + effects(y).
  struct Linear {
    Eigen::Vector3d y;
    Eigen::Vector3d slope;                           ///< dz/dy
    Eigen::Matrix<double, 3, Eigen::Dynamic> share;  ///< Derivatives of z: 3 x effects.
  };
  Linear linear_of(const NormPose& pose, const Eigen::Vector3d& z, const Eigen::VectorXd& x) const {
    Linear out{z, Eigen::Vector3d::Ones(), Eigen::Matrix<double, 3, Eigen::Dynamic>::Zero(3, own_)};
    for (int pass = 0; pass < 12 && own_ > 0; ++pass) {
      const ItemPoint point{pose.t, out.y, pose.came_from};
      Eigen::Vector3d change;
      for (int j = 0; j < 3; ++j) {
        double sum = 0.0, slope = 1.0;
        for (Eigen::Index k = 0; k < own_; ++k) {
          const Own& own = effects_[static_cast<std::size_t>(k)];
          const ItemShare share = own.effect->share(point, j, own.index);
          const double p = x(column(j, k));
          sum += share.value * p;
          slope += share.by_y * p;
          out.share(j, k) = share.value;
        }
        out.slope(j) = slope;
        change(j) = (z(j) - sum - out.y(j)) / slope;
      }
      out.y += change;
      if (change.cwiseAbs().maxCoeff() < 1e-15) break;
    }
    return out;
  }

  void evaluate(NormSolution& at) {
    const Eigen::Matrix3d b = upper(at.unknowns);
    const Eigen::Matrix3d s = b.triangularView<Eigen::Upper>().solve(Eigen::Matrix3d::Identity());
    const Eigen::Vector3d unit = s.rowwise().norm();
    const Eigen::Index across = 2 * static_cast<Eigen::Index>(directions_.size());
    jacobian_.bottomRows(across).setZero();
    residual_.tail(across).setZero();
    variance_.tail(across).setConstant(model_.turn_variance > 0.0 ? model_.turn_variance : 1.0);
    by_reading_across_.assign(is_directed() ? poses_.size() : 0, {});
    std::vector<Linear> linears(is_directed() ? poses_.size() : 0);
    for (std::size_t i = 0; i < poses_.size(); ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      const NormPose& pose = poses_[i];
      const Eigen::Vector3d z = (pose.reading - at.unknowns.segment<3>(6)).cwiseQuotient(unit);
      const Linear linear = linear_of(pose, z, at.unknowns);
      const Eigen::Vector3d l = linear.y.cwiseProduct(unit);
      const Eigen::Vector3d a = b * l;
      const double norm = a.norm();
      const Eigen::Vector3d e = a / norm;
      const Eigen::Vector3d by_linear = b.transpose() * e;
      const Eigen::Vector3d gradient = by_linear.cwiseQuotient(linear.slope);  // d norm / d reading
      at.direction[i] = e;
      residual_(row) = norm - 1.0;
      variance_(row) =
          pose.u ? gradient.cwiseProduct(*pose.u).squaredNorm() + model_.common_variance
                 : (model_.common_variance > 0.0 ? model_.common_variance / model_.norm_weight : 1.0);
      by_reading_.row(row) = gradient.transpose();
      jacobian_.row(row).setZero();
      add_to_row(row, 1.0, e, gradient, l, unit, linear.share);
      if (is_directed()) linears[i] = linear;
    }
    evaluate_across(at, b, unit, linears);
    const auto n = static_cast<Eigen::Index>(poses_.size());
    at.residual = residual_.head(n);
    at.variance = variance_.head(n);
  }

  /// Adds `part` of the derivatives of the component of B (l - O) along `along`.
  /// @param gradient  its derivatives by the readings
  template <class Share>
  void add_to_row(Eigen::Index row, double part, const Eigen::Vector3d& along,
                  const Eigen::Vector3d& gradient, const Eigen::Vector3d& l, const Eigen::Vector3d& unit,
                  const Share& share) {
    for (std::size_t k = 0; k < 6; ++k)
      jacobian_(row, static_cast<Eigen::Index>(k)) += part * along(kRow[k]) * l(kColumn[k]);
    jacobian_.row(row).segment<3>(6) -= part * gradient.transpose();
    for (int j = 0; j < 3; ++j) {
      for (Eigen::Index k = 0; k < own_; ++k)
        jacobian_(row, column(j, k)) -= part * gradient(j) * unit(j) * share(j, k);
    }
  }

  /// The rows of the stated directions: the mean over the poses of a direction of what is across it.
  void evaluate_across(const NormSolution& at, const Eigen::Matrix3d& b, const Eigen::Vector3d& unit,
                       const std::vector<Linear>& linears) {
    auto row = static_cast<Eigen::Index>(poses_.size());
    for (const StatedDirection& direction : directions_) {
      const double part = 1.0 / static_cast<double>(direction.poses.size());
      for (Eigen::Index k = 0; k < 2; ++k, ++row) {
        const Eigen::Vector3d axis = direction.across.col(k);
        const Eigen::Vector3d along = at.orientation->turn.transpose() * axis;
        for (const std::size_t i : direction.poses) {
          const Eigen::Vector3d l = linears[i].y.cwiseProduct(unit);
          const Eigen::Vector3d a = b * l;
          const Eigen::Vector3d by_linear = b.transpose() * along;
          const Eigen::Vector3d gradient = by_linear.cwiseQuotient(linears[i].slope);
          residual_(row) += part * along.dot(a);
          if (poses_[i].u) variance_(row) += part * part * gradient.cwiseProduct(*poses_[i].u).squaredNorm();
          by_reading_across_[i].row(k) = part * gradient.transpose();
          add_to_row(row, part, along, gradient, l, unit, linears[i].share);
          const Eigen::Vector3d by_turn = (at.orientation->turn * a).cross(axis);
          jacobian_.row(row).segment<3>(count_) += part * by_turn.transpose();
        }
      }
    }
  }

  /// Derivatives of the three angles between the axes (radian beyond 90 degrees) by B, and their values.
  void orthogonality(const Eigen::VectorXd& x, Eigen::Vector3d& value, Eigen::MatrixXd& by_unknown) const {
    const Eigen::Matrix3d s = upper(x).triangularView<Eigen::Upper>().solve(Eigen::Matrix3d::Identity());
    value = (intrinsic_properties(s).angle_deg.array() - 90.0) / kDegrees;
    by_unknown = Eigen::MatrixXd::Zero(3, columns());
    by_unknown.leftCols<6>() =
        product(intrinsic_jacobian(s).middleRows<3>(3), by_b(s).leftCols<6>()) / kDegrees;
  }

  /// s = B^-1: ds = -s dB s; the offset follows its own unknowns.
  static Eigen::Matrix<double, 12, kBasic> by_b(const Eigen::Matrix3d& s) {
    Eigen::Matrix<double, 12, kBasic> out = Eigen::Matrix<double, 12, kBasic>::Zero();
    for (std::size_t i = 0; i < 6; ++i) {
      const Eigen::Matrix3d change = -s.col(kRow[i]) * s.row(kColumn[i]);
      for (int j = 0; j < 3; ++j)
        out.block<3, 1>(3 * j, static_cast<Eigen::Index>(i)) = change.row(j).transpose();
    }
    out.bottomRightCorner<3, 3>().setIdentity();
    return out;
  }

  /// One Gauss-Newton step by the normal equations, columns scaled.
  Eigen::VectorXd step(NormSolution& at) {
    const Eigen::VectorXd root = variance_.cwiseSqrt().cwiseInverse();
    weighted_ = scaled_rows(root, jacobian_);
    const Eigen::VectorXd left = -root.cwiseProduct(residual_);
    Eigen::MatrixXd normal = lower_of_products_of_columns(weighted_);
    Eigen::VectorXd right = transposed_product_with_vector(weighted_, left);
    at.weighted_squares = left.squaredNorm();
    for (int j = 0; j < 3; ++j) {
      for (Eigen::Index k = 0; k < own_; ++k) {
        const double prior = effects_[static_cast<std::size_t>(k)].prior;
        const double p = at.unknowns(column(j, k)) / prior;
        normal(column(j, k), column(j, k)) += 1.0 / (prior * prior);
        right(column(j, k)) -= p / prior;
        at.weighted_squares += p * p;
      }
    }
    if (model_.orthogonality > 0.0) {
      Eigen::Vector3d value;
      Eigen::MatrixXd by_unknown;
      orthogonality(at.unknowns, value, by_unknown);
      by_unknown /= model_.orthogonality;
      value /= model_.orthogonality;
      normal += lower_of_products_of_columns(by_unknown);
      right -= transposed_product_with_vector(by_unknown, value);
      at.weighted_squares += value.squaredNorm();
    }
    scale_ = normal.diagonal().cwiseSqrt().cwiseInverse();
    factor_ = Cholesky(scaled_on_both_sides(normal, scale_));
    if (!scale_.allFinite() || !factor_.positive_definite()) throw undetermined(poses_.size());
    return scale_.cwiseProduct(factor_.solve_vector(scale_.cwiseProduct(right)));
  }

  /// Condition for the nine unknowns and the turn of the mount, from poses and prior of the axes; the effects
  /// have priors of their own.
  double reciprocal_condition(const NormSolution& at) const {
    const Eigen::Index angles = model_.orthogonality > 0.0 ? 3 : 0;
    const Eigen::Index turns = columns() - count_;
    Eigen::MatrixXd design = Eigen::MatrixXd::Zero(jacobian_.rows() + angles, kBasic + turns);
    design.topLeftCorner(jacobian_.rows(), kBasic) = weighted_.leftCols<kBasic>();
    design.topRightCorner(jacobian_.rows(), turns) = weighted_.rightCols(turns);
    if (angles > 0) {
      Eigen::Vector3d value;
      Eigen::MatrixXd by_unknown;
      orthogonality(at.unknowns, value, by_unknown);
      design.bottomLeftCorner(3, kBasic) = by_unknown.leftCols<kBasic>() / model_.orthogonality;
    }
    if (design.rows() < design.cols()) return 0.0;
    const Eigen::VectorXd scale = design.colwise().norm().cwiseInverse();
    return PivotedQr(scaled_columns(design, scale)).reciprocal_condition();
  }

 public:
  /// The line response and its derivatives: s row by row, then O.
  struct Line {
    Eigen::Matrix3d sensitivity;
    Eigen::Vector3d offset;
    Eigen::Matrix<double, 12, Eigen::Dynamic> by_unknown;
    Eigen::Matrix<double, 9, 1> intrinsic() const {
      const IntrinsicProperties properties = intrinsic_properties(sensitivity);
      Eigen::Matrix<double, 9, 1> out;
      out << properties.sensitivity, properties.angle_deg, offset;
      return out;
    }
  };
  Line line_at(const Eigen::VectorXd& x) const {
    const Eigen::Matrix3d s = upper(x).triangularView<Eigen::Upper>().solve(Eigen::Matrix3d::Identity());
    const Eigen::Vector3d unit = s.rowwise().norm();
    const Eigen::Matrix3d rows = unit.cwiseInverse().asDiagonal() * s;
    Line out{s, x.segment<3>(6), Eigen::Matrix<double, 12, Eigen::Dynamic>::Zero(12, count_)};
    out.by_unknown.leftCols<kBasic>() = by_b(s);
    for (int j = 0; j < 3; ++j) {
      double scale = 1.0;
      for (Eigen::Index k = 0; k < own_; ++k) {
        const Own& own = effects_[static_cast<std::size_t>(k)];
        const LineShare share = own.effect->line(rows, j, own.index);
        const double p = x(column(j, k));
        scale += share.scale * p;
        out.offset(j) += unit(j) * share.offset * p;
        out.by_unknown.block<3, 1>(3 * j, column(j, k)) = share.scale * s.row(j).transpose();
        out.by_unknown(9 + j, column(j, k)) = unit(j) * share.offset;
      }
      out.sensitivity.row(j) *= scale;
      out.by_unknown.block<3, kBasic>(3 * j, 0) *= scale;
    }
    return out;
  }

  /// The reading at a pose of a known direction.
  Eigen::Vector3d reading(const NormPose& pose, const Eigen::Vector3d& direction,
                          const Eigen::VectorXd& x) const {
    const Eigen::Matrix3d s = upper(x).triangularView<Eigen::Upper>().solve(Eigen::Matrix3d::Identity());
    const Eigen::Vector3d unit = s.rowwise().norm();
    const ItemPoint point{pose.t, (s * direction).cwiseQuotient(unit), pose.came_from};
    Eigen::Vector3d z = point.y;
    for (int j = 0; j < 3; ++j)
      for (Eigen::Index k = 0; k < own_; ++k) {
        const Own& own = effects_[static_cast<std::size_t>(k)];
        z(j) += own.effect->share(point, j, own.index).value * x(column(j, k));
      }
    return x.segment<3>(6) + z.cwiseProduct(unit);
  }

  std::vector<NormUnknown> unknowns() const {
    std::vector<NormUnknown> out;
    for (const Own& own : effects_) out.push_back({own.effect->key, own.prior});
    return out;
  }

 private:
  /// Fills the line response, its covariance and gain.
  void finish(NormSolution& out) const {
    out.cofactor = scaled_on_both_sides(factor_.inverse(), scale_);
    out.reciprocal_condition = reciprocal_condition(out);
    const auto n = static_cast<Eigen::Index>(poses_.size());
    const Eigen::MatrixXd fitted = product(weighted_, out.cofactor);
    const Eigen::VectorXd free = 1.0 - fitted.cwiseProduct(weighted_).rowwise().sum().array();
    out.free_share = free.head(n);
    out.redundancy = out.free_share.sum();
    out.successive_products =
        -fitted.topRows(n - 1).cwiseProduct(weighted_.topRows(n).bottomRows(n - 1)).sum();
    Line line = line_at(out.unknowns);
    std::vector<NormEffectShare> of_line;
    if (is_directed()) {
      out.scatter_degrees = degrees_of_rows(weighted_.topRows(n), fitted.topRows(n), out.redundancy);
      turn_line(out.orientation->turn, line);
      finish_orientation(line, fitted, free, out);
      of_line = shares_of(out, product(line.by_unknown.topRows<9>(), out.cofactor));
    } else {
      const Eigen::MatrixXd hat =
          transposed_product(fitted, weighted_);  // W' W C: its powers have H's traces.
      // Student's t has no value below one degree: round-off must not make that of ten poses smaller.
      constexpr double kRoundOff = 1e-9;
      out.scatter_degrees =
          2.0 * out.redundancy - static_cast<double>(n) + hat.cwiseProduct(hat.transpose()).sum() + kRoundOff;
    }
    out.line_sensitivity = line.sensitivity;
    out.line_offset = line.offset;
    out.intrinsic = line.intrinsic();
    const Eigen::Matrix<double, 9, Eigen::Dynamic> jacobian =
        product(intrinsic_jacobian(out.line_sensitivity), line.by_unknown);
    out.covariance = carried_covariance(jacobian, out.cofactor);
    const Eigen::MatrixXd by_equation = product(jacobian, out.cofactor);
    out.shares = shares_of(out, by_equation);
    for (std::size_t i = 0; i < of_line.size(); ++i) out.shares[i].of_matrix = of_line[i].variance;
    const Eigen::MatrixXd by_row =
        -product_transposed(by_equation, scaled_rows(variance_.cwiseInverse(), jacobian_));
    out.covariance_of_poses = product_transposed(scaled_columns(by_row, variance_), by_row);
    out.gain = gain_of(by_row);
    if (is_directed()) {
      const Eigen::Matrix<double, 9, 12> by_line = intrinsic_jacobian(out.line_sensitivity);
      out.covariance = carried_covariance(by_line, out.orientation->covariance);
      out.covariance_of_poses =
          carried_covariance(by_line, out.orientation->of_norm + out.orientation->of_turn);
    }
  }

  /// Derivatives of outputs by the readings of the poses, from those by the rows of the design.
  Eigen::MatrixXd gain_of(const Eigen::MatrixXd& by_row) const {
    const auto n = static_cast<Eigen::Index>(poses_.size());
    Eigen::MatrixXd gain(by_row.rows(), 3 * n);
    for (Eigen::Index i = 0; i < n; ++i)
      gain.middleCols<3>(3 * i) = product(by_row.col(i), by_reading_.row(i));
    Eigen::Index row = n;
    for (const StatedDirection& direction : directions_) {
      for (const std::size_t i : direction.poses)
        gain.middleCols<3>(3 * static_cast<Eigen::Index>(i)) +=
            product(by_row.middleCols<2>(row), by_reading_across_[i]);
      row += 2;
    }
    return gain;
  }

  /// Turns the line response into the axes of the mount, which adds the derivatives by its turn.
  static void turn_line(const Eigen::Matrix3d& turn, Line& line) {
    line.sensitivity = line.sensitivity * turn.transpose();
    line.by_unknown.conservativeResize(12, line.by_unknown.cols() + 3);
    line.by_unknown.rightCols<3>().setZero();
    for (Eigen::Index j = 0; j < 3; ++j) {
      auto three = line.by_unknown.middleRows<3>(3 * j);
      three = Eigen::MatrixXd(turn * three);
      const Eigen::Vector3d row = line.sensitivity.row(j).transpose();
      three.rightCols<3>() = -cross_matrix(row);  // e x s = -s x e
    }
  }

  /// @param free  1 less the leverage of each row
  void finish_orientation(const Line& line, const Eigen::MatrixXd& fitted, const Eigen::VectorXd& free,
                          NormSolution& out) const {
    NormOrientation& to = *out.orientation;
    const auto n = static_cast<Eigen::Index>(poses_.size());
    const Eigen::Index across = residual_.size() - n;
    to.residual = residual_.tail(across).reshaped(2, across / 2);
    for (const StatedDirection& direction : directions_) to.first.push_back(direction.poses.front());
    to.weighted_squares = residual_.tail(across).cwiseAbs2().cwiseQuotient(variance_.tail(across)).sum();
    to.redundancy = free.tail(across).sum();
    to.scatter_degrees =
        degrees_of_rows(weighted_.bottomRows(across), fitted.bottomRows(across), to.redundancy);
    const Eigen::MatrixXd by_equation = product(line.by_unknown, out.cofactor);
    const Eigen::MatrixXd by_row =
        -product_transposed(by_equation, scaled_rows(variance_.cwiseInverse(), jacobian_));
    const Eigen::MatrixXd as_weighted = product_transposed(scaled_columns(by_row, variance_), by_row);
    const Eigen::MatrixXd of_priors = product_transposed(by_equation, line.by_unknown) - as_weighted;
    to.of_turn = model_.turn_variance * covariance_of_root(by_row.rightCols(across));
    if (poses_.front().u) {
      // The weights leave out that the readings are common to the norm and what is across.
      Eigen::VectorXd u(3 * n);
      for (Eigen::Index i = 0; i < n; ++i) u.segment<3>(3 * i) = *poses_[static_cast<std::size_t>(i)].u;
      to.of_norm = covariance_of_root(scaled_columns(gain_of(by_row), u)) +
                   model_.common_variance * covariance_of_root(by_row.leftCols(n));
    } else {
      to.of_norm = model_.common_variance * covariance_of_root(by_row.leftCols(n));
    }
    to.covariance = to.of_norm + to.of_turn;
    if (own_ > 0) to.covariance += of_priors;
  }

  /// @param by_equation  derivatives of the outputs by the right side of the normal equations
  std::vector<NormEffectShare> shares_of(const NormSolution& at, const Eigen::MatrixXd& by_equation) const {
    std::vector<NormEffectShare> out;
    for (Eigen::Index k = 0; k < own_; ++k) {
      const Own& own = effects_[static_cast<std::size_t>(k)];
      if (own.index == 0) out.push_back({std::string(own.effect->name), std::string(own.effect->key)});
      for (int j = 0; j < 3; ++j)
        out.back().variance += (by_equation.col(column(j, k)) / own.prior).cwiseAbs2();
    }
    if (model_.orthogonality > 0.0) {
      Eigen::Vector3d value;
      Eigen::MatrixXd by_unknown;
      orthogonality(at.unknowns, value, by_unknown);
      out.push_back({"the angles between the axes", "orthogonality_deg"});
      out.back().variance =
          (product_transposed(by_equation, by_unknown) / model_.orthogonality).cwiseAbs2().rowwise().sum();
    }
    return out;
  }

  std::span<const NormPose> poses_;
  const NormModel& model_;
  std::vector<Own> effects_;
  Eigen::Index own_ = 0, count_ = kBasic;
  std::vector<StatedDirection> directions_;  ///< Empty: none are stated.
  // A row for the norm of each pose, then two for each stated direction.
  Eigen::MatrixXd jacobian_;
  Eigen::VectorXd residual_, variance_;
  Eigen::Matrix<double, Eigen::Dynamic, 3> by_reading_;         ///< Derivatives of the norm.
  std::vector<Eigen::Matrix<double, 2, 3>> by_reading_across_;  ///< Those of the rows of its direction.
  Eigen::MatrixXd weighted_;  ///< The Jacobian over the standard deviations.
  Eigen::VectorXd scale_;
  Cholesky factor_;  ///< Cholesky factor of the scaled normal matrix.
};

}  // namespace

NormSolution solve_norm(std::span<const NormPose> poses, const NormModel& model,
                        const Eigen::VectorXd& from) {
  return NormProblem(poses, model).solve(from);
}

void find_directions(std::vector<NormPose>& poses) {
  for (std::size_t i = 1; i < poses.size(); ++i) {
    for (Eigen::Index j = 0; j < 3; ++j) {
      const double change = poses[i].reading(j) - poses[i - 1].reading(j);
      const double noise =
          poses[i].u && poses[i - 1].u ? std::hypot((*poses[i].u)(j), (*poses[i - 1].u)(j)) : 1e-6;
      poses[i].came_from(j) = std::abs(change) > 5.0 * noise ? std::copysign(1.0, change) : 0.0;
    }
  }
}

std::vector<NormUnknown> norm_unknowns(const NormModel& model) {
  return NormProblem({}, model).unknowns();
}

Eigen::Vector3d norm_reading(const NormPose& pose, const Eigen::Vector3d& direction,
                             const Eigen::VectorXd& unknowns, const NormModel& model) {
  return NormProblem({}, model).reading(pose, direction, unknowns);
}

Eigen::Matrix<double, 9, 1> norm_outputs(const Eigen::VectorXd& unknowns, const NormModel& model) {
  return NormProblem({}, model).line_at(unknowns).intrinsic();
}

Eigen::Matrix3d norm_line_sensitivity(const Eigen::VectorXd& unknowns, const NormModel& model) {
  return NormProblem({}, model).line_at(unknowns).sensitivity;
}

Eigen::Matrix<double, 6, 1> norm_triangle(const Eigen::Matrix<double, 6, 1>& intrinsic) {
  const auto cosine = [&](Eigen::Index k) { return std::cos(intrinsic(3 + k) / kDegrees); };
  Eigen::Matrix3d gram;
  gram << 1.0, cosine(0), cosine(2),  //
      cosine(0), 1.0, cosine(1),      //
      cosine(2), cosine(1), 1.0;
  const Eigen::Vector3d size = intrinsic.head<3>();
  const Eigen::Matrix3d inverse = (size.asDiagonal() * gram * size.asDiagonal()).inverse();
  const Eigen::Matrix3d b = inverse.llt().matrixU();
  Eigen::Matrix<double, 6, 1> x;
  for (std::size_t i = 0; i < 6; ++i) x(static_cast<Eigen::Index>(i)) = b(kRow[i], kColumn[i]);
  return x;
}

}  // namespace abcal
