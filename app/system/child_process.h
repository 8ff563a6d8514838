#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace abcal {

/// A required program is not installed; what() names it, its purpose and its package.
class ProgramMissing : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Another program of this machine, and how to get it.
struct Tool {
  std::string program;  ///< Name, searched for in PATH, or a path with "/".
  std::string needed_by;
  std::string package;  ///< Debian package that contains it.
};

/// Whether the program is found. Nothing is started.
bool is_installed(const Tool& tool);

/// @throws ProgramMissing if the program is not found
void require_installed(const Tool& tool);

/// Where the output of a program goes.
enum class ToolOutput {
  kShown,   ///< On standard error: ours belongs to results.
  kHidden,  ///< The exit code alone is the answer.
};

/// How long another program may take unless its caller knows better.
inline constexpr std::chrono::seconds kLongestTool{600};

/// Runs a program to its end, without a shell: arguments may hold any character. It has a process group of
/// its own and no descriptor of this program but the standard ones; it ends with this program (even if that
/// is killed), at Ctrl-C, and at the time limit.
/// @returns its exit code; 128 + signal if a signal ended it
/// @throws ProgramMissing, RunInterrupted (Ctrl-C meanwhile), std::runtime_error (also at the time limit)
int run_tool(const Tool& tool, const std::vector<std::string>& arguments,
             ToolOutput output = ToolOutput::kShown, std::chrono::seconds longest = kLongestTool);

/// Exit code of a program, and its text on either stream.
struct ToolResult {
  int exit_code = 0;  ///< 128 + signal if a signal ended it
  std::string words;  ///< At most 64 kB, without the newlines at its end.
};

/// Like run_tool(), for a program whose output becomes the message of its failure.
/// @param cancelled  asked each 0.1 s; true ends the program
/// @throws ProgramMissing, RunInterrupted (Ctrl-C, or cancelled), std::runtime_error
ToolResult run_tool_for_words(const Tool& tool, const std::vector<std::string>& arguments,
                              std::chrono::seconds longest = kLongestTool,
                              const std::function<bool()>& cancelled = {});

/// A program that is started before its input is known, so that it loads in the meantime. Otherwise as
/// run_tool_for_words(); it ends with this object.
class ToolAwaitingInput {
 public:
  /// @throws ProgramMissing, std::runtime_error
  ToolAwaitingInput(const Tool& tool, const std::vector<std::string>& arguments);
  ~ToolAwaitingInput();
  ToolAwaitingInput(const ToolAwaitingInput&) = delete;
  ToolAwaitingInput& operator=(const ToolAwaitingInput&) = delete;

  /// Gives it the whole standard input, and waits for its end. To be called once.
  /// @param cancelled  asked each 0.1 s; true ends the program
  /// @throws RunInterrupted, std::runtime_error
  ToolResult finish(std::string_view input, std::chrono::seconds longest = kLongestTool,
                    const std::function<bool()>& cancelled = {});

 private:
  struct Running;
  std::unique_ptr<Running> running_;
};

}  // namespace abcal
