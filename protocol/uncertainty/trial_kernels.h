#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "protocol/estimators/shared/noise_process.h"
#include "protocol/linear/products.h"

namespace abcal {

// The loops in which JointTrials spends its time, for several trials side by side on the widest vectors of
// this machine. Each sum runs in one order and no operation is fused, so that a trial has the same bits on
// every processor and at every place among the others.

/// Trials that are solved side by side. A divisor of the block of run_monte_carlo().
inline constexpr std::size_t kTrialsTogether = 40;
/// Rows of a PanelMatrix that are stored together.
inline constexpr std::size_t kPanelRows = 8;

/// Numbers where every vector set may load its widest vector; zero at first.
class AlignedNumbers {
 public:
  AlignedNumbers() = default;
  explicit AlignedNumbers(std::size_t count) : memory_(count / kPanelRows + 1) {}
  double* data() { return reinterpret_cast<double*>(memory_.data()); }
  const double* data() const { return reinterpret_cast<const double*>(memory_.data()); }

 private:
  struct alignas(kPanelRows * sizeof(double)) Vector {
    double value[kPanelRows] = {};
  };
  std::vector<Vector> memory_{1};
};

/// A matrix with one column for each trial, row by row; zero at first.
class TrialRows {
 public:
  TrialRows() = default;
  explicit TrialRows(std::size_t rows) : numbers_(rows * kTrialsTogether) {}
  double* row(std::size_t i) { return numbers_.data() + i * kTrialsTogether; }
  const double* row(std::size_t i) const { return numbers_.data() + i * kTrialsTogether; }
  double& at(std::size_t i, std::size_t trial) { return row(i)[trial]; }
  double at(std::size_t i, std::size_t trial) const { return row(i)[trial]; }

 private:
  AlignedNumbers numbers_;
};

/// A constant matrix, stored for products with TrialRows.
class PanelMatrix {
 public:
  PanelMatrix() = default;
  explicit PanelMatrix(const MatrixView& matrix);
  std::size_t inner() const { return inner_; }  ///< Its columns.
  std::size_t panels() const { return panels_; }
  /// Its rows, rounded up to whole panels.
  std::size_t padded_rows() const { return kPanelRows * panels_; }
  /// Column k of a panel: kPanelRows numbers.
  const double* column(std::size_t panel, std::size_t k) const {
    return numbers_.data() + (panel * inner_ + k) * kPanelRows;
  }

 private:
  std::size_t inner_ = 0, panels_ = 0;
  AlignedNumbers numbers_;
};

/// A B. @param out  padded_rows() of A; none of B
void multiply(const PanelMatrix& a, const TrialRows& b, TrialRows& out);

/// An element of the readings that is not zero.
struct ReadingElement {
  std::size_t row = 0;
  double value = 0.0;
};
/// For each output the elements of a trial in the rows of this output.
using ReadingElements = std::array<std::vector<ReadingElement>, 3>;

/// A e of each trial and output. Row i of output j: out.row(j * a.padded_rows() + i).
void multiply_elements(const PanelMatrix& a, std::span<const ReadingElements> elements, TrialRows& out);

/// Rows of the products x' V^-1 y: readings with themselves; with the parts of u, v, w; parts uu, vu, vv, wu,
/// wv, ww.
inline constexpr std::size_t kWhitenedProducts = 10;
/// @param by_output  its rows of u, v, w are the three parts; null: the first row of `out` alone is computed
void whitened_products(const NoiseWhitener& whitener, const TrialRows& readings, const TrialRows* by_output,
                       TrialRows& out);

/// Products of the columns of a trial that the hysteresis needs, over the unknowns i.
enum HysteresisProduct : std::size_t {
  kRootedSquared = 0,      ///< y.y
  kSelectedRooted = 1,     ///< S_j.y
  kLinkedRooted = 4,       ///< L_j.y
  kSelectedLinked = 7,     ///< S_j.L_k, row by row
  kLinkedLinked = 16,      ///< L_j.L_k, k <= j, row by row
  kSelectedSelected = 22,  ///< S_j.S_k, k <= j, row by row
  kHysteresisProducts = 28,
};
/// Adds sum_j weight_j S_j to y of each trial, and computes the products.
/// @param selected  unknowns x 3, row by row: S
/// @param linked  L, as multiply_elements() gives it; its outputs are `stride` rows apart
/// @param weights  3 rows, one for each output
/// @param y  as many rows as S
void hysteresis_products(std::span<const std::array<double, 3>> selected, const TrialRows& linked,
                         std::size_t stride, const double* weights, TrialRows& y, TrialRows& out);
/// Subtracts sum_j a_j S_j + b_j L_j from y of each trial.
/// @param weights  6 rows: a, b
/// @param along  3 rows: S_j.y afterwards
void take_hysteresis(std::span<const std::array<double, 3>> selected, const TrialRows& linked,
                     std::size_t stride, const TrialRows& weights, TrialRows& y, TrialRows& along);
/// y.y of each trial over the first `rows` rows.
void squares(const TrialRows& y, std::size_t rows, double* out);

}  // namespace abcal
