#include "protocol/estimators/shared/reading_kernels.h"

#include <algorithm>
#include <cstddef>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "protocol/estimators/shared/reading_kernels.cc"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

#include <vector>

HWY_BEFORE_NAMESPACE();
namespace abcal {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

/// Columns are padded to this: two vectors of the widest set.
constexpr std::size_t kPad = 16;
constexpr std::size_t kBlock = 4;

// One vector of columns all the way down the run: the state of the filter stays in registers.
template <class D, class V = hn::Vec<D>>
HWY_INLINE void whiten_columns(D d, const WhitenerStep* steps, std::size_t count, bool white, double* rows,
                               std::size_t stride) {
  V mean[3] = {hn::Zero(d), hn::Zero(d), hn::Zero(d)};
  for (std::size_t n = 0; n < count; ++n, rows += 3 * stride) {
    const WhitenerStep& at = steps[n];
    V in[3];
    for (std::size_t j = 0; j < 3; ++j) in[j] = hn::LoadU(d, rows + j * stride);
    if (!white) {
      for (std::size_t j = 0; j < 3; ++j) in[j] = hn::Sub(in[j], mean[j]);
      const V decay = hn::Set(d, at.decay);
      for (Eigen::Index j = 0; j < 3; ++j) {
        V sum = mean[j];
        for (Eigen::Index k = 0; k < 3; ++k) sum = hn::Add(sum, hn::Mul(hn::Set(d, at.gain(j, k)), in[k]));
        mean[j] = hn::Mul(sum, decay);
      }
    }
    for (Eigen::Index j = 0; j < 3; ++j) {
      V sum = hn::Mul(hn::Set(d, at.lower_inverse(j, 0)), in[0]);
      for (Eigen::Index k = 1; k <= j; ++k)
        sum = hn::Add(sum, hn::Mul(hn::Set(d, at.lower_inverse(j, k)), in[k]));
      hn::StoreU(sum, d, rows + static_cast<std::size_t>(j) * stride);
    }
  }
}

void WhitenRows(const WhitenerStep* steps, std::size_t count, bool white, double* rows, std::size_t columns) {
  const hn::ScalableTag<double> d;
  const hn::CappedTag<double, 1> one;
  const std::size_t lanes = hn::Lanes(d);
  std::size_t column = 0;
  for (; column + lanes <= columns; column += lanes)
    whiten_columns(d, steps, count, white, rows + column, columns);
  for (; column < columns; ++column) whiten_columns(one, steps, count, white, rows + column, columns);
}

// out(a, b) += the sum of x(r, a) x(r, b) for kBlock rows a and two vectors of columns b.
template <class D, class V = hn::Vec<D>>
HWY_INLINE void add_block(D d, const double* HWY_RESTRICT x, std::size_t rows, std::size_t width,
                          std::size_t a, std::size_t b, double* HWY_RESTRICT out) {
  const std::size_t lanes = hn::Lanes(d);
  V sum[kBlock][2];
  for (std::size_t i = 0; i < kBlock; ++i) {
    sum[i][0] = hn::Load(d, out + (a + i) * width + b);
    sum[i][1] = hn::Load(d, out + (a + i) * width + b + lanes);
  }
  for (std::size_t r = 0; r < rows; ++r) {
    const double* HWY_RESTRICT row = x + r * width;
    const V first = hn::Load(d, row + b);
    const V second = hn::Load(d, row + b + lanes);
    for (std::size_t i = 0; i < kBlock; ++i) {
      const V left = hn::Set(d, row[a + i]);
      sum[i][0] = hn::Add(sum[i][0], hn::Mul(left, first));
      sum[i][1] = hn::Add(sum[i][1], hn::Mul(left, second));
    }
  }
  for (std::size_t i = 0; i < kBlock; ++i) {
    hn::Store(sum[i][0], d, out + (a + i) * width + b);
    hn::Store(sum[i][1], d, out + (a + i) * width + b + lanes);
  }
}

// `x`: rows x width, `out`: width x width, both aligned; width a multiple of kPad. Of `out` the blocks from
// the diagonal on.
void AddProducts(const double* x, std::size_t rows, std::size_t width, double* out) {
  const hn::CappedTag<double, kPad / 2> d;
  const std::size_t step = 2 * hn::Lanes(d);
  for (std::size_t a = 0; a < width; a += kBlock) {
    for (std::size_t b = a / step * step; b < width; b += step) add_block(d, x, rows, width, a, b, out);
  }
}

// out = x m for kBlock rows of x: `x` has `inner` columns, `m` inner x width, `out` kBlock x width, m and out
// aligned, width a multiple of kPad. Of an upper triangular m the zeros are left out.
void MultiplyRows(const double* const* x, const double* m, std::size_t inner, std::size_t width, bool upper,
                  double* out) {
  const hn::CappedTag<double, kPad / 2> d;
  using V = hn::Vec<decltype(d)>;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t b = 0; b < width; b += 2 * lanes) {
    V sum[kBlock][2];
    for (std::size_t i = 0; i < kBlock; ++i) sum[i][0] = sum[i][1] = hn::Zero(d);
    const std::size_t last = upper ? std::min(inner, b + 2 * lanes) : inner;
    for (std::size_t k = 0; k < last; ++k) {
      const V first = hn::Load(d, m + k * width + b);
      const V second = hn::Load(d, m + k * width + b + lanes);
      for (std::size_t i = 0; i < kBlock; ++i) {
        const V left = hn::Set(d, x[i][k]);
        sum[i][0] = hn::Add(sum[i][0], hn::Mul(left, first));
        sum[i][1] = hn::Add(sum[i][1], hn::Mul(left, second));
      }
    }
    for (std::size_t i = 0; i < kBlock; ++i) {
      hn::Store(sum[i][0], d, out + i * width + b);
      hn::Store(sum[i][1], d, out + i * width + b + lanes);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace abcal
HWY_AFTER_NAMESPACE();

#if HWY_ONCE

namespace abcal {

HWY_EXPORT(WhitenRows);
HWY_EXPORT(AddProducts);
HWY_EXPORT(MultiplyRows);

void whiten_rows(std::span<const WhitenerStep> steps, bool white, ReadingRows& rows) {
  if (rows.size() == 0) return;
  HWY_DYNAMIC_DISPATCH(WhitenRows)
  (steps.data(), steps.size(), white, rows.data(), static_cast<std::size_t>(rows.cols()));
}

namespace {

/// As many numbers as the widest vector holds, where it may be loaded from; zero at first.
constexpr std::size_t kAligned = 8;
struct alignas(kAligned * sizeof(double)) AlignedDoubles {
  double value[kAligned] = {};
};
constexpr std::size_t kWidth = 16;  // the kernels' kPad

std::size_t padded(Eigen::Index columns) {
  return (static_cast<std::size_t>(columns) + kWidth - 1) / kWidth * kWidth;
}

ReadingRows multiplied(const ReadingRows& rows, const Eigen::MatrixXd& matrix, bool upper) {
  constexpr std::size_t kTogether = 4;  // the kernels' kBlock
  const auto inner = static_cast<std::size_t>(rows.cols());
  const auto columns = static_cast<std::size_t>(matrix.cols());
  const std::size_t width = padded(matrix.cols());
  std::vector<AlignedDoubles> matrix_memory(inner * width / kAligned + 1);
  std::vector<AlignedDoubles> out_memory(kTogether * width / kAligned + 1);
  double* const by_rows = matrix_memory.data()->value;
  double* const products = out_memory.data()->value;
  for (std::size_t b = 0; b < columns; ++b) {
    const std::size_t last = upper ? std::min(inner, b + 1) : inner;
    for (std::size_t k = 0; k < last; ++k)
      by_rows[k * width + b] = matrix(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(b));
  }
  ReadingRows out(rows.rows(), matrix.cols());
  const auto count = static_cast<std::size_t>(rows.rows());
  for (std::size_t first = 0; first < count; first += kTogether) {
    const double* x[kTogether];
    // Where fewer are left, the last one is multiplied more than once.
    for (std::size_t i = 0; i < kTogether; ++i) x[i] = rows.data() + std::min(first + i, count - 1) * inner;
    HWY_DYNAMIC_DISPATCH(MultiplyRows)(x, by_rows, inner, width, upper, products);
    for (std::size_t i = 0; i < kTogether && first + i < count; ++i)
      std::copy_n(products + i * width, columns, out.data() + (first + i) * columns);
  }
  return out;
}

}  // namespace

ReadingRows times(const ReadingRows& rows, const Eigen::MatrixXd& matrix) {
  return multiplied(rows, matrix, false);
}

ReadingRows times_upper(const ReadingRows& rows, const Eigen::MatrixXd& upper) {
  return multiplied(rows, upper, true);
}

Eigen::MatrixXd products_of_columns(const ReadingRows& rows) {
  const auto columns = static_cast<std::size_t>(rows.cols());
  const auto count = static_cast<std::size_t>(rows.rows());
  const std::size_t width = padded(rows.cols());
  constexpr std::size_t kRows = 32;  // are multiplied while they are in the first cache
  std::vector<AlignedDoubles> chunk_memory(kRows * width / kAligned);
  std::vector<AlignedDoubles> sums_memory(width * width / kAligned);
  double* const chunk = chunk_memory.data()->value;
  double* const sums = sums_memory.data()->value;
  for (std::size_t first = 0; first < count; first += kRows) {
    const std::size_t many = std::min(kRows, count - first);
    for (std::size_t r = 0; r < many; ++r)
      std::copy_n(rows.data() + (first + r) * columns, columns, chunk + r * width);
    HWY_DYNAMIC_DISPATCH(AddProducts)(chunk, many, width, sums);
  }
  Eigen::MatrixXd out(rows.cols(), rows.cols());
  for (std::size_t a = 0; a < columns; ++a) {
    for (std::size_t b = a; b < columns; ++b) {
      const double sum = sums[a * width + b];
      out(static_cast<Eigen::Index>(a), static_cast<Eigen::Index>(b)) = sum;
      out(static_cast<Eigen::Index>(b), static_cast<Eigen::Index>(a)) = sum;
    }
  }
  return out;
}

}  // namespace abcal

#endif  // HWY_ONCE
