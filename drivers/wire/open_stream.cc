#include "drivers/wire/open_stream.h"

#include "drivers/wire/port_list.h"
#include "drivers/wire/tcp_stream.h"
#include "drivers/wire/usbtmc_stream.h"

namespace abcal::wire {

std::unique_ptr<ByteStream> open_stream(std::string_view port, const SerialSettings& defaults, Clock& clock,
                                        const std::string& holder) {
  const PortName name = parse_port(port);
  if (name.kind == PortName::Kind::kTcp)
    return std::make_unique<TcpStream>(name.host, name.tcp_port, clock, std::chrono::seconds(5),
                                       kDefaultQueueBytes, holder);
  if (name.kind == PortName::Kind::kUsbtmc) return std::make_unique<UsbtmcStream>(name.path, clock, holder);
  SerialSettings settings = defaults;
  settings.path = resolve_port(port);
  return std::make_unique<SerialPort>(settings, clock, kDefaultQueueBytes, holder);
}

}  // namespace abcal::wire
