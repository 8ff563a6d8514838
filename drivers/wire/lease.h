#pragma once

#include <memory>
#include <string>
#include <string_view>

namespace abcal::wire {

/// The right of one program of this computer, of any user, to an instrument: a file that all users share,
/// locked as long as this object lives and released by the system when the program dies. The lock of a serial
/// port names no holder of another user, and a network address has none: a second host program would end the
/// exchanges of the first.
class Lease {
 public:
  /// Takes the lease of a resource. Within this program a resource may be taken several times.
  /// @param resource  a resolved device or address ("/dev/ttyUSB0", "tcp:192.168.0.7:50000"), or
  /// of_instrument()
  /// @param holder  who uses it, for the message to others: "a run on the bench \"left\" (process 4711)";
  /// empty: the program's name and process
  /// @throws PortHeld with the words of the holder; also where the holder cannot be known, because the
  /// lease's name belongs to a link, a folder or a file that this user may not read, with its owner. A
  /// computer that has no folder for such files and lets this user make none grants every lease.
  static std::shared_ptr<Lease> take(const std::string& resource, std::string_view holder);

  /// As take(), for the device behind a path, which may be a link to it.
  /// @return null if the path does not exist; opening it reports why
  static std::shared_ptr<Lease> take_device(const std::string& path, std::string_view holder);

  /// The resource that is an instrument itself, on any port, in words.
  /// @param serial_number  as the instrument reports it; not empty
  static std::string of_instrument(std::string_view maker, std::string_view model,
                                   std::string_view serial_number);

  explicit Lease(int descriptor) : descriptor_(descriptor) {}
  ~Lease();
  Lease(const Lease&) = delete;
  Lease& operator=(const Lease&) = delete;

 private:
  const int descriptor_;
};

}  // namespace abcal::wire
