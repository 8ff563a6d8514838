#pragma once

#include <fmt/format.h>

#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>

#include "app/system/output.h"
#include "app/system/text_layout.h"
#include "app/system/typed_line.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/text/text.h"
#include "protocol/record/run_interrupted.h"

namespace abcal {

/// A question of the program to the person at the terminal.
struct Question {
  std::string words;
  std::string details;  ///< How to answer it: whole lines.
  std::string option;   ///< "--travel": answers it without a terminal.
};

/// Each line of a text, indented and wrapped for a terminal.
inline std::string indented(const std::string& text) {
  std::string lines;
  for (const std::string_view line : pieces::split(text, '\n'))
    lines += wrapped(line, "  ", "  ", kTerminalColumns);
  return lines;
}

/// For an interruption before anything was done that needs an end.
[[noreturn]] inline void end_without_an_answer() {
  throw RunInterrupted(Message("init ended without an answer; no bench file is written"));
}

/// Asks until `read` accepts the answer, and keeps it in `given`; an answer that was given as an option is
/// read once, and a mistake in it ends the program.
/// @throws RunInterrupted; std::invalid_argument, InstrumentError as `read` refuses an answer
template <class Read>
auto ask(const Question& question, std::string& given, const Read& read) {
  if (!given.empty()) {
    try {
      return read(given);
    } catch (const std::invalid_argument& error) {
      throw std::invalid_argument(fmt::format("{} \"{}\": {}", question.option, given, error.what()));
    }
  }
  print_log("\n{}\n{}", question.words, question.details);
  for (;;) {
    print_log("> ");
    const std::optional<std::string> line = typed_line();
    if (!line) {
      print_log("\n");
      end_without_an_answer();
    }
    try {
      auto answer = read(*line);
      given = pieces::trimmed(*line);
      return answer;
    } catch (const std::invalid_argument& error) {
      print_log("{}", indented(error.what()));
    } catch (const InstrumentError& error) {
      print_log("{}", indented(error.what()));
    }
  }
}

}  // namespace abcal
