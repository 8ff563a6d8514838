#include "app/run_program.h"

#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdlib>
#include <exception>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/nearest_word.h"
#include "app/system/output.h"
#include "app/system/version.h"
#include "drivers/instrument/instrument_error.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_interrupted.h"

namespace abcal {
namespace {

int fail_with(ExitCode code, const char* what) {
  print_error(what);
  return code;
}

/// A command was refused, or help was asked for.
int explain_command_line(const CLI::App& app, const CLI::ParseError& error) {
  if (error.get_exit_code() == static_cast<int>(CLI::ExitCodes::Success)) {
    std::ostringstream text, ignored;
    const int exit_code = app.exit(error, text, ignored);
    print_result("{}", text.str());
    return exit_code;
  }
  print_log("{0}: {1}\nRun `{0} help COMMAND` for the options of a command, `{0} help` for the commands.\n",
            app.get_name(), error.what());
  return kExitUsage;
}

/// `help lab add` is `lab add --help`.
std::vector<std::string> with_help_option(std::vector<std::string> words) {
  if (words.empty() || words.front() != "help") return words;
  words.erase(words.begin());
  words.emplace_back("--help");
  return words;
}

/// The message for an unknown command: CLI11 reports only that a command is missing.
/// @return nullopt if the commands are known
std::optional<std::string> unknown_command(CLI::App& app, const std::vector<std::string>& words) {
  CLI::App* parent = &app;
  std::string path = app.get_name();
  for (const std::string& word : words) {
    if (word.starts_with("-") || parent->get_require_subcommand_min() == 0) return std::nullopt;
    const std::vector<CLI::App*> commands = parent->get_subcommands([](const CLI::App*) { return true; });
    const auto command =
        std::ranges::find_if(commands, [&](const CLI::App* each) { return each->check_name(word); });
    if (command == commands.end()) {
      std::vector<std::string> names;
      for (const CLI::App* each : commands)
        if (!each->get_name().empty()) names.push_back(each->get_name());  // Groups of options have none.
      const std::string meant = nearest_word(word, names);
      return fmt::format(
          "{0}: there is no command \"{1}\"; required: {2}\nRun `{0} help` for the commands.\n", path, word,
          meant.empty() ? fmt::format("one of {}", fmt::join(names, ", "))
                        : fmt::format("a known command: did you mean `{} {}`?", path, meant));
    }
    parent = *command;
    path += " " + word;
  }
  return std::nullopt;
}

/// @return the exit code of the program.
int run_command(int argc, char** argv, const ProgramDescription& program) {
  const std::string version = program.name + " " + program_version();
  const std::string_view only = argc == 2 ? argv[1] : "";
  if (only == "--version" || only == "-v") {  // Other programs ask often: without all the commands.
    print_result("{}\n", version);
    return kExitDone;
  }
  int exit_code = kExitDone;
  CLI::App app(program.description, program.name);
  app.set_version_flag("-v,--version", version);
  app.require_subcommand(1);
  app.failure_message(CLI::FailureMessage::help);
  program.add_commands(app, exit_code);
  std::vector<std::string> words = with_help_option({argv + std::min(argc, 1), argv + argc});
  if (words.empty()) {
    print_log("{}", app.help());
    return kExitUsage;
  }
  if (const auto unknown = unknown_command(app, words)) {
    print_log("{}", *unknown);
    return kExitUsage;
  }
  try {
    std::ranges::reverse(words);  // CLI11 takes the last one first.
    app.parse(words);
    return exit_code;
  } catch (const CLI::ParseError& error) {
    return explain_command_line(app, error);
  } catch (const BenchError& error) {
    return fail_with(kExitUsage, error.what());
  } catch (const PlanError& error) {
    return fail_with(kExitUsage, error.what());
  } catch (const InstrumentError& error) {
    return fail_with(kExitInstrument, error.what());
  } catch (const RunInterrupted& error) {
    return fail_with(kExitInterrupted, error.what());
  } catch (const std::invalid_argument& error) {
    return fail_with(kExitUsage, error.what());
  }
}

/// An exception that is caught nowhere is a bug, in any thread; its message is logged.
[[noreturn]] void end_after_bug() noexcept {
  try {
    if (const std::exception_ptr pending = std::current_exception()) std::rethrow_exception(pending);
    print_error("internal error");
  } catch (const std::exception& error) {
    print_log("abcal: internal error: {}\n", error.what());
  } catch (...) {
    print_error("internal error of an unknown kind");
  }
  std::abort();
}

}  // namespace

int run_program(int argc, char** argv, const ProgramDescription& program) noexcept {
  reserve_standard_descriptors();
  std::set_terminate(end_after_bug);
  int exit_code = kExitFailed;
  try {
    watch_for_signals();
    exit_code = run_command(argc, argv, program);
  } catch (const std::exception& error) {
    print_error(error.what());
  } catch (...) {
    print_error("failed for an unknown reason");
  }
  return finish_output(exit_code);
}

}  // namespace abcal
