#pragma once

#include <cstddef>

namespace abcal::wire {

/// Verdict of a pure frame function on the bytes so far: no frame, not yet a frame, or a frame.
enum class FrameCheck { kInvalid, kNeedMore, kComplete };

struct FrameVerdict {
  FrameCheck check = FrameCheck::kInvalid;
  std::size_t length = 0;  ///< Bytes that the frame occupies; 0 unless kComplete.

  bool operator==(const FrameVerdict&) const = default;
};

}  // namespace abcal::wire
