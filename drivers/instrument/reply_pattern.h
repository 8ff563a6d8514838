#pragma once

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace abcal {

/// A reply of more bytes fits no pattern.
inline constexpr std::size_t kLongestHaltReply = 256;

/// One part of a reply: plain data. The functions of abcal::pattern make parts.
struct ReplyPart {
  enum class Kind : std::uint8_t {
    kBytes,   ///< Exactly `bytes`; only the bits that are set in `mask` are compared.
    kRun,     ///< From `least` to `most` bytes, each of which is one of `bytes`.
    kNumber,  ///< A decimal number from `least` to `most`, without a sign and without leading zeros.
    kText,    ///< Zero or more bytes; no CR and no LF.
    /// A whole decimal number of 32 bits, -2147483648 to 4294967295, of at most ten digits, perhaps with a
    /// sign. `least` 0: all bits of `most` are 0 in it; 1: at least one of them is 1.
    kBits,
  };

  bool operator==(const ReplyPart&) const = default;

  Kind kind = Kind::kText;
  std::string bytes{};
  std::string mask{};  ///< One byte for each of `bytes`; all bits of bytes beyond its end are compared.
  std::uint32_t least = 0;
  std::uint32_t most = 0;
};

/// A set of replies, as plain data. A reply fits if it consists of the parts of at least one alternative, in
/// their order, with nothing before, between or after them: ReplyPattern{pattern::literal("0,"),
/// pattern::number(0, 39)} fits "0,7" and "0,39". Patterns are joined by `|`.
/// wire::matches() and wire::occurs_in() compare replies with it.
struct ReplyPattern {
  ReplyPattern() = default;
  ReplyPattern(std::initializer_list<ReplyPart> parts) : alternatives{parts} {}

  /// No reply fits.
  bool empty() const { return alternatives.empty(); }
  bool operator==(const ReplyPattern&) const = default;

  std::vector<std::vector<ReplyPart>> alternatives;
};

/// Replies that fit at least one of the two.
inline ReplyPattern operator|(ReplyPattern one, const ReplyPattern& other) {
  one.alternatives.insert(one.alternatives.end(), other.alternatives.begin(), other.alternatives.end());
  return one;
}

/// The parts of a ReplyPattern.
namespace pattern {

inline constexpr std::uint32_t kAnyCount = std::numeric_limits<std::uint32_t>::max();
inline constexpr std::string_view kDecimalDigits = "0123456789";
inline constexpr std::string_view kHexadecimalDigits = "0123456789ABCDEFabcdef";

/// These bytes.
inline ReplyPart literal(std::string bytes) {
  return {.kind = ReplyPart::Kind::kBytes, .bytes = std::move(bytes)};
}

/// One byte for each of `mask`, in which all bits that are set in `mask` are 0.
inline ReplyPart zero_bits(std::string mask) {
  std::string zeros(mask.size(), '\0');
  return {.kind = ReplyPart::Kind::kBytes, .bytes = std::move(zeros), .mask = std::move(mask)};
}

/// This number of arbitrary bytes.
inline ReplyPart any_bytes(std::size_t count) {
  return zero_bits(std::string(count, '\0'));
}

/// From `least` to `most` bytes of a set.
inline ReplyPart run(std::string_view set, std::uint32_t least = 1, std::uint32_t most = kAnyCount) {
  return {.kind = ReplyPart::Kind::kRun, .bytes = std::string(set), .least = least, .most = most};
}

/// Any number of spaces, also none.
inline ReplyPart spaces() {
  return run(" ", 0);
}

/// A decimal number from `least` to `most`, without a sign and without leading zeros.
inline ReplyPart number(std::uint32_t least, std::uint32_t most) {
  return {.kind = ReplyPart::Kind::kNumber, .least = least, .most = most};
}

/// A whole decimal number of 32 bits, perhaps negative, in which no bit of the mask is 1, or at least one is.
inline ReplyPart no_bit_of(std::uint32_t mask) {
  return {.kind = ReplyPart::Kind::kBits, .least = 0, .most = mask};
}
inline ReplyPart some_bit_of(std::uint32_t mask) {
  return {.kind = ReplyPart::Kind::kBits, .least = 1, .most = mask};
}

/// Anything, also nothing, in the same line.
inline ReplyPart text() {
  return {};
}

}  // namespace pattern
}  // namespace abcal
