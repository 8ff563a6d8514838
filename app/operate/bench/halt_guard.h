#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/halt.h"

namespace abcal {

/// A port of a stage or of a chamber, as another process holds it.
struct GuardedPort {
  std::string name;  ///< For messages.
  std::vector<HaltRecipe> recipes;
};

/// The owner's end of a guard: a process of its own (abcal-guard) that holds the descriptors of the ports of
/// a stage and a chamber and does nothing with them until this process has died; then it halts the axes and
/// leaves the chamber by the recipes.
/// However this process dies, also by SIGKILL, the system closes its end of their socket, and the guard sees
/// that. For one thread.
class HaltGuard {
 public:
  HaltGuard() = default;
  /// Tells the guard that the stage is at rest, and waits until it has released the ports and ended.
  ~HaltGuard();
  HaltGuard(const HaltGuard&) = delete;
  HaltGuard& operator=(const HaltGuard&) = delete;

  /// Hands a port over, which replaces one of the same name; starts the guard if none runs.
  /// @throws std::runtime_error (also ProgramMissing): no guard would halt the stage
  void hold(const GuardedPort& port, int descriptor);

  /// Number of guards started so far. Starts one if none runs; a new guard holds no port.
  int generation();
  pid_t process() const { return process_; }

 private:
  void start();
  void end();
  /// Closes the socket of a guard that has ended or is about to, and waits for its process.
  void collect();

  int socket_ = -1;
  pid_t process_ = -1;
  int generation_ = 0;
};

/// The guard itself: holds the ports received over `socket` until its other end is closed. Then, unless it
/// was told that the stage is at rest, it halts the axes and leaves the chamber by the recipes.
/// @return the outcome for each port, in words; empty: the owner ended in order.
std::vector<std::string> guard_until_owner_dies(int socket, Clock& clock);

}  // namespace abcal
