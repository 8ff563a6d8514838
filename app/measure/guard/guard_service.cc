#include "app/measure/guard/guard_service.h"

#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <sstream>
#include <system_error>
#include <utility>

#include "app/system/channel.h"
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
constexpr std::size_t kMostClients = 8;

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
  if (listener_.number() < 0) return;
  std::error_code ignored;
  std::filesystem::remove(listening_at_, ignored);
}

void GuardService::send(const Json& json, const std::vector<Descriptor>& descriptors) {
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

/// Whether the port of an axis was lost while the axis was at rest: no command reaches it.
bool GuardService::is_cut_off(StageAxis axis) const {
  return std::ranges::any_of(connections_, [&](const auto& each) {
    const GuardedConnection::Status status = each.second->status();
    return status.axes[index(axis)] && status.state == GuardedConnection::State::kClosed;
  });
}

bool GuardService::is_all_done() const {
  return std::ranges::all_of(connections_, [](const auto& each) { return each.second->status().is_done(); });
}

std::vector<std::string> GuardService::serve() {
  while (owner_alive_ && !owner_ended_) tick();
  std::vector<std::string> words;
  if (owner_ended_ && is_all_done()) {
    log(GuardLog::kEnded);
  } else {
    words = finish_halt();
  }
  send({{"kind", to_owner::kEnds}, {"given_up", !is_all_done()}});
  return words;
}

/// The owner has died, or has ended before everything was confirmed at rest.
/// @return the result for each port, in words
std::vector<std::string> GuardService::finish_halt() {
  if (owner_ended_) log(GuardLog::kDied, owner_ + " has ended before the halt was confirmed");
  const Clock::Instant begun = clock_.now();
  while (!is_all_done() && clock_.now() - begun <= options_.limits.give_up) tick();
  std::vector<std::string> words;
  for (const auto& [name, connection] : connections_) {
    const GuardedConnection::Status status = connection->status();
    if (!status.is_done()) report_halt(name, status);
    if (status.axes[0] || status.axes[1] || !status.chamber.empty()) words.push_back(words_of(name, status));
  }
  return words;
}

void GuardService::tick() {
  std::vector<pollfd> waiting;
  if (owner_alive_) waiting.push_back({.fd = options_.socket, .events = POLLIN, .revents = 0});
  if (listener_.number() >= 0 && clients_.size() < kMostClients)
    waiting.push_back({.fd = listener_.number(), .events = POLLIN, .revents = 0});
  for (const Descriptor& client : clients_)
    waiting.push_back({.fd = client.number(), .events = POLLIN, .revents = 0});
  ::poll(waiting.data(), waiting.size(), kTickMs);
  check_time();  // Before any byte is passed on after a freeze.
  for (const pollfd& each : waiting) {
    if (each.revents == 0) continue;
    if (each.fd == options_.socket)
      receive_from_owner();
    else if (each.fd == listener_.number())
      accept();
    else
      answer(each.fd);
  }
  check_beat();
  if (clock_.now() - own_beat_at_ >= options_.limits.own_beat) {
    own_beat_at_ = clock_.now();
    send({{"kind", to_owner::kBeat}});
  }
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
  while (owner_alive_ && wait_until_readable(options_.socket, 0ms)) receive_from_owner();
  if (!owner_alive_ || owner_ended_) return;
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
      handle(*packet);
      return;
    }
  } catch (const Json::exception& error) {
    print_log("abcal-guard: malformed packet ignored: {}\n", error.what());
    return;
  }
  owner_alive_ = false;
  if (owner_ended_) return;  // It waited for the halt.
  log(GuardLog::kDied, owner_ + " has died");
  halt(owner_ + " has died", true);
}

void GuardService::handle(const GuardPacket& packet) {
  const Json& json = packet.json;
  const std::string kind = json.at("kind").get<std::string>();
  if (kind == to_guard::kBeat) {
    handle_beat(owner_beat_from(json));
  } else if (kind == to_guard::kOwner) {
    owner_ = json.at("words").get<std::string>();
    if (const std::string file = json.at("log").get<std::string>(); !file.empty()) {
      known_ = read_motion(file, json.at("bench").get<std::string>()).axes;
      log_.open(file);
    }
    log(GuardLog::kBegan);
    if (const std::string path = json.at("listen").get<std::string>(); !path.empty()) listen(path);
  } else if (kind == to_guard::kOpen) {
    halted_because_.clear();
    PortRequest request = port_request_from(json);
    GuardedConnection& wanted = connection(request.name);
    wanted.open(std::move(request));
  } else if (kind == to_guard::kTakeOver) {
    PortRequest request = port_request_from(json);
    log(GuardLog::kHalting, request.name + ": the guard before this one is gone");
    GuardedConnection& left = connection(request.name);
    left.take_over(std::move(request));
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
    owner_ended_ = true;
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
  std::array<bool, 2> before{}, now = beat.may_move;
  for (const StageAxis axis : kStageAxes)
    if (!halted_because_.empty() || is_cut_off(axis)) now[index(axis)] = false;
  {
    const std::lock_guard lock(mutex_);
    before = beat_.may_move;
    beat_ = beat;
    beat_.may_move = now;
  }
  for (const StageAxis axis : kStageAxes) {
    const bool moves = now[index(axis)];
    if (before[index(axis)] == moves || !halted_because_.empty()) continue;
    note(moves ? GuardLog::kMoves : GuardLog::kAtRest, {axis}, {});
  }
}

/// Notes the state of axes for those who ask, and in the log.
void GuardService::note(std::string_view what, const std::vector<StageAxis>& axes, const std::string& text) {
  const Clock::UtcTime utc = clock_.utc_now();
  Json json = {{"owner", owner_}, {"axes", Json::array()}};
  if (!text.empty()) json["text"] = text;
  for (const StageAxis axis : axes) {
    json["axes"].push_back(to_string(axis));
    const std::lock_guard lock(mutex_);
    if (what != GuardLog::kNotHalted)
      known_[index(axis)] = {
          what == GuardLog::kMoves ? axis_state::kMayMove : axis_state::kAtRest, format_utc(utc), {}};
    if (what == GuardLog::kHalted) beat_.may_move[index(axis)] = false;
  }
  log_.add(what, utc, std::move(json));
}

GuardedConnection& GuardService::connection(const std::string& name) {
  std::unique_ptr<GuardedConnection>& found = connections_[name];
  if (found) return *found;
  GuardedConnection::Listener listener;
  listener.opened = [this, name](const std::string& port_name, const std::string& lasting_name,
                                 const std::vector<Descriptor>& descriptors) {
    send({{"kind", to_owner::kOpened}, {"name", name}, {"port", port_name}, {"again", lasting_name}},
         descriptors);
  };
  listener.failed = [this, name](const std::exception& why) { report_failure(name, why); };
  // `found` is in a node of the map, which does not move, and is set before the first port is opened.
  listener.lost = [this, name, &found](const std::string& why) {
    const GuardedConnection::Status status = found->status();
    // A beat that was sent before the last bytes counts first.
    const Clock::Instant latest = clock_.now() + 100ms;
    while (owner_alive_ && wait_until_readable(options_.socket, 0ms) && clock_.now() < latest)
      clock_.sleep_until(clock_.now() + 1ms);
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
  std::vector<StageAxis> axes;
  // A port that was lost while its axes were at rest is closed: they still are.
  if (status.state != GuardedConnection::State::kClosed)
    std::ranges::copy_if(kStageAxes, std::back_inserter(axes),
                         [&](StageAxis axis) { return status.axes[index(axis)]; });
  note(is_at_rest ? GuardLog::kHalted : GuardLog::kNotHalted, axes, words);
  send({{"kind", to_owner::kHalted},
        {"name", name},
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
    words += fmt::format(
        "{}axis {}: {}", words.empty() ? "" : "; ", to_string(axis),
        is_at_rest ? "halted"
                   : "did not acknowledge the halt, may be moving since " + format_utc(status.since));
  }
  if (!is_at_rest && !status.detail.empty()) words += fmt::format(" ({})", status.detail);
  return fmt::format("{}: {}", name, words);
}

// ---- Others who ask: Stop without the owner

void GuardService::listen(const std::filesystem::path& path) {
  std::error_code ignored;
  std::filesystem::remove(
      path, ignored);  // One that a killed guard has left: the name has the number of its owner.
  try {
    listener_ = listen_at(path, ChannelKind::kPackets, kForThisUser);
    listening_at_ = path;
  } catch (const std::system_error& error) {
    print_log("abcal-guard: {}; Stop reaches the stage only through {}\n", error.what(), owner_);
  }
}

void GuardService::accept() {
  if (std::optional<Descriptor> client = accept_from(listener_)) clients_.push_back(*std::move(client));
}

void GuardService::answer(int client) {
  try {
    if (const std::optional<GuardPacket> packet = receive_guard_packet(client)) {
      if (packet->json.value("kind", "") == to_guard::kHalt)
        halt("stopped by " + packet->json.value("by", "a person"), false);
      (void)send_guard_packet(client, status());
      return;
    }
  } catch (const Json::exception&) {  // No packet: the connection ends.
  }
  std::erase_if(clients_, [&](const Descriptor& each) { return each.number() == client; });
}

GuardService::Json GuardService::status() const {
  AxesReport axes;
  {
    const std::lock_guard lock(mutex_);
    axes = known_;
  }
  for (const auto& [name, connection] : connections_) {
    const GuardedConnection::Status status = connection->status();
    if (status.is_done()) continue;
    const bool is_reachable = status.state == GuardedConnection::State::kHalting;
    for (std::size_t k = 0; k < 2; ++k)
      if (status.axes[k])
        axes[k] = {is_reachable ? axis_state::kMayMove : axis_state::kUnreachable, format_utc(status.since),
                   status.detail};
  }
  return {{"kind", "status"},
          {"owner", owner_},
          {"owner_alive", owner_alive_.load()},
          {"halted", halted_because_},
          {"axes", to_json(axes)}};
}

}  // namespace abcal
