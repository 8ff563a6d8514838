#include "drivers/wire/readable_bytes.h"

#include <fmt/format.h>

namespace abcal::wire {

std::string bytes_in_hex(std::string_view bytes) {
  std::string text;
  for (const char byte : bytes)
    text += fmt::format("{}{:02X}", text.empty() ? "" : " ", static_cast<unsigned char>(byte));
  return text;
}

std::string bytes_as_text(std::string_view bytes) {
  std::string text;
  for (const char byte : bytes) {
    const bool plain = byte >= ' ' && byte <= '~';
    text += plain ? std::string(1, byte) : fmt::format("\\x{:02X}", static_cast<unsigned char>(byte));
  }
  return text;
}

std::string printable(std::string_view bytes) {
  constexpr std::size_t kLongest = 80;
  std::string text;
  for (const char byte : bytes.substr(0, kLongest)) {
    if (byte == '\n') {
      text += "\\n";
    } else if (byte == '\r') {
      text += "\\r";
    } else if (byte >= 0x20 && byte < 0x7F) {
      text += byte;
    } else {
      text += fmt::format("\\x{:02x}", static_cast<unsigned char>(byte));
    }
  }
  if (bytes.size() > kLongest) text += "...";
  return text;
}

}  // namespace abcal::wire
