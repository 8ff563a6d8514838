#include "app/measure/guard/guard_service.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>
#include <utility>

#include "app/system/output.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/port_held.h"
#include "protocol/record/run_file.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;

/// Between two looks at beats and threads.
constexpr int kTickMs = 20;
/// If the guard itself was suspended for this time, nothing was watched.
constexpr Clock::Duration kFrozen = 1s;
constexpr int kMostClients = 8;

/// The parent of a process: the one that started it, or after its end a process of the system. 0: unknown.
pid_t parent_of(const std::string& process) {
  std::ifstream file(fmt::format("/proc/{}/stat", process));
  std::string text;
  std::getline(file, text);
  const std::size_t name_end = text.rfind(") ");
  pid_t parent = 0;
  if (name_end != std::string::npos) std::istringstream(text.substr(name_end + 4)) >> parent;
  return parent;
}

/// Whether a guard whose program has died holds a port, which it releases once the axes are at rest. The
/// socket of a guard (HaltGuard) is named after the program that started it.
/// @param folder  of these sockets
bool is_held_after_death(const wire::PortHeld& held, const std::filesystem::path& folder) {
  return std::ranges::any_of(held.holders(), [&](const wire::PortHolder& holder) {
    if (holder.program != "abcal-guard") return false;
    const std::string socket = fmt::format("abcal-guard-{}-", parent_of(holder.pid));
    std::error_code error;
    for (const auto& entry : std::filesystem::directory_iterator(folder, error))
      if (entry.path().filename().string().starts_with(socket)) return false;
    return true;
  });
}

}  // namespace

GuardService::GuardService(Clock& clock, Options options)
    : clock_(clock),
      options_(std::move(options)),
      beat_at_(clock.now()),
      own_beat_at_(clock.now()),
      uptime_(options_.uptime()) {}

GuardService::~GuardService() {
  connections_.clear();
  for (const int client : clients_) ::close(client);
  if (listener_ >= 0) {
    ::close(listener_);
    std::error_code ignored;
    std::filesystem::remove(listening_at_, ignored);
  }
}

void GuardService::send(const Json& json, const std::vector<int>& descriptors) {
  if (owner_alive_) (void)send_guard_packet(options_.socket, json, descriptors);
}

void GuardService::log(std::string_view what, const std::string& text) {
  Json json = {{"owner", owner_}};
  if (!text.empty()) json["text"] = text;
  log_.add(what, clock_.utc_now(), std::move(json));
}

bool GuardService::may_move() const {
  const std::lock_guard lock(mutex_);
  return beat_.may_move[0] || beat_.may_move[1];
}

bool GuardService::is_all_done() const {
  return std::ranges::all_of(connections_, [](const auto& each) { return each.second->status().is_done(); });
}

std::vector<std::string> GuardService::serve() {
  std::optional<Clock::Instant> died;
  while (tick()) {
    if (owner_alive_) continue;
    if (!died) died = clock_.now();
    if (is_all_done() || clock_.now() - *died > options_.limits.give_up) break;
  }
  if (ended_in_order_) {
    log(GuardLog::kEnded);
    return {};
  }
  std::vector<std::string> words;
  for (const auto& [name, connection] : connections_) {
    const GuardedConnection::Status status = connection->status();
    if (status.axes[0] || status.axes[1] || !status.chamber.empty()) words.push_back(words_of(name, status));
  }
  return words;
}

/// @return false: the owner has ended in order
bool GuardService::tick() {
  std::vector<pollfd> waiting;
  if (owner_alive_) waiting.push_back({.fd = options_.socket, .events = POLLIN, .revents = 0});
  if (listener_ >= 0 && clients_.size() < kMostClients)
    waiting.push_back({.fd = listener_, .events = POLLIN, .revents = 0});
  for (const int client : clients_) waiting.push_back({.fd = client, .events = POLLIN, .revents = 0});
  ::poll(waiting.data(), waiting.size(), kTickMs);
  check_time();  // Before any byte is passed on after a freeze.
  for (const pollfd& each : waiting) {
    if (each.revents == 0) continue;
    if (each.fd == options_.socket)
      receive_from_owner();
    else if (each.fd == listener_)
      accept();
    else
      answer(each.fd);
  }
  if (ended_in_order_) return false;
  if (!owner_alive_) return true;
  check_beat();
  if (ended_in_order_) return false;
  if (clock_.now() - own_beat_at_ >= options_.limits.own_beat) {
    own_beat_at_ = clock_.now();
    send({{"kind", to_owner::kBeat}});
  }
  return true;
}

/// During a freeze of the guard (a container, the computer in suspension) the axes were not watched.
void GuardService::check_time() {
  const Clock::Duration now = options_.uptime();
  const Clock::Duration gap = now - uptime_.load();
  if (gap > kFrozen && may_move())
    halt(fmt::format("the guard itself stood still for {:.1f} s while an axis was moving", to_seconds(gap)),
         false);
  uptime_ = now;
}

void GuardService::check_beat() {
  // On a busy machine this thread may have been suspended since poll(): a beat that arrived meanwhile counts
  // first.
  for (pollfd more{.fd = options_.socket, .events = POLLIN, .revents = 0};
       owner_alive_ && !ended_in_order_ && ::poll(&more, 1, 0) == 1;)
    receive_from_owner();
  if (!owner_alive_ || ended_in_order_) return;
  const Clock::Duration silent = clock_.now() - beat_at_;
  OwnerBeat beat;
  {
    const std::lock_guard lock(mutex_);
    beat = beat_;
  }
  const bool moves = beat.may_move[0] || beat.may_move[1];
  const auto why = [&] {
    return fmt::format("{} did not give a sign of life for {:.1f} s{}{}", owner_, to_seconds(silent),
                       moves ? " while an axis was moving" : "",
                       beat.awaits.empty() ? "" : "; it waited for " + beat.awaits);
  };
  if (moves && silent > options_.limits.beat) halt(why(), false);
  if (beat.chamber && silent > options_.limits.chamber_beat) {
    halt(why(), true);
    const std::lock_guard lock(mutex_);
    beat_.chamber = false;
  }
}

/// Drops the owner's side of every port and halts the axes; with `chambers` leaves chambers as their policy
/// states.
void GuardService::halt(const std::string& why, bool chambers) {
  halted_because_ = why;
  for (const auto& [name, connection] : connections_) {
    const GuardedConnection::Status status = connection->status();
    if (!status.chamber.empty() && !chambers) continue;
    connection->drop(true);
    // The owner learns at once that a port is closed or gone. A halt that is under way reports by itself.
    const bool is_out_of_reach = status.state == GuardedConnection::State::kClosed ||
                                 status.state == GuardedConnection::State::kUnreachable;
    if (is_out_of_reach && (status.axes[0] || status.axes[1])) report_halt(name, status);
  }
  {
    // From here on the connections know. Not before: a port that is lost now asks whether its axes may be
    // moving.
    const std::lock_guard lock(mutex_);
    beat_.may_move = {};
  }
  log(GuardLog::kHalting, why);
  send({{"kind", to_owner::kHalting}, {"why", why}});
}

void GuardService::receive_from_owner() {
  try {
    if (std::optional<GuardPacket> packet = receive_guard_packet(options_.socket)) {
      handle(*std::move(packet));
      return;
    }
  } catch (const Json::exception& error) {
    print_log("abcal-guard: malformed packet ignored: {}\n", error.what());
    return;
  }
  owner_alive_ = false;
  log(GuardLog::kDied, owner_ + " has died");
  halt(owner_ + " has died", true);
}

void GuardService::handle(GuardPacket packet) {
  for (const int descriptor : packet.descriptors) ::close(descriptor);  // An owner sends none.
  const Json& json = packet.json;
  const std::string kind = json.at("kind").get<std::string>();
  if (kind == to_guard::kBeat) {
    handle_beat(owner_beat_from(json));
  } else if (kind == to_guard::kOwner) {
    owner_ = json.at("words").get<std::string>();
    if (const std::string file = json.at("log").get<std::string>(); !file.empty()) log_.open(file);
    log(GuardLog::kBegan);
    if (const std::string path = json.at("listen").get<std::string>(); !path.empty()) listen(path);
  } else if (kind == to_guard::kOpen) {
    halted_because_.clear();
    PortRequest request = port_request_from(json);
    GuardedConnection& wanted = connection(request.name);
    wanted.open(std::move(request));
  } else if (kind == to_guard::kLease) {
    take_leases(lease_request_from(json));
  } else if (kind == to_guard::kRecipes) {
    const std::string name = json.at("name").get<std::string>();
    std::vector<HaltRecipe> recipes;
    for (const Json& recipe : json.at("recipes")) recipes.push_back(halt_recipe_from(recipe));
    connection(name).set_recipes(std::move(recipes));
    send({{"kind", to_owner::kTaken}, {"name", name}});
  } else if (kind == to_guard::kHalt) {
    halt(json.at("why").get<std::string>(), false);
  } else if (kind == to_guard::kEnd) {
    if (may_move()) halt(owner_ + " has ended while an axis was moving", false);
    ended_in_order_ = is_all_done();
    if (!ended_in_order_) {  // It continues until the halt is confirmed, as after the owner's death.
      owner_alive_ = false;
      log(GuardLog::kDied, owner_ + " has ended before the halt was confirmed");
    }
  }
}

void GuardService::take_leases(const LeaseRequest& request) {
  try {
    for (const std::string& resource : request.resources)
      leases_[resource] = wire::Lease::take(resource, request.holder);
    send({{"kind", to_owner::kLeased}, {"name", request.name}});
  } catch (const wire::PortHeld& error) {
    report_failure(request.name, error);
  }
}

void GuardService::report_failure(const std::string& name, const std::exception& why) {
  Json json = {{"kind", to_owner::kFailed}, {"name", name}, {"detail", why.what()}};
  if (const auto* error = dynamic_cast<const InstrumentError*>(&why)) {
    json["instrument"] = error->instrument();
    json["fault"] = static_cast<int>(error->fault());
    json["detail"] = error->detail();
  }
  if (const auto* held = dynamic_cast<const wire::PortHeld*>(&why))
    json["held_by_guard"] = is_held_after_death(*held, listening_at_.parent_path());
  send(json);
}

void GuardService::handle_beat(const OwnerBeat& beat) {
  beat_at_ = clock_.now();
  std::array<bool, 2> before{};
  {
    const std::lock_guard lock(mutex_);
    before = beat_.may_move;
    beat_ = beat;
    if (!halted_because_.empty()) beat_.may_move = {};
    for (std::size_t k = 0; k < 2; ++k) {
      has_moved_[k] = has_moved_[k] || beat.may_move[k];
      if (before[k] && !beat.may_move[k]) rest_since_[k] = clock_.utc_now();
    }
  }
  for (const StageAxis axis : kStageAxes) {
    const std::size_t k = index(axis);
    if (before[k] != beat.may_move[k] && halted_because_.empty())
      log_.add(beat.may_move[k] ? GuardLog::kMoves : GuardLog::kAtRest, clock_.utc_now(),
               {{"owner", owner_}, {"axis", to_string(axis)}});
  }
}

GuardedConnection& GuardService::connection(const std::string& name) {
  std::unique_ptr<GuardedConnection>& found = connections_[name];
  if (found) return *found;
  GuardedConnection::Listener listener;
  listener.opened = [this, name](const std::string& port_name, int socket, int duplicate) {
    std::vector<int> descriptors{socket};
    if (duplicate >= 0) descriptors.push_back(duplicate);
    send({{"kind", to_owner::kOpened}, {"name", name}, {"port", port_name}}, descriptors);
    for (const int descriptor : descriptors) ::close(descriptor);
  };
  listener.failed = [this, name](const std::exception& why) { report_failure(name, why); };
  // `found` is in a node of the map, which does not move, and is set before the first port is opened.
  listener.lost = [this, name, &found](const std::string& why) {
    const GuardedConnection::Status status = found->status();
    bool moves = false;
    {
      const std::lock_guard lock(mutex_);
      moves = (status.axes[0] && beat_.may_move[0]) || (status.axes[1] && beat_.may_move[1]);
    }
    if (moves) log(GuardLog::kHalting, fmt::format("{}: {}", name, why));
    return moves;
  };
  listener.halted = [this, name](const GuardedConnection::Status& status) { report_halt(name, status); };
  listener.may_pass = [this] { return options_.uptime() - uptime_.load() < kFrozen; };
  found = std::make_unique<GuardedConnection>(clock_, options_.open, std::move(listener));
  return *found;
}

void GuardService::report_halt(const std::string& name, const GuardedConnection::Status& status) {
  const bool is_at_rest = status.state == GuardedConnection::State::kAtRest;
  const std::string words = words_of(name, status);
  log(is_at_rest ? GuardLog::kHalted : GuardLog::kNotHalted, words);
  send({{"kind", to_owner::kHalted},
        {"confirmed", is_at_rest},
        {"x", status.axes[0]},
        {"z", status.axes[1]},
        {"words", words}});
}

std::string GuardService::words_of(const std::string& name, const GuardedConnection::Status& status) const {
  const bool is_at_rest = status.state == GuardedConnection::State::kAtRest;
  std::string words;
  if (!status.chamber.empty())
    words = is_at_rest ? status.chamber
                       : "did not acknowledge its set point, is left as it is and may be heating or cooling";
  for (const StageAxis axis : kStageAxes) {
    if (!status.axes[index(axis)]) continue;
    words += fmt::format("{}axis {}: {}", words.empty() ? "" : "; ", to_string(axis),
                         is_at_rest ? "halted" : "did not acknowledge the halt, may be moving");
  }
  if (!is_at_rest && !status.detail.empty()) words += fmt::format(" ({})", status.detail);
  return fmt::format("{}: {}", name, words);
}

// ---- Others who ask: Stop without the owner

void GuardService::listen(const std::filesystem::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string text = path.string();
  if (text.size() >= sizeof address.sun_path) return;
  std::memcpy(address.sun_path, text.c_str(), text.size() + 1);
  std::error_code ignored;
  std::filesystem::remove(
      path, ignored);  // One that a killed guard has left: the name has the number of its owner.
  listener_ = ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  const mode_t before = ::umask(0177);  // For this user alone.
  const bool is_bound = ::bind(listener_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0 &&
                        ::listen(listener_, kMostClients) == 0;
  ::umask(before);
  if (is_bound) {
    listening_at_ = path;
    return;
  }
  print_log("abcal-guard: {}: {}; Stop reaches the stage only through {}\n", text, std::strerror(errno),
            owner_);
  ::close(std::exchange(listener_, -1));
}

void GuardService::accept() {
  const int client = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK);
  if (client >= 0) clients_.insert(client);
}

void GuardService::answer(int client) {
  try {
    if (const std::optional<GuardPacket> packet = receive_guard_packet(client)) {
      for (const int descriptor : packet->descriptors) ::close(descriptor);
      if (packet->json.value("kind", "") == to_guard::kHalt)
        halt("stopped by " + packet->json.value("by", "a person"), false);
      (void)send_guard_packet(client, status());
      return;
    }
  } catch (const Json::exception&) {  // No packet: the connection ends.
  }
  ::close(client);
  clients_.erase(client);
}

GuardService::Json GuardService::status() const {
  Json axes = Json::object();
  for (const StageAxis axis : kStageAxes) {
    const std::size_t k = index(axis);
    Json json = {{"state", axis_state::kNotMoved}};
    {
      const std::lock_guard lock(mutex_);
      if (beat_.may_move[k])
        json = {{"state", axis_state::kMayMove}};
      else if (has_moved_[k])
        json = {{"state", axis_state::kAtRest}, {"since", format_utc(rest_since_[k])}};
    }
    for (const auto& [name, connection] : connections_) {
      const GuardedConnection::Status status = connection->status();
      if (!status.axes[k]) continue;
      if (status.state == GuardedConnection::State::kHalting)
        json = {{"state", axis_state::kMayMove}, {"since", format_utc(status.since)}};
      else if (status.state == GuardedConnection::State::kUnreachable)
        json = {{"state", axis_state::kUnreachable},
                {"since", format_utc(status.since)},
                {"detail", status.detail}};
      else if (status.state == GuardedConnection::State::kAtRest)
        json = {{"state", axis_state::kAtRest}, {"since", format_utc(status.since)}};
    }
    axes[axis == StageAxis::kX ? "x" : "z"] = std::move(json);
  }
  return {{"kind", "status"},
          {"owner", owner_},
          {"owner_alive", owner_alive_.load()},
          {"halted", halted_because_},
          {"axes", std::move(axes)}};
}

}  // namespace abcal
