#include "app/measure/emulator/listening_port.h"

#include <fmt/format.h>

#include <stdexcept>

#include "drivers/text/number.h"

namespace abcal {

sim::TcpPort listening_port(const std::string& port) {
  const std::size_t colon = port.rfind(':');  // at least that of "tcp:"
  std::string host = colon < 4 ? "" : port.substr(4, colon - 4);
  if (host.size() >= 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  sim::TcpPort where;
  if (!host.empty()) where.host = host;
  const auto number = pieces::number<std::uint16_t>(std::string_view(port).substr(colon + 1));
  if (!number) {
    throw std::invalid_argument(
        fmt::format("port \"{}\": \"{}\" is not a port number; required for emulate: tcp:HOST:PORT or "
                    "tcp:PORT (listens on the loopback), PORT from 0 (any free one) to 65535",
                    port, port.substr(colon + 1)));
  }
  where.port = *number;
  return where;
}

}  // namespace abcal
