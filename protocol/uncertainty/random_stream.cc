#include "protocol/uncertainty/random_stream.h"

#include <Random123/philox.h>

#include "protocol/uncertainty/normal_pairs-inl.h"

namespace abcal {

namespace {

std::uint64_t word(std::uint32_t low, std::uint32_t high) {
  return (std::uint64_t{high} << 32) | low;
}

}  // namespace

std::array<std::uint32_t, 4> RandomStream::bits(std::uint32_t pair) const {
  const r123::Philox4x32::key_type key = {
      {static_cast<std::uint32_t>(seed_), static_cast<std::uint32_t>(seed_ >> 32)}};
  const r123::Philox4x32::ctr_type counter = {{static_cast<std::uint32_t>(trial_),
                                               static_cast<std::uint32_t>(trial_ >> 32), pair,
                                               static_cast<std::uint32_t>(purpose_)}};
  const r123::Philox4x32::ctr_type out = r123::Philox4x32()(counter, key);
  return {out.v[0], out.v[1], out.v[2], out.v[3]};
}

std::array<double, 2> RandomStream::normal_pair(std::uint32_t pair) const {
  // One lane of the code that the vectors run: the arithmetic is written once.
  namespace hn = hwy::HWY_NAMESPACE;
  const hn::CappedTag<double, 1> d;
  const hn::RebindToUnsigned<decltype(d)> du;
  const std::array<std::uint32_t, 4> r = bits(pair);
  hn::Vec<decltype(d)> first, second;
  HWY_NAMESPACE::normals_of_words(d, hn::Set(du, word(r[0], r[1])), hn::Set(du, word(r[2], r[3])), first,
                                  second);
  return {hn::GetLane(first), hn::GetLane(second)};
}

double RandomStream::normal() {
  if (have_second_) {
    have_second_ = false;
    return second_;
  }
  const std::array<double, 2> pair = normal_pair(next_pair_++);
  second_ = pair[1];
  have_second_ = true;
  return pair[0];
}

double RandomStream::uniform() {
  const std::array<std::uint32_t, 4> r = bits(next_pair_++);
  have_second_ = false;
  // The middle of one of 2^52 equal cells: never 0, never 1.
  return (static_cast<double>(word(r[0], r[1]) >> 12) + 0.5) * 0x1p-52;
}

}  // namespace abcal
