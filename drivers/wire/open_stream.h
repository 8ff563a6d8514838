#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "drivers/wire/byte_stream.h"
#include "drivers/wire/serial_port.h"

namespace abcal::wire {

/// Opens the `port` of a bench file: "/path", "usb:VID:PID[:SERIAL]", "tcp:HOST:PORT" or
/// "usbtmc:/dev/usbtmc0". ("simulated" is not a port: the program handles it before this call.)
/// @param defaults Baud rate and flow control for serial ports; its path is not used.
/// @param holder Who uses it, for other programs that want the same device or network address (Lease).
/// @throws InstrumentError kCannotOpen, PortHeld; std::invalid_argument if `port` has none of these forms.
std::unique_ptr<ByteStream> open_stream(std::string_view port, const SerialSettings& defaults, Clock& clock,
                                        const std::string& holder = {});

}  // namespace abcal::wire
