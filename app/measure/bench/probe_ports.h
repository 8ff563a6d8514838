#pragma once

#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/measure/bench/probe.h"
#include "drivers/wire/port_list.h"

namespace abcal {

/// The outcome of probing one port.
struct Probed {
  std::string port;
  std::optional<ProbeAnswer> answer;
  std::string failure;  ///< Why the port could not be asked; empty: it was.
};

/// Asks all ports at once, each in a thread of its own (probe_port()).
/// @param trying  called from these threads with the port and the driver that is tried
std::vector<Probed> probe_ports(
    const std::vector<std::string>& ports,
    const std::function<void(const std::string& port, const std::string& driver)>& trying);

/// The ports that are free and that this user may use.
std::vector<std::string> ports_to_ask(const std::vector<wire::PortInfo>& ports);

/// One line on the outcome, for a person.
std::string in_words(const Probed& probed);
nlohmann::ordered_json probed_json(const Probed& probed);
nlohmann::ordered_json port_json(const wire::PortInfo& port);
/// As a bench file names a port of USB; empty for any other.
std::string usb_name(const wire::PortInfo& port);

}  // namespace abcal
