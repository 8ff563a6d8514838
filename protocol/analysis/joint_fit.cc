#include "protocol/analysis/joint_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>

#include "protocol/analysis/known_acs_fit.h"
#include "protocol/analysis/unusable_data.h"
#include "protocol/model/forward_model.h"

namespace abcal {
namespace {

constexpr int kLocal = kOwnUnknowns + kGeometryUnknowns;
constexpr int kFirstGeometry = 3 * kOwnUnknowns;
/// Gauss-Newton stops when the next step would lower chi2 by less than this: a step of 1e-4 standard
/// uncertainties in all unknowns together.
constexpr double kDecrement = 1e-8;
constexpr int kMaxIterations = 25;
/// Width of the prior of what is stated as exactly zero (radian, relative): far below what any reading shows,
/// and far above round-off.
constexpr double kKnownExactly = 1e-9;

using GeometryVector = Eigen::Matrix<double, kGeometryUnknowns, 1>;

/// g(a) = centre + cosine cos(a) + sine sin(a) of one experiment (the circle of docs/theory/model.md), with
/// its derivatives by Zx, Zy, Xz and the experiment's own turn error (d2 or d3).
struct Circle {
  Eigen::Vector3d centre, cosine, sine;
  Eigen::Matrix<double, 3, 4> d_centre, d_cosine, d_sine;
  int turn = -1;  ///< Geometry index of the turn error; -1: none.
  int mean = 0;   ///< Geometry index of the mean step error.
};

/// Z and its derivatives by Zx and Zy.
struct ZAxis {
  Eigen::Vector3d z, by_zx, by_zy;
};

ZAxis z_axis(double zx, double zy) {
  const double up = std::sqrt(1.0 - zx * zx - zy * zy);
  return {{zx, zy, up}, {1.0, 0.0, -zx / up}, {0.0, 1.0, -zy / up}};
}

/// v turned about Z by an angle with sine s, cosine c, and its derivative by a change dz of Z.
Eigen::Vector3d turned(const Eigen::Vector3d& v, const Eigen::Vector3d& z, double s, double c) {
  return v * c + z.cross(v) * s + z * (z.dot(v) * (1.0 - c));
}
Eigen::Vector3d turned_by_axis(const Eigen::Vector3d& v, const Eigen::Vector3d& z, const Eigen::Vector3d& dz,
                               double s, double c) {
  return dz.cross(v) * s + (dz * z.dot(v) + z * dz.dot(v)) * (1.0 - c);
}

Circle circle_about_x(double xz) {
  // RRF(z, X, -a) with X = (c, 0, Xz).
  const double c = std::sqrt(1.0 - xz * xz);
  Circle out;
  out.centre = {c * xz, 0.0, xz * xz};
  out.cosine = {-c * xz, 0.0, 1.0 - xz * xz};
  out.sine = {0.0, c, 0.0};
  out.d_centre.setZero();
  out.d_cosine.setZero();
  out.d_sine.setZero();
  out.d_centre.col(2) = Eigen::Vector3d(c - xz * xz / c, 0.0, 2.0 * xz);
  out.d_cosine.col(2) = -out.d_centre.col(2);
  out.d_sine.col(2) = Eigen::Vector3d(0.0, -xz / c, 0.0);
  out.mean = kFX - kFirstGeometry;
  return out;
}

Circle circle_of(int experiment, const GeometryVector& geometry) {
  Circle out = circle_about_x(geometry(2));
  if (experiment == 1) return out;
  const ZAxis axis = z_axis(geometry(0), geometry(1));
  if (experiment == 2) {
    // The accelerometer was turned by -90 + d2 about Z: seen from it, gravity is turned by 90 - d2.
    const double s = std::cos(geometry(3));
    const double c = std::sin(geometry(3));
    const auto turn = [&](Eigen::Vector3d& v, Eigen::Matrix<double, 3, 4>& d) {
      const Eigen::Vector3d v_turned = turned(v, axis.z, s, c);
      d.col(2) = turned(d.col(2), axis.z, s, c);
      d.col(0) = turned_by_axis(v, axis.z, axis.by_zx, s, c);
      d.col(1) = turned_by_axis(v, axis.z, axis.by_zy, s, c);
      d.col(3) = -axis.z.cross(v_turned);
      v = v_turned;
    };
    turn(out.centre, out.d_centre);
    turn(out.cosine, out.d_cosine);
    turn(out.sine, out.d_sine);
    out.turn = kD2 - kFirstGeometry;
    return out;
  }
  // Experiment 3: X stands at -90 + d3; from there, RRF(h, Z, -a).
  const double s = -std::cos(geometry(4));
  const double c = std::sin(geometry(4));
  const Eigen::Vector3d h = out.centre + out.cosine * c + out.sine * s;
  Eigen::Matrix<double, 3, 4> d_h = out.d_centre + out.d_cosine * c + out.d_sine * s;  // column 2: by Xz
  d_h.col(3) = -out.cosine * s + out.sine * c;
  const double along = axis.z.dot(h);
  out.centre = axis.z * along;
  out.cosine = h - out.centre;
  out.sine = -axis.z.cross(h);
  for (int i = 0; i < 4; ++i) {
    Eigen::Vector3d dz = Eigen::Vector3d::Zero();
    if (i == 0) dz = axis.by_zx;
    if (i == 1) dz = axis.by_zy;
    out.d_centre.col(i) = dz * along + axis.z * (dz.dot(h) + axis.z.dot(d_h.col(i)));
    out.d_cosine.col(i) = d_h.col(i) - out.d_centre.col(i);
    out.d_sine.col(i) = -dz.cross(h) - axis.z.cross(d_h.col(i));
  }
  out.turn = kD3 - kFirstGeometry;
  out.mean = kFZ - kFirstGeometry;
  return out;
}

std::array<Circle, 3> circles_of(const GeometryVector& geometry) {
  return {circle_of(1, geometry), circle_of(2, geometry), circle_of(3, geometry)};
}

/// The model at one angle: readings and their derivatives by each accelerometer's own seven unknowns, by the
/// geometry and by f.
struct Point {
  double reading[3];
  double local[3][kLocal];  ///< Own seven, then geometry seven.
  double by_step[3];
};

void evaluate(const JointReading& at, const Circle& circle, const JointVector& value, double f, Point& out) {
  const double e = value(kFirstGeometry + circle.mean) + f;
  const double sin_e = std::sin(e);
  const double cos_e = std::cos(e);
  const double s = at.sin_alpha * cos_e + at.cos_alpha * sin_e;
  const double c = at.cos_alpha * cos_e - at.sin_alpha * sin_e;
  const Eigen::Vector3d g = circle.centre + circle.cosine * c + circle.sine * s;
  const Eigen::Vector3d g_angle = circle.sine * c - circle.cosine * s;
  const Eigen::Matrix<double, 3, 4> d_g = circle.d_centre + circle.d_cosine * c + circle.d_sine * s;
  for (int j = 0; j < 3; ++j) {
    const double* own = value.data() + kOwnUnknowns * j;
    const Eigen::Vector3d row(own[0], own[1], own[2]);
    const double x = row.dot(g);
    const double k2 = own[kK2Index];
    const double k3 = own[kK3Index];
    const double slope = 1.0 + x * (2.0 * k2 + 3.0 * k3 * x);
    out.reading[j] = own[kOffsetIndex] + x * (1.0 + x * (k2 + x * k3)) + own[kDriftIndex] * at.t;
    double* local = out.local[j];
    local[0] = slope * g.x();
    local[1] = slope * g.y();
    local[2] = slope * g.z();
    local[kOffsetIndex] = 1.0;
    local[kDriftIndex] = at.t;
    local[kK2Index] = x * x;
    local[kK3Index] = x * x * x;
    const Eigen::Vector4d by_geometry = slope * (d_g.transpose() * row);
    const double by_angle = slope * row.dot(g_angle);
    double* geometry = local + kOwnUnknowns;
    std::fill_n(geometry, kGeometryUnknowns, 0.0);
    geometry[0] = by_geometry(0);
    geometry[1] = by_geometry(1);
    geometry[2] = by_geometry(2);
    if (circle.turn >= 0) geometry[circle.turn] = by_geometry(3);
    geometry[circle.mean] = by_angle;
    out.by_step[j] = by_angle;
  }
}

/// Column of the 28 unknowns for entry i of accelerometer j's local vector.
constexpr int column(int j, int i) {
  return i < kOwnUnknowns ? kOwnUnknowns * j + i : kFirstGeometry + (i - kOwnUnknowns);
}

/// Diagonal and link of one eliminated step error.
struct Eliminated {
  double diagonal = 0.0;  ///< A
  double right = 0.0;     ///< b
  JointVector link;       ///< v
};

/// Everything in units of S_j: the fit's work space.
struct Problem {
  std::span<const JointReading> readings;
  Eigen::Vector3d unit;                 ///< S_j
  std::vector<Eigen::Vector3d> value;   ///< r / S
  std::vector<Eigen::Vector3d> weight;  ///< (S / u)^2
  JointPriors priors;
  JointModel model;
  std::size_t steps = 0;  ///< Step errors.

  std::array<bool, kJointUnknowns> fixed{};
  JointVector prior_mean = JointVector::Zero();
  JointVector prior_weight = JointVector::Zero();
};

void require(bool holds, const std::string& message) {
  if (!holds) throw std::invalid_argument("joint fit: " + message);
}

bool positive(double x) {
  return std::isfinite(x) && x > 0.0;
}

void set_priors(Problem& problem) {
  const JointPriors& priors = problem.priors;
  const auto width = [](double sd, const char* name) {
    require(positive(sd), std::string("the prior of ") + name + " has the width " + std::to_string(sd) +
                              "; a finite width greater than zero is required");
    return 1.0 / (sd * sd);
  };
  static constexpr const char* kNames[kGeometryUnknowns] = {
      "Zx (alignment)",    "Zy (alignment)",  "Xz (alignment)", "d2 (initial turn)",
      "d3 (initial turn)", "F_X (axis zero)", "F_Z (axis zero)"};
  for (int i = 0; i < kGeometryUnknowns; ++i) {
    const bool left_out = kFirstGeometry + i >= kFX && !problem.model.mean_step;
    const auto at = static_cast<std::size_t>(kFirstGeometry + i);
    problem.fixed[at] = left_out;
    if (left_out) continue;
    require(std::isfinite(priors.mean(i)), std::string("the prior of ") + kNames[i] + " has no finite mean");
    problem.prior_mean(kFirstGeometry + i) = priors.mean(i);
    problem.prior_weight(kFirstGeometry + i) = width(priors.sd(i), kNames[i]);
  }
  width(priors.step, "the step errors");
  for (int j = 0; j < 3; ++j) {
    const int own = kOwnUnknowns * j;
    problem.fixed[static_cast<std::size_t>(own + kDriftIndex)] = !problem.model.drift;
    problem.fixed[static_cast<std::size_t>(own + kK2Index)] = !problem.model.nonlinearity;
    problem.fixed[static_cast<std::size_t>(own + kK3Index)] = !problem.model.nonlinearity;
    if (problem.model.drift) problem.prior_weight(own + kDriftIndex) = width(priors.drift, "the drift");
    if (problem.model.nonlinearity) {
      problem.prior_weight(own + kK2Index) = width(priors.k2, "k2");
      problem.prior_weight(own + kK3Index) = width(priors.k3, "k3");
    }
  }
}

/// Normal equations at one point, step errors eliminated.
struct Normal {
  JointMatrix matrix;  ///< Lower triangle.
  JointVector right;
  std::vector<Eliminated> eliminated;
  double chi2 = 0.0;
};

void assemble(const Problem& problem, const JointVector& value, const std::vector<double>& step,
              Normal& out) {
  out.matrix.setZero();
  out.right.setZero();
  out.eliminated.resize(problem.steps);
  out.chi2 = 0.0;
  const std::array<Circle, 3> circles = circles_of(value.tail<kGeometryUnknowns>());
  const double step_weight = 1.0 / (problem.priors.step * problem.priors.step);
  // Local normal matrices of the three accelerometers, scattered into the whole at the end.
  double local[3][kLocal][kLocal] = {};
  double local_right[3][kLocal] = {};
  Point point;
  for (std::size_t i = 0; i < problem.readings.size();) {
    const int group = problem.readings[i].step_error;
    Eliminated& eliminated = out.eliminated[static_cast<std::size_t>(group)];
    const double f = step[static_cast<std::size_t>(group)];
    eliminated.diagonal = step_weight;
    eliminated.right = -step_weight * f;
    eliminated.link.setZero();
    out.chi2 += step_weight * f * f;
    for (; i < problem.readings.size() && problem.readings[i].step_error == group; ++i) {
      const JointReading& at = problem.readings[i];
      evaluate(at, circles[static_cast<std::size_t>(at.experiment - 1)], value, f, point);
      for (int j = 0; j < 3; ++j) {
        const double w = problem.weight[i](j);
        const double residual = problem.value[i](j) - point.reading[j];
        const double* row = point.local[j];
        const double by_step = w * point.by_step[j];
        out.chi2 += w * residual * residual;
        eliminated.diagonal += by_step * point.by_step[j];
        eliminated.right += by_step * residual;
        for (int a = 0; a < kLocal; ++a) {
          const double wa = w * row[a];
          local_right[j][a] += wa * residual;
          eliminated.link(column(j, a)) += by_step * row[a];
          for (int b = 0; b <= a; ++b) local[j][a][b] += wa * row[b];
        }
      }
    }
    const double inverse = 1.0 / eliminated.diagonal;
    const double* link = eliminated.link.data();
    for (int b = 0; b < kJointUnknowns; ++b) {  // column by column: Eigen's order
      const double scaled = inverse * link[b];
      double* to = out.matrix.data() + b * kJointUnknowns;
      for (int a = b; a < kJointUnknowns; ++a) to[a] -= scaled * link[a];
      out.right(b) -= scaled * eliminated.right;
    }
  }
  for (int j = 0; j < 3; ++j) {
    for (int a = 0; a < kLocal; ++a) {
      out.right(column(j, a)) += local_right[j][a];
      for (int b = 0; b <= a; ++b) out.matrix(column(j, a), column(j, b)) += local[j][a][b];
    }
  }
  for (int i = 0; i < kJointUnknowns; ++i) {
    if (problem.fixed[static_cast<std::size_t>(i)]) {
      out.matrix.row(i).setZero();
      out.matrix.col(i).setZero();
      out.matrix(i, i) = 1.0;
      out.right(i) = 0.0;
      for (Eliminated& eliminated : out.eliminated) eliminated.link(i) = 0.0;
      continue;
    }
    const double weight = problem.prior_weight(i);
    const double difference = value(i) - problem.prior_mean(i);
    out.matrix(i, i) += weight;
    out.right(i) -= weight * difference;
    out.chi2 += weight * difference * difference;
  }
}

/// Sizes that turn the inner units (S_j) into the response unit.
JointVector unit_of_unknowns(const Eigen::Vector3d& unit) {
  JointVector out = JointVector::Ones();
  for (int j = 0; j < 3; ++j) {
    out.segment<5>(kOwnUnknowns * j).setConstant(unit(j));  // s, O, b
    out(kOwnUnknowns * j + kK2Index) = 1.0 / unit(j);
    out(kOwnUnknowns * j + kK3Index) = 1.0 / (unit(j) * unit(j));
  }
  return out;
}

/// Cholesky of the normal matrix with its diagonal scaled to 1.
class ScaledCholesky {
 public:
  explicit ScaledCholesky(const JointMatrix& lower) {
    scale_ = lower.diagonal().cwiseSqrt().cwiseInverse();
    JointMatrix scaled = lower.triangularView<Eigen::Lower>();
    scaled = scale_.asDiagonal() * scaled * scale_.asDiagonal();
    llt_.compute(scaled);
  }
  bool ok() const { return scale_.allFinite() && llt_.info() == Eigen::Success; }
  JointVector solve(const JointVector& right) const {
    return scale_.cwiseProduct(llt_.solve(scale_.cwiseProduct(right)));
  }
  JointMatrix covariance() const {
    // By columns of the identity: the covariance itself is what is asked for.
    JointMatrix out = llt_.solve(JointMatrix::Identity());
    out = scale_.asDiagonal() * out * scale_.asDiagonal();
    return 0.5 * (out + out.transpose());
  }
  double reciprocal_condition() const { return std::sqrt(llt_.rcond()); }

 private:
  JointVector scale_;
  Eigen::LLT<JointMatrix> llt_;
};

/// Checks the readings and numbers their step errors. @return the linear solution at a perfect stage
KnownAcsFit start_of(Problem& problem) {
  std::vector<Eigen::Vector3d> gravity;
  std::vector<Eigen::Vector3d> values;
  gravity.reserve(problem.readings.size());
  values.reserve(problem.readings.size());
  const std::array<Circle, 3> nominal = circles_of(GeometryVector::Zero());
  int last_step = -1;
  for (const JointReading& at : problem.readings) {
    require(at.experiment >= 1 && at.experiment <= 3,
            "experiment " + std::to_string(at.experiment) + "; 1, 2 or 3 is required");
    require(at.value.allFinite() && std::isfinite(at.sin_alpha) && std::isfinite(at.cos_alpha) &&
                std::isfinite(at.t),
            "a reading, its angle or its time is not a finite number");
    require(at.u.allFinite() && at.u.minCoeff() > 0.0,
            "the standard uncertainty of a reading is not a finite number greater than zero");
    require(at.step_error == last_step || at.step_error == last_step + 1,
            "step errors are not numbered consecutively");
    last_step = at.step_error;
    const Circle& circle = nominal[static_cast<std::size_t>(at.experiment - 1)];
    gravity.push_back(circle.centre + circle.cosine * at.cos_alpha + circle.sine * at.sin_alpha);
    values.push_back(at.value);
  }
  problem.steps = static_cast<std::size_t>(last_step + 1);
  return linear_fit_given_acs(gravity, values);
}

/// Readings and weights in units of S_j.
void scale_readings(const KnownAcsFit& start, Problem& problem) {
  problem.unit = start.sensitivity_matrix.rowwise().norm();
  for (int j = 0; j < 3; ++j) {
    // An output that never changes leaves a row of round-off: some ulp of what it reads.
    if (!(problem.unit(j) > 1e-12 * std::abs(start.offset(j)))) {
      throw UnusableData(std::string("joint fit: accelerometer ") + "uvw"[j] +
                         " does not respond to gravity at all");
    }
  }
  problem.value.reserve(problem.readings.size());
  problem.weight.reserve(problem.readings.size());
  for (const JointReading& at : problem.readings) {
    problem.value.push_back(at.value.cwiseQuotient(problem.unit));
    problem.weight.push_back(problem.unit.cwiseQuotient(at.u).cwiseAbs2());
  }
}

/// Unknowns and step errors on their way to the solution.
struct Iterate {
  JointVector value;
  std::vector<double> step;
  Normal normal;  ///< Where the last step began.
  JointMatrix covariance = JointMatrix::Zero();
};

void add_residuals(const Problem& problem, const Iterate& found, JointFit& fit) {
  const std::array<Circle, 3> circles = circles_of(found.value.tail<kGeometryUnknowns>());
  fit.residuals.resize(problem.readings.size());
  Point point;
  for (std::size_t i = 0; i < problem.readings.size(); ++i) {
    const JointReading& at = problem.readings[i];
    const auto group = static_cast<std::size_t>(at.step_error);
    evaluate(at, circles[static_cast<std::size_t>(at.experiment - 1)], found.value, found.step[group], point);
    const Eliminated& eliminated = found.normal.eliminated[group];
    // Covariance of f with the 28: -C v / A; its variance: 1/A + v' C v / A^2.
    const JointVector with_step = -(found.covariance * eliminated.link) / eliminated.diagonal;
    const double step_variance =
        1.0 / eliminated.diagonal - eliminated.link.dot(with_step) / eliminated.diagonal;
    for (int j = 0; j < 3; ++j) {
      JointVector row = JointVector::Zero();
      for (int a = 0; a < kLocal; ++a) row(column(j, a)) = point.local[j][a];
      const double h = point.by_step[j];
      const double variance =
          row.dot(found.covariance * row) + 2.0 * h * row.dot(with_step) + h * h * step_variance;
      const double residual = problem.value[i](j) - point.reading[j];
      fit.residuals[i](j) = residual * problem.unit(j);
      fit.sum_weighted_squares(j) += problem.weight[i](j) * residual * residual;
      fit.redundancy(j) += 1.0 - problem.weight[i](j) * variance;
    }
  }
}

/// Gauss-Newton. Leaves `fit` as not converged where there is no solution.
void iterate(const Problem& problem, Iterate& at, JointFit& fit) {
  while (fit.iterations < kMaxIterations) {
    ++fit.iterations;
    assemble(problem, at.value, at.step, at.normal);
    if (!std::isfinite(at.normal.chi2) || !at.normal.right.allFinite()) return;
    const ScaledCholesky cholesky(at.normal.matrix);
    if (!cholesky.ok()) return;
    const JointVector change = cholesky.solve(at.normal.right);
    double decrement = at.normal.right.dot(change);
    for (std::size_t i = 0; i < problem.steps; ++i) {
      const Eliminated& eliminated = at.normal.eliminated[i];
      decrement += eliminated.right * eliminated.right / eliminated.diagonal;
      at.step[i] += (eliminated.right - eliminated.link.dot(change)) / eliminated.diagonal;
    }
    at.value += change;
    if (!at.value.allFinite() || !(at.value.segment<2>(kZx).squaredNorm() < 1.0) ||
        !(std::abs(at.value(kXz)) < 1.0)) {
      return;
    }
    // The round-off of chi2 itself (u may be far below the readings' last digit) bounds what a step can show.
    if (decrement < kDecrement + 1e-12 * at.normal.chi2) {
      fit.converged = true;
      fit.chi2 = std::max(0.0, at.normal.chi2 - decrement);
      fit.reciprocal_condition = cholesky.reciprocal_condition();
      at.covariance = cholesky.covariance();
      return;
    }
  }
}

/// Step errors with their uncertainties. @return the information that the priors of all unknowns carry
///
/// The estimate is linear in the priors' means: each moves it by C (its row of the normal matrix). The sum of
/// the squares is the part of the posterior variance that the priors carry.
JointMatrix fill_step_errors(const Problem& problem, const Iterate& at, JointFit& fit) {
  JointMatrix prior_information = problem.prior_weight.asDiagonal();
  const double step_sd = problem.priors.step;
  fit.step_error = at.step;
  fit.u_step_error.resize(problem.steps);
  for (std::size_t i = 0; i < problem.steps; ++i) {
    const Eliminated& eliminated = at.normal.eliminated[i];
    const double a = eliminated.diagonal;
    const JointVector scaled = eliminated.link / a;
    prior_information.selfadjointView<Eigen::Lower>().rankUpdate(scaled, 1.0 / (step_sd * step_sd));
    fit.u_step_error[i] = std::sqrt(1.0 / a + scaled.dot(at.covariance * scaled));
  }
  return prior_information.selfadjointView<Eigen::Lower>();
}

}  // namespace

JointPriors JointPriors::from(const Tolerances& tolerances, const MeasuredAlignment& measured) {
  const auto width = [](double value, const char* key, double found) {
    if (!(std::isfinite(found) && found >= 0.0)) {
      throw UnusableData(std::string("joint fit: ") + key + " is " + std::to_string(found) +
                         "; a finite number not below zero is required");
    }
    return std::max(value, kKnownExactly);
  };
  JointPriors out;
  const double alignment =
      width(abcal::sincos(tolerances.alignment).sin, "alignment_deg", tolerances.alignment.deg());
  const double turn = width(tolerances.initial_turn.rad(), "initial_turn_deg", tolerances.initial_turn.deg());
  const double zero = width(tolerances.zero.rad(), "zero_deg", tolerances.zero.deg());
  out.sd << alignment, alignment, alignment, turn, turn, zero, zero;
  out.step = width(tolerances.step.rad(), "step_deg", tolerances.step.deg());
  out.drift = width(tolerances.drift, "drift", tolerances.drift);
  const std::optional<MeasuredValue>* values[3] = {&measured.zx, &measured.zy, &measured.xz};
  static constexpr const char* kNames[3] = {"Zx", "Zy", "Xz"};
  for (int i = 0; i < 3; ++i) {
    if (!*values[i]) continue;
    const MeasuredValue& value = **values[i];
    if (!std::isfinite(value.value) || !positive(value.standard_uncertainty)) {
      throw UnusableData(std::string("joint fit: measured ") + kNames[i] + " = " +
                         std::to_string(value.value) + " with standard uncertainty " +
                         std::to_string(value.standard_uncertainty) +
                         "; a finite value and an uncertainty greater than zero are required");
    }
    out.mean(i) = value.value;
    out.sd(i) = value.standard_uncertainty;
  }
  return out;
}

JointModelPoint joint_model(const JointReading& at, const JointVector& value, double step_error) {
  require(at.experiment >= 1 && at.experiment <= 3,
          "experiment " + std::to_string(at.experiment) + "; 1, 2 or 3 is required");
  Point point;
  evaluate(at, circle_of(at.experiment, value.tail<kGeometryUnknowns>()), value, step_error, point);
  JointModelPoint out;
  out.by_unknown.setZero();
  for (int j = 0; j < 3; ++j) {
    out.reading(j) = point.reading[j];
    out.by_step_error(j) = point.by_step[j];
    for (int a = 0; a < kLocal; ++a) out.by_unknown(j, column(j, a)) = point.local[j][a];
  }
  return out;
}

JointFit joint_fit(std::span<const JointReading> readings, const JointPriors& priors, const JointModel& model,
                   bool with_residuals) {
  require(!readings.empty(), "no readings");
  Problem problem;
  problem.readings = readings;
  problem.priors = priors;
  problem.model = model;
  const KnownAcsFit start = start_of(problem);
  set_priors(problem);
  scale_readings(start, problem);

  Iterate at;
  at.value = problem.prior_mean;
  for (int j = 0; j < 3; ++j) {
    at.value.segment<3>(kOwnUnknowns * j) = start.sensitivity_matrix.row(j).transpose() / problem.unit(j);
    at.value(kOwnUnknowns * j + kOffsetIndex) = start.offset(j) / problem.unit(j);
  }
  at.step.assign(problem.steps, 0.0);
  JointFit fit;
  fit.degrees_of_freedom = 3 * static_cast<int>(readings.size()) - 12;
  iterate(problem, at, fit);
  if (!fit.converged) return fit;

  for (int i = 0; i < kJointUnknowns; ++i) {
    if (problem.fixed[static_cast<std::size_t>(i)]) at.covariance(i, i) = 0.0;
  }
  const JointMatrix type_b = at.covariance * fill_step_errors(problem, at, fit) * at.covariance;
  const JointVector units = unit_of_unknowns(problem.unit);
  fit.value = at.value.cwiseProduct(units);
  fit.covariance = units.asDiagonal() * at.covariance * units.asDiagonal();
  fit.covariance_type_b = units.asDiagonal() * type_b * units.asDiagonal();
  if (with_residuals) add_residuals(problem, at, fit);
  return fit;
}

}  // namespace abcal
