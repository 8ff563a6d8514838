#pragma once

#include <string>
#include <string_view>

namespace abcal::wire {

/// Bytes as a message shows them: "55 51 AE FF".
std::string bytes_in_hex(std::string_view bytes);

/// Text for messages: bytes that are not printable appear as "\x0A".
std::string bytes_as_text(std::string_view bytes);

/// At most 80 bytes of lines of text: printable ones unchanged, others as \n, \r or \x1b.
std::string printable(std::string_view bytes);

}  // namespace abcal::wire
