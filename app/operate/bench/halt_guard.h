#pragma once

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/halt.h"

namespace abcal {

/// A port of a stage or of a chamber, as another process holds it.
struct GuardedPort {
  bool operator==(const GuardedPort&) const = default;

  std::string name;  ///< For messages.
  std::vector<HaltRecipe> recipes;
};

/// A port as it is sent to the guard (MessagePack), and back. @{
std::vector<std::uint8_t> packet_of(const GuardedPort& port);
/// @return nothing: the packet says that stage and chamber are at rest
/// @throws nlohmann::json::exception for any other packet that packet_of() has not made
std::optional<GuardedPort> port_of(const std::vector<std::uint8_t>& packet);
/// @}

/// The owner's end of a guard: a process of its own (abcal-guard) that holds the descriptors of the ports of
/// a stage and a chamber and does nothing with them until this process has died; then it halts the axes and
/// leaves the chamber by the recipes.
/// However this process dies, also by SIGKILL, the system closes its end of their socket, and the guard sees
/// that. For one thread.
class HaltGuard {
 public:
  HaltGuard() = default;
  /// The stage is at rest: the guard lets go of the ports and ends, which is waited for.
  ~HaltGuard();
  HaltGuard(const HaltGuard&) = delete;
  HaltGuard& operator=(const HaltGuard&) = delete;

  /// Hands a port over, in place of one of the same name; starts the guard if there is none.
  /// @throws std::runtime_error (ProgramMissing among them): nobody would halt the stage
  void hold(const GuardedPort& port, int descriptor);

  /// How often a guard was started; grows if the last one has died. A new one holds nothing.
  int generation();
  pid_t process() const { return process_; }

 private:
  void start();
  void end();
  /// Of a guard that has ended or is about to: closes the socket and waits for the process.
  void collect();

  int socket_ = -1;
  pid_t process_ = -1;
  int generation_ = 0;
};

/// The guard itself: holds what comes over `socket` until its other end is closed, then halts the axes and
/// leaves the chamber unless it was told that they are at rest.
/// @return what happened to each port, in words; nothing: the owner ended in order.
std::vector<std::string> guard_until_owner_dies(int socket, Clock& clock);

}  // namespace abcal
