#include "app/system/terminal.h"

#include <fmt/color.h>
#include <unistd.h>

#include <cstdlib>

namespace abcal {

bool is_terminal(std::FILE* stream) {
  return ::isatty(::fileno(stream)) == 1;
}

std::string emphasised(std::FILE* stream, Emphasis emphasis, const std::string& text) {
  if (emphasis == Emphasis::kNone || !is_terminal(stream) || std::getenv("NO_COLOR") != nullptr) return text;
  fmt::text_style style;
  switch (emphasis) {
    case Emphasis::kNone:
      break;
    case Emphasis::kGood:
      style = fg(fmt::terminal_color::green);
      break;
    case Emphasis::kWarning:
      style = fg(fmt::terminal_color::yellow);
      break;
    case Emphasis::kBad:
      style = fg(fmt::terminal_color::red);
      break;
    case Emphasis::kHeading:
      style = fmt::emphasis::bold;
      break;
  }
  return fmt::format(style, "{}", text);
}

}  // namespace abcal
