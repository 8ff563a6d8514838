#pragma once

#include <sys/types.h>

#include <array>
#include <atomic>
#include <condition_variable>
#include <filesystem>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "app/measure/guard/guard_packets.h"
#include "app/system/descriptor.h"
#include "app/system/interrupt.h"
#include "app/system/real_clock.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/halt.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/serial_port.h"

namespace abcal {

/// The owner's end of a guard (GuardService, in a process of its own, abcal-guard). The guard opens the ports
/// of a stage and a chamber and passes the bytes on. It halts the axes if this process dies or its moving
/// thread gives no sign of life for 1 s while an axis may be moving. This end watches the guard in turn:
/// while an axis may be moving and the guard is dead or silent for 0.9 s, the axes are halted over duplicates
/// of the ports' descriptors, and by another guard where that is not confirmed. Ctrl-Z halts the axes before
/// it suspends the program.
///
/// Functions may be called from any thread.
class HaltGuard {
 public:
  /// @param who  moves the bench, for the guard's log and for programs that find a port in use: "a run by A.
  /// B."
  /// @param bench  bench_in_words()
  HaltGuard(const std::string& who, std::string bench);
  /// Waits until the guard has ended: it halts every axis that is not confirmed at rest, and tries this for
  /// ten minutes. What is waited for is printed, and again at each signal.
  ~HaltGuard();
  HaltGuard(const HaltGuard&) = delete;
  HaltGuard& operator=(const HaltGuard&) = delete;

  /// Opens a port behind the guard; starts a guard if there is none.
  /// @param name  InstrumentPort::name
  /// @throws InstrumentError as wire::open_stream() (PortHeld as kCannotOpen), ProgramMissing,
  /// std::runtime_error: the guard cannot be started
  std::unique_ptr<wire::ByteStream> open(const std::string& name, const std::string& port,
                                         const wire::SerialSettings& settings);

  /// Has the guard take the leases of the instrument behind a port; it holds them until it ends, which is
  /// after all axes are at rest.
  /// @param resources  by resources_of_instrument(); none: nothing is done
  /// @throws wire::PortHeld with the words of the holder; InstrumentError kLinkLost: there is no guard
  void lease(const std::string& name, std::vector<std::string> resources);

  /// Gives the guard the recipes to halt what is on a port, before it moves.
  /// @throws InstrumentError kLinkLost: there is no guard, and nothing may move
  void hold(const std::string& name, std::vector<HaltRecipe> recipes);

  /// An axis is about to be commanded to move, by this thread, which beats from now on.
  /// @throws InstrumentError kStalled after a halt by the guard, kLinkLost: there is no guard
  void begin_motion(StageAxis axis);
  /// The controller has reported standstill of an axis.
  void end_motion(StageAxis axis);
  /// A chamber has a set point of this run.
  void drive_chamber();

  /// A sign of life of the moving thread, at least each 0.25 s of every wait; without effect in other
  /// threads.
  /// @param awaits  the event that it waits for, in words
  void beat(std::string_view awaits) noexcept;

  /// Has the guard halt the axes, and waits for the result of its first attempt; the guard continues to try.
  /// Its ports are closed for this program then.
  HaltReport halt(const std::string& why) noexcept;

  /// Why the guard, or this end in its place, has halted the axes; empty if it has not since the last open().
  /// @param longest_wait  for news of it, after a port was closed by the guard
  std::string halted_because(Clock::Duration longest_wait = {}) const;

  /// Who moves which bench, in words: "a run on the bench \"left\" (process 4711)".
  const std::string& owner() const { return owner_; }
  /// The end of the previous session on this bench, if it did not end in order, in words; empty otherwise.
  std::string last_incident() const;
  pid_t process() const;

 private:
  using Json = nlohmann::json;

  /// A port, as another guard takes it over.
  struct Port {
    PortRequest request;
    std::vector<std::string> leases;
  };

  void start();
  void launch();
  bool replace();
  void end();
  void wait_for_rest();
  void collect();
  std::optional<GuardPacket> answer_to(const std::string& name, const Json& question,
                                       std::chrono::seconds longest);
  void watch(const std::stop_token& stop);
  void receive(GuardPacket packet);
  void note_silence(const std::string& why);
  bool may_move() const;
  bool may_move_locked() const { return beat_.may_move[0] || beat_.may_move[1]; }
  std::string unconfirmed_locked() const;
  HaltReport halt_by_duplicates();
  bool send_beat_locked(std::string_view awaits);
  bool is_alive() const;

  RealClock clock_;
  const std::string bench_, owner_;  ///< In words: "on the bench \"left\"", "a run on the bench \"left\"".

  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  Descriptor socket_, pidfd_;
  pid_t process_ = -1;
  bool alive_ = false;
  bool is_watched_ = false;   ///< The watcher runs, and starts another guard if that is needed.
  bool has_ended_ = false;    ///< This end moves nothing any more.
  bool guard_ends_ = false;   ///< The guard says that it has nothing to do any more.
  bool is_given_up_ = false;  ///< ... although an axis is not confirmed at rest.
  Clock::Instant launched_, heard_, beat_sent_;
  OwnerBeat beat_;
  std::optional<std::thread::id> moving_thread_;
  /// Requests for a port, by its name, that the guard has not answered yet: at most one for each port.
  std::map<std::string, std::shared_ptr<std::promise<GuardPacket>>> asked_;
  std::map<std::string, Descriptor> duplicates_;  ///< Descriptors of open ports, by name.
  std::map<std::string, std::vector<HaltRecipe>> recipes_;
  std::map<std::string, Port> ports_;               ///< By name.
  std::map<std::string, std::string> unconfirmed_;  ///< In words, by name: halts that are not confirmed.
  int recipes_taken_ = 0;
  std::string halted_because_;
  std::string incident_;
  std::array<std::optional<bool>, 2> confirmed_{};  ///< Result of the halt under way, by index(StageAxis).
  std::mutex duplicates_mutex_;  ///< Held during halt_by_duplicates(); guards the next two.
  std::optional<Clock::Instant> halted_by_duplicates_at_;
  HaltReport last_halt_by_duplicates_;
  std::mutex start_mutex_;  ///< Held while a guard is started or a port is opened.
  std::jthread watcher_;    ///< It ends before the members that it uses.
  BeforeSuspension halt_first_;
};

/// Folder for the sockets of running guards: XDG_RUNTIME_DIR, or a folder of this user in the temporary one.
std::filesystem::path guard_folder();

/// Asks all guards of a program: to halt (to_guard::kHalt, with "by"), or for their status ("status").
/// @return their answers; empty: there is no guard of that program, or none answers in time
std::vector<nlohmann::json> ask_guards(pid_t owner, const nlohmann::json& question,
                                       std::chrono::milliseconds longest);

}  // namespace abcal
