#include "app/console/visible_text.h"

#include <fmt/format.h>
#include <unicode/uchar.h>
#include <unicode/utf8.h>

#include <cstdint>

namespace abcal::console {
namespace {

/// Calls `each` with every character and its bytes; a byte that is not UTF-8 is a character < 0.
template <class Each>
void for_each_character(std::string_view utf8, const Each& each) {
  const auto length = static_cast<std::int32_t>(utf8.size());
  for (std::int32_t at = 0; at < length;) {
    const std::int32_t begin = at;
    UChar32 character = 0;
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wconversion"  // Inside the macro.
    U8_NEXT(utf8.data(), at, length, character);
#pragma GCC diagnostic pop
    each(character, utf8.substr(static_cast<std::size_t>(begin), static_cast<std::size_t>(at - begin)));
  }
}

bool turns_direction(UChar32 character) {
  return character >= 0 && u_hasBinaryProperty(character, UCHAR_BIDI_CONTROL) != 0;
}

}  // namespace

bool has_direction_controls(std::string_view utf8) {
  bool found = false;
  for_each_character(
      utf8, [&](UChar32 character, std::string_view) { found = found || turns_direction(character); });
  return found;
}

std::string with_visible_direction_controls(std::string_view utf8) {
  // Most texts have none. These characters (U+061C, U+200E to U+2069) begin with one of these bytes.
  if (utf8.find('\xD8') == std::string_view::npos && utf8.find('\xE2') == std::string_view::npos)
    return std::string(utf8);
  std::string shown;
  shown.reserve(utf8.size());
  for_each_character(utf8, [&](UChar32 character, std::string_view bytes) {
    if (turns_direction(character))
      shown += fmt::format("[U+{:04X}]", static_cast<std::uint32_t>(character));
    else
      shown += bytes;
  });
  return shown;
}

}  // namespace abcal::console
