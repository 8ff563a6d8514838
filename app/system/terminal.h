#pragma once

#include <cstdio>
#include <string>
#include <string_view>

namespace abcal {

/// Whether this stream is a terminal, since colours and moving bars are for a terminal only.
bool is_terminal(std::FILE* stream);

enum class Emphasis { kNone, kGood, kWarning, kBad, kHeading };

/// `text` marked for print_log() and print_result() (app/system/output.h), which show it in a colour,
/// if `stream` is a terminal and NO_COLOR is not set; otherwise unchanged.
std::string emphasised(std::FILE* stream, Emphasis emphasis, const std::string& text);

/// Bytes that begin and end an emphasis. None of them occurs in UTF-8, so no text of a bench file
/// holds one.
inline constexpr std::string_view kEmphasisMarks = "\xf8\xf9\xfa\xfb\xfc";

/// The terminal sequence for each of kEmphasisMarks.
std::string_view terminal_sequence(char mark);

}  // namespace abcal
