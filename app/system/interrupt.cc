#include "app/system/interrupt.h"

#include "app/system/last_signal.h"

#include <unistd.h>

#include <atomic>
#include <csignal>
#include <mutex>
#include <thread>
#include <utility>

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

std::atomic<int>& signals() {
  static std::atomic<int> count = 0;
  return count;
}

sigset_t watched_signals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGHUP);
  sigaddset(&signals, SIGTSTP);
  return signals;
}

/// Action on a signal, decided under one lock: a thread that has undertaken to end orderly is no longer
/// killed.
struct SignalPolicy {
  std::mutex mutex;
  bool ends_orderly = false;
  std::list<std::function<void()>> before_end;
  std::list<std::function<void()>> before_suspension;
};

SignalPolicy& policy() {
  static SignalPolicy& instance = *new SignalPolicy;  // Never deleted: the watching thread never ends.
  return instance;
}

bool is_ignored(int number) {
  struct sigaction inherited {};
  return ::sigaction(number, nullptr, &inherited) == 0 && inherited.sa_handler == SIG_IGN;
}

/// Ends by the default action, so that the shell sees a program that a signal has ended.
[[noreturn]] void end_by(int number) {
  sigset_t one;
  sigemptyset(&one);
  sigaddset(&one, number);
  pthread_sigmask(SIG_UNBLOCK, &one, nullptr);
  std::raise(number);
  constexpr int kEndedBySignal = 128;  // as a shell has it
  ::_exit(kEndedBySignal + number);    // The first process of a container has no default actions.
}

/// Ctrl-Z: halts what moves, then suspends the program until SIGCONT.
void suspend() {
  {
    SignalPolicy& state = policy();
    const std::lock_guard lock(state.mutex);
    if (is_ignored(SIGTSTP)) return;
    for (const std::function<void()>& action : state.before_suspension) action();
  }
  ::kill(::getpid(), SIGSTOP);
}

void act_on(int number) {
  if (number == SIGTSTP) return suspend();
  {
    SignalPolicy& state = policy();
    const std::lock_guard lock(state.mutex);  // Held until the end, so that the other threads wait.
    if (!state.ends_orderly) {
      if (is_ignored(number)) return;
      for (const std::function<void()>& action : state.before_end) action();
      end_by(number);
    }
  }
  last_signal() = number;
  ++signals();
  source().request_stop();
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
    while (sigwait(&signals, &number) == 0) act_on(number);
  }).detach();
}

int last_interrupt_signal() {
  return last_signal();
}

int interrupt_signals() {
  return signals();
}

void end_orderly_at_signals() {
  SignalPolicy& state = policy();
  const std::lock_guard lock(state.mutex);
  state.ends_orderly = true;
}

std::stop_token interrupt_token() {
  end_orderly_at_signals();
  return source().get_token();
}

BeforeSignalEnds::BeforeSignalEnds(std::function<void()> action) {
  SignalPolicy& state = policy();
  const std::lock_guard lock(state.mutex);
  place_ = state.before_end.insert(state.before_end.end(), std::move(action));
}

BeforeSignalEnds::~BeforeSignalEnds() {
  SignalPolicy& state = policy();
  const std::lock_guard lock(state.mutex);
  state.before_end.erase(place_);
}

BeforeSuspension::BeforeSuspension(std::function<void()> action) {
  SignalPolicy& state = policy();
  const std::lock_guard lock(state.mutex);
  place_ = state.before_suspension.insert(state.before_suspension.end(), std::move(action));
}

BeforeSuspension::~BeforeSuspension() {
  SignalPolicy& state = policy();
  const std::lock_guard lock(state.mutex);
  state.before_suspension.erase(place_);
}

}  // namespace abcal
