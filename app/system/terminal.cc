#include "app/system/terminal.h"

#include <unistd.h>

#include <cstdlib>

namespace abcal {
namespace {

constexpr char kEndMark = '\xf8';

char begin_mark(Emphasis emphasis) {
  switch (emphasis) {
    case Emphasis::kGood:
      return '\xf9';
    case Emphasis::kWarning:
      return '\xfa';
    case Emphasis::kBad:
      return '\xfb';
    case Emphasis::kHeading:
      return '\xfc';
    case Emphasis::kNone:
      break;
  }
  return kEndMark;
}

}  // namespace

bool is_terminal(std::FILE* stream) {
  return ::isatty(::fileno(stream)) == 1;
}

std::string emphasised(std::FILE* stream, Emphasis emphasis, const std::string& text) {
  if (emphasis == Emphasis::kNone || !is_terminal(stream) || std::getenv("NO_COLOR") != nullptr) return text;
  return begin_mark(emphasis) + text + kEndMark;
}

std::string_view terminal_sequence(char mark) {
  switch (mark) {
    case '\xf9':
      return "\x1b[32m";  // green
    case '\xfa':
      return "\x1b[33m";  // yellow
    case '\xfb':
      return "\x1b[31m";  // red
    case '\xfc':
      return "\x1b[1m";  // bold
    default:
      return "\x1b[0m";
  }
}

}  // namespace abcal
