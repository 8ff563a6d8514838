#include "app/system/output.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <limits.h>
#include <poll.h>
#include <spdlog/logger.h>
#include <spdlog/sinks/base_sink.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <iostream>
#include <memory>
#include <mutex>
#include <utility>

#include "app/system/exit_code.h"
#include "app/system/last_signal.h"
#include "app/system/terminal.h"

namespace abcal {
namespace {

constexpr std::size_t kLongestMessage = 16'384;  // bytes
constexpr int kMostForLogReader = 300;  // ms; the guard of a stage halts a thread that is silent for 1 s.
constexpr int kBetweenLooks = 200;      // ms, between two checks for an interrupt.

/// The state of the streams. One lock for both, so that lines of several threads are not torn.
struct Streams {
  std::mutex mutex;
  bool log_is_stuck = false;  ///< Its reader did not read within its time.
  std::size_t messages_left_out = 0;
  std::function<void(std::string_view)> listener;
  int result_error = 0;  ///< errno of the first result that was lost; 0: none.
};

Streams& streams() {
  static Streams& instance = *new Streams;  // Never deleted: threads may write until the very end.
  return instance;
}

enum class Room { kThere, kNone, kUnknown };

/// Waits until a write would not block. kUnknown: the write itself reports the error.
Room wait_for_room(int descriptor, int patience_ms) {
  pollfd request{descriptor, POLLOUT, 0};
  const int ready = ::poll(&request, 1, patience_ms);
  if (ready == 0) return Room::kNone;
  return ready > 0 ? Room::kThere : Room::kUnknown;
}

/// @returns the number of bytes written; not all after an error (`error`: errno) or without room (`error`:
/// EAGAIN). `may_wait` is asked whenever no room became free in `patience_ms`.
template <class MayWait>
std::size_t write_bytes(int descriptor, std::string_view bytes, int patience_ms, MayWait may_wait,
                        int& error) {
  std::size_t done = 0;
  error = 0;
  while (done < bytes.size()) {
    if (wait_for_room(descriptor, patience_ms) == Room::kNone) {
      if (may_wait()) continue;
      error = EAGAIN;
      break;
    }
    // PIPE_BUF bytes fit into a pipe with room without waiting.
    const ssize_t count =
        ::write(descriptor, bytes.data() + done, std::min<std::size_t>(bytes.size() - done, PIPE_BUF));
    if (count >= 0) {
      done += static_cast<std::size_t>(count);
    } else if (errno != EINTR && errno != EAGAIN) {
      error = errno;
      break;
    }
  }
  return done;
}

void write_log(std::string_view bytes) noexcept {
  try {
    Streams& state = streams();
    const std::lock_guard lock(state.mutex);
    if (state.listener) {
      state.listener(bytes);
      return;
    }
    const auto write = [&](std::string_view text) {
      int error = 0;
      const int patience_ms = state.log_is_stuck ? 0 : kMostForLogReader;
      write_bytes(
          STDERR_FILENO, text, patience_ms, [] { return false; }, error);
      state.log_is_stuck = error == EAGAIN;
      return error == 0;
    };
    if (state.messages_left_out > 0 && wait_for_room(STDERR_FILENO, 0) == Room::kThere) {
      const std::size_t count = state.messages_left_out;
      if (write(fmt::format("\nwarning: {} messages are missing here: they could not be written\n", count)))
        state.messages_left_out = 0;
    }
    if (!write(bytes)) ++state.messages_left_out;
  } catch (...) {  // Out of memory, at most: these words are lost, the run is not.
  }
}

void note_lost_result(int error) noexcept {
  try {
    Streams& state = streams();
    const std::lock_guard lock(state.mutex);
    if (state.result_error == 0) state.result_error = error;
  } catch (...) {
  }
}

void write_result(std::string_view bytes) noexcept {
  int error = 0;
  write_bytes(
      STDOUT_FILENO, bytes, kBetweenLooks, [] { return last_interrupt_signal() == 0; }, error);
  if (error != 0) note_lost_result(error);
}

/// A code point, 0 bytes long where the text is not UTF-8.
struct Character {
  char32_t code = 0;
  std::size_t bytes = 0;
};

Character first_character(std::string_view text) {
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned lead = byte(0);
  if (lead < 0x80) return {lead, 1};
  const std::size_t size = lead >= 0xf0 ? 4 : lead >= 0xe0 ? 3 : 2;
  if (lead < 0xc2 || lead > 0xf4 || text.size() < size) return {};
  char32_t code = lead & (0xffU >> (size + 1));
  for (std::size_t i = 1; i < size; ++i) {
    if ((byte(i) & 0xc0U) != 0x80) return {};
    code = (code << 6) | (byte(i) & 0x3fU);
  }
  const bool too_long = (size == 3 && code < 0x800) || (size == 4 && code < 0x10000);
  const bool no_character = (code >= 0xd800 && code < 0xe000) || code > 0x10ffff;
  if (too_long || no_character) return {};
  return {code, size};
}

/// Characters that control a terminal: control characters (C0, DEL, C1), separators of lines and paragraphs,
/// marks, embeddings, overrides and isolates of the direction (Unicode UAX #9).
bool is_obeyed(char32_t code) {
  return (code < 0x20 && code != '\n' && code != '\t') || (code >= 0x7f && code < 0xa0) || code == 0x061c ||
         code == 0x200e || code == 0x200f || (code >= 0x2028 && code <= 0x202e) ||
         (code >= 0x2066 && code <= 0x2069);
}

/// The printable text for a stream, with emphasis as terminal sequences.
std::string text_for_stream(std::string_view text, std::FILE* stream) {
  std::string made;
  while (!text.empty()) {
    const std::size_t mark = text.find_first_of(kEmphasisMarks);
    made += printable_text(text.substr(0, mark));
    if (mark == std::string_view::npos) break;
    made += is_terminal(stream) ? terminal_sequence(text[mark]) : printable_text(text.substr(mark, 1));
    text.remove_prefix(mark + 1);
  }
  return made;
}

/// The end of the log: standard error, written so that no failure ends a run.
class StandardErrorSink final : public spdlog::sinks::base_sink<spdlog::details::null_mutex> {
 private:
  void sink_it_(const spdlog::details::log_msg& message) override {
    spdlog::memory_buf_t line;
    formatter_->format(message, line);
    const std::string_view text(line.data(), line.size());
    std::string kept = text_for_stream(shortened_text(text, kLongestMessage), stderr);
    if (kept.back() != '\n') kept += '\n';
    write_log(kept);
  }
  void flush_() override {}
};

/// spdlog catches exceptions of its sinks; its own message about them on standard error is suppressed.
spdlog::logger& logger() {
  static spdlog::logger instance = [] {
    spdlog::logger made("abcal", std::make_shared<StandardErrorSink>());
    made.set_pattern("%v");  // The first word of a line is its level.
    made.set_error_handler([](const std::string&) {});
    return made;
  }();
  return instance;
}

constexpr std::string_view kNoWords = "abcal: a message could not be formatted (out of memory?)\n";

}  // namespace

void reserve_standard_descriptors() noexcept {
  // Opened the wrong way round, so that using it fails as the closed one would.
  const auto reserve = [](int descriptor, int mode) {
    if (::fcntl(descriptor, F_GETFD) >= 0 || errno != EBADF) return;
    const int opened = ::open("/dev/null", mode);  // NOLINT(cppcoreguidelines-pro-type-vararg)
    if (opened < 0 || opened == descriptor) return;
    ::dup2(opened, descriptor);
    ::close(opened);
  };
  reserve(STDIN_FILENO, O_WRONLY);
  reserve(STDOUT_FILENO, O_RDONLY);
  reserve(STDERR_FILENO, O_RDONLY);
}

void vprint_log(fmt::string_view format, fmt::format_args arguments) noexcept {
  try {
    const std::string text = fmt::vformat(format, arguments);
    const bool ends_line = !text.empty() && text.back() == '\n';
    std::string kept = text_for_stream(shortened_text(text, kLongestMessage), stderr);
    if (ends_line && kept.back() != '\n') kept += '\n';
    write_log(kept);
  } catch (...) {
    write_log(kNoWords);
  }
}

void send_log_to(std::function<void(std::string_view)> listener) {
  Streams& state = streams();
  const std::lock_guard lock(state.mutex);
  state.listener = std::move(listener);
}

void print_warning(std::string_view text) noexcept {
  try {
    logger().warn("{} {}", emphasised(stderr, Emphasis::kWarning, "warning:"), text);
  } catch (...) {
    write_log(kNoWords);
  }
}

void print_error(std::string_view text) noexcept {
  try {
    logger().error("{} {}", emphasised(stderr, Emphasis::kBad, "abcal:"), text);
  } catch (...) {
    write_log(kNoWords);
  }
}

void vprint_result(fmt::string_view format, fmt::format_args arguments) noexcept {
  try {
    write_result(text_for_stream(fmt::vformat(format, arguments), stdout));
  } catch (...) {
    note_lost_result(ENOMEM);
  }
}

void silence_standard_error_stream() noexcept {
  std::cerr.setstate(std::ios::failbit);  // throws only where asked to
}

int finish_output(int exit_code) noexcept {
  const int error = streams().result_error;
  if (error == 0) return exit_code;
  print_log("abcal: the result could not be written to standard output, or not all of it: {}\n",
            error == EAGAIN ? "interrupted because the reading program did not read" : std::strerror(error));
  return exit_code == kExitDone ? static_cast<int>(kExitFailed) : exit_code;
}

void print_to_terminal(std::string_view text) noexcept {
  write_log(text);
}

std::string printable_text(std::string_view text) {
  std::string made;
  made.reserve(text.size());
  while (!text.empty()) {
    const Character next = first_character(text);
    if (next.bytes == 0) {
      made += fmt::format("\\x{:02x}", static_cast<unsigned char>(text.front()));
    } else if (is_obeyed(next.code)) {
      made += fmt::format("\\u{:04x}", static_cast<unsigned>(next.code));
    } else {
      made.append(text.substr(0, next.bytes));
    }
    text.remove_prefix(std::max<std::size_t>(1, next.bytes));
  }
  return made;
}

std::string printable_line(std::string_view text) {
  std::string made;
  for (const char c : printable_text(text)) {
    if (c == '\n')
      made += "\\n";
    else
      made += c;
  }
  return made;
}

std::string shortened_text(std::string_view text, std::size_t limit) {
  if (text.size() <= limit) return std::string(text);
  std::size_t end = limit;
  while (end > 0 && (static_cast<unsigned char>(text[end]) & 0xc0U) == 0x80) --end;
  return fmt::format("{}... ({} bytes more)", text.substr(0, end), text.size() - end);
}

}  // namespace abcal
