#include "app/system/interrupt.h"

#include "app/system/last_signal.h"

#include <atomic>
#include <csignal>
#include <thread>

namespace abcal {
namespace {

std::stop_source& source() {
  static std::stop_source instance;
  return instance;
}

std::atomic<int>& last_signal() {
  static std::atomic<int> number = 0;
  return number;
}

sigset_t watched_signals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGHUP);
  return signals;
}

}  // namespace

void watch_for_signals() {
  const sigset_t signals = watched_signals();
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  // A pipe or port whose other end is gone is an error to report; it does not end the program.
  std::signal(SIGPIPE, SIG_IGN);
  // The file size limit shows as a failed write, which the run file reports.
  std::signal(SIGXFSZ, SIG_IGN);
  source();
  std::thread([signals] {
    int number = 0;
    while (sigwait(&signals, &number) == 0) {
      last_signal() = number;
      source().request_stop();
    }
  }).detach();
}

int last_interrupt_signal() {
  return last_signal();
}

std::stop_token interrupt_token() {
  return source().get_token();
}

}  // namespace abcal
