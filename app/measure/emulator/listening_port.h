#pragma once

#include <string>

#include "sim/emulator.h"

namespace abcal {

/// Where to listen for "tcp:HOST:PORT". Port 0 is any free one, which is then printed. Without a host
/// ("tcp:PORT", "tcp::PORT") on the loopback only; another address (0.0.0.0) must be given.
/// @throws std::invalid_argument
sim::TcpPort listening_port(const std::string& port);

}  // namespace abcal
