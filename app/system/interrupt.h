#pragma once

#include <functional>
#include <list>
#include <stop_token>

namespace abcal {

/// Blocks SIGINT, SIGTERM, SIGHUP and SIGTSTP in this and all later threads and starts the one thread that
/// waits for them. Call once, first thing in main().
///
/// A signal ends the program at once, by its default action, until a part of the program has undertaken to
/// end orderly (end_orderly_at_signals(), interrupt_token()). From then on it only requests the stop of
/// interrupt_token(). Commands that only compute do not undertake this. A bench does, before a stage or a
/// chamber that may be real is opened, so that no command that moves one ends without its halt; so does a
/// command with an end of its own. A signal that the program was started to ignore (nohup) is ignored until
/// then.
void watch_for_signals();

/// From now on no signal ends the program; the caller must end it soon after one.
void end_orderly_at_signals();

/// Undertakes to end orderly. Stop is requested when one of these signals arrives. Callbacks on it run in the
/// watching thread, at once: that is how a stage is halted while another thread waits for a reply.
std::stop_token interrupt_token();

/// First action of a signal that ends the program at once, e.g. to remove a temporary file; valid for the
/// lifetime of this object. It runs in the watching thread, while the others continue.
class BeforeSignalEnds {
 public:
  explicit BeforeSignalEnds(std::function<void()> action);
  BeforeSignalEnds(const BeforeSignalEnds&) = delete;
  BeforeSignalEnds& operator=(const BeforeSignalEnds&) = delete;
  ~BeforeSignalEnds();  ///< Does not return once such a signal has arrived.

 private:
  std::list<std::function<void()>>::iterator place_;
};

/// Action before Ctrl-Z (SIGTSTP) suspends the program, valid for the lifetime of this object: a stage is
/// halted first. It runs in the watching thread.
class BeforeSuspension {
 public:
  explicit BeforeSuspension(std::function<void()> action);
  BeforeSuspension(const BeforeSuspension&) = delete;
  BeforeSuspension& operator=(const BeforeSuspension&) = delete;
  ~BeforeSuspension();  ///< Waits for the end of an action that has begun.

 private:
  std::list<std::function<void()>>::iterator place_;
};

}  // namespace abcal
