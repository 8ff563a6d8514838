#pragma once

#include <functional>
#include <list>
#include <stop_token>

namespace abcal {

/// Blocks SIGINT, SIGTERM and SIGHUP in this and all later threads and starts the one thread that waits for
/// them. Call once, first thing in main().
///
/// What a signal does: it ends the program at once, by its default action, as it does a program that knows
/// nothing of signals, until somebody has undertaken to end orderly (end_orderly_at_signals(),
/// interrupt_token()). From then on it requests the stop of interrupt_token() and does nothing else. Commands
/// that only compute undertake nothing; a bench does before a stage or a chamber that may be real is opened,
/// so that no command that moves one is ended without its halt, and so does a command with an end of its own.
/// A signal that the program was started to ignore (nohup) is ignored until then.
void watch_for_signals();

/// From now on no signal ends the program; who calls this sees to it that it ends soon after one.
void end_orderly_at_signals();

/// Undertakes to end orderly. Stop is requested when one of these signals has come. Callbacks on it run in
/// the watching thread, at once: that is how a stage is halted while another thread waits for a reply.
std::stop_token interrupt_token();

/// What a signal that ends the program at once does first, e.g. removes a temporary file; for as long as this
/// lives. It runs in the watching thread, while the others go on.
class BeforeSignalEnds {
 public:
  explicit BeforeSignalEnds(std::function<void()> action);
  BeforeSignalEnds(const BeforeSignalEnds&) = delete;
  BeforeSignalEnds& operator=(const BeforeSignalEnds&) = delete;
  ~BeforeSignalEnds();  ///< Does not return where such a signal has come.

 private:
  std::list<std::function<void()>>::iterator place_;
};

}  // namespace abcal
