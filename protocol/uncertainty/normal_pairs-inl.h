// Philox4x32-10 and pairs of standard normals, one stream a lane. Included once for each vector instruction
// set (Highway's foreach_target.h) and once by random_stream.cc.
//
// Only +, -, *, / and square root on doubles and whole-number operations: with -ffp-contract=off every
// instruction set gives the same bits. The polynomials are those of FreeBSD's msun (fdlibm, Sun Microsystems
// 1993): e_log.c, k_sin.c, k_cos.c, s_atan.c.

// Per-target include guard, as Highway asks for.
#if defined(ABCAL_PROTOCOL_UNCERTAINTY_NORMAL_PAIRS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef ABCAL_PROTOCOL_UNCERTAINTY_NORMAL_PAIRS_INL_H_
#undef ABCAL_PROTOCOL_UNCERTAINTY_NORMAL_PAIRS_INL_H_
#else
#define ABCAL_PROTOCOL_UNCERTAINTY_NORMAL_PAIRS_INL_H_
#endif

#include <hwy/highway.h>

#include <cstdint>

HWY_BEFORE_NAMESPACE();
namespace abcal {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// Vectors without a size at compile time cannot be members of a struct: they are passed one by one.
// NOLINTBEGIN(readability-function-size)

/// Key schedule of Philox4x32-10: the two key words of each of the ten rounds.
struct PhiloxKeys {
  explicit PhiloxKeys(std::uint64_t seed) {
    auto k0 = static_cast<std::uint32_t>(seed);
    auto k1 = static_cast<std::uint32_t>(seed >> 32);
    for (int round = 0; round < 10; ++round) {
      first[round] = k0;
      second[round] = k1;
      k0 += 0x9E3779B9U;
      k1 += 0xBB67AE85U;
    }
  }
  std::uint64_t first[10];
  std::uint64_t second[10];
};

/// The full 64-bit product of the low 32 bits of each 64-bit lane and `factor`.
template <class DU, class VU = hn::Vec<DU>>
HWY_INLINE VU times(DU du, VU v, std::uint32_t factor) {
#if HWY_TARGET == HWY_SCALAR  // has no vectors of two 32-bit numbers
  return hn::Set(du, (hn::GetLane(v) & 0xFFFFFFFFU) * std::uint64_t{factor});
#else
  const hn::Repartition<std::uint32_t, DU> d32;
  return hn::MulEven(hn::BitCast(d32, hn::Set(du, std::uint64_t{factor})), hn::BitCast(d32, v));
#endif
}

/// Ten rounds on K counters held one in each 64-bit lane. Only the low 32 bits of a lane count: the
/// multiplication ignores the high ones, so they never need clearing. The K counters go side by side because
/// each waits for its own multiplications.
template <int K, class DU, class VU = hn::Vec<DU>>
HWY_INLINE void philox(DU du, const PhiloxKeys& keys, VU (&c0)[K], VU (&c1)[K], VU (&c2)[K], VU (&c3)[K]) {
  for (int round = 0; round < 10; ++round) {
    const VU key0 = hn::Set(du, keys.first[round]), key1 = hn::Set(du, keys.second[round]);
    for (int k = 0; k < K; ++k) {
      const VU p0 = times(du, c0[k], 0xD2511F53U);
      const VU p1 = times(du, c2[k], 0xCD9E8D57U);
      c0[k] = hn::Xor(hn::Xor(hn::ShiftRight<32>(p1), c1[k]), key0);
      c2[k] = hn::Xor(hn::Xor(hn::ShiftRight<32>(p0), c3[k]), key1);
      c1[k] = p1;
      c3[k] = p0;
    }
  }
}

/// Horner's rule: c[0] + x (c[1] + x (c[2] + ...)).
template <class D, class V = hn::Vec<D>, int N>
HWY_INLINE V polynomial(D d, V x, const double (&c)[N]) {
  V sum = hn::Set(d, c[N - 1]);
  for (int i = N - 2; i >= 0; --i) sum = hn::Add(hn::Mul(sum, x), hn::Set(d, c[i]));
  return sum;
}

/// sin x and cos x - 1 for |x| <= pi/4.
template <class D, class V = hn::Vec<D>>
HWY_INLINE void small_sincos(D d, V x, V& sin_x, V& cos_x_minus_1) {
  static constexpr double kSin[] = {-1.66666666666666324348e-01, 8.33333333332248946124e-03,
                                    -1.98412698298579493134e-04, 2.75573137070700676789e-06,
                                    -2.50507602534068634195e-08, 1.58969099521155010221e-10};
  static constexpr double kCos[] = {4.16666666666666019037e-02, -1.38888888888741095749e-03,
                                    2.48015872894767294178e-05, -2.75573143513906633035e-07,
                                    2.08757232129817482790e-09, -1.13596475577881948265e-11};
  const V z = hn::Mul(x, x);
  sin_x = hn::Add(x, hn::Mul(hn::Mul(x, z), polynomial(d, z, kSin)));
  cos_x_minus_1 = hn::Mul(z, hn::Add(hn::Mul(z, polynomial(d, z, kCos)), hn::Set(d, -0.5)));
}

/// sin x and cos x - 1 for |x| <= kTiny: the truncation error of the shorter series is below 1e-21 of either.
constexpr double kTiny = 0.01;
template <class D, class V = hn::Vec<D>>
HWY_INLINE void tiny_sincos(D d, V x, V& sin_x, V& cos_x_minus_1) {
  static constexpr double kSin[] = {-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0};
  static constexpr double kCos[] = {1.0 / 24.0, -1.0 / 720.0, 1.0 / 40320.0};
  const V z = hn::Mul(x, x);
  sin_x = hn::Add(x, hn::Mul(hn::Mul(x, z), polynomial(d, z, kSin)));
  cos_x_minus_1 = hn::Mul(z, hn::Add(hn::Mul(z, polynomial(d, z, kCos)), hn::Set(d, -0.5)));
}

/// Natural logarithm of 2^-52 <= x <= 1.
template <class D, class V = hn::Vec<D>>
HWY_INLINE V log_of_uniform(D d, V x) {
  static constexpr double kLog[] = {
      6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01,
      1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01};
  const hn::RebindToUnsigned<D> du;
  // x = 2^k m with sqrt(1/2) <= m < sqrt(2): the bits of sqrt(1/2) are the origin of the split.
  const auto origin = hn::Set(du, std::uint64_t{0x3FE6A09E667F3BCD});
  const auto shifted = hn::Add(hn::Sub(hn::BitCast(du, x), origin), hn::Set(du, std::uint64_t{1023} << 52));
  const auto mantissa = hn::And(shifted, hn::Set(du, (std::uint64_t{1} << 52) - 1));
  const V m = hn::BitCast(d, hn::Add(mantissa, origin));
  // k + 1023 as the low bits of the double 2^52.
  const V k =
      hn::Sub(hn::BitCast(d, hn::Or(hn::ShiftRight<52>(shifted), hn::Set(du, std::uint64_t{0x433} << 52))),
              hn::Set(d, 4503599627370496.0 + 1023.0));
  const V f = hn::Sub(m, hn::Set(d, 1.0));
  const V s = hn::Div(f, hn::Add(hn::Set(d, 2.0), f));
  const V z = hn::Mul(s, s);
  const V r = hn::Mul(z, polynomial(d, z, kLog));
  const V half_square = hn::Mul(hn::Mul(hn::Set(d, 0.5), f), f);
  const V low =
      hn::Add(hn::Mul(s, hn::Add(half_square, r)), hn::Mul(k, hn::Set(d, 1.90821492927058770002e-10)));
  return hn::Sub(hn::Mul(k, hn::Set(d, 6.93147180369123816490e-01)), hn::Sub(hn::Sub(half_square, low), f));
}

/// The angle of the point (x, y), right for any point and best within a right angle of the x axis, where the
/// study's differences of angles are. Three times half the angle, then the series: no case distinction.
template <class D, class V = hn::Vec<D>>
HWY_INLINE V angle_of(D d, V y, V x) {
  static constexpr double kAtan[] = {
      3.33333333333329318027e-01,  -1.99999999998764832476e-01, 1.42857142725034663711e-01,
      -1.11111104054623557880e-01, 9.09088713343650656196e-02,  -7.69187620504482999495e-02,
      6.66107313738753120669e-02,  -5.83357013379057348645e-02, 4.97687799461593236017e-02,
      -3.65315727442169155270e-02, 1.62858201153657823623e-02};
  const V one = hn::Set(d, 1.0);
  V t = hn::Div(y, hn::Add(x, hn::Sqrt(hn::Add(hn::Mul(x, x), hn::Mul(y, y)))));
  t = hn::Div(t, hn::Add(one, hn::Sqrt(hn::Add(one, hn::Mul(t, t)))));
  t = hn::Div(t, hn::Add(one, hn::Sqrt(hn::Add(one, hn::Mul(t, t)))));
  const V z = hn::Mul(t, t);
  const V series = hn::Sub(t, hn::Mul(hn::Mul(t, z), polynomial(d, z, kAtan)));
  return hn::Mul(hn::Set(d, 8.0), series);
}

/// The two 64-bit numbers of each lane's counters `pair`, `pair` + 1 ...
template <int K, class DU, class VU = hn::Vec<DU>>
HWY_INLINE void philox_words(DU du, const PhiloxKeys& keys, VU trial, std::uint32_t pair,
                             std::uint32_t purpose, VU (&a)[K], VU (&b)[K]) {
  VU c0[K], c1[K], c2[K], c3[K];
  for (int k = 0; k < K; ++k) {
    c0[k] = trial;
    c1[k] = hn::ShiftRight<32>(trial);
    c2[k] = hn::Set(du, std::uint64_t{pair} + static_cast<std::uint64_t>(k));
    c3[k] = hn::Set(du, std::uint64_t{purpose});
  }
  philox<K>(du, keys, c0, c1, c2, c3);
  const VU low = hn::Set(du, std::uint64_t{0xFFFFFFFFU});
  for (int k = 0; k < K; ++k) {
    a[k] = hn::Or(hn::And(c0[k], low), hn::ShiftLeft<32>(c1[k]));
    b[k] = hn::Or(hn::And(c2[k], low), hn::ShiftLeft<32>(c3[k]));
  }
}

/// One pair of standard normals for each lane from its two 64-bit numbers (Box & Muller 1958).
template <class D, class VU, class V = hn::Vec<D>>
HWY_INLINE void normals_of_words(D d, VU a, VU b, V& first, V& second) {
  const hn::RebindToUnsigned<D> du;
  const VU exponent = hn::Set(du, std::uint64_t{0x3FF} << 52);
  // The upper 52 bits make a number of [1, 2).
  const V u = hn::Sub(hn::Set(d, 2.0), hn::BitCast(d, hn::Or(hn::ShiftRight<12>(a), exponent)));  // (0, 1]
  const V v =
      hn::Sub(hn::BitCast(d, hn::Or(hn::ShiftRight<12>(b), exponent)), hn::Set(d, 1.5));  // [-1/2, 1/2)
  const V radius = hn::Sqrt(hn::Mul(hn::Set(d, -2.0), log_of_uniform(d, u)));
  // A direction within 45 degrees of the x axis; two of the bits left over spread it over the four quarters.
  V sin_t, cos_t;
  small_sincos(d, hn::Mul(v, hn::Set(d, 1.57079632679489661923)), sin_t, cos_t);
  cos_t = hn::Add(cos_t, hn::Set(d, 1.0));
  cos_t = hn::Xor(cos_t, hn::BitCast(d, hn::ShiftLeft<63>(b)));
  const auto swap = hn::RebindMask(d, hn::TestBit(b, hn::Set(du, std::uint64_t{2})));
  first = hn::Mul(radius, hn::IfThenElse(swap, sin_t, cos_t));
  second = hn::Mul(radius, hn::IfThenElse(swap, cos_t, sin_t));
}

/// K pairs of standard normals for each lane's trial.
template <int K, class D, class VU, class V = hn::Vec<D>>
HWY_INLINE void normal_pairs(D d, const PhiloxKeys& keys, VU trial, std::uint32_t pair, std::uint32_t purpose,
                             V (&first)[K], V (&second)[K]) {
  const hn::RebindToUnsigned<D> du;
  VU a[K], b[K];
  philox_words<K>(du, keys, trial, pair, purpose, a, b);
  for (int k = 0; k < K; ++k) normals_of_words(d, a[k], b[k], first[k], second[k]);
}

/// One pair of standard normals for each lane's trial.
template <class D, class VU, class V = hn::Vec<D>>
HWY_INLINE void normal_pair(D d, const PhiloxKeys& keys, VU trial, std::uint32_t pair, std::uint32_t purpose,
                            V& first, V& second) {
  V one[1], two[1];
  normal_pairs<1>(d, keys, trial, pair, purpose, one, two);
  first = one[0];
  second = two[0];
}

// NOLINTEND(readability-function-size)

}  // namespace HWY_NAMESPACE
}  // namespace abcal
HWY_AFTER_NAMESPACE();

#endif  // per-target include guard
