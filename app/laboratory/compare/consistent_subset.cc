#include "app/laboratory/compare/consistent_subset.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "protocol/statistics/distributions.h"

namespace abcal {
namespace {

/// chi2 of any subset of the results. With P = V^-1 - V^-1 A (A' V^-1 A)^-1 A' V^-1 (A: the mean in every
/// result) chi2 of all is x' P x. To leave a result out is to let its values be free: chi2 becomes the least
/// over them, and P its Schur complement.
class Chi2 {
 public:
  /// @param precision  V^-1
  Chi2(const Eigen::VectorXd& x, const Eigen::MatrixXd& precision, Eigen::Index size) : size_(size) {
    const Eigen::Index n = x.size() / size;
    Eigen::MatrixXd sums = Eigen::MatrixXd::Zero(x.size(), size);  // V^-1 A
    for (Eigen::Index i = 0; i < n; ++i) sums += precision.middleCols(i * size, size);
    Eigen::MatrixXd of_mean = Eigen::MatrixXd::Zero(size, size);
    for (Eigen::Index i = 0; i < n; ++i) of_mean += sums.middleRows(i * size, size);
    p_ = precision - sums * of_mean.ldlt().solve(sums.transpose());
    px_ = p_ * x;
    chi2_ = x.dot(px_);
  }
  double value() const { return std::max(0.0, chi2_); }
  /// chi2 if result i is left out too.
  double without(std::size_t i) const {
    const Eigen::VectorXd part = px_.segment(at(i), size_);
    return std::max(0.0, chi2_ - part.dot(block(i, i).ldlt().solve(part)));
  }
  /// chi2 if results i and j are left out too: without a copy of P, which would take most of the time.
  double without(std::size_t i, std::size_t j) const {
    Eigen::VectorXd part(2 * size_);
    part << px_.segment(at(i), size_), px_.segment(at(j), size_);
    Eigen::MatrixXd both(2 * size_, 2 * size_);
    both << block(i, i), block(i, j), block(j, i), block(j, j);
    return std::max(0.0, chi2_ - part.dot(both.ldlt().solve(part)));
  }
  /// Leaves result i out.
  void leave_out(std::size_t i) {
    const Eigen::LDLT<Eigen::MatrixXd> factor(block(i, i));
    const Eigen::MatrixXd columns = p_.middleCols(at(i), size_);
    const Eigen::VectorXd part = px_.segment(at(i), size_);
    chi2_ = without(i);
    px_ -= columns * factor.solve(part);
    p_ -= columns * factor.solve(columns.transpose());
  }

 private:
  Eigen::Index at(std::size_t i) const { return static_cast<Eigen::Index>(i) * size_; }
  Eigen::MatrixXd block(std::size_t i, std::size_t j) const { return p_.block(at(i), at(j), size_, size_); }

  Eigen::Index size_;
  Eigen::MatrixXd p_;
  Eigen::VectorXd px_;
  double chi2_ = 0.0;
};

ConsistencyTest test_of(double chi2, std::size_t results, Eigen::Index size) {
  const int degrees = static_cast<int>(results - 1) * static_cast<int>(size);
  return {chi2, degrees, chi2_tail(chi2, degrees)};
}

/// A set of results left out, and what remains of chi2.
struct LeftOut {
  std::vector<std::size_t> results;
  double chi2 = std::numeric_limits<double>::infinity();
};

/// Tries every set of `more` further results from `from` on.
template <class Try>
void each_set(const Chi2& before, std::size_t from, std::size_t more, std::size_t n,
              std::vector<std::size_t>& left_out, const Try& attempt) {
  for (std::size_t i = from; i + more <= n; ++i) {
    left_out.push_back(i);
    if (more == 1) {
      attempt(left_out, before.without(i));
    } else if (more == 2) {
      for (std::size_t j = i + 1; j < n; ++j) {
        left_out.push_back(j);
        attempt(left_out, before.without(i, j));
        left_out.pop_back();
      }
    } else {
      Chi2 after = before;
      after.leave_out(i);
      each_set(after, i + 1, more - 1, n, left_out, attempt);
    }
    left_out.pop_back();
  }
}

/// Whether there are at most `limit` sets of r of n.
bool few_sets(std::size_t n, std::size_t r, double limit) {
  double count = 1.0;
  for (std::size_t k = 0; k < r; ++k) count *= static_cast<double>(n - k) / static_cast<double>(k + 1);
  return count <= limit;
}

/// V^-1 of values in units of their own; of the variances alone if V is not positive definite.
Eigen::MatrixXd precision_of(const Eigen::MatrixXd& covariance, bool& covariances_used) {
  const Eigen::MatrixXd identity = Eigen::MatrixXd::Identity(covariance.rows(), covariance.cols());
  const Eigen::LLT<Eigen::MatrixXd> factor(covariance);
  constexpr double kLeastReciprocalCondition = 1e-13;
  covariances_used = factor.info() == Eigen::Success && factor.rcond() > kLeastReciprocalCondition;
  if (covariances_used) return factor.solve(identity);
  return covariance.diagonal().cwiseInverse().asDiagonal();
}

void require_sizes(const std::vector<Eigen::VectorXd>& values, const Eigen::MatrixXd& covariance) {
  const std::size_t n = values.size();
  const Eigen::Index size = n == 0 ? 0 : values.front().size();
  const bool alike = std::ranges::all_of(values, [&](const Eigen::VectorXd& v) { return v.size() == size; });
  const Eigen::Index rows = static_cast<Eigen::Index>(n) * size;
  if (n < 2 || n > kMostConsistent || size == 0 || !alike || covariance.rows() != rows ||
      covariance.cols() != rows) {
    throw std::invalid_argument(fmt::format(
        "consistency of {} results; required: 2 to {}, all of the same properties, and their covariance", n,
        kMostConsistent));
  }
  if (!(covariance.diagonal().array() > 0.0).all() || !covariance.allFinite())
    throw std::invalid_argument(
        "consistency: the uncertainty of a result is not above 0; required: one for each value");
}

}  // namespace

ConsistentSubset largest_consistent_subset(const std::vector<Eigen::VectorXd>& values,
                                           const Eigen::MatrixXd& covariance, double level) {
  require_sizes(values, covariance);
  const std::size_t n = values.size();
  const Eigen::Index size = values.front().size();
  // In units of each property's typical uncertainty, around the first result.
  Eigen::VectorXd unit = Eigen::VectorXd::Zero(size), x(covariance.rows()), scale(covariance.rows());
  for (std::size_t i = 0; i < n; ++i)
    unit += covariance.diagonal().segment(static_cast<Eigen::Index>(i) * size, size);
  unit = (unit / static_cast<double>(n)).cwiseSqrt();
  for (std::size_t i = 0; i < n; ++i) {
    const Eigen::Index at = static_cast<Eigen::Index>(i) * size;
    x.segment(at, size) = (values[i] - values.front()).cwiseQuotient(unit);
    scale.segment(at, size) = unit.cwiseInverse();
  }
  ConsistentSubset result;
  const Eigen::MatrixXd scaled = scale.asDiagonal() * covariance * scale.asDiagonal();
  const Chi2 all(x, precision_of(scaled, result.covariances_used), size);
  result.all = result.subset = test_of(all.value(), n, size);
  result.found = result.agree(level);
  Chi2 greedy = all;
  std::vector<std::size_t> removed;
  constexpr double kMostSets = 5000.0;
  for (std::size_t r = 1; !result.found && 2 * (n - r) > n; ++r) {
    LeftOut best;
    int agreeing = 0;
    const auto attempt = [&](const std::vector<std::size_t>& left_out, double chi2) {
      if (test_of(chi2, n - r, size).probability >= level) ++agreeing;
      if (chi2 < best.chi2) best = {left_out, chi2};
    };
    if (result.exhaustive && few_sets(n, r, kMostSets)) {
      std::vector<std::size_t> none;
      each_set(all, 0, r, n, none, attempt);
      removed = best.results;
    } else {
      if (result.exhaustive) {
        for (const std::size_t i : removed) greedy.leave_out(i);
        result.exhaustive = false;
      }
      for (std::size_t i = 0; i < n; ++i) {
        if (std::ranges::find(removed, i) != removed.end()) continue;
        std::vector<std::size_t> more = removed;
        more.push_back(i);
        attempt(more, greedy.without(i));
      }
      greedy.leave_out(best.results.back());
      removed = best.results;
    }
    if (agreeing == 0) continue;
    result.found = true;
    result.outliers = best.results;
    std::ranges::sort(result.outliers);
    result.subset = test_of(best.chi2, n - r, size);
    result.alternatives = agreeing - 1;
  }
  return result;
}

}  // namespace abcal
