#include "protocol/uncertainty/trial_kernels.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "protocol/uncertainty/trial_kernels.cc"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace abcal {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using Lanes = hn::CappedTag<double, kPanelRows>;
using V = hn::Vec<Lanes>;

HWY_INLINE V add_product(V sum, V a, V b) {
  return hn::Add(sum, hn::Mul(a, b));
}

// The names are Highway's; what a kernel needs is passed one by one.
// NOLINTBEGIN(readability-function-size, readability-identifier-naming)
void Multiply(const PanelMatrix& a, const TrialRows& b, TrialRows& out) {
  const Lanes d;
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t panel = 0; panel < a.panels(); ++panel) {
    for (std::size_t t = 0; t < kTrialsTogether; t += lanes) {
      V sum[kPanelRows];
      for (std::size_t i = 0; i < kPanelRows; ++i) sum[i] = hn::Zero(d);
      const double* HWY_RESTRICT left = a.column(panel, 0);
      const double* HWY_RESTRICT right = b.row(0) + t;
      for (std::size_t k = 0; k < a.inner(); ++k, left += kPanelRows, right += kTrialsTogether) {
        const V one = hn::Load(d, right);
        for (std::size_t i = 0; i < kPanelRows; ++i) sum[i] = add_product(sum[i], hn::Set(d, left[i]), one);
      }
      for (std::size_t i = 0; i < kPanelRows; ++i) hn::Store(sum[i], d, out.row(kPanelRows * panel + i) + t);
    }
  }
}

// Even and odd elements have sums of their own: a chain of additions alone would leave the processor waiting.
HWY_INLINE void multiply_panel(const double* HWY_RESTRICT panel, const std::vector<ReadingElement>& elements,
                               double* HWY_RESTRICT out) {
  const Lanes d;
  for (std::size_t i = 0; i < kPanelRows; i += hn::Lanes(d)) {
    V even = hn::Zero(d), odd = hn::Zero(d);
    std::size_t k = 0;
    for (; k + 1 < elements.size(); k += 2) {
      even = add_product(even, hn::Set(d, elements[k].value),
                         hn::Load(d, panel + elements[k].row * kPanelRows + i));
      odd = add_product(odd, hn::Set(d, elements[k + 1].value),
                        hn::Load(d, panel + elements[k + 1].row * kPanelRows + i));
    }
    if (k < elements.size())
      even = add_product(even, hn::Set(d, elements[k].value),
                         hn::Load(d, panel + elements[k].row * kPanelRows + i));
    hn::Store(hn::Add(even, odd), d, out + i);
  }
}

void MultiplyElements(const PanelMatrix& a, std::span<const ReadingElements> elements, TrialRows& out) {
  HWY_ALIGN double products[kPanelRows];
  for (std::size_t panel = 0; panel < a.panels(); ++panel) {
    for (std::size_t t = 0; t < elements.size(); ++t) {
      for (std::size_t j = 0; j < 3; ++j) {
        multiply_panel(a.column(panel, 0), elements[t][j], products);
        const std::size_t first = j * a.padded_rows() + kPanelRows * panel;
        for (std::size_t i = 0; i < kPanelRows; ++i) out.at(first + i, t) = products[i];
      }
    }
  }
}

// The whitening filter of noise_process.h for one vector of trials; its state stays in registers.
struct Filter {
  V mean[3];

  HWY_INLINE void reset() {
    for (V& one : mean) one = hn::Zero(Lanes());
  }
  HWY_INLINE void pass(const WhitenerStep& at, bool white, V (&rows)[3]) {
    const Lanes d;
    if (!white) {
      for (std::size_t j = 0; j < 3; ++j) rows[j] = hn::Sub(rows[j], mean[j]);
      const V decay = hn::Set(d, at.decay);
      for (Eigen::Index j = 0; j < 3; ++j) {
        V sum = mean[j];
        for (Eigen::Index k = 0; k < 3; ++k) sum = add_product(sum, hn::Set(d, at.gain(j, k)), rows[k]);
        mean[j] = hn::Mul(sum, decay);
      }
    }
    for (Eigen::Index j = 2; j >= 0; --j) {
      V sum = hn::Mul(hn::Set(d, at.lower_inverse(j, 0)), rows[0]);
      for (Eigen::Index k = 1; k <= j; ++k)
        sum = add_product(sum, hn::Set(d, at.lower_inverse(j, k)), rows[k]);
      rows[j] = sum;
    }
  }
};

HWY_INLINE V add_dot(V sum, const V (&a)[3], const V (&b)[3]) {
  for (std::size_t j = 0; j < 3; ++j) sum = add_product(sum, a[j], b[j]);
  return sum;
}

void WhitenedSquares(std::span<const WhitenerStep> steps, bool white, const TrialRows& readings,
                     TrialRows& out) {
  const Lanes d;
  for (std::size_t t = 0; t < kTrialsTogether; t += hn::Lanes(d)) {
    Filter filter;
    filter.reset();
    V sum = hn::Zero(d);
    for (std::size_t n = 0; n < steps.size(); ++n) {
      V own[3];
      for (std::size_t j = 0; j < 3; ++j) own[j] = hn::Load(d, readings.row(3 * n + j) + t);
      filter.pass(steps[n], white, own);
      sum = add_dot(sum, own, own);
    }
    hn::Store(sum, d, out.row(0) + t);
  }
}

void WhitenedProducts(std::span<const WhitenerStep> steps, bool white, const TrialRows& readings,
                      const TrialRows& by_output, TrialRows& out) {
  const Lanes d;
  for (std::size_t t = 0; t < kTrialsTogether; t += hn::Lanes(d)) {
    Filter of_readings, of_parts[3];
    of_readings.reset();
    for (Filter& one : of_parts) one.reset();
    V sum[kWhitenedProducts];
    for (V& one : sum) one = hn::Zero(d);
    for (std::size_t n = 0; n < steps.size(); ++n) {
      V own[3], part[3][3];
      for (std::size_t j = 0; j < 3; ++j) {
        own[j] = hn::Load(d, readings.row(3 * n + j) + t);
        for (std::size_t k = 0; k < 3; ++k) part[j][k] = hn::Zero(d);
        part[j][j] = hn::Load(d, by_output.row(3 * n + j) + t);
      }
      of_readings.pass(steps[n], white, own);
      for (std::size_t j = 0; j < 3; ++j) of_parts[j].pass(steps[n], white, part[j]);
      sum[0] = add_dot(sum[0], own, own);
      std::size_t next = 4;
      for (std::size_t j = 0; j < 3; ++j) {
        sum[1 + j] = add_dot(sum[1 + j], part[j], own);
        for (std::size_t k = 0; k <= j; ++k, ++next) sum[next] = add_dot(sum[next], part[j], part[k]);
      }
    }
    for (std::size_t i = 0; i < kWhitenedProducts; ++i) hn::Store(sum[i], d, out.row(i) + t);
  }
}

void HysteresisProducts(std::span<const std::array<double, 3>> selected, const TrialRows& linked,
                        std::size_t stride, const double* weights, TrialRows& y, TrialRows& out) {
  const Lanes d;
  for (std::size_t t = 0; t < kTrialsTogether; t += hn::Lanes(d)) {
    V weight[3];
    for (std::size_t j = 0; j < 3; ++j) weight[j] = hn::Load(d, weights + j * kTrialsTogether + t);
    V sum[kHysteresisProducts];
    for (V& one : sum) one = hn::Zero(d);
    for (std::size_t i = 0; i < selected.size(); ++i) {
      V s[3], l[3];
      V own = hn::Load(d, y.row(i) + t);
      for (std::size_t j = 0; j < 3; ++j) {
        s[j] = hn::Set(d, selected[i][j]);
        l[j] = hn::Load(d, linked.row(j * stride + i) + t);
        own = add_product(own, weight[j], s[j]);
      }
      hn::Store(own, d, y.row(i) + t);
      sum[kRootedSquared] = add_product(sum[kRootedSquared], own, own);
      std::size_t next = kLinkedLinked;
      for (std::size_t j = 0; j < 3; ++j) {
        sum[kSelectedRooted + j] = add_product(sum[kSelectedRooted + j], s[j], own);
        sum[kLinkedRooted + j] = add_product(sum[kLinkedRooted + j], l[j], own);
        for (std::size_t k = 0; k < 3; ++k) {
          V& both = sum[kSelectedLinked + 3 * j + k];
          both = add_product(both, s[j], l[k]);
        }
        for (std::size_t k = 0; k <= j; ++k, ++next) {
          sum[next] = add_product(sum[next], l[j], l[k]);
          V& both = sum[next - kLinkedLinked + kSelectedSelected];
          both = add_product(both, s[j], s[k]);
        }
      }
    }
    for (std::size_t i = 0; i < kHysteresisProducts; ++i) hn::Store(sum[i], d, out.row(i) + t);
  }
}

void TakeHysteresis(std::span<const std::array<double, 3>> selected, const TrialRows& linked,
                    std::size_t stride, const TrialRows& weights, TrialRows& y, TrialRows& along) {
  const Lanes d;
  for (std::size_t t = 0; t < kTrialsTogether; t += hn::Lanes(d)) {
    V of_selected[3], of_linked[3], sum[3];
    for (std::size_t j = 0; j < 3; ++j) {
      of_selected[j] = hn::Load(d, weights.row(j) + t);
      of_linked[j] = hn::Load(d, weights.row(3 + j) + t);
      sum[j] = hn::Zero(d);
    }
    for (std::size_t i = 0; i < selected.size(); ++i) {
      V taken = hn::Zero(d);
      for (std::size_t j = 0; j < 3; ++j) {
        taken = add_product(taken, of_selected[j], hn::Set(d, selected[i][j]));
        taken = add_product(taken, of_linked[j], hn::Load(d, linked.row(j * stride + i) + t));
      }
      const V own = hn::Sub(hn::Load(d, y.row(i) + t), taken);
      hn::Store(own, d, y.row(i) + t);
      for (std::size_t j = 0; j < 3; ++j) sum[j] = add_product(sum[j], hn::Set(d, selected[i][j]), own);
    }
    for (std::size_t j = 0; j < 3; ++j) hn::Store(sum[j], d, along.row(j) + t);
  }
}

void Squares(const TrialRows& y, std::size_t rows, double* out) {
  const Lanes d;
  for (std::size_t t = 0; t < kTrialsTogether; t += hn::Lanes(d)) {
    V sum = hn::Zero(d);
    for (std::size_t i = 0; i < rows; ++i) {
      const V own = hn::Load(d, y.row(i) + t);
      sum = add_product(sum, own, own);
    }
    hn::Store(sum, d, out + t);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace abcal
HWY_AFTER_NAMESPACE();

#if HWY_ONCE

namespace abcal {

HWY_EXPORT(Multiply);
HWY_EXPORT(MultiplyElements);
HWY_EXPORT(WhitenedSquares);
HWY_EXPORT(WhitenedProducts);
HWY_EXPORT(HysteresisProducts);
HWY_EXPORT(TakeHysteresis);
HWY_EXPORT(Squares);

PanelMatrix::PanelMatrix(const MatrixView& matrix)
    : inner_(static_cast<std::size_t>(matrix.cols())),
      panels_((static_cast<std::size_t>(matrix.rows()) + kPanelRows - 1) / kPanelRows),
      numbers_(inner_ * panels_ * kPanelRows) {
  for (Eigen::Index k = 0; k < matrix.cols(); ++k) {
    for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
      const auto row = static_cast<std::size_t>(i);
      numbers_
          .data()[(row / kPanelRows * inner_ + static_cast<std::size_t>(k)) * kPanelRows + row % kPanelRows] =
          matrix(i, k);
    }
  }
}

void multiply(const PanelMatrix& a, const TrialRows& b, TrialRows& out) {
  HWY_DYNAMIC_DISPATCH(Multiply)(a, b, out);
}

void multiply_elements(const PanelMatrix& a, std::span<const ReadingElements> elements, TrialRows& out) {
  HWY_DYNAMIC_DISPATCH(MultiplyElements)(a, elements, out);
}

void whitened_products(const NoiseWhitener& whitener, const TrialRows& readings, const TrialRows* by_output,
                       TrialRows& out) {
  if (by_output == nullptr) {
    HWY_DYNAMIC_DISPATCH(WhitenedSquares)(whitener.steps(), whitener.white(), readings, out);
  } else {
    HWY_DYNAMIC_DISPATCH(WhitenedProducts)(whitener.steps(), whitener.white(), readings, *by_output, out);
  }
}

void hysteresis_products(std::span<const std::array<double, 3>> selected, const TrialRows& linked,
                         std::size_t stride, const double* weights, TrialRows& y, TrialRows& out) {
  HWY_DYNAMIC_DISPATCH(HysteresisProducts)(selected, linked, stride, weights, y, out);
}

void take_hysteresis(std::span<const std::array<double, 3>> selected, const TrialRows& linked,
                     std::size_t stride, const TrialRows& weights, TrialRows& y, TrialRows& along) {
  HWY_DYNAMIC_DISPATCH(TakeHysteresis)(selected, linked, stride, weights, y, along);
}

void squares(const TrialRows& y, std::size_t rows, double* out) {
  HWY_DYNAMIC_DISPATCH(Squares)(y, rows, out);
}

// NOLINTEND(readability-function-size, readability-identifier-naming)

}  // namespace abcal

#endif  // HWY_ONCE
