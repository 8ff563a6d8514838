#include "app/commands/wait_for_enter.h"

#include <poll.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <stdexcept>

#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "protocol/run/experiment_run.h"

namespace abcal {

bool is_person_at_terminal() {
  return ::isatty(STDIN_FILENO) == 1;
}

void wait_for_enter(const std::string& request, const std::string& when) {
  print_log("{}", request);
  std::array<char, 256> line{};
  for (;;) {
    if (interrupt_token().stop_requested())
      throw RunInterrupted(Message("stopped by the operator {when}", when));
    pollfd input{STDIN_FILENO, POLLIN, 0};
    const int ready = ::poll(&input, 1, 200);  // ms, between two checks for an interrupt
    if (ready == 0 || (ready < 0 && errno == EINTR)) continue;
    if (::read(STDIN_FILENO, line.data(), line.size()) > 0) return;
    throw std::runtime_error(
        "the terminal was closed, so nobody can confirm that the accelerometer is mounted");
  }
}

}  // namespace abcal
