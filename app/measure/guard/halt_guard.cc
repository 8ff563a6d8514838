#include "app/measure/guard/halt_guard.h"

#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <fstream>
#include <stdexcept>
#include <utility>

#include "app/measure/guard/guard_log.h"
#include "app/system/channel.h"
#include "app/system/detached_process.h"
#include "app/system/helper_program.h"
#include "app/system/last_signal.h"
#include "app/system/output.h"
#include "app/system/temporary_folder.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/halt_recipe.h"
#include "drivers/wire/port_held.h"
#include "drivers/wire/socket_stream.h"

namespace abcal {
namespace {

using namespace std::chrono_literals;

/// Longest silence of the guard while an axis may be moving. It beats each 0.1 s; on a machine with ten busy
/// programs for two processors it was 0.5 s late once in some hundred runs.
constexpr Clock::Duration kSilent = 900ms;
/// Between two beats of the moving thread; its waits are sliced more finely.
constexpr Clock::Duration kBeatInterval = 200ms;
constexpr std::chrono::seconds kAnswerTime{5};
/// To resolve a host and connect to it, on a slow network.
constexpr std::chrono::seconds kOpenTime{15};
/// Between the end of an attempt of the guard and its news of it.
constexpr Clock::Duration kAnswerMargin = 500ms;
/// Between the starts of two guards.
constexpr Clock::Duration kBetweenGuards = 1s;
/// At the end: between two looks at signals, and before it is said what is waited for.
constexpr Clock::Duration kLook = 50ms, kQuietWait = 1s;
constexpr const char* kGone = "its guard has ended";

/// Where memory is short the system ends this program before the guard, which was started with the score of
/// before.
void prefer_as_victim() {
  std::ofstream("/proc/self/oom_score_adj") << 500;
}

/// Throws what the guard could not do.
/// @param who  the port or the instrument
[[noreturn]] void throw_failure(const nlohmann::json& answer, const std::string& who) {
  if (answer.empty()) throw InstrumentError(who, Fault::kCannotOpen, kGone);
  const std::string detail = answer.at("detail").get<std::string>();
  if (!answer.contains("fault")) throw std::invalid_argument(detail);
  if (const auto held = answer.find("held_by_guard"); held != answer.end()) {
    std::vector<wire::PortHolder> holders;
    if (held->get<bool>()) holders.push_back({"", "abcal-guard"});
    throw wire::PortHeld(who, detail, std::move(holders));
  }
  throw InstrumentError(answer.value("instrument", who), static_cast<Fault>(answer.at("fault").get<int>()),
                        detail);
}

nlohmann::json recipes_packet(const std::string& name, const std::vector<HaltRecipe>& recipes) {
  nlohmann::json list = nlohmann::json::array();
  for (const HaltRecipe& recipe : recipes) list.push_back(to_json(recipe));
  return {{"kind", to_guard::kRecipes}, {"name", name}, {"recipes", std::move(list)}};
}

}  // namespace

std::filesystem::path guard_folder() {
  if (const char* folder = std::getenv("XDG_RUNTIME_DIR"); folder != nullptr && *folder != '\0')
    return folder;
  std::filesystem::path folder = temporary_place() / fmt::format("abcal-{}", ::geteuid());
  ::mkdir(folder.c_str(), 0700);
  struct stat status {};
  // Another user may have made it, to listen in.
  if (::lstat(folder.c_str(), &status) != 0 || !S_ISDIR(status.st_mode) || status.st_uid != ::geteuid() ||
      (status.st_mode & 077) != 0)
    return {};
  return folder;
}

std::vector<nlohmann::json> ask_guards(pid_t owner, const nlohmann::json& question,
                                       std::chrono::milliseconds longest) {
  std::vector<nlohmann::json> answers;
  const std::filesystem::path folder = guard_folder();
  std::error_code error;
  const std::string begin = fmt::format("abcal-guard-{}-", owner);
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    if (!entry.path().filename().string().starts_with(begin)) continue;
    try {
      const Descriptor socket = connect_to(entry.path(), ChannelKind::kPackets);
      if (!send_guard_packet(socket.number(), question) || !wait_until_readable(socket.number(), longest))
        continue;
      if (const auto packet = receive_guard_packet(socket.number())) answers.push_back(packet->json);
    } catch (const std::system_error&) {          // Its guard has ended.
    } catch (const nlohmann::json::exception&) {  // Not a guard's answer.
    }
  }
  return answers;
}

HaltGuard::HaltGuard(const std::string& who, std::string bench)
    : bench_(std::move(bench)),
      owner_(fmt::format("{} {} (process {})", who, bench_, ::getpid())),
      halt_first_([this] {
        if (may_move()) (void)halt("the program is suspended (Ctrl-Z)");
      }) {}

HaltGuard::~HaltGuard() {
  end();
}

pid_t HaltGuard::process() const {
  const std::lock_guard lock(mutex_);
  return process_;
}

std::string HaltGuard::last_incident() const {
  const std::lock_guard lock(mutex_);
  return incident_;
}

bool HaltGuard::may_move() const {
  const std::lock_guard lock(mutex_);
  return may_move_locked();
}

bool HaltGuard::is_alive() const {
  const std::lock_guard lock(mutex_);
  return alive_;
}

void HaltGuard::start() {
  watcher_ = {};  // It may be about to replace a guard that is gone.
  if (!is_alive()) {
    collect();
    const std::filesystem::path log = motion_log();
    const std::string incident = log.empty() ? "" : read_motion(log, bench_).incident;
    {
      const std::lock_guard lock(mutex_);
      incident_ = incident;
      halted_because_.clear();
    }
    launch();
  }
  const std::lock_guard lock(mutex_);
  is_watched_ = true;
  watcher_ = std::jthread([this](const std::stop_token& stop) { watch(stop); });
}

/// Starts a guard, which takes over the ports behind which an axis may be moving.
void HaltGuard::launch() {
  ConnectedProcess guard =
      start_connected(helper_program("abcal-guard", "halting a stage whose program has died needs"));
  prefer_as_victim();
  // Several guards may belong to one program, one after the other.
  static std::atomic<int> started = 0;
  const std::filesystem::path folder = guard_folder();
  const std::string path =
      folder.empty() ? "" : (folder / fmt::format("abcal-guard-{}-{}", ::getpid(), ++started)).string();
  const Json introduction = {{"kind", to_guard::kOwner},
                             {"words", owner_},
                             {"bench", bench_},
                             {"log", motion_log().string()},
                             {"listen", path}};
  const std::lock_guard lock(mutex_);
  process_ = guard.process;
  socket_ = std::move(guard.socket);
  pidfd_ = Descriptor(static_cast<int>(::syscall(SYS_pidfd_open, guard.process, 0)));
  launched_ = clock_.now();
  heard_ = launched_ + kAnswerTime;  // It starts, which may take that long on a busy machine.
  guard_ends_ = false;
  alive_ = send_guard_packet(socket_.number(), introduction);
  for (const auto& [name, port] : ports_) {
    const std::vector<HaltRecipe>& recipes = recipes_[name];
    if (std::ranges::none_of(recipes, [this](const HaltRecipe& recipe) {
          return (recipe.axes[0] && beat_.may_move[0]) || (recipe.axes[1] && beat_.may_move[1]);
        }))
      continue;
    Json take_over = to_json(port.request);
    take_over["kind"] = to_guard::kTakeOver;
    alive_ = alive_ && send_guard_packet(socket_.number(), recipes_packet(name, recipes)) &&
             send_guard_packet(socket_.number(), take_over) &&
             send_guard_packet(socket_.number(), to_json(LeaseRequest{name, port.leases, owner_}));
  }
  if (has_ended_) alive_ = alive_ && send_guard_packet(socket_.number(), {{"kind", to_guard::kEnd}});
  if (!alive_) throw std::runtime_error("the guard does not answer");
}

/// Starts another guard in place of one that is gone if an axis is not confirmed at rest.
/// @return whether there is one now
bool HaltGuard::replace() {
  {
    const std::lock_guard lock(mutex_);
    if (guard_ends_ || !may_move_locked()) return false;
  }
  collect();
  clock_.sleep_until(launched_ + kBetweenGuards);
  try {
    launch();
    print_error(fmt::format("stage: another guard (process {}) goes on with the halt", process()));
    return true;
  } catch (const std::exception& error) {
    print_error(fmt::format("stage: {}; stop it by its own switch", error.what()));
    return false;
  }
}

void HaltGuard::end() {
  {
    const std::lock_guard lock(mutex_);
    has_ended_ = true;
    if (alive_) (void)send_guard_packet(socket_.number(), {{"kind", to_guard::kEnd}});
  }
  wait_for_rest();
  watcher_ = {};
  collect();
}

/// Waits for the end of a guard that has nothing to do or is gone: whoever is next finds its ports free.
void HaltGuard::collect() {
  if (socket_.number() < 0) return;
  if (pidfd_.number() < 0 || wait_until_readable(pidfd_.number(), kAnswerTime))
    ::waitpid(process_, nullptr, 0);
  const std::lock_guard lock(mutex_);
  alive_ = false;
  socket_.close();
  pidfd_.close();
  process_ = -1;
  duplicates_.clear();            // They would keep the ports locked.
  if (may_move_locked()) return;  // Another guard needs what follows.
  beat_ = {};
  recipes_.clear();
  ports_.clear();
}

/// Waits until the guard has nothing to do any more, and says what it waits for.
void HaltGuard::wait_for_rest() {
  const Clock::Instant begun = clock_.now();
  int told = -1;  // The number of signals when it was said last.
  std::unique_lock lock(mutex_);
  while (!changed_.wait_for(lock, kLook, [this] { return guard_ends_ || !is_watched_; })) {
    const Clock::Duration waited = clock_.now() - begun;
    if (!may_move_locked() && waited > kAnswerTime) return;  // It hangs, with nothing left to halt.
    if (!may_move_locked() || waited < kQuietWait || told == interrupt_signals()) continue;
    told = interrupt_signals();
    print_error(
        fmt::format("{}. {} waits until abcal-guard (process {}) has halted it, for ten minutes at "
                    "most; stop it by its own switch",
                    unconfirmed_locked(), owner_, process_));
  }
  if (told < 0 && !is_given_up_) return;
  print_error(is_given_up_ || may_move_locked() ? unconfirmed_locked() + ". Nobody tries to halt it any more"
                                                : "stage: all axes are at rest");
}

/// The axes that are not confirmed at rest, and since when, in words.
std::string HaltGuard::unconfirmed_locked() const {
  std::string words;
  for (const auto& [name, report] : unconfirmed_) words += (words.empty() ? "" : "; ") + report;
  return words.empty() ? "stage: " + in_words(HaltReport{}) : words;
}

std::unique_ptr<wire::ByteStream> HaltGuard::open(const std::string& name, const std::string& port,
                                                  const wire::SerialSettings& settings) {
  const std::lock_guard starting(start_mutex_);
  if (!is_alive()) start();
  {
    const std::lock_guard lock(mutex_);
    duplicates_.erase(name);  // It would keep the port locked.
    halted_because_.clear();
  }
  auto answer = answer_to(name, to_json(PortRequest{name, port, settings, owner_}), kOpenTime);
  if (!answer) throw InstrumentError(port, Fault::kCannotOpen, "its guard does not answer");
  if (answer->json.value("kind", "") != to_owner::kOpened) throw_failure(answer->json, port);
  {
    const std::lock_guard lock(mutex_);
    ports_[name].request = {name, answer->json.at("again").get<std::string>(), settings, owner_};
    if (answer->descriptors.size() > 1) duplicates_[name] = std::move(answer->descriptors[1]);
  }
  return std::make_unique<wire::SocketStream>(answer->descriptors.at(0).release(),
                                              answer->json.at("port").get<std::string>(), clock_);
}

void HaltGuard::lease(const std::string& name, std::vector<std::string> resources) {
  if (resources.empty()) return;
  const std::lock_guard starting(start_mutex_);
  const auto answer = answer_to(name, to_json(LeaseRequest{name, resources, owner_}), kAnswerTime);
  if (!answer || answer->json.empty()) throw InstrumentError(name, Fault::kLinkLost, kGone);
  if (answer->json.value("kind", "") != to_owner::kLeased)
    throw_failure(answer->json, answer->json.value("instrument", name));
  const std::lock_guard lock(mutex_);
  ports_[name].leases = std::move(resources);
}

/// Asks the guard about a port. An answer without members: the guard has ended.
/// @return nullopt if it does not answer in time
std::optional<GuardPacket> HaltGuard::answer_to(const std::string& name, const Json& question,
                                                std::chrono::seconds longest) {
  const auto promise = std::make_shared<std::promise<GuardPacket>>();
  std::future<GuardPacket> answered = promise->get_future();
  {
    const std::lock_guard lock(mutex_);
    if (!alive_ || !send_guard_packet(socket_.number(), question)) return GuardPacket{};
    asked_[name] = promise;
  }
  if (answered.wait_for(longest) != std::future_status::ready) return std::nullopt;
  return answered.get();
}

void HaltGuard::hold(const std::string& name, std::vector<HaltRecipe> recipes) {
  const Json packet = recipes_packet(name, recipes);
  std::unique_lock lock(mutex_);
  recipes_[name] = std::move(recipes);
  const int before = recipes_taken_;
  const bool is_sent = alive_ && send_guard_packet(socket_.number(), packet);
  if (!is_sent || !changed_.wait_for(lock, kAnswerTime, [&] { return recipes_taken_ > before || !alive_; }) ||
      !alive_)
    throw InstrumentError(name, Fault::kLinkLost, fmt::format("{}; without a guard nothing moves", kGone));
}

void HaltGuard::begin_motion(StageAxis axis) {
  const std::lock_guard lock(mutex_);
  if (!halted_because_.empty()) throw InstrumentError("stage", Fault::kStalled, halted_because_);
  if (!alive_)
    throw InstrumentError("stage", Fault::kLinkLost, fmt::format("{}; without a guard nothing moves", kGone));
  moving_thread_ = std::this_thread::get_id();
  beat_.may_move[index(axis)] = true;
  if (!send_beat_locked("the command to move"))
    throw InstrumentError("stage", Fault::kLinkLost,
                          "its guard does not take beats; without one nothing moves");
}

void HaltGuard::end_motion(StageAxis axis) {
  const std::lock_guard lock(mutex_);
  if (!std::exchange(beat_.may_move[index(axis)], false)) return;
  (void)send_beat_locked("");
}

void HaltGuard::drive_chamber() {
  const std::lock_guard lock(mutex_);
  moving_thread_ = std::this_thread::get_id();
  beat_.chamber = true;
  (void)send_beat_locked("");
}

void HaltGuard::beat(std::string_view awaits) noexcept {
  try {
    const std::lock_guard lock(mutex_);
    if (!alive_ || moving_thread_ != std::this_thread::get_id()) return;
    if (clock_.now() - beat_sent_ < kBeatInterval) return;
    (void)send_beat_locked(awaits);
  } catch (const std::exception&) {  // Memory is short: the guard halts if this continues.
  }
}

bool HaltGuard::send_beat_locked(std::string_view awaits) {
  beat_.awaits = awaits;
  beat_sent_ = clock_.now();
  return alive_ && send_guard_packet(socket_.number(), to_json(beat_));
}

HaltReport HaltGuard::halt(const std::string& why) noexcept {
  try {
    HaltReport report;
    std::unique_lock lock(mutex_);
    Clock::Duration longest{};
    std::array<bool, 2> wanted{};
    for (const auto& [name, recipes] : recipes_) {
      for (const HaltRecipe& recipe : recipes) {
        longest = std::max(longest, wire::longest_halt(recipe) + kAnswerMargin);
        for (std::size_t k = 0; k < 2; ++k) wanted[k] = wanted[k] || recipe.axes[k];
      }
    }
    confirmed_ = {};
    const bool is_asked =
        alive_ && send_guard_packet(socket_.number(), {{"kind", to_guard::kHalt}, {"why", why}});
    const auto is_answered = [&] {
      return !alive_ || ((!wanted[0] || confirmed_[0]) && (!wanted[1] || confirmed_[1]));
    };
    if (is_asked) (void)changed_.wait_for(lock, longest, is_answered);
    if (!alive_) {
      lock.unlock();
      return halt_by_duplicates();
    }
    for (std::size_t k = 0; k < 2; ++k) {
      if (!confirmed_[k].value_or(false)) continue;
      report.axes[k] = AxisHalt::kHalted;
      beat_.may_move[k] = false;
    }
    return report;
  } catch (const std::exception&) {
    return {};
  }
}

/// In place of a guard that is dead or hangs.
HaltReport HaltGuard::halt_by_duplicates() {
  // One at a time: two readers of a port would take each other's replies. Who has waited has the same result.
  const Clock::Instant asked = clock_.now();
  const std::lock_guard alone(duplicates_mutex_);
  if (halted_by_duplicates_at_ && *halted_by_duplicates_at_ >= asked) return last_halt_by_duplicates_;
  std::map<std::string, Descriptor> descriptors;
  std::map<std::string, std::vector<HaltRecipe>> recipes;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [name, descriptor] : duplicates_)
      descriptors[name] = Descriptor(::dup(descriptor.number()));
    recipes = recipes_;
  }
  HaltReport report;
  for (const auto& [name, descriptor] : descriptors) {
    wire::DescriptorStream stream(descriptor.number(), name, clock_);
    for (const HaltRecipe& recipe : recipes[name]) {
      if (!recipe.chamber.empty()) continue;
      const Clock::Instant deadline = clock_.now() + wire::longest_halt(recipe);
      if (!wire::carry_out(recipe, stream, clock_, deadline)) continue;
      for (std::size_t k = 0; k < 2; ++k)
        if (recipe.axes[k]) report.axes[k] = AxisHalt::kHalted;
    }
  }
  const std::lock_guard lock(mutex_);
  for (std::size_t k = 0; k < 2; ++k)
    if (report.axes[k] == AxisHalt::kHalted) beat_.may_move[k] = false;
  halted_by_duplicates_at_ = clock_.now();
  last_halt_by_duplicates_ = report;
  return report;
}

std::string HaltGuard::halted_because(Clock::Duration longest_wait) const {
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, longest_wait, [this] { return !halted_because_.empty(); });
  return halted_because_;
}

// ---- Watching the guard

void HaltGuard::watch(const std::stop_token& stop) {
  constexpr int kTickMs = 50;
  Clock::Instant last_tick = clock_.now();
  while (!stop.stop_requested()) {
    // This program itself was suspended; so may the guard have been, which therefore has its whole time from
    // now on.
    const Clock::Instant tick = clock_.now();
    if (tick - std::exchange(last_tick, tick) > kSilent / 2) {
      const std::lock_guard lock(mutex_);
      heard_ = tick;
    }
    std::array<pollfd, 2> waiting{pollfd{.fd = socket_.number(), .events = POLLIN, .revents = 0},
                                  pollfd{.fd = pidfd_.number(), .events = POLLIN, .revents = 0}};
    ::poll(waiting.data(), waiting.size(), kTickMs);
    if ((waiting[0].revents & POLLIN) != 0) {
      try {
        if (auto packet = receive_guard_packet(socket_.number())) {
          receive(*std::move(packet));
          continue;  // All received packets count before its silence does.
        }
      } catch (const Json::exception& error) {
        print_warning(fmt::format("guard: malformed packet ignored: {}", error.what()));
        continue;
      }
    }
    const bool is_dead = waiting[0].revents != 0 || waiting[1].revents != 0;
    bool is_silent = false, moves = false;
    {
      const std::lock_guard lock(mutex_);
      moves = may_move_locked();
      is_silent = moves && clock_.now() - heard_ > kSilent;
    }
    if (!is_dead && !is_silent) continue;
    // On a busy machine this thread may have been suspended since poll(): a packet that arrived meanwhile
    // counts first.
    if (!is_dead && wait_until_readable(socket_.number(), 0ms)) continue;
    note_silence(is_dead ? "the guard of the stage has died" : "the guard of the stage does not answer");
    if (!replace()) break;
    last_tick = clock_.now();
  }
  {
    const std::lock_guard lock(mutex_);
    is_watched_ = false;
  }
  changed_.notify_all();
}

void HaltGuard::note_silence(const std::string& why) {
  bool moves = false;
  {
    const std::lock_guard lock(mutex_);
    alive_ = false;
    moves = may_move_locked() && !guard_ends_;
    if (moves && halted_because_.empty())
      halted_because_ = why + " while an axis was moving; this program halts the axes itself";
    for (const auto& [name, opening] : std::exchange(asked_, {})) opening->set_value({});
  }
  changed_.notify_all();
  // One that hangs must not write to the ports again: from here on this program does.
  ::kill(process_, SIGKILL);
  if (!moves) return;
  const HaltReport report = halt_by_duplicates();
  print_error(fmt::format("stage: {}: {}", why, in_words(report)));
}

void HaltGuard::receive(GuardPacket packet) {
  const std::string kind = packet.json.value("kind", "");
  {
    const std::lock_guard lock(mutex_);
    heard_ = clock_.now();
    if (kind == to_owner::kOpened || kind == to_owner::kLeased || kind == to_owner::kFailed) {
      const auto found = asked_.find(packet.json.value("name", ""));
      if (found != asked_.end()) {
        found->second->set_value(std::move(packet));
        asked_.erase(found);
      }
    } else if (kind == to_owner::kTaken) {
      ++recipes_taken_;
    } else if (kind == to_owner::kHalting) {
      halted_because_ = "the guard halted the stage: " + packet.json.value("why", "");
    } else if (kind == to_owner::kHalted) {
      const bool is_confirmed = packet.json.value("confirmed", false);
      for (const StageAxis axis : kStageAxes)
        if (packet.json.value(axis == StageAxis::kX ? "x" : "z", false)) {
          confirmed_[index(axis)] = is_confirmed;
          if (is_confirmed) beat_.may_move[index(axis)] = false;
        }
      if (is_confirmed)
        unconfirmed_.erase(packet.json.value("name", ""));
      else
        unconfirmed_[packet.json.value("name", "")] = packet.json.value("words", "");
    } else if (kind == to_owner::kEnds) {
      guard_ends_ = true;
      is_given_up_ = packet.json.value("given_up", false);
    }
  }
  changed_.notify_all();
}

}  // namespace abcal
