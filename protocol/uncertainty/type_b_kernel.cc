// The inner loop of the type B study, compiled once for each vector instruction set; one trial a lane.
//
// docs/theory/model.md, "Turning gravity instead of the matrix": gravity seen from the accelerometer is p + q
// cos(alpha + F + f) + t sin(alpha + F + f) with p, q, t constant in an experiment, and the fit is linear in
// the readings. Thus the step errors only change six sums (A, B, C of the cosine and of the sine), and the
// accelerometer is applied after them. Independent small step errors are drawn as these sums: a sum of many
// is normal, and the cosines are near their mean.
#include "protocol/uncertainty/type_b_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "protocol/uncertainty/type_b_kernel.cc"
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>

#include "protocol/uncertainty/normal_pairs-inl.h"
#include "protocol/uncertainty/random_stream.h"

HWY_BEFORE_NAMESPACE();
namespace abcal {
namespace HWY_NAMESPACE {

// Random numbers made side by side: one chain of multiplications alone would leave the processor waiting.
constexpr int kSideBySide = 2;

template <class D>
struct Vector3 {
  using V = hn::Vec<D>;
  V x, y, z;
};

template <class D, class V = hn::Vec<D>>
HWY_INLINE Vector3<D> scaled(const Vector3<D>& a, V f) {
  return {hn::Mul(a.x, f), hn::Mul(a.y, f), hn::Mul(a.z, f)};
}

template <class D>
HWY_INLINE Vector3<D> sum(const Vector3<D>& a, const Vector3<D>& b) {
  return {hn::Add(a.x, b.x), hn::Add(a.y, b.y), hn::Add(a.z, b.z)};
}

template <class D>
HWY_INLINE Vector3<D> difference(const Vector3<D>& a, const Vector3<D>& b) {
  return {hn::Sub(a.x, b.x), hn::Sub(a.y, b.y), hn::Sub(a.z, b.z)};
}

template <class D>
HWY_INLINE hn::Vec<D> dot(const Vector3<D>& a, const Vector3<D>& b) {
  return hn::Add(hn::Add(hn::Mul(a.x, b.x), hn::Mul(a.y, b.y)), hn::Mul(a.z, b.z));
}

template <class D>
HWY_INLINE Vector3<D> cross(const Vector3<D>& a, const Vector3<D>& b) {
  return {hn::Sub(hn::Mul(a.y, b.z), hn::Mul(a.z, b.y)), hn::Sub(hn::Mul(a.z, b.x), hn::Mul(a.x, b.z)),
          hn::Sub(hn::Mul(a.x, b.y), hn::Mul(a.y, b.x))};
}

// RRF(v, e, 90 degrees - d) from sin d and cos d - 1: the initial turn of -90 degrees + d undone.
template <class D, class V = hn::Vec<D>>
HWY_INLINE Vector3<D> turned_back(D d, const Vector3<D>& v, const Vector3<D>& e, V sin_d, V cos_d_minus_1) {
  const V one = hn::Set(d, 1.0);
  const V cosine = sin_d;
  const V sine = hn::Add(one, cos_d_minus_1);
  return sum(sum(scaled(v, cosine), scaled(cross(e, v), sine)),
             scaled(e, hn::Mul(dot(e, v), hn::Sub(one, cosine))));
}

// A, B, C of one experiment's gravity: p w_1 + q w_cos + t w_sin, w_1 = (0, 0, 1).
template <class D>
struct Coefficients {
  Vector3<D> a, b, c;
};

template <class D, class V = hn::Vec<D>>
HWY_INLINE Coefficients<D> coefficients(const Vector3<D>& p, const Vector3<D>& q, const Vector3<D>& t,
                                        const V (&w)[6]) {
  return {sum(scaled(q, w[0]), scaled(t, w[3])), sum(scaled(q, w[1]), scaled(t, w[4])),
          sum(p, sum(scaled(q, w[2]), scaled(t, w[5])))};
}

// Adds the share of angle n, turned by f beyond alpha(n). is_tiny: |f| <= kTiny.
template <bool is_tiny, class D, class V = hn::Vec<D>>
HWY_INLINE void add_angle(D d, const double* HWY_RESTRICT table, V f, V (&w)[6]) {
  V sin_f, cos_f_minus_1;
  if constexpr (is_tiny) {
    tiny_sincos(d, f, sin_f, cos_f_minus_1);
  } else {
    small_sincos(d, f, sin_f, cos_f_minus_1);
  }
  const V sin_alpha = hn::Set(d, table[0]), cos_alpha = hn::Set(d, table[1]);
  // cos(alpha + f) - cos alpha and sin(alpha + f) - sin alpha.
  const V dcos = hn::Sub(hn::Mul(cos_alpha, cos_f_minus_1), hn::Mul(sin_alpha, sin_f));
  const V dsin = hn::Add(hn::Mul(sin_alpha, cos_f_minus_1), hn::Mul(cos_alpha, sin_f));
  for (int i = 0; i < 3; ++i) {
    const V weight = hn::Set(d, table[2 + i]);
    w[i] = hn::Add(w[i], hn::Mul(weight, dcos));
    w[3 + i] = hn::Add(w[3 + i], hn::Mul(weight, dsin));
  }
}

// Vectors without a size at compile time cannot be members of a struct: they are passed one by one.
// NOLINTBEGIN(readability-function-size) The sums with step errors that are independent.
template <bool is_tiny, class D, class VU, class V = hn::Vec<D>>
HWY_INLINE void add_independent_steps(D d, const TypeBSampler::Plan& plan, const PhiloxKeys& keys, VU trial,
                                      std::size_t i, V mean_step, std::uint32_t& pair, V (&w)[6]) {
  constexpr auto kPurpose = static_cast<std::uint32_t>(StreamPurpose::kTypeB);
  const std::uint32_t n = plan.angles[i];
  const double* HWY_RESTRICT table = plan.table[i].data();
  const V step = hn::Set(d, plan.step);
  std::uint32_t row = 0;
  for (; row + 2 * kSideBySide <= n; row += 2 * kSideBySide, pair += kSideBySide) {
    V first[kSideBySide], second[kSideBySide];
    normal_pairs<kSideBySide>(d, keys, trial, pair, kPurpose, first, second);
    for (std::uint32_t k = 0; k < kSideBySide; ++k) {
      add_angle<is_tiny>(d, table + 5 * (row + 2 * k), hn::Add(mean_step, hn::Mul(step, first[k])), w);
      add_angle<is_tiny>(d, table + 5 * (row + 2 * k + 1), hn::Add(mean_step, hn::Mul(step, second[k])), w);
    }
  }
  for (; row < n; row += 2) {
    V first, second;
    normal_pair(d, keys, trial, pair++, kPurpose, first, second);
    add_angle<is_tiny>(d, table + 5 * row, hn::Add(mean_step, hn::Mul(step, first)), w);
    if (row + 1 < n)
      add_angle<is_tiny>(d, table + 5 * (row + 1), hn::Add(mean_step, hn::Mul(step, second)), w);
  }
}

// The six sums drawn as such: cos(alpha + F + f) with the sums of cos alpha sin f and sin alpha sin f, then
// turned by F.
template <class D, class VU, class V = hn::Vec<D>>
HWY_INLINE void draw_sums(D d, const TypeBSampler::Plan& plan, const PhiloxKeys& keys, VU trial,
                          std::size_t i, V mean_step, std::uint32_t& pair, V (&w)[6]) {
  constexpr auto kPurpose = static_cast<std::uint32_t>(StreamPurpose::kTypeB);
  V first[3], second[3];
  for (int k = 0; k < 3; ++k) normal_pair(d, keys, trial, pair++, kPurpose, first[k], second[k]);
  const double* HWY_RESTRICT root = plan.sum_root[i].data();
  V sums[6];
  for (int r = 0; r < 6; ++r) {
    sums[r] = hn::Zero(d);
    for (int k = 0; k < 3; ++k) {
      sums[r] = hn::Add(sums[r], hn::Mul(hn::Set(d, root[6 * r + 2 * k]), first[k]));
      sums[r] = hn::Add(sums[r], hn::Mul(hn::Set(d, root[6 * r + 2 * k + 1]), second[k]));
    }
  }
  V sin_f = hn::Zero(d), cos_f_minus_1 = hn::Zero(d);
  if (plan.zero > 0.0) small_sincos(d, mean_step, sin_f, cos_f_minus_1);
  const V cos_f = hn::Add(hn::Set(d, 1.0), cos_f_minus_1);
  for (int k = 0; k < 3; ++k) {
    const auto at = static_cast<std::size_t>(k);
    const V cosine = hn::Sub(hn::Set(d, plan.mean_cosine * plan.nominal[i][at]), sums[3 + k]);
    const V sine = hn::Add(hn::Set(d, plan.mean_cosine * plan.nominal[i][3 + at]), sums[k]);
    w[k] = hn::Sub(hn::Mul(cos_f, cosine), hn::Mul(sin_f, sine));
    w[3 + k] = hn::Add(hn::Mul(sin_f, cosine), hn::Mul(cos_f, sine));
  }
}

// The six sums of one experiment; `pair` moves on past the random numbers that the experiment owns.
template <class D, class VU, class V = hn::Vec<D>>
HWY_INLINE void rotation_sums(D d, const TypeBSampler::Plan& plan, const PhiloxKeys& keys, VU trial,
                              std::size_t i, V mean_step, std::uint32_t& pair, V (&w)[6]) {
  constexpr auto kPurpose = static_cast<std::uint32_t>(StreamPurpose::kTypeB);
  const std::uint32_t n = plan.angles[i];
  const double* HWY_RESTRICT table = plan.table[i].data();
  const V step = hn::Set(d, plan.step);
  if (plan.by_sums) {
    draw_sums(d, plan, keys, trial, i, mean_step, pair, w);
    return;
  }
  for (V& sums : w) sums = hn::Zero(d);
  if (plan.harmonic) {
    const std::uint32_t harmonics = n / 2;
    HWY_ALIGN double amplitudes[2 * kMostHarmonics * hn::MaxLanes(D())];
    const std::size_t lanes = hn::Lanes(d);
    for (std::uint32_t m = 0; m < harmonics; ++m) {
      V sine, cosine;
      normal_pair(d, keys, trial, pair++, kPurpose, sine, cosine);
      hn::Store(sine, d, amplitudes + 2 * m * lanes);
      hn::Store(cosine, d, amplitudes + (2 * m + 1) * lanes);
    }
    const double* HWY_RESTRICT trig = plan.spectrum[i].data();
    for (std::uint32_t row = 0; row < n; ++row, trig += 2 * harmonics) {
      V f = hn::Zero(d);
      for (std::uint32_t m = 0; m < 2 * harmonics; ++m) {
        f = hn::Add(f, hn::Mul(hn::Set(d, trig[m]), hn::Load(d, amplitudes + m * lanes)));
      }
      add_angle<false>(d, table + 5 * row, hn::Add(mean_step, hn::Mul(step, f)), w);
    }
  } else if (plan.step > 0.0) {
    constexpr double kLargestNormal = 8.5;
    if (kLargestNormal * (plan.step + plan.zero) <= kTiny) {
      add_independent_steps<true>(d, plan, keys, trial, i, mean_step, pair, w);
    } else {
      add_independent_steps<false>(d, plan, keys, trial, i, mean_step, pair, w);
    }
  } else {
    pair += (n + 1) / 2;
    if (plan.zero > 0.0) {
      for (std::uint32_t row = 0; row < n; ++row) add_angle<false>(d, table + 5 * row, mean_step, w);
    }
  }
  for (int k = 0; k < 6; ++k) w[k] = hn::Add(hn::Set(d, plan.nominal[i][static_cast<std::size_t>(k)]), w[k]);
}
// NOLINTEND(readability-function-size)

// Estimate minus truth of the angle between rows a and b (degrees): the angle of the difference of the two
// directions.
template <class D, class V = hn::Vec<D>>
HWY_INLINE V angle_error(D d, const Vector3<D>& a_found, const Vector3<D>& b_found, const Vector3<D>& a,
                         const Vector3<D>& b) {
  const Vector3<D> c_found = cross(a_found, b_found), c = cross(a, b);
  const V sin_found = hn::Sqrt(dot(c_found, c_found)), sin_true = hn::Sqrt(dot(c, c));
  const V cos_found = dot(a_found, b_found), cos_true = dot(a, b);
  const V sine = hn::Sub(hn::Mul(sin_found, cos_true), hn::Mul(cos_found, sin_true));
  const V cosine = hn::Add(hn::Mul(cos_found, cos_true), hn::Mul(sin_found, sin_true));
  return hn::Mul(angle_of(d, sine, cosine), hn::Set(d, 57.29577951308232));
}

// Rows of the sensitivity matrix: those of the plan, or drawn around them.
template <class D, class VU, class V = hn::Vec<D>>
HWY_INLINE void accelerometer_rows(D d, const TypeBSampler::Plan& plan, const PhiloxKeys& keys, VU trial,
                                   Vector3<D> (&row)[3]) {
  for (int j = 0; j < 3; ++j) {
    row[j] = {hn::Set(d, plan.accelerometer[static_cast<std::size_t>(3 * j)]),
              hn::Set(d, plan.accelerometer[static_cast<std::size_t>(3 * j + 1)]),
              hn::Set(d, plan.accelerometer[static_cast<std::size_t>(3 * j + 2)])};
  }
  if (plan.spread > 0.0) {
    // 9 elements of s, row by row. The offset would follow; no error depends on it.
    constexpr auto kAccelerometers = static_cast<std::uint32_t>(StreamPurpose::kAccelerometers);
    const V spread = hn::Set(d, plan.spread);
    V normals[10];
    for (std::uint32_t i = 0; i < 5; ++i) {
      normal_pair(d, keys, trial, i, kAccelerometers, normals[2 * i], normals[2 * i + 1]);
    }
    for (int j = 0; j < 3; ++j) {
      row[j].x = hn::Add(row[j].x, hn::Mul(spread, normals[3 * j]));
      row[j].y = hn::Add(row[j].y, hn::Mul(spread, normals[3 * j + 1]));
      row[j].z = hn::Add(row[j].z, hn::Mul(spread, normals[3 * j + 2]));
    }
  }
}

// One simulated calibration in each lane.
template <class D, class VU, class V = hn::Vec<D>>
HWY_INLINE void trials(D d, const TypeBSampler::Plan& plan, const PhiloxKeys& keys, VU trial,
                       V (&out)[kStudyOutputs]) {
  constexpr auto kPurpose = static_cast<std::uint32_t>(StreamPurpose::kTypeB);
  const V one = hn::Set(d, 1.0), zero = hn::Zero(d), half = hn::Set(d, 0.5);
  std::uint32_t pair = 0;
  V zx, zy, xz, d2, d3, f_x, f_z, unused;
  normal_pair(d, keys, trial, pair++, kPurpose, zx, zy);
  normal_pair(d, keys, trial, pair++, kPurpose, xz, d2);
  normal_pair(d, keys, trial, pair++, kPurpose, d3, f_x);
  normal_pair(d, keys, trial, pair++, kPurpose, f_z, unused);
  const V alignment = hn::Set(d, plan.alignment), turn = hn::Set(d, plan.turn),
          axis_zero = hn::Set(d, plan.zero);
  zx = hn::Mul(alignment, zx);
  zy = hn::Mul(alignment, zy);
  xz = hn::Mul(alignment, xz);
  f_x = hn::Mul(axis_zero, f_x);
  f_z = hn::Mul(axis_zero, f_z);
  V w1[6], w2[6], w3[6];
  rotation_sums(d, plan, keys, trial, 0, f_x, pair, w1);
  rotation_sums(d, plan, keys, trial, 1, f_x, pair, w2);
  rotation_sums(d, plan, keys, trial, 2, f_z, pair, w3);

  const V z_tilt2 = hn::Add(hn::Mul(zx, zx), hn::Mul(zy, zy));
  const Vector3<D> x_axis = {hn::Sqrt(hn::Sub(one, hn::Mul(xz, xz))), zero, xz};
  const Vector3<D> z_axis = {zx, zy, hn::Sqrt(hn::Sub(one, z_tilt2))};
  const Vector3<D> up = {zero, zero, one};

  // Experiment 1: up turned by -(alpha + f) about X.
  const Vector3<D> p1 = scaled(x_axis, xz);
  const Vector3<D> q1 = difference(up, p1);
  const Vector3<D> t1 = {zero, x_axis.x, zero};  // up x X
  const Coefficients<D> e1 = coefficients(p1, q1, t1, w1);
  // Experiment 2: the same, then the initial turn about Z undone.
  V sin_d, cos_d_minus_1;
  small_sincos(d, hn::Mul(turn, d2), sin_d, cos_d_minus_1);
  Coefficients<D> e2 = coefficients(p1, q1, t1, w2);
  e2.a = turned_back(d, e2.a, z_axis, sin_d, cos_d_minus_1);
  e2.b = turned_back(d, e2.b, z_axis, sin_d, cos_d_minus_1);
  e2.c = turned_back(d, e2.c, z_axis, sin_d, cos_d_minus_1);
  // Experiment 3: about Z, seen after the initial turn about X is undone.
  small_sincos(d, hn::Mul(turn, d3), sin_d, cos_d_minus_1);
  const Vector3<D> up3 = turned_back(d, up, x_axis, sin_d, cos_d_minus_1);
  const Vector3<D> p3 = scaled(z_axis, dot(z_axis, up3));
  const Coefficients<D> e3 = coefficients(p3, difference(up3, p3), cross(up3, z_axis), w3);

  // The estimate is s G with the columns of G below; G - 1 is the error (docs/theory/abc_protocol.md).
  Vector3<D> gx = scaled(sum(e2.a, e3.a), hn::Set(d, -0.5));
  Vector3<D> gy = scaled(difference(e1.a, e3.b), half);
  Vector3<D> gz = scaled(sum(e1.b, e2.b), half);
  const Vector3<D> go = scaled(sum(sum(e1.c, e2.c), e3.c), hn::Set(d, 1.0 / 3.0));
  gx.x = hn::Sub(gx.x, one);
  gy.y = hn::Sub(gy.y, one);
  gz.z = hn::Sub(gz.z, one);

  Vector3<D> row[3];
  accelerometer_rows(d, plan, keys, trial, row);
  // The platter tilts with Z: RRF(s_j, E, Theta_E) with E sin Theta_E = z x Z, cos Theta_E = Z_z.
  const Vector3<D> tilt = {hn::Neg(zy), zx, zero};
  const V tilt_factor = hn::Div(one, hn::Add(one, z_axis.z));  // (1 - cos) / sin^2
  Vector3<D> found[3];
  for (int j = 0; j < 3; ++j) {
    row[j] = sum(sum(scaled(row[j], z_axis.z), cross(tilt, row[j])),
                 scaled(tilt, hn::Mul(dot(tilt, row[j]), tilt_factor)));
    const Vector3<D> error = {dot(row[j], gx), dot(row[j], gy), dot(row[j], gz)};
    found[j] = sum(row[j], error);
    out[3 * j] = error.x;
    out[3 * j + 1] = error.y;
    out[3 * j + 2] = error.z;
    out[kFirstOffset + j] = dot(row[j], go);
    // |found| - |row| without cancellation.
    const V norms = hn::Add(hn::Sqrt(dot(found[j], found[j])), hn::Sqrt(dot(row[j], row[j])));
    out[kFirstIntrinsicSensitivity + j] = hn::Div(dot(error, sum(found[j], row[j])), norms);
  }
  for (int j = 0; j < 3; ++j) {
    const int next = (j + 1) % 3;
    out[kFirstIntrinsicAngle + j] = angle_error(d, found[j], found[next], row[j], row[next]);
  }
}

void TypeBTrials(const TypeBSampler::Plan& plan, std::uint64_t first, std::size_t count, double* out) {
  const hn::ScalableTag<double> d;
  const hn::RebindToUnsigned<decltype(d)> du;
  const PhiloxKeys keys(plan.seed);
  const std::size_t lanes = hn::Lanes(d);
  for (std::size_t i = 0; i < count; i += lanes) {
    hn::Vec<decltype(d)> result[kStudyOutputs];
    trials(d, plan, keys, hn::Iota(du, first + i), result);
    if (i + lanes <= count) {
      for (std::size_t k = 0; k < kStudyOutputs; ++k) hn::StoreU(result[k], d, out + k * count + i);
    } else {
      HWY_ALIGN double rest[hn::MaxLanes(d)];
      for (std::size_t k = 0; k < kStudyOutputs; ++k) {
        hn::Store(result[k], d, rest);
        for (std::size_t lane = 0; i + lane < count; ++lane) out[k * count + i + lane] = rest[lane];
      }
    }
  }
}

void NormalsOnly(std::uint64_t seed, std::uint32_t pairs, std::uint64_t first, std::size_t count,
                 double* out) {
  const hn::ScalableTag<double> d;
  const hn::RebindToUnsigned<decltype(d)> du;
  const PhiloxKeys keys(seed);
  const std::size_t lanes = hn::Lanes(d);
  HWY_ALIGN double rest[hn::MaxLanes(d)];
  for (std::size_t i = 0; i < count; i += lanes) {
    const auto trial = hn::Iota(du, first + i);
    auto total = hn::Zero(d);
    std::uint32_t pair = 0;
    for (; pair + kSideBySide <= pairs; pair += kSideBySide) {
      hn::Vec<decltype(d)> a[kSideBySide], b[kSideBySide];
      normal_pairs<kSideBySide>(d, keys, trial, pair, static_cast<std::uint32_t>(StreamPurpose::kTypeB), a,
                                b);
      for (int k = 0; k < kSideBySide; ++k) total = hn::Add(total, hn::Add(a[k], b[k]));
    }
    for (; pair < pairs; ++pair) {
      hn::Vec<decltype(d)> a, b;
      normal_pair(d, keys, trial, pair, static_cast<std::uint32_t>(StreamPurpose::kTypeB), a, b);
      total = hn::Add(total, hn::Add(a, b));
    }
    hn::Store(total, d, rest);
    for (std::size_t lane = 0; lane < lanes && i + lane < count; ++lane) out[i + lane] = rest[lane];
  }
}

const char* TargetName() {
  return hwy::TargetName(HWY_TARGET);
}

}  // namespace HWY_NAMESPACE
}  // namespace abcal
HWY_AFTER_NAMESPACE();

#if HWY_ONCE

namespace abcal {

HWY_EXPORT(TypeBTrials);
HWY_EXPORT(NormalsOnly);
HWY_EXPORT(TargetName);

void type_b_trials(const TypeBSampler::Plan& plan, std::uint64_t first, std::size_t count, double* out) {
  HWY_DYNAMIC_DISPATCH(TypeBTrials)(plan, first, count, out);
}

void type_b_normals_only(std::uint64_t seed, std::uint32_t pairs, std::uint64_t first, std::size_t count,
                         double* out) {
  HWY_DYNAMIC_DISPATCH(NormalsOnly)(seed, pairs, first, count, out);
}

const char* vector_target() {
  return HWY_DYNAMIC_DISPATCH(TargetName)();
}

}  // namespace abcal

#endif  // HWY_ONCE
