#pragma once

namespace abcal::wire {

/// A stream that is an open descriptor of the system, which another process can hold as well.
class PortDescriptor {
 public:
  virtual ~PortDescriptor() = default;
  /// -1: not open now.
  virtual int descriptor() const = 0;
};

}  // namespace abcal::wire
