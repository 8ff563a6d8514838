#pragma once

#include <cstddef>

namespace abcal::wire {

/// What a pure frame function says of the bytes it was shown: certainly not a frame, not yet one, or one.
enum class FrameCheck { kInvalid, kNeedMore, kComplete };

struct FrameVerdict {
  FrameCheck check = FrameCheck::kInvalid;
  std::size_t length = 0;  ///< Bytes that the frame occupies; 0 unless kComplete.

  bool operator==(const FrameVerdict&) const = default;
};

}  // namespace abcal::wire
