#include "app/measure/guard/guard_log.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cstdint>
#include <fstream>
#include <map>
#include <utility>

#include "app/document/json_text.h"
#include "protocol/record/run_file.h"

namespace abcal {
namespace {

using Json = nlohmann::json;

constexpr std::uintmax_t kLongestLog = std::uintmax_t{4} * 1024 * 1024;

void append(const std::filesystem::path& file, const std::string& text) {
  std::error_code ignored;
  std::filesystem::create_directories(file.parent_path(), ignored);
  if (std::filesystem::file_size(file, ignored) > kLongestLog && !ignored)
    std::filesystem::rename(file, file.string() + ".1", ignored);
  const int descriptor = ::open(file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
  if (descriptor < 0) return;  // A log that cannot be written must not keep a stage from being halted.
  // One write a batch: several guards append to the same file.
  (void)!::write(descriptor, text.data(), text.size());
  ::close(descriptor);
}

void synchronise(const std::filesystem::path& file) {
  const int descriptor = ::open(file.c_str(), O_WRONLY | O_CLOEXEC);
  if (descriptor < 0) return;
  ::fdatasync(descriptor);
  ::close(descriptor);
}

}  // namespace

GuardLog::~GuardLog() = default;

void GuardLog::open(std::filesystem::path file) {
  const std::lock_guard lock(mutex_);
  file_ = std::move(file);
  if (writer_.joinable()) return;
  syncer_ = std::jthread([this](const std::stop_token& end) { sync(end); });
  writer_ = std::jthread([this](const std::stop_token& end) { write(end); });
}

void GuardLog::add(std::string_view what, Clock::UtcTime utc, Json json) {
  json["what"] = what;
  json["utc"] = format_utc(utc);
  json["guard"] = ::getpid();
  {
    const std::lock_guard lock(mutex_);
    lines_.push_back(json_text(json) + "\n");
  }
  changed_.notify_all();
}

void GuardLog::write(const std::stop_token& end) {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, end, [this] { return !lines_.empty(); });
    if (lines_.empty()) return;  // The end, and all is written.
    std::string text;
    for (const std::string& line : std::exchange(lines_, {})) text += line;
    const std::filesystem::path file = file_;
    lock.unlock();
    append(file, text);
    lock.lock();
    is_unsynced_ = true;
    changed_.notify_all();
  }
}

void GuardLog::sync(const std::stop_token& end) {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, end, [this] { return is_unsynced_; });
    if (!std::exchange(is_unsynced_, false)) return;
    const std::filesystem::path file = file_;
    lock.unlock();
    synchronise(file);
    lock.lock();
  }
}

namespace {

bool is_running_guard(pid_t process) {
  std::ifstream file(fmt::format("/proc/{}/stat", process));
  std::string text;
  std::getline(file, text);
  const std::size_t end = text.find("(abcal-guard) ");
  constexpr std::size_t kState = 14;  // After the name. Z: ended, with its exit code not yet collected.
  return end != std::string::npos && text.size() > end + kState && text[end + kState] != 'Z';
}

}  // namespace

std::optional<std::string> last_incident(const std::filesystem::path& file, std::string_view owner) {
  std::ifstream stream(file);
  std::string line, reason, outcome;  // The first reason and the last result are enough for a person.
  Json began;
  std::map<std::string, std::string>
      moving;         // Axes that were not confirmed at rest, and since when they move.
  bool open = false;  // Its last entry is not that of its end.
  const auto forget = [&] {
    reason.clear();
    outcome.clear();
    moving.clear();
  };
  while (std::getline(stream, line)) {
    const Json entry = Json::parse(line, nullptr, /*allow_exceptions=*/false);
    if (!entry.is_object()) continue;  // Half a line: the computer lost its supply.
    const std::string what = entry.value("what", "");
    if (what == GuardLog::kBegan) {
      if (entry.value("owner", "").find(owner) == std::string::npos) continue;
      began = entry;
      forget();
      open = true;
      continue;
    }
    if (!began.is_object() || entry.value("guard", 0) != began.value("guard", 0)) continue;
    const std::string text = fmt::format("{}: {}", entry.value("utc", ""), entry.value("text", ""));
    if (what == GuardLog::kEnded) {
      forget();
      open = false;
    } else if (what == GuardLog::kMoves) {
      moving[entry.value("axis", "")] = entry.value("utc", "");
    } else if (what == GuardLog::kAtRest) {
      moving.erase(entry.value("axis", ""));
    } else if (what == GuardLog::kHalted || what == GuardLog::kNotHalted) {
      outcome = text;
    } else if ((what == GuardLog::kDied || what == GuardLog::kHalting) && reason.empty()) {
      reason = text;
    }
  }
  if (reason.empty() && outcome.empty()) {
    // Program and guard were killed together, or the computer stopped. A bench that was at rest needs no
    // words.
    if (!open || moving.empty() || is_running_guard(began.value("guard", 0))) return std::nullopt;
    reason = "Nobody is left who saw its end";
    for (const auto& [axis, since] : moving)
      reason += fmt::format("; axis {} was moving since {}", axis, since);
  }
  return fmt::format("{} did not end in order. {}{}{}", began.value("owner", ""), reason,
                     reason.empty() || outcome.empty() ? "" : "; ", outcome);
}

}  // namespace abcal
