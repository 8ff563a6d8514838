#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <stdexcept>
#include <string_view>
#include <type_traits>

namespace abcal {

/// The bytes of a log end where more were expected.
class LogEnds final : public std::runtime_error {
 public:
  LogEnds() : std::runtime_error("the bytes end too early") {}
};

/// Takes numbers and texts from bytes, one after the other. The bytes must outlive it.
class ByteReader {
 public:
  explicit ByteReader(std::string_view bytes, std::endian order = std::endian::little)
      : bytes_(bytes), order_(order) {}

  bool at_end() const { return at_ >= bytes_.size(); }
  std::size_t position() const { return at_; }
  std::size_t left() const { return bytes_.size() - at_; }
  /// @throws LogEnds
  std::string_view text(std::size_t count) {
    if (count > left()) throw LogEnds();
    at_ += count;
    return bytes_.substr(at_ - count, count);
  }
  void skip(std::size_t count) { (void)text(count); }
  /// Continues at a multiple of `size` from the beginning.
  void align(std::size_t size) { skip((size - at_ % size) % size); }
  template <class Number>
  Number number() {
    static_assert(std::is_arithmetic_v<Number>);
    std::array<char, sizeof(Number)> raw;
    const std::string_view taken = text(raw.size());
    std::ranges::copy(taken, raw.begin());
    if (order_ != std::endian::native) std::ranges::reverse(raw);
    return std::bit_cast<Number>(raw);
  }

 private:
  std::string_view bytes_;
  std::endian order_;
  std::size_t at_ = 0;
};

}  // namespace abcal
