#include "drivers/wire/reply_match.h"

#include <algorithm>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

namespace abcal::wire {
namespace {

using Parts = std::vector<ReplyPart>;
/// Places of a reply: place n is before its byte n. All places where the parts so far may end are followed
/// at once, so that nothing is tried twice.
using Places = std::bitset<kLongestHaltReply + 1>;

bool equal_at(const ReplyPart& part, std::string_view bytes) {
  for (std::size_t i = 0; i < part.bytes.size(); ++i) {
    const unsigned mask = i < part.mask.size() ? static_cast<unsigned char>(part.mask[i]) : 0xFFU;
    const auto difference = static_cast<unsigned char>(part.bytes[i] ^ bytes[i]);
    if ((difference & mask) != 0) return false;
  }
  return true;
}

Places after_bytes(const ReplyPart& part, std::string_view reply, const Places& from) {
  Places to;
  for (std::size_t at = 0; at + part.bytes.size() <= reply.size(); ++at)
    if (from[at] && equal_at(part, reply.substr(at))) to.set(at + part.bytes.size());
  return to;
}

/// `is_one`: whether a byte belongs to the run.
template <class IsOne>
Places after_run(std::size_t least, std::size_t most, std::string_view reply, const Places& from,
                 const IsOne& is_one) {
  Places to;
  std::size_t unbroken = 0;           // All bytes from here to `at` belong to the run.
  std::optional<std::size_t> latest;  // Latest place at which a run may have begun that is long enough.
  for (std::size_t at = 0; at <= reply.size(); ++at) {
    if (at > 0 && !is_one(reply[at - 1])) unbroken = at;
    if (at >= least && from[at - least]) latest = at - least;
    if (latest && *latest >= unbroken && at - *latest <= most) to.set(at);
  }
  return to;
}

Places after_number(const ReplyPart& part, std::string_view reply, const Places& from) {
  Places to;
  for (std::size_t begin = 0; begin < reply.size(); ++begin) {
    if (!from[begin]) continue;
    std::uint64_t value = 0;
    for (std::size_t at = begin; at < reply.size() && reply[at] >= '0' && reply[at] <= '9'; ++at) {
      value = 10 * value + static_cast<std::uint64_t>(reply[at] - '0');
      if (value > part.most) break;
      if (value >= part.least) to.set(at + 1);
      if (value == 0) break;  // No digit follows a leading zero.
    }
  }
  return to;
}

Places after_bits(const ReplyPart& part, std::string_view reply, const Places& from) {
  constexpr std::size_t kMostDigits = 10;
  Places to;
  for (std::size_t begin = 0; begin < reply.size(); ++begin) {
    if (!from[begin]) continue;
    const bool is_negative = reply[begin] == '-';
    const std::size_t first = begin + (is_negative || reply[begin] == '+' ? 1 : 0);
    const std::int64_t most = is_negative ? std::int64_t{1} << 31 : (std::int64_t{1} << 32) - 1;
    std::int64_t value = 0;
    for (std::size_t at = first;
         at < reply.size() && at < first + kMostDigits && reply[at] >= '0' && reply[at] <= '9'; ++at) {
      value = 10 * value + (reply[at] - '0');
      if (value > most) break;
      const auto bits = static_cast<std::uint32_t>(is_negative ? -value : value);
      if (((bits & part.most) != 0) == (part.least != 0)) to.set(at + 1);
    }
  }
  return to;
}

/// Where the part may end that begins at one of the places.
Places after(const ReplyPart& part, std::string_view reply, const Places& from) {
  switch (part.kind) {
    case ReplyPart::Kind::kBytes:
      return after_bytes(part, reply, from);
    case ReplyPart::Kind::kRun:
      return after_run(part.least, part.most, reply, from,
                       [&](char byte) { return part.bytes.find(byte) != std::string::npos; });
    case ReplyPart::Kind::kNumber:
      return after_number(part, reply, from);
    case ReplyPart::Kind::kBits:
      return after_bits(part, reply, from);
    case ReplyPart::Kind::kText:
      return after_run(0, reply.size(), reply, from, [](char byte) { return byte != '\r' && byte != '\n'; });
  }
  return {};
}

Places after_all(const Parts& parts, std::string_view reply, Places places) {
  for (const ReplyPart& part : parts) places = after(part, reply, places);
  return places;
}

}  // namespace

bool matches(const ReplyPattern& pattern, std::string_view reply) noexcept {
  if (reply.size() > kLongestHaltReply) return false;
  Places begin;
  begin.set(0);
  return std::any_of(pattern.alternatives.begin(), pattern.alternatives.end(),
                     [&](const Parts& parts) { return after_all(parts, reply, begin).test(reply.size()); });
}

bool occurs_in(const ReplyPattern& pattern, std::string_view bytes) noexcept {
  const std::string_view newest = bytes.substr(bytes.size() - std::min(bytes.size(), kLongestHaltReply));
  Places anywhere;
  for (std::size_t at = 0; at <= newest.size(); ++at) anywhere.set(at);
  return std::any_of(pattern.alternatives.begin(), pattern.alternatives.end(),
                     [&](const Parts& parts) { return after_all(parts, newest, anywhere).any(); });
}

}  // namespace abcal::wire
