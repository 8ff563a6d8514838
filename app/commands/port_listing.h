#pragma once

#include <stop_token>
#include <string>
#include <vector>

#include "app/measure/bench/probe_ports.h"
#include "drivers/wire/port_list.h"

namespace abcal {

/// Identifies the instruments on all ports at once (probe_ports()), with a bar. Nothing moves.
/// @param stop  ends it before the next question: ports that were not asked to the end have a failure
std::vector<Probed> probe_with_bar(const std::vector<std::string>& ports, const std::stop_token& stop = {});

/// Lines on a serial port for a person: its names, and why it cannot be used or is slow.
std::string port_text(const wire::PortInfo& port);

}  // namespace abcal
