#pragma once

#include <array>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "app/measure/guard/guard_packets.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/halt.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/lease.h"
#include "drivers/wire/port_list.h"

namespace abcal {

/// One port in the hands of a guard. It opens the port, passes the bytes of the owner on, and halts the
/// instruments behind it: it drops the owner's side first, so that there is one writer on the wire at any
/// time, and repeats the halt each second until the controller has confirmed it, also after the port was gone
/// for a while. Has two threads of its own; every call returns at once.
class GuardedConnection {
 public:
  /// State of the port and of the axes behind it.
  enum class State {
    kClosed,       ///< No port is open.
    kPassing,      ///< The owner moves them.
    kHalting,      ///< A halt was sent and is not confirmed yet.
    kUnreachable,  ///< The port is gone, or the controller does not answer: they may be moving.
    kAtRest,       ///< Halted by the guard, confirmed by the controller.
  };

  struct Status {
    State state = State::kClosed;
    Clock::UtcTime since;
    std::array<bool, 2> axes{};  ///< Axes behind the port, by index(StageAxis), from its recipes.
    std::string chamber;         ///< The action on a chamber behind the port, in words; empty: none.
    std::string detail;          ///< Why the port cannot be opened.

    bool is_done() const { return state != State::kHalting && state != State::kUnreachable; }
  };

  /// Opens a port. @throws InstrumentError kCannotOpen, std::invalid_argument
  using OpenPort = std::function<std::unique_ptr<wire::ByteStream>(const PortRequest& request)>;
  struct Listener {
    /// With the name by which the port is found again wherever it is plugged in, the channel for the owner,
    /// and a duplicate of the port's descriptor if it has one. May be called from a thread of this object, as
    /// the others.
    std::function<void(const std::string& port_name, const std::string& lasting_name,
                       const std::vector<Descriptor>& descriptors)>
        opened;
    std::function<void(const std::exception& why)> failed;
    /// A first attempt to halt has ended, or a later one was successful.
    std::function<void(const Status&)> halted;
    /// The port is gone. @return whether an axis behind it may be moving, so that it must be halted
    std::function<bool(const std::string& why)> lost;
    /// Before bytes of the owner are passed on: false while the guard must not.
    std::function<bool()> may_pass;
  };

  GuardedConnection(Clock& clock, OpenPort open, Listener listener);
  ~GuardedConnection();
  GuardedConnection(const GuardedConnection&) = delete;
  GuardedConnection& operator=(const GuardedConnection&) = delete;

  /// Opens the port, in place of one that is open. While a halt is not confirmed this fails.
  void open(PortRequest request);
  /// Halts the axes behind a port that another guard has left, as one that was lost in motion.
  void take_over(PortRequest request);
  void set_recipes(std::vector<HaltRecipe> recipes);
  std::vector<HaltRecipe> recipes() const;
  /// Drops the owner's side. With `halt`, halts until that is confirmed; a port without recipes never moved.
  void drop(bool halt);
  Status status() const;

 private:
  void keep(const std::stop_token& end);
  void pass_output(const std::stop_token& end);
  void serve(const PortRequest& request);
  void pass_input();
  void pass_to_owner(std::string_view bytes);
  void halt_once();
  bool reopen();
  void lose(const std::string& why);
  void begin_halt_locked(State state);
  void set_state(State state, std::string detail = {});
  void close_owner_side();

  Clock& clock_;
  const OpenPort open_;
  const Listener listener_;

  mutable std::mutex mutex_;  ///< Guards what follows, but for the stream's own calls.
  std::condition_variable_any changed_;
  std::optional<PortRequest> wanted_;
  PortRequest request_;
  std::optional<wire::PortInfo> usb_;  ///< The USB device of the port, to find it again.
  std::vector<HaltRecipe> recipes_;
  std::shared_ptr<wire::ByteStream> stream_;  ///< Null: the port is not open.
  /// Leases of the stream that was open last, so that no other program takes the address of an instrument
  /// that is still to be halted.
  std::vector<std::shared_ptr<wire::Lease>> leases_;
  Descriptor owner_;  ///< The guard's end of the owner's channel of bytes.
  Status status_;
  bool is_reported_ = false;  ///< The result of the halt under way.
  Clock::Instant next_attempt_;
  std::mutex pass_mutex_;  ///< Held for one write of the owner's bytes; taken before mutex_.

  std::jthread keeper_;  ///< Opens, reads and halts. The threads end before the members that they use.
  std::jthread passer_;  ///< Passes the owner's bytes on.
};

}  // namespace abcal
