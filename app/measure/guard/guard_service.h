#pragma once

#include <array>
#include <atomic>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "app/measure/guard/guard_log.h"
#include "app/measure/guard/guard_packets.h"
#include "app/measure/guard/guarded_connection.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/wire/lease.h"

namespace abcal {

/// Limits of a guard, in real time.
struct GuardLimits {
  /// Without a beat for this time, while an axis may be moving, the axes are halted.
  Clock::Duration beat = std::chrono::seconds(1);
  /// Without a beat for this time a chamber is left as its policy states.
  Clock::Duration chamber_beat = std::chrono::seconds(60);
  /// Between two beats to the owner.
  Clock::Duration own_beat = std::chrono::milliseconds(100);
  /// After the end of the owner: an instrument that stays unreachable is given up after this time.
  Clock::Duration give_up = std::chrono::minutes(10);
};

/// The guard itself, in a process of its own: opens the ports of a stage and a chamber for the program that
/// moves them (its owner), passes the bytes on, and halts the axes if the owner dies, hangs, or another
/// program asks it to stop. Serves one owner.
class GuardService {
 public:
  struct Options {
    int socket = -1;                          ///< Its end of the socket to the owner.
    GuardedConnection::OpenPort open;         ///< Opens a port.
    std::function<Clock::Duration()> uptime;  ///< Time since boot, time in suspension included.
    GuardLimits limits;
  };

  GuardService(Clock& clock, Options options);
  ~GuardService();
  GuardService(const GuardService&) = delete;
  GuardService& operator=(const GuardService&) = delete;

  /// Serves until the owner has ended or died, and everything is confirmed at rest or given up.
  /// @return the result for each port, in words; empty: everything was at rest when the owner ended
  std::vector<std::string> serve();

 private:
  using Json = nlohmann::json;

  void tick();
  void receive_from_owner();
  void handle(const GuardPacket& packet);
  void handle_beat(const OwnerBeat& beat);
  void take_leases(const LeaseRequest& request);
  void report_failure(const std::string& name, const std::exception& why);
  void check_time();
  void check_beat();
  void halt(const std::string& why, bool chambers);
  void listen(const std::filesystem::path& path);
  void accept();
  void answer(int client);
  GuardedConnection& connection(const std::string& name);
  Json status() const;
  std::vector<std::string> finish_halt();
  void note(std::string_view what, const std::vector<StageAxis>& axes, const std::string& text);
  void report_halt(const std::string& name, const GuardedConnection::Status& status);
  std::string words_of(const std::string& name, const GuardedConnection::Status& status) const;
  bool may_move() const;
  bool is_cut_off(StageAxis axis) const;
  bool is_all_done() const;
  void log(std::string_view what, const std::string& text = {});
  void send(const Json& json, const std::vector<Descriptor>& descriptors = {});

  Clock& clock_;
  const Options options_;
  GuardLog log_;
  mutable std::mutex mutex_;  ///< Guards what threads of the connections use, too: the next two.
  OwnerBeat beat_;
  AxesReport known_;  ///< But for ports that are being halted.
  Clock::Instant beat_at_;
  Clock::Instant own_beat_at_;
  std::atomic<Clock::Duration> uptime_;  ///< At the last tick.
  std::string owner_ = "a program";
  std::atomic<bool> owner_alive_ = true;
  bool owner_ended_ = false;
  std::string halted_because_;  ///< Reason of the latest halt; empty: none since a port was last opened.
  std::filesystem::path listening_at_;
  Descriptor listener_;
  std::vector<Descriptor> clients_;
  std::map<std::string, std::shared_ptr<wire::Lease>> leases_;             ///< Until the end of this object.
  std::map<std::string, std::unique_ptr<GuardedConnection>> connections_;  ///< By PortRequest::name.
};

}  // namespace abcal
