#pragma once

#include <memory>
#include <vector>

#include "drivers/wire/lease.h"

namespace abcal::wire {

/// A stream that is an open descriptor of the system, which another process can hold as well.
class PortDescriptor {
 public:
  virtual ~PortDescriptor() = default;
  /// -1: not open now.
  virtual int descriptor() const = 0;
  /// Leases that may be kept longer than the stream: those of a network address. The name of a device that is
  /// unplugged belongs to the device that gets it next.
  virtual std::vector<std::shared_ptr<Lease>> leases() const { return {}; }
};

}  // namespace abcal::wire
