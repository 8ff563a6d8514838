#include "app/measure/guard/halt_guard.h"

#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <utility>

#include "app/measure/guard/guard_log.h"
#include "app/system/detached_process.h"
#include "app/system/helper_program.h"
#include "app/system/output.h"
#include "app/system/state_folder.h"
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

}  // namespace

std::filesystem::path guard_folder() {
  if (const char* folder = std::getenv("XDG_RUNTIME_DIR"); folder != nullptr && *folder != '\0')
    return folder;
  std::filesystem::path folder =
      std::filesystem::temp_directory_path() / fmt::format("abcal-{}", ::geteuid());
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
    const std::string path = entry.path().string();
    sockaddr_un address{};
    if (!entry.path().filename().string().starts_with(begin) || path.size() >= sizeof address.sun_path)
      continue;
    address.sun_family = AF_UNIX;
    std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
    const int socket = ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    pollfd answer{.fd = socket, .events = POLLIN, .revents = 0};
    if (::connect(socket, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0 &&
        send_guard_packet(socket, question) && ::poll(&answer, 1, static_cast<int>(longest.count())) == 1) {
      try {
        if (const auto packet = receive_guard_packet(socket)) answers.push_back(packet->json);
      } catch (const nlohmann::json::exception&) {  // Not a guard's answer.
      }
    }
    ::close(socket);
  }
  return answers;
}

HaltGuard::HaltGuard(const std::string& who, const std::string& bench)
    : has_name_(!bench.empty()),
      bench_(bench.empty() ? "on a bench without a name" : fmt::format("on the bench \"{}\"", bench)),
      owner_(fmt::format("{} {} (process {})", who, bench_, ::getpid())) {}

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
  return beat_.may_move[0] || beat_.may_move[1];
}

bool HaltGuard::is_alive() const {
  const std::lock_guard lock(mutex_);
  return alive_;
}

void HaltGuard::start() {
  end();
  const ConnectedProcess guard =
      start_connected(helper_program("abcal-guard", "halting a stage whose program has died needs"));
  {
    const std::lock_guard lock(mutex_);
    process_ = guard.process;
    socket_ = guard.socket;
    pidfd_ = static_cast<int>(::syscall(SYS_pidfd_open, guard.process, 0));
    alive_ = true;
    heard_ = clock_.now();
    beat_ = {};
    halted_because_.clear();
  }
  prefer_as_victim();
  const std::filesystem::path folder = guard_folder(), log = state_folder();
  if (!log.empty() && has_name_) {
    const std::string incident = abcal::last_incident(log / "motion.log", bench_).value_or("");
    const std::lock_guard lock(mutex_);
    incident_ = incident;
  }
  // Several guards may belong to one program, one after the other.
  static std::atomic<int> started = 0;
  const std::string path =
      folder.empty() ? "" : (folder / fmt::format("abcal-guard-{}-{}", ::getpid(), ++started)).string();
  const Json introduction = {{"kind", to_guard::kOwner},
                             {"words", owner_},
                             {"log", log.empty() ? "" : (log / "motion.log").string()},
                             {"listen", path}};
  if (!send_guard_packet(socket_, introduction)) throw std::runtime_error("the guard does not answer");
  watcher_ = std::jthread([this](const std::stop_token& stop) { watch(stop); });
}

void HaltGuard::end() {
  pid_t process = -1;
  {
    const std::lock_guard lock(mutex_);
    if (socket_ < 0) return;
    if (alive_) (void)send_guard_packet(socket_, {{"kind", to_guard::kEnd}});
    process = process_;
  }
  // The next owner finds the ports free: the guard's end is waited for, unless it still halts.
  pollfd ended{.fd = pidfd_, .events = POLLIN, .revents = 0};
  const bool has_ended = pidfd_ < 0 || ::poll(&ended, 1, std::chrono::milliseconds(kAnswerTime).count()) == 1;
  watcher_ = {};
  const std::lock_guard lock(mutex_);
  alive_ = false;
  ::close(std::exchange(socket_, -1));
  if (pidfd_ >= 0) ::close(std::exchange(pidfd_, -1));
  if (has_ended) ::waitpid(process, nullptr, 0);
  process_ = -1;
  for (const auto& [name, descriptor] : std::exchange(duplicates_, {})) ::close(descriptor);
  recipes_.clear();
}

std::unique_ptr<wire::ByteStream> HaltGuard::open(const std::string& name, const std::string& port,
                                                  const wire::SerialSettings& settings) {
  const std::lock_guard starting(start_mutex_);
  if (!is_alive()) start();
  {
    const std::lock_guard lock(mutex_);
    if (const auto old = duplicates_.find(name); old != duplicates_.end()) {
      ::close(old->second);  // It would keep the port locked.
      duplicates_.erase(old);
    }
    halted_because_.clear();
  }
  const auto answer = answer_to(name, to_json(PortRequest{name, port, settings, owner_}), kOpenTime);
  if (!answer) throw InstrumentError(port, Fault::kCannotOpen, "its guard does not answer");
  if (answer->json.value("kind", "") != to_owner::kOpened) throw_failure(answer->json, port);
  if (answer->descriptors.size() > 1) {
    const std::lock_guard lock(mutex_);
    duplicates_[name] = answer->descriptors[1];
  }
  return std::make_unique<wire::SocketStream>(answer->descriptors.at(0),
                                              answer->json.at("port").get<std::string>(), clock_);
}

void HaltGuard::lease(const std::string& name, std::vector<std::string> resources) {
  if (resources.empty()) return;
  const std::lock_guard starting(start_mutex_);
  const auto answer = answer_to(name, to_json(LeaseRequest{name, std::move(resources), owner_}), kAnswerTime);
  if (!answer || answer->json.empty()) throw InstrumentError(name, Fault::kLinkLost, kGone);
  if (answer->json.value("kind", "") != to_owner::kLeased)
    throw_failure(answer->json, answer->json.value("instrument", name));
}

/// Asks the guard about a port. An answer without members: the guard has ended.
/// @return nullopt if it does not answer in time
std::optional<GuardPacket> HaltGuard::answer_to(const std::string& name, const Json& question,
                                                std::chrono::seconds longest) {
  const auto promise = std::make_shared<std::promise<GuardPacket>>();
  std::future<GuardPacket> answered = promise->get_future();
  {
    const std::lock_guard lock(mutex_);
    if (!alive_ || !send_guard_packet(socket_, question)) return GuardPacket{};
    asked_[name] = promise;
  }
  if (answered.wait_for(longest) != std::future_status::ready) return std::nullopt;
  return answered.get();
}

void HaltGuard::hold(const std::string& name, std::vector<HaltRecipe> recipes) {
  Json list = Json::array();
  for (const HaltRecipe& recipe : recipes) list.push_back(to_json(recipe));
  std::unique_lock lock(mutex_);
  recipes_[name] = std::move(recipes);
  const int before = recipes_taken_;
  const bool is_sent =
      alive_ && send_guard_packet(
                    socket_, {{"kind", to_guard::kRecipes}, {"name", name}, {"recipes", std::move(list)}});
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
  return alive_ && send_guard_packet(socket_, to_json(beat_));
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
    const bool is_asked = alive_ && send_guard_packet(socket_, {{"kind", to_guard::kHalt}, {"why", why}});
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
  std::map<std::string, int> descriptors;
  std::map<std::string, std::vector<HaltRecipe>> recipes;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [name, descriptor] : duplicates_) descriptors[name] = ::dup(descriptor);
    recipes = recipes_;
  }
  HaltReport report;
  for (const auto& [name, descriptor] : descriptors) {
    wire::DescriptorStream stream(descriptor, name, clock_);
    for (const HaltRecipe& recipe : recipes[name]) {
      if (!recipe.chamber.empty()) continue;
      const Clock::Instant deadline = clock_.now() + wire::longest_halt(recipe);
      if (!wire::carry_out(recipe, stream, clock_, deadline)) continue;
      for (std::size_t k = 0; k < 2; ++k)
        if (recipe.axes[k]) report.axes[k] = AxisHalt::kHalted;
    }
    ::close(descriptor);
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
    std::array<pollfd, 2> waiting{pollfd{.fd = socket_, .events = POLLIN, .revents = 0},
                                  pollfd{.fd = pidfd_, .events = POLLIN, .revents = 0}};
    ::poll(waiting.data(), waiting.size(), kTickMs);
    if ((waiting[0].revents & POLLIN) != 0) {
      try {
        if (auto packet = receive_guard_packet(socket_)) {
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
      moves = beat_.may_move[0] || beat_.may_move[1];
      is_silent = moves && clock_.now() - heard_ > kSilent;
    }
    if (!is_dead && !is_silent) continue;
    // On a busy machine this thread may have been suspended since poll(): a packet that arrived meanwhile
    // counts first.
    if (!is_dead && ::poll(waiting.data(), 1, 0) == 1) continue;
    note_silence(is_dead ? "the guard of the stage has died" : "the guard of the stage does not answer");
    return;
  }
}

void HaltGuard::note_silence(const std::string& why) {
  bool moves = false;
  {
    const std::lock_guard lock(mutex_);
    alive_ = false;
    moves = (beat_.may_move[0] || beat_.may_move[1]) && halted_because_.empty();
    if (moves) halted_because_ = why + " while an axis was moving; this program halts the axes itself";
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
        if (packet.json.value(axis == StageAxis::kX ? "x" : "z", false))
          confirmed_[index(axis)] = is_confirmed;
    }
  }
  changed_.notify_all();
}

}  // namespace abcal
