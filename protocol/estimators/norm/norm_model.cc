#include "protocol/estimators/norm/norm_model.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>

#include "protocol/estimators/shared/intrinsic_properties.h"
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
  }

  NormSolution solve(const Eigen::VectorXd& from) {
    NormSolution out;
    const auto n = static_cast<Eigen::Index>(poses_.size());
    out.unknowns = from.size() == count_ ? from : Eigen::VectorXd::Zero(count_);
    if (from.size() != count_)
      out.unknowns.head<kBasic>() = from.size() > 0 ? Basic(from.head<kBasic>()) : start(poses_);
    jacobian_.resize(n, count_);
    by_reading_.resize(n, 3);
    out.residual.resize(n);
    out.variance.resize(n);
    out.direction.resize(poses_.size());
    bool converged = false;
    for (int iteration = 0; iteration < 50 && !converged; ++iteration) {
      evaluate(out);
      const Eigen::VectorXd change = step(out);
      if (iteration == 0 && !(reciprocal_condition(out) > kSingular)) throw undetermined(poses_.size());
      out.unknowns += change;
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

  Eigen::Index column(int output, Eigen::Index own) const { return kBasic + own_ * output + own; }

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
      at.residual(row) = norm - 1.0;
      at.variance(row) = pose.u ? gradient.cwiseProduct(*pose.u).squaredNorm() + model_.common_variance
                                : (model_.common_variance > 0.0 ? model_.common_variance : 1.0);
      by_reading_.row(row) = gradient.transpose();
      for (std::size_t k = 0; k < 6; ++k)
        jacobian_(row, static_cast<Eigen::Index>(k)) = e(kRow[k]) * l(kColumn[k]);
      jacobian_.row(row).segment<3>(6) = -gradient.transpose();
      for (int j = 0; j < 3; ++j) {
        for (Eigen::Index k = 0; k < own_; ++k)
          jacobian_(row, column(j, k)) = -gradient(j) * unit(j) * linear.share(j, k);
      }
    }
  }

  /// Derivatives of the three angles between the axes (radian beyond 90 degrees) by B, and their values.
  void orthogonality(const Eigen::VectorXd& x, Eigen::Vector3d& value, Eigen::MatrixXd& by_unknown) const {
    const Eigen::Matrix3d s = upper(x).triangularView<Eigen::Upper>().solve(Eigen::Matrix3d::Identity());
    value = (intrinsic_properties(s).angle_deg.array() - 90.0) / kDegrees;
    by_unknown = Eigen::MatrixXd::Zero(3, count_);
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
    const Eigen::VectorXd root = at.variance.cwiseSqrt().cwiseInverse();
    weighted_ = scaled_rows(root, jacobian_);
    const Eigen::VectorXd left = -root.cwiseProduct(at.residual);
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

  /// Condition for the nine unknowns, from poses and prior of the axes; the effects have priors of their own.
  double reciprocal_condition(const NormSolution& at) const {
    const Eigen::Index angles = model_.orthogonality > 0.0 ? 3 : 0;
    Eigen::MatrixXd design = Eigen::MatrixXd::Zero(jacobian_.rows() + angles, kBasic);
    design.topRows(jacobian_.rows()) = weighted_.leftCols<kBasic>();
    if (angles > 0) {
      Eigen::Vector3d value;
      Eigen::MatrixXd by_unknown;
      orthogonality(at.unknowns, value, by_unknown);
      design.bottomRows(3) = by_unknown.leftCols<kBasic>() / model_.orthogonality;
    }
    if (design.rows() < kBasic) return 0.0;
    const Basic scale = design.colwise().norm().cwiseInverse();
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
    const Eigen::MatrixXd fitted = product(weighted_, out.cofactor);
    const Eigen::Index pairs = weighted_.rows() - 1;
    out.redundancy = static_cast<double>(weighted_.rows()) - fitted.cwiseProduct(weighted_).sum();
    out.successive_products = -fitted.topRows(pairs).cwiseProduct(weighted_.bottomRows(pairs)).sum();
    out.free_share = 1.0 - fitted.cwiseProduct(weighted_).rowwise().sum().array();
    const Eigen::MatrixXd hat = transposed_product(fitted, weighted_);  // W' W C: its powers have H's traces.
    // Student's t has no value below one degree: round-off must not make that of ten poses smaller.
    constexpr double kRoundOff = 1e-9;
    out.scatter_degrees = 2.0 * out.redundancy - static_cast<double>(weighted_.rows()) +
                          hat.cwiseProduct(hat.transpose()).sum() + kRoundOff;
    Line line = line_at(out.unknowns);
    out.line_sensitivity = line.sensitivity;
    out.line_offset = line.offset;
    out.intrinsic = line.intrinsic();
    const Eigen::Matrix<double, 9, Eigen::Dynamic> jacobian =
        product(intrinsic_jacobian(out.line_sensitivity), line.by_unknown);
    out.covariance = carried_covariance(jacobian, out.cofactor);
    const Eigen::MatrixXd by_equation = product(jacobian, out.cofactor);
    out.shares = shares_of(out, by_equation);
    const Eigen::MatrixXd by_norm =
        -product_transposed(by_equation, scaled_rows(out.variance.cwiseInverse(), jacobian_));
    out.covariance_of_poses = product_transposed(scaled_columns(by_norm, out.variance), by_norm);
    out.gain.resize(9, 3 * jacobian_.rows());
    for (Eigen::Index i = 0; i < jacobian_.rows(); ++i)
      out.gain.middleCols<3>(3 * i) = product(by_norm.col(i), by_reading_.row(i));
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
  Eigen::MatrixXd jacobian_;
  Eigen::Matrix<double, Eigen::Dynamic, 3> by_reading_;  ///< Derivatives of the norm.
  Eigen::MatrixXd weighted_;                             ///< The Jacobian over the standard deviations.
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
