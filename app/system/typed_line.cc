#include "app/system/typed_line.h"

#include <poll.h>
#include <unistd.h>

#include <cerrno>

#include "app/system/interrupt.h"

namespace abcal {

std::optional<std::string> typed_line() {
  std::string line;
  for (;;) {
    if (interrupt_token().stop_requested()) return std::nullopt;
    pollfd input{STDIN_FILENO, POLLIN, 0};
    const int ready = ::poll(&input, 1, 200);  // ms, between two checks for an interrupt
    if (ready == 0 || (ready < 0 && errno == EINTR)) continue;
    char c = 0;
    if (::read(STDIN_FILENO, &c, 1) <= 0) return std::nullopt;
    if (c == '\n') return line;
    line += c;
  }
}

}  // namespace abcal
