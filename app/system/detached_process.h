#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

#include "app/system/child_process.h"
#include "app/system/descriptor.h"

namespace abcal {

/// Starts a program that outlives this one: in a session of its own, so that neither Ctrl-C nor a closed
/// terminal reaches it, with nothing on standard input, and standard error for both outputs. It inherits no
/// other descriptor but `descriptor`, as number 3 (-1: none).
/// @throws ProgramMissing, std::runtime_error
pid_t start_detached(const Tool& tool, const std::vector<std::string>& arguments, int descriptor = -1);

/// A detached program, which the caller waits for, and this end of a channel of packets to it.
struct ConnectedProcess {
  Descriptor socket;
  pid_t process = -1;
};

/// start_detached() with the other end of a channel as the program's descriptor.
/// @throws ProgramMissing, std::runtime_error
ConnectedProcess start_connected(const Tool& tool, const std::vector<std::string>& arguments = {});

}  // namespace abcal
