#pragma once

#include <memory>
#include <string>
#include <string_view>

namespace abcal::wire {

/// The right of one program of this computer to an instrument, whoever uses it: a file that all users share,
/// locked as long as this object lives and released by the system when the program dies. A serial port has a
/// lock of its own; a network address has none, and a second host program would end the exchanges of the
/// first.
class Lease {
 public:
  /// Takes the lease of a resource. Within this program a resource may be taken several times.
  /// @param resource  a resolved device or address: "tcp:192.168.0.7:50000"
  /// @param holder  who uses it, for the message to others: "abcal run on the bench \"left\""; empty: the
  /// program's name
  /// @throws PortHeld with the words of the holder. A computer without a folder for such files grants every
  /// lease.
  static std::shared_ptr<Lease> take(const std::string& resource, std::string_view holder);

  explicit Lease(int descriptor) : descriptor_(descriptor) {}
  ~Lease();
  Lease(const Lease&) = delete;
  Lease& operator=(const Lease&) = delete;

 private:
  const int descriptor_;
};

}  // namespace abcal::wire
