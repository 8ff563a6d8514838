#include "tests/app/certificate/statement_relations.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <numbers>
#include <optional>
#include <stdexcept>

#include "app/formats/xml_query.h"

namespace abcal::test {
namespace {

constexpr int kOutputs = 12;
constexpr double kFar = std::numeric_limits<double>::infinity();
using Outputs = Eigen::Matrix<double, kOutputs, 1>;
using Covariance = Eigen::Matrix<double, kOutputs, kOutputs>;
using Function = std::function<double(const Outputs&)>;

const std::array<std::string, 3> kRows{"u", "v", "w"}, kColumns{"x", "y", "z"}, kPairs{"uv", "vw", "wu"};

Eigen::Matrix3d matrix_of(const Outputs& y) {
  Eigen::Matrix3d s;
  s << y(0), y(1), y(2), y(3), y(4), y(5), y(6), y(7), y(8);
  return s;
}

/// "x -z y": the directions of u, v, w as rows.
Eigen::Matrix3d directions_of(const std::vector<std::string>& axes) {
  Eigen::Matrix3d directions = Eigen::Matrix3d::Zero();
  for (int j = 0; j < 3; ++j) {
    const std::string& axis = axes.at(static_cast<std::size_t>(j));
    directions(j, axis.back() - 'x') = axis.front() == '-' ? -1.0 : 1.0;
  }
  return directions;
}

/// P(t > `t`) of Student's distribution by Simpson's rule over its density, written for this reader.
double student_above(double t, double degrees) {
  if (std::isinf(degrees)) return 0.5 * std::erfc(t / std::numbers::sqrt2);
  if (t < 0.0) return 1.0 - student_above(-t, degrees);
  if (std::isinf(t)) return 0.0;
  const double scale = std::exp(std::lgamma(0.5 * (degrees + 1.0)) - std::lgamma(0.5 * degrees)) /
                       std::sqrt(degrees * std::numbers::pi);
  constexpr int kSteps = 4000;
  // t = tan(a): the density falls as a power, which the substitution makes finite.
  const double step = std::atan(t) / kSteps;
  double sum = 0.0;
  for (int i = 0; i <= kSteps; ++i) {
    const double x = std::tan(step * i);
    const double density = scale * std::pow(1.0 + x * x / degrees, -0.5 * (degrees + 1.0)) * (1.0 + x * x);
    sum += density * (i == 0 || i == kSteps ? 1.0 : i % 2 == 1 ? 4.0 : 2.0);
  }
  return 0.5 - sum * step / 3.0;
}

/// The factor with which U covers 95.45 %, by bisection.
double factor_of(double degrees) {
  static std::map<double, double> known;
  if (const auto found = known.find(degrees); found != known.end()) return found->second;
  const double above = 0.5 * (1.0 - std::erf(std::numbers::sqrt2));
  double low = 1.0, high = 1e4;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (student_above(middle, degrees) > above ? low : high) = middle;
  }
  return known[degrees] = low;
}

/// A quantity that follows from the twelve outputs. A magnitude that is not larger than its U has that of its
/// two components.
struct Follows {
  std::string name;
  Function value;
  std::vector<Function> components = {};
};

std::vector<Follows> what_follows(const Eigen::Matrix3d& mounting) {
  std::vector<Follows> all;
  for (int i = 0; i < 3; ++i) {
    const auto at = static_cast<std::size_t>(i);
    const int next = (i + 1) % 3;
    const auto along = [mounting, i](const Outputs& y, int k) {
      return matrix_of(y).row(i).dot(mounting.row(k % 3));
    };
    const Function across_1 = [=](const Outputs& y) { return along(y, i + 1) / std::abs(along(y, i)); };
    const Function across_2 = [=](const Outputs& y) { return along(y, i + 2) / std::abs(along(y, i)); };
    all.push_back(
        {"intrinsic_sensitivity_" + kRows[at], [i](const Outputs& y) { return matrix_of(y).row(i).norm(); }});
    all.push_back({"intrinsic_angle_" + kPairs[at], [i, next](const Outputs& y) {
                     const Eigen::Matrix3d s = matrix_of(y);
                     return std::atan2(s.row(i).cross(s.row(next)).norm(), s.row(i).dot(s.row(next)));
                   }});
    all.push_back(
        {"bias_" + kRows[at], [i](const Outputs& y) { return y(9 + i) / matrix_of(y).row(i).norm(); }});
    all.push_back({"transverse_sensitivity_" + kRows[at],
                   [=](const Outputs& y) { return std::hypot(across_1(y), across_2(y)); },
                   {across_1, across_2}});
    all.push_back({"misalignment_" + kRows[at],
                   [=](const Outputs& y) { return std::atan(std::hypot(across_1(y), across_2(y))); },
                   {across_1, across_2}});
    all.push_back({"transverse_azimuth_" + kRows[at],
                   [=](const Outputs& y) { return std::atan2(across_2(y), across_1(y)); }});
    for (int j = 0; j < 3; ++j)
      all.push_back({"M_" + kColumns[at] + kRows[static_cast<std::size_t>(j)],
                     [i, j](const Outputs& y) { return matrix_of(y).inverse()(i, j); }});
    for (int j = 0; j < 3; ++j)
      all.push_back({"sensitivity_" + kRows[at] + kColumns[static_cast<std::size_t>(j)],
                     [i, j](const Outputs& y) { return y(3 * i + j); }});
    all.push_back({"offset_" + kRows[at], [i](const Outputs& y) { return y(9 + i); }});
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
  }

  std::vector<std::string> broken() {
    if (!by_name_.contains("sensitivity_ux")) return {};  // No numbers.
    read_state();
    for (const Follows& one : what_follows(mounting_)) {
      const Derived derived = derive(one);
      derived_.emplace(one.name, derived);
      if (by_name_.contains(one.name)) compare(one.name, derived);
    }
    for (int i = 0; i < kOutputs; ++i) compare_per_gravity(i);
    compare_decisions();
    return broken_;
  }

 private:
  /// A quantity as it follows from the state.
  struct Derived {
    double value = 0.0, u = 0.0, degrees = kFar;
    double expanded() const { return factor_of(degrees) * u; }
  };

  std::string in_state(const std::string& type) const {
    return "dcc:results/dcc:result[@refType='abc_state']/dcc:data/*[@refType='abc_state" + type + "']";
  }
  /// The numbers of a list in SI units.
  std::vector<double> numbers(const std::string& list, xmlNode* from) const {
    std::vector<double> all;
    for (const std::string& word : xml_.words(list + "si:valueXMLList", from))
      all.push_back(std::stod(word) * factor_of_d_si(xml_.text(list + "si:unitXMLList", from)));
    return all;
  }

  void read_state() {
    std::vector<double> values;
    for (xmlNode* list : xml_.nodes(in_state("Values") + "/si:realListXMLList", calibration_)) {
      const auto more = numbers("", list);
      values.insert(values.end(), more.begin(), more.end());
      for (const std::string& label : xml_.words("si:labelXMLList", list)) labels_.push_back(label);
    }
    if (std::ssize(values) != kOutputs) throw std::runtime_error("the state has no twelve outputs");
    y_ = Eigen::Map<const Outputs>(values.data());
    const auto gravity = numbers(in_state("Gravity") + "/si:realListXMLList/", calibration_);
    g_loc_ = gravity.at(0);
    u_g_loc_ = gravity.at(1);
    covariance_ = covariance("Covariance");
    measured_ = xml_.nodes(in_state("CovarianceAsMeasured"), calibration_).empty()
                    ? covariance_
                    : covariance("CovarianceAsMeasured");
    degrees_.setConstant(kFar);
    const std::string finite = in_state("DegreesOfFreedom") + "/si:realListXMLList";
    const auto labels = xml_.words(finite + "/si:labelXMLList", calibration_);
    const auto degrees = numbers(finite + "/", calibration_);
    for (std::size_t n = 0; n < labels.size(); ++n)
      degrees_(std::find(labels_.begin(), labels_.end(), labels[n]) - labels_.begin()) = degrees.at(n);
    mounting_ = directions_of(
        xml_words(xml_.text("//dcc:itemQuantity[@refType='abc_axes']/dcc:noQuantity/dcc:content")));
  }

  /// Symmetric and positive semidefinite, to the last of its digits.
  Covariance covariance(const std::string& type) {
    Covariance matrix = Covariance::Constant(kFar);
    std::map<std::string, Eigen::Index> filled;
    for (xmlNode* row : xml_.nodes(in_state(type) + "/dcc:quantity", calibration_)) {
      const std::string label = xml_.text("dcc:name/dcc:content", row);
      const Eigen::Index i = std::find(labels_.begin(), labels_.end(), label) - labels_.begin();
      for (const double number : numbers("si:realListXMLList/", row)) matrix(i, filled[label]++) = number;
    }
    const Outputs scale = matrix.diagonal().cwiseSqrt().cwiseInverse();
    const Covariance correlation = scale.asDiagonal() * matrix * scale.asDiagonal();
    const double least = Eigen::SelfAdjointEigenSolver<Covariance>(correlation).eigenvalues().minCoeff();
    if (!matrix.allFinite() || !matrix.isApprox(matrix.transpose(), 1e-11) || least < -1e-10)
      broken_.push_back(type + " is no covariance");
    return matrix;
  }

  Outputs gradient_of(const Function& value) const {
    Outputs gradient;
    for (int k = 0; k < kOutputs; ++k) {
      Outputs step = Outputs::Zero();
      step(k) = 1e-5 * (k < 9 ? y_.head<9>().cwiseAbs().maxCoeff() : 1.0);
      gradient(k) = (value(y_ + step) - value(y_ - step)) / (2.0 * step(k));
    }
    return gradient;
  }

  /// The covariance without the part of local gravity, which all sensitivities have in common.
  Covariance without_gravity(const Covariance& of) const {
    Outputs common = Outputs::Zero();
    common.head<9>() = y_.head<9>() * u_g_loc_ / g_loc_;
    return of - common * common.transpose();
  }

  /// The degrees of freedom of the least known output that has more than a twentieth of the variance.
  double degrees_of(const Outputs& gradient) const {
    const double variance = gradient.dot(measured_ * gradient);
    const Covariance own = without_gravity(measured_);
    double least = kFar;
    for (int i = 0; i < kOutputs; ++i)
      if (std::pow(gradient(i), 2) * own(i, i) > 0.05 * variance) least = std::min(least, degrees_(i));
    return least;
  }

  Derived derive(const Follows& one) const {
    const Outputs gradient = gradient_of(one.value);
    Derived derived{one.value(y_), std::sqrt(std::max(0.0, gradient.dot(covariance_ * gradient))),
                    degrees_of(gradient)};
    double both = 0.0;
    for (const Function& component : one.components) {
      const Outputs across = gradient_of(component);
      both += across.dot(covariance_ * across);
    }
    if (!(derived.value > 2.0 * std::sqrt(both)) && both > 0.0) derived.u = std::sqrt(both);
    return derived;
  }

  void compare(const std::string& name, const Derived& derived) {
    const Claim& stated = *by_name_.at(name);
    // The state has twelve digits.
    const double rounding = 0.5001 * stated.value.digit + 1e-9 * std::abs(derived.value);
    if (std::abs(stated.value.value - derived.value) > rounding)
      broken_.push_back(fmt::format("{} is {:.9g}, but {:.9g} follows from the state", name,
                                    stated.value.value, derived.value));
    const double of_u = 0.5001 * stated.expanded.digit + 1e-4 * stated.expanded.value;
    if (std::abs(stated.expanded.value - derived.expanded()) > of_u)
      broken_.push_back(fmt::format("U of {} is {:.4g}, but {:.4g} follows from the state", name,
                                    stated.expanded.value, derived.expanded()));
    if (!stated.factor.empty() && std::abs(std::stod(stated.factor) - factor_of(derived.degrees)) > 0.0051)
      broken_.push_back(fmt::format("k of {} is {}, but {:.4g} follows from the state", name, stated.factor,
                                    factor_of(derived.degrees)));
  }

  /// The change of the output for one g_loc does not have the uncertainty of g_loc.
  void compare_per_gravity(int i) {
    const bool is_offset = i >= 9;
    const auto row = static_cast<std::size_t>(is_offset ? i - 9 : i / 3);
    const std::string name =
        is_offset ? "offset_" + kRows[row]
                  : "g_loc*sensitivity_" + kRows[row] + kColumns[static_cast<std::size_t>(i % 3)];
    if (!by_name_.contains(name)) return broken_.push_back("the certificate does not state " + name);
    const double scale = is_offset ? 1.0 : g_loc_;
    compare(name, {scale * y_(i), scale * std::sqrt(without_gravity(covariance_)(i, i)), degrees_(i)});
  }

  std::optional<double> fact(const std::string& type, xmlNode* facts) const {
    const auto found = xml_.nodes("dcc:data/dcc:quantity[@refType='" + type + "']//si:real", facts);
    if (found.empty()) return std::nullopt;
    return std::stod(xml_.text("si:value", found.front()));
  }

  /// Acceptance limits, verdict, probability and risk from the printed value, U, limits and rule.
  void compare_decisions() {
    for (xmlNode* quantity : xml_.nodes(
             "dcc:results/dcc:result[@refType='abc_conformity']/dcc:data/dcc:quantity", calibration_)) {
      const std::string name = xml_.text("dcc:name/dcc:content", quantity);
      xmlNode* real = xml_.nodes("si:real | si:hybrid/si:real", quantity).front();
      xmlNode* facts =
          xml_.nodes("dcc:measurementMetaData/dcc:metaData[@refType='basic_conformity']", quantity).front();
      decide(name, real, facts);
    }
  }

  void decide(const std::string& name, xmlNode* real, xmlNode* facts) {
    const double value = std::stod(xml_.text("si:value", real)),
                 expanded = std::stod(xml_.text(".//si:valueExpandedMU", real));
    const auto of = [&](const char* prefix) { return name.starts_with(prefix); };
    const auto found =
        derived_.find(of("non_orthogonality") ? "intrinsic_angle" + name.substr(name.rfind('_')) : name);
    const double degrees = found->second.degrees;
    const double u = expanded / factor_of(degrees);
    const auto lower = fact("basic_toleranceLimitLower", facts),
               upper = fact("basic_toleranceLimitUpper", facts);
    double factor = 0.0;
    for (const char* rule : {"guard_band", "non_binary"})
      if (const auto r = fact(fmt::format("abc_rule_{}", rule), facts)) factor = *r;
    const bool conditional = fact("abc_rule_non_binary", facts).has_value();
    const double guard = factor * expanded;
    // The range of the quantity, in the unit of the decision.
    const bool positive = of("intrinsic_") || of("transverse_sensitivity") || of("misalignment");
    const double low = lower.value_or(-kFar) + guard, high = upper.value_or(kFar) - guard;
    const double digit = std::pow(10.0, std::stod(xml_.text("si:significantDigit", real)));
    const bool possible = std::max(low, positive ? 0.0 : -kFar) <= high + 1e-6 * digit;
    const auto near = [&](double a, double b) { return std::abs(a - b) < digit; };
    const auto in = [&](double extra) {
      return value >= lower.value_or(-kFar) + extra - 1e-6 * digit &&
             value <= upper.value_or(kFar) - extra + 1e-6 * digit;
    };
    const std::string verdict = xml_.text("dcc:conformity", facts);
    const std::string expected = in(guard)                   ? "pass"
                                 : conditional && in(0.0)    ? "conditionalPass"
                                 : conditional && in(-guard) ? "conditionalFail"
                                                             : "fail";
    // Within one digit of a limit, the rounding of the limits decides, which read_xml() compares.
    const bool at_limit = near(value, low) || near(value, high) || near(value, lower.value_or(kFar)) ||
                          near(value, upper.value_or(kFar)) || near(value, lower.value_or(kFar) - guard) ||
                          near(value, upper.value_or(kFar) + guard);
    const bool narrow = std::abs(high - std::max(low, positive ? 0.0 : -kFar)) < 2.0 * digit;
    if (!narrow && possible == verdict.empty())
      broken_.push_back(fmt::format("decision on {}: \"{}\", possible: {}", name, verdict, possible));
    else if (!narrow && possible && !at_limit && verdict != expected)
      broken_.push_back(fmt::format("decision on {}: {}, but {} follows", name, verdict, expected));
    const auto beyond = [&](double at) {
      return (lower ? student_above((at - *lower) / u, degrees) : 0.0) +
             (upper ? student_above((*upper - at) / u, degrees) : 0.0);
    };
    constexpr double kFourDecimals = 0.51e-4;
    const double probability = *fact("abc_conformanceProbability", facts);
    if (std::abs(1.0 - beyond(value) - probability) > kFourDecimals)
      broken_.push_back(
          fmt::format("P of {} is {}, but {:.7f} follows", name, probability, 1.0 - beyond(value)));
    const auto risk = fact("abc_risk", facts);
    const auto accepted_low = fact("basic_acceptanceLimitLower", facts),
               accepted_high = fact("basic_acceptanceLimitUpper", facts);
    if (risk.has_value() == verdict.empty())
      broken_.push_back(
          fmt::format("{} has a decision \"{}\" and a risk: {}", name, verdict, risk.has_value()));
    const double worst =
        std::max(accepted_low ? beyond(*accepted_low) : 0.0, accepted_high ? beyond(*accepted_high) : 0.0);
    if (risk && std::abs(worst - *risk) > kFourDecimals)
      broken_.push_back(fmt::format("risk of {} is {}, but {:.7f} follows", name, *risk, worst));
  }

  XmlDocument document_;
  XmlQuery xml_;
  const Reading& reading_;
  xmlNode* calibration_ = nullptr;
  std::map<std::string, const Claim*> by_name_;
  std::map<std::string, Derived> derived_;
  std::vector<std::string> labels_;
  double g_loc_ = 0.0, u_g_loc_ = 0.0;
  Outputs y_ = Outputs::Zero(), degrees_ = Outputs::Zero();
  Covariance covariance_ = Covariance::Zero(), measured_ = Covariance::Zero();
  Eigen::Matrix3d mounting_ = Eigen::Matrix3d::Identity();
  std::vector<std::string> broken_;
};

}  // namespace

std::vector<std::string> broken_relations(const std::string& xml, const Reading& reading, bool last) {
  return Relations(xml, reading, last).broken();
}

}  // namespace abcal::test
