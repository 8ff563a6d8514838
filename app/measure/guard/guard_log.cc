#include "app/measure/guard/guard_log.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <fstream>
#include <utility>

#include "app/document/json_text.h"
#include "app/system/state_folder.h"
#include "drivers/instrument/rotation_stage.h"
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

/// Follows the entries of one bench from the oldest to the newest.
class MotionReader {
 public:
  explicit MotionReader(std::string_view bench) : bench_(bench) {}

  void add(const Json& entry) {
    // Half a line: the computer lost its supply.
    if (!entry.is_object() || text_of(entry, "owner").find(bench_) == std::string::npos) return;
    const std::string what = text_of(entry, "what");
    for (const StageAxis axis : kStageAxes) {
      const auto axes = entry.find("axes");
      if (axes != entry.end() && std::ranges::find(*axes, Json(to_string(axis))) != axes->end())
        note_axis(axis, what, entry);
    }
    if (what == GuardLog::kBegan) {
      began_ = entry;
      reason_.clear();
      outcome_.clear();
      open_ = true;
    } else if (began_.is_object() && guard_of(entry) == guard_of(began_)) {
      note_session(what, entry);
    }
  }

  MotionRecord record() {
    for (std::size_t k = 0; k < 2; ++k)
      if (!axes_[k].is_at_rest() && !is_running_guard(guards_[k])) axes_[k].state = axis_state::kUnknown;
    return {axes_, incident()};
  }

 private:
  static std::string text_of(const Json& entry, const char* member) {
    const auto found = entry.find(member);
    return found != entry.end() && found->is_string() ? found->get<std::string>() : std::string();
  }
  static pid_t guard_of(const Json& entry) {
    const auto found = entry.find("guard");
    return found != entry.end() && found->is_number_integer() ? found->get<pid_t>() : 0;
  }

  void note_axis(StageAxis axis, std::string_view what, const Json& entry) {
    AxisReport& known = axes_[index(axis)];
    const std::string utc = text_of(entry, "utc");
    guards_[index(axis)] = guard_of(entry);
    if (what == GuardLog::kMoves)
      known = {axis_state::kMayMove, utc, {}};
    else if (what == GuardLog::kAtRest || what == GuardLog::kHalted)
      known = {axis_state::kAtRest, utc, {}};
    else if (what == GuardLog::kNotHalted)
      known = {axis_state::kUnreachable, utc, text_of(entry, "text")};
  }

  /// The first reason and the last result are enough for a person.
  void note_session(std::string_view what, const Json& entry) {
    const std::string text = fmt::format("{}: {}", text_of(entry, "utc"), text_of(entry, "text"));
    if (what == GuardLog::kEnded) {
      reason_.clear();
      outcome_.clear();
      open_ = false;
    } else if (what == GuardLog::kHalted || what == GuardLog::kNotHalted) {
      outcome_ = text;
    } else if ((what == GuardLog::kDied || what == GuardLog::kHalting) && reason_.empty()) {
      reason_ = text;
    }
  }

  std::string incident() const {
    std::string reason = reason_;
    if (reason_.empty() && outcome_.empty()) {
      // Program and guard were killed together, or the computer stopped. A bench that was at rest needs no
      // words.
      if (!open_) return {};
      for (const StageAxis axis : kStageAxes) {
        const AxisReport& known = axes_[index(axis)];
        if (known.state != axis_state::kUnknown || guards_[index(axis)] != guard_of(began_)) continue;
        reason +=
            fmt::format("{}; axis {} was moving since {}",
                        reason.empty() ? "Nobody is left who saw its end" : "", to_string(axis), known.since);
      }
      if (reason.empty()) return {};
    }
    return fmt::format("{} did not end in order. {}{}{}", text_of(began_, "owner"), reason,
                       reason.empty() || outcome_.empty() ? "" : "; ", outcome_);
  }

  const std::string bench_;
  Json began_;
  std::string reason_, outcome_;
  bool open_ = false;  ///< The last entry of the session is not that of its end.
  AxesReport axes_;
  std::array<pid_t, 2> guards_{};  ///< That wrote the latest entry on an axis.
};

}  // namespace

std::filesystem::path motion_log() {
  const std::filesystem::path folder = state_folder();
  return folder.empty() ? folder : folder / "motion.log";
}

MotionRecord read_motion(const std::filesystem::path& file, std::string_view bench) {
  MotionReader reader(bench);
  for (const std::string& part : {file.string() + ".1", file.string()}) {
    std::ifstream stream(part);
    for (std::string line; std::getline(stream, line);)
      reader.add(Json::parse(line, nullptr, /*allow_exceptions=*/false));
  }
  return reader.record();
}

}  // namespace abcal
