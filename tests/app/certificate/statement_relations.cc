#include "tests/app/certificate/statement_relations.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <set>
#include <stdexcept>

#include "app/formats/xml_query.h"

namespace abcal::test {
namespace {

constexpr int kOutputs = 12;
using Outputs = Eigen::Matrix<double, kOutputs, 1>;
using Function = std::function<double(const Outputs&)>;

const std::array<std::string, 3> kRows{"u", "v", "w"}, kColumns{"x", "y", "z"}, kPairs{"uv", "vw", "wu"};

Eigen::Matrix3d matrix_of(const Outputs& y) {
  Eigen::Matrix3d s;
  s << y(0), y(1), y(2), y(3), y(4), y(5), y(6), y(7), y(8);
  return s;
}

/// A quantity that follows from the twelve outputs.
struct Follows {
  std::string name;
  Function value;
};

std::vector<Follows> what_follows() {
  std::vector<Follows> all;
  for (int i = 0; i < 3; ++i) {
    const auto at = static_cast<std::size_t>(i);
    const int next = (i + 1) % 3;
    all.push_back(
        {"intrinsic_sensitivity_" + kRows[at], [i](const Outputs& y) { return matrix_of(y).row(i).norm(); }});
    all.push_back({"intrinsic_angle_" + kPairs[at], [i, next](const Outputs& y) {
                     const Eigen::Matrix3d s = matrix_of(y);
                     return std::atan2(s.row(i).cross(s.row(next)).norm(), s.row(i).dot(s.row(next)));
                   }});
    all.push_back(
        {"bias_" + kRows[at], [i](const Outputs& y) { return y(9 + i) / matrix_of(y).row(i).norm(); }});
    for (int j = 0; j < 3; ++j)
      all.push_back({"M_" + kColumns[at] + kRows[static_cast<std::size_t>(j)],
                     [i, j](const Outputs& y) { return matrix_of(y).inverse()(i, j); }});
  }
  return all;
}

class Relations {
 public:
  Relations(const std::string& xml, const Reading& reading, bool last)
      : document_(parse_xml(xml, "certificate")), xml_(document_.get()), reading_(reading) {
    const auto all = xml_.nodes("dcc:measurementResults/dcc:measurementResult[@refType='abc_calibration']");
    calibration_ = last ? all.back() : all.front();
    for (const Claim& claim : reading.claims) by_name_.emplace(claim.quantity, &claim);  // The first of each.
    for (const std::string& labels : xml_.texts(
             "dcc:results//dcc:metaData[@refType='abc_raisedToScope']/dcc:data/dcc:text", calibration_))
      for (const std::string& label : xml_words(labels)) raised_.insert(label);
  }

  std::vector<std::string> broken() {
    if (!by_name_.contains("sensitivity_ux")) return {};  // No numbers.
    read_outputs();
    const Eigen::MatrixXd correlation = correlations("abc_correlationOutputs", kOutputs);
    const Eigen::MatrixXd covariance = u_.asDiagonal() * correlation * u_.asDiagonal();
    for (const Follows& one : what_follows()) compare(one, covariance);
    correlations("abc_correlationIntrinsic", 9);
    correlations("abc_correlationEquation", kOutputs);
    compare_per_gravity();
    return broken_;
  }

 private:
  const Claim& claim(const std::string& name) const {
    const auto found = by_name_.find(name);
    if (found == by_name_.end()) throw std::runtime_error("the certificate does not state " + name);
    return *found->second;
  }
  static double u_of(const Claim& claim) { return claim.expanded.value / std::stod(claim.factor); }
  /// Least and most, of which U and k are the printed numbers. k has two decimals.
  static std::pair<double, double> range_of_u(const Claim& claim) {
    const double expanded = claim.expanded.value, half = 0.5 * claim.expanded.digit,
                 k = std::stod(claim.factor);
    return {(expanded - half) / (k + 0.005), (expanded + half) / (k - 0.005)};
  }

  void read_outputs() {
    for (int k = 0; k < kOutputs; ++k) {
      const auto row = static_cast<std::size_t>(k < 9 ? k / 3 : k - 9);
      const Claim& output =
          claim(k < 9 ? "sensitivity_" + kRows[row] + kColumns[static_cast<std::size_t>(k % 3)]
                      : "offset_" + kRows[row]);
      y_(k) = output.value.value;
      u_(k) = u_of(output);
      half_digit_(k) = 0.5 * output.value.digit;
      rounding_of_u_(k) = range_of_u(output).second / u_(k) - 1.0;
    }
  }

  /// A matrix of coefficients, which is symmetric and positive semidefinite with ones on its diagonal.
  Eigen::MatrixXd correlations(const std::string& type, int size) {
    Eigen::MatrixXd matrix(size, size);
    const auto rows =
        xml_.nodes("dcc:results/dcc:result[@refType='abc_correlations']/dcc:data/dcc:list[@refType='" + type +
                       "']/dcc:quantity",
                   calibration_);
    if (std::ssize(rows) != size) throw std::runtime_error(type + " has another size");
    for (int i = 0; i < size; ++i) {
      const auto values = xml_.words(".//si:valueXMLList", rows[static_cast<std::size_t>(i)]);
      for (int j = 0; j < size; ++j) matrix(i, j) = std::stod(values.at(static_cast<std::size_t>(j)));
    }
    // Four decimals of each coefficient.
    const double least = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(matrix).eigenvalues().minCoeff();
    if (!matrix.isApprox(matrix.transpose()) || matrix.diagonal() != Eigen::VectorXd::Ones(size) ||
        least < -1e-4 * size)
      broken_.push_back(type + " is no matrix of coefficients of correlation");
    return matrix;
  }

  void compare(const Follows& one, const Eigen::MatrixXd& covariance) {
    const Claim& stated = claim(one.name);
    Outputs gradient;
    for (int k = 0; k < kOutputs; ++k) {
      Outputs step = Outputs::Zero();
      step(k) = 1e-5 * (k < 9 ? y_.head<9>().cwiseAbs().maxCoeff() : 1.0);
      gradient(k) = (one.value(y_ + step) - one.value(y_ - step)) / (2.0 * step(k));
    }
    const double value = one.value(y_);
    const double rounding = half_digit_.dot(gradient.cwiseAbs()) + 0.5 * stated.value.digit;
    if (std::abs(stated.value.value - value) > 1.001 * rounding + 1e-9 * std::abs(value))
      broken_.push_back(
          fmt::format("{} is {:.9g}, but {:.9g} follows from S and O", one.name, stated.value.value, value));
    const double u = std::sqrt(std::max(0.0, gradient.dot(covariance * gradient)));
    double rounding_of_u = 0.0;
    for (int k = 0; k < kOutputs; ++k)
      if (std::abs(gradient(k)) * u_(k) > 1e-3 * u)
        rounding_of_u = std::max(rounding_of_u, rounding_of_u_(k));
    compare_uncertainty(one.name, {(1.0 - rounding_of_u) * u, (1.0 + rounding_of_u) * u});
  }

  /// @param follows  least and most
  void compare_uncertainty(const std::string& name, const std::pair<double, double>& follows) {
    const auto [least, most] = range_of_u(claim(name));
    // Coefficients of correlation have four decimals.
    constexpr double kOfCoefficients = 2e-3;
    if (most < (1.0 - kOfCoefficients) * follows.first ||
        (!is_raised(name) && least > (1.0 + kOfCoefficients) * follows.second))
      broken_.push_back(fmt::format("u of {} is {:.3g} to {:.3g}, but {:.3g} to {:.3g} follows", name, least,
                                    most, follows.first, follows.second));
  }

  /// Marks name a quantity as its list does: "phi_uv", "bias_u".
  bool is_raised(const std::string& name) const {
    const std::string of = name.substr(name.rfind('_'));
    const bool sensitivity = name.find("sensitivity_") != std::string::npos;
    return raised_.contains(name) || (sensitivity && raised_.contains("s" + of)) ||
           (name.starts_with("intrinsic_angle_") &&
            (raised_.contains("phi" + of) || raised_.contains("non_orthogonality" + of)));
  }

  void compare_per_gravity() {
    const std::string condition =
        "dcc:influenceConditions/dcc:influenceCondition[@refType='abc_localGravity']";
    const double g = reading_.g_loc_mps2;
    Claim gravity;
    const std::string expanded = xml_.text(condition + "//si:valueExpandedMU", calibration_);
    gravity.expanded = {std::stod(expanded),
                        std::pow(10.0, std::floor(std::log10(std::stod(expanded))) - 1.0)};
    gravity.factor = xml_.text(condition + "//si:coverageFactor", calibration_);
    for (const auto& [name, per_si] : by_name_) {
      const auto found = by_name_.find("g_loc*" + name);
      if (found == by_name_.end()) continue;
      const Claim& per_gravity = *found->second;
      const double rounding = 0.5 * (per_gravity.value.digit + g * per_si->value.digit);
      // Local gravity is printed to two digits of its U.
      const double of_gravity = 0.05 * gravity.expanded.value * std::abs(per_si->value.value);
      if (std::abs(per_gravity.value.value - g * per_si->value.value) > 1.001 * rounding + of_gravity)
        broken_.push_back(fmt::format("{} times g_loc is {:.9g}, but {:.9g} is stated", name,
                                      g * per_si->value.value, per_gravity.value.value));
      const auto with_gravity = [&, value = per_si->value.value](double u, double of_g) {
        return std::hypot(u / g, value * of_g / g);
      };
      const auto [least, most] = range_of_u(per_gravity);
      const auto [least_g, most_g] = range_of_u(gravity);
      compare_uncertainty(name, {with_gravity(least, least_g), with_gravity(most, most_g)});
    }
  }

  XmlDocument document_;
  XmlQuery xml_;
  const Reading& reading_;
  xmlNode* calibration_ = nullptr;
  std::map<std::string, const Claim*> by_name_;
  std::set<std::string> raised_;
  Outputs y_ = Outputs::Zero(), u_ = Outputs::Zero(), half_digit_ = Outputs::Zero(),
          rounding_of_u_ = Outputs::Zero();  // Relative.
  std::vector<std::string> broken_;
};

}  // namespace

std::vector<std::string> broken_relations(const std::string& xml, const Reading& reading, bool last) {
  return Relations(xml, reading, last).broken();
}

}  // namespace abcal::test
