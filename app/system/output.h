#pragma once

#include <fmt/core.h>

#include <cstddef>
#include <functional>
#include <string>
#include <string_view>

namespace abcal {

// Standard output belongs to results, standard error to words for a person. No function here throws, and none
// ends a run: a closed pipe, a full disk or a closed descriptor loses the text and nothing else. A result
// that was lost is remembered until finish_output(). Text for a stream is made printable (printable_text).

/// Opens /dev/null in place of each standard descriptor that the caller closed, so that no port and no file
/// gets its number. Output to it still fails, so that the caller learns of it. Call first in main().
void reserve_standard_descriptors() noexcept;

/// Text on standard error, unchanged; the caller ends its lines. At most 16 kB are kept. A reader that does
/// not read costs 0.3 s once: after that, text is left out until room is free again.
void vprint_log(fmt::string_view format, fmt::format_args arguments) noexcept;
template <typename... Arguments>
void print_log(fmt::format_string<Arguments...> format, const Arguments&... arguments) noexcept {
  vprint_log(format, fmt::make_format_args(arguments...));
}

/// Sends the text to `listener` instead of standard error, from any thread, one call at a time; empty: to
/// standard error (as at the start). For tests of a program inside their own process.
void send_log_to(std::function<void(std::string_view)> listener);

/// A line "warning: TEXT" on standard error.
void print_warning(std::string_view text) noexcept;

/// A line "abcal: TEXT" on standard error.
void print_error(std::string_view text) noexcept;

/// Text on standard output, unchanged. Waits as long as its reader does.
void vprint_result(fmt::string_view format, fmt::format_args arguments) noexcept;
template <typename... Arguments>
void print_result(fmt::format_string<Arguments...> format, const Arguments&... arguments) noexcept {
  vprint_result(format, fmt::make_format_args(arguments...));
}

/// Silences the C++ stream of standard error from now on: for a library that also writes the messages of its
/// exceptions to it.
void silence_standard_error_stream() noexcept;

/// The exit code after all output: `exit_code`, or kExitFailed with words on standard error if that was
/// kExitDone and a result could not be written.
int finish_output(int exit_code) noexcept;

/// Control sequences of a terminal (a progress bar) with text between them, on standard error. The text must
/// be printable already.
void print_to_terminal(std::string_view text) noexcept;

/// The text with everything escaped that a terminal would interpret: control characters other than newline
/// and tab as \u001b, characters that turn the direction of writing or end a line as \u202e, bytes that are
/// not UTF-8 as \xff. In JSON this changes no meaning.
std::string printable_text(std::string_view text);

/// As printable_text(), and a line break is escaped too: for text within one line of a file.
std::string printable_line(std::string_view text);

/// The first `limit` bytes, cut between two characters of UTF-8, and how many bytes are left out; all of a
/// text that is no longer.
std::string shortened_text(std::string_view text, std::size_t limit);

}  // namespace abcal
