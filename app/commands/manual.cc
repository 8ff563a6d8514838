#include "app/commands/manual.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "app/commands/shell_word.h"

namespace abcal {
namespace {

/// Text for troff: hyphens that can be copied, no accidental requests at the start of a line.
std::string troff(const std::string& text) {
  std::string out;
  for (const char c : text) {
    const bool line_start = out.empty() || out.back() == '\n';
    if (line_start && (c == '.' || c == '\'')) out += "\\&";
    if (c == '\\') {
      out += "\\e";
    } else if (c == '-') {
      out += "\\-";
    } else {
      out += c;
    }
  }
  return out;
}

bool hidden(const CLI::Option& option) {
  return option.get_group().empty();
}

std::vector<const CLI::Option*> shown_options(const CLI::App& command) {
  std::vector<const CLI::Option*> options;
  for (const CLI::Option* option : command.get_options()) {
    if (!hidden(*option)) options.push_back(option);
  }
  return options;
}

std::vector<const CLI::App*> shown_commands(const CLI::App& app) {
  return app.get_subcommands([](const CLI::App* command) { return !command->get_group().empty(); });
}

/// "-o", "--output".
std::vector<std::string> dashed_names(const CLI::Option& option) {
  std::vector<std::string> names;
  for (const std::string& name : option.get_snames()) names.push_back("-" + name);
  for (const std::string& name : option.get_lnames()) names.push_back("--" + name);
  return names;
}

bool is_flag(const CLI::Option& option) {
  return option.get_items_expected_max() == 0;
}

/// "FILE" of a positional, "TEXT", "FLOAT", or option_text() of an option.
std::string argument_word(const CLI::Option& option) {
  if (!option.get_option_text().empty()) return option.get_option_text();
  if (option.get_positional()) return option.get_name(true);
  std::string type = option.get_type_name();
  return type.substr(0, type.find(':'));
}

/// The choices that a check such as IsMember lists: "{abc,joint,norm}" in the name of the type.
std::vector<std::string> choices(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  const std::size_t begin = type.find('{');
  const std::size_t end = type.find('}', begin);
  if (begin == std::string::npos || end == std::string::npos) return {};
  std::vector<std::string> list;
  std::string word;
  for (const char c : type.substr(begin + 1, end - begin - 1) + ",") {
    if (c != ',') {
      word += c;
    } else {
      // A transformer lists "name->value".
      list.push_back(word.substr(0, word.find("->")));
      word.clear();
    }
  }
  return list;
}

std::string option_heading(const CLI::Option& option) {
  if (option.get_positional() && dashed_names(option).empty())
    return fmt::format("\\fI{}\\fR", troff(option.get_name(true)));
  std::vector<std::string> names;
  for (const std::string& name : dashed_names(option)) names.push_back("\\fB" + troff(name) + "\\fR");
  std::string heading = fmt::format("{}", fmt::join(names, ", "));
  if (!is_flag(option)) heading += " \\fI" + troff(argument_word(option)) + "\\fR";
  return heading;
}

std::string option_text(const CLI::Option& option) {
  std::string text = option.get_description();
  if (!option.get_default_str().empty() && !is_flag(option) && text.find("default") == std::string::npos)
    text += fmt::format(" (default: {})", option.get_default_str());
  return text;
}

std::string options_section(const CLI::App& command) {
  std::string text;
  for (const CLI::Option* option : shown_options(command))
    text += ".TP\n" + option_heading(*option) + "\n" + troff(option_text(*option)) + "\n";
  return text.empty() ? "" : ".SH OPTIONS\n" + text;
}

std::string synopsis(const CLI::App& command, const std::string& name) {
  std::string text = ".SH SYNOPSIS\n\\fB" + troff(name) + "\\fR";
  bool optional = false;
  for (const CLI::Option* option : shown_options(command)) optional = optional || !option->get_required();
  if (optional) text += " [\\fIOPTION\\fR]...";
  for (const CLI::Option* option : shown_options(command)) {
    if (!option->get_required()) continue;
    const bool several = option->get_expected_max() > 1;
    if (option->get_positional()) {
      text += fmt::format(" \\fI{}\\fR{}", troff(option->get_name(true)), several ? "..." : "");
    } else {
      text += " " + option_heading(*option);
    }
  }
  return text + "\n";
}

/// The commands of a command, and theirs, each with its options.
std::string commands_section(const CLI::App& command, const std::string& name) {
  std::string text;
  for (const CLI::App* inner : shown_commands(command)) {
    const std::string full = name + " " + inner->get_name();
    if (shown_commands(*inner).empty()) {
      std::string call = synopsis(*inner, full);
      call.erase(0, call.find('\n') + 1);
      if (text.empty() && command.get_parent() != nullptr && command.get_parent()->get_parent() == nullptr)
        text += ".SH COMMANDS\n";
      text += ".SS " + troff(full) + "\n" + call + ".PP\n" + troff(inner->get_description()) + "\n";
      std::string options = options_section(*inner);
      if (!options.empty()) options.erase(0, options.find('\n') + 1);
      text += options;
    }
    text += commands_section(*inner, full);
  }
  return text;
}

/// The examples of a command (command_help.h), each in a line of its own.
std::string examples_section(const CLI::App& command) {
  std::istringstream lines(command.get_footer());
  std::string text;
  for (std::string line; std::getline(lines, line);)
    if (line.starts_with("  ")) text += ".PP\n.nf\n" + troff(line) + "\n.fi\n";
  return text.empty() ? "" : ".SH EXAMPLES\n" + text;
}

constexpr const char* kEnvironment =
    ".SH ENVIRONMENT\n"
    ".TP\nABCAL_REGISTER\nthe register of the laboratory: a file, or postgresql://USER@HOST/DATABASE\n"
    ".TP\nABCAL_SIGNING_KEY\nthe key of the bench (PEM) for a witness beside the run\n"
    ".TP\nABCAL_WITNESS\nthe socket of a witness that runs as a service\n"
    ".TP\nABCAL_TIME_STAMP_AUTHORITY\nthe address of an authority (RFC 3161) that stamps closed runs\n"
    ".TP\nABCAL_MAIL_USER, ABCAL_MAIL_PASSWORD\nfor messages by mail\n"
    ".TP\nXDG_STATE_HOME\nthe folder of abcal's own files (default: ~/.local/state)\n"
    ".TP\nNO_COLOR\nif set: no colours on the terminal\n";

constexpr const char* kFiles =
    ".SH FILES\n"
    ".TP\n*.toml\na bench file, or a file of the laboratory\n"
    ".TP\n*.run\na run: one SQLite file with plan, readings, events and the bench file\n"
    ".TP\n*.run.results\nanalyses, approvals and certificates of a run\n"
    ".TP\n~/.local/state/abcal/motion.log\nwho moved which stage, and each halt by the guard\n";

constexpr const char* kExitStatus =
    ".SH EXIT STATUS\n"
    ".TP\n0\ndone\n"
    ".TP\n1\nthe measurement or the analysis failed, or results do not agree\n"
    ".TP\n2\nusage, or a file that was given is wrong\n"
    ".TP\n3\nan instrument failed\n"
    ".TP\n130\ninterrupted (a command that only computes is ended by the signal itself: 128 and its "
    "number)\n";

constexpr const char* kSafety =
    ".SH SAFETY\nA software halt is not an emergency stop. A computer can hang: keep the stage's own switch "
    "within reach.\n";

std::string page(const std::string& name, const std::string& one_line, const std::string& body,
                 const std::string& version, const std::string& date) {
  std::string upper = name;
  for (char& c : upper) c = static_cast<char>(c >= 'a' && c <= 'z' ? c - 'a' + 'A' : c);
  return fmt::format(
      ".\\\" Made from the command line's own help; do not edit.\n"
      ".TH \"{}\" 1 \"{}\" \"{}\" \"User Commands\"\n.SH NAME\n{} \\- {}\n{}",
      upper, date, version, troff(name), troff(one_line), body);
}

/// The first sentence or line of a description, without its full stop.
std::string one_line(const std::string& description) {
  std::string line = description.substr(0, description.find('\n'));
  if (line.ends_with('.')) line.pop_back();
  return line;
}

/// A description inside [brackets] of zsh's _arguments.
std::string zsh_text(const std::string& text) {
  std::string out;
  for (const char c : text.substr(0, text.find('\n'))) {
    if (c == '[' || c == ']' || c == ':' || c == '\\') out += '\\';
    out += c;
  }
  return out;
}

std::string zsh_action(const CLI::Option& option) {
  const std::vector<std::string> list = choices(option);
  return list.empty() ? "_files" : fmt::format("({})", fmt::join(list, " "));
}

std::string zsh_arguments(const CLI::App& command) {
  std::string text;
  for (const CLI::Option* option : shown_options(command)) {
    const std::vector<std::string> names = dashed_names(*option);
    const std::string word = zsh_text(argument_word(*option));
    if (names.empty()) {
      const char* several = option->get_expected_max() > 1 ? "*" : "";
      text += fmt::format(" \\\n        {}",
                          shell_word(fmt::format("{}:{}:{}", several, word, zsh_action(*option))));
      continue;
    }
    for (const std::string& name : names) {
      std::string spec = fmt::format("{}[{}]", name, zsh_text(option->get_description()));
      if (!is_flag(*option)) spec += fmt::format(":{}:{}", word, zsh_action(*option));
      text += " \\\n        " + shell_word(spec);
    }
  }
  return text;
}

void write_text(const std::filesystem::path& path, const std::string& text) {
  std::ofstream file(path, std::ios::binary);
  file << text;
  file.close();
  if (!file) throw std::runtime_error(path.string() + ": cannot be written");
}

std::string date_of_sources() {
  const char* epoch = std::getenv("SOURCE_DATE_EPOCH");
  if (epoch == nullptr) return {};
  return fmt::format("{:%Y-%m-%d}", fmt::gmtime(static_cast<std::time_t>(std::strtoll(epoch, nullptr, 10))));
}

}  // namespace

std::map<std::string, std::string> manual_pages(const CLI::App& app, const std::string& version,
                                                const std::string& date) {
  std::map<std::string, std::string> pages;
  const std::string program = app.get_name();
  std::string commands = ".SH COMMANDS\n";
  for (const CLI::App* command : shown_commands(app)) {
    const std::string name = program + "-" + command->get_name();
    commands += fmt::format(".TP\n\\fB{}\\fR(1)\n{}\n", troff(name), troff(command->get_description()));
    pages[name + ".1"] = page(name, one_line(command->get_description()),
                              synopsis(*command, program + " " + command->get_name()) + ".SH DESCRIPTION\n" +
                                  troff(command->get_description()) + ".\n" + options_section(*command) +
                                  commands_section(*command, program + " " + command->get_name()) +
                                  examples_section(*command) + kEnvironment + kFiles + kExitStatus + kSafety +
                                  fmt::format(".SH SEE ALSO\n\\fB{}\\fR(1)\n", troff(program)),
                              version, date);
  }
  pages[program + ".1"] =
      page(program, "calibrate triaxial accelerometers with gravity",
           fmt::format(".SH SYNOPSIS\n\\fB{}\\fR \\fICOMMAND\\fR [\\fIOPTION\\fR]...\n", troff(program)) +
               ".SH DESCRIPTION\n" + troff(app.get_description()) + "\n" + commands + options_section(app) +
               kEnvironment + kFiles + kExitStatus,
           version, date);
  return pages;
}

namespace {

/// The files that a positional argument is completed with: "*.toml" for BENCH, "*.run" for RUN; all for
/// others.
std::string file_pattern(const CLI::App& command) {
  for (const CLI::Option* option : shown_options(command)) {
    if (!dashed_names(*option).empty()) continue;
    const std::string name = option->get_name(true);
    if (name == "BENCH") return "*.toml";
    if (name == "RUN") return "*.run";
  }
  return "";
}

/// The words that bash offers behind a command, and behind its own commands.
/// @param path  "abcal lab add"
/// @param commands_of  filled: the commands behind each path
void add_bash_cases(const CLI::App& command, const std::string& path, std::string& commands_of,
                    std::string& cases) {
  std::vector<std::string> words;
  std::string values, positional;
  for (const CLI::Option* option : shown_options(command)) {
    const std::vector<std::string> dashed = dashed_names(*option);
    words.insert(words.end(), dashed.begin(), dashed.end());
    const std::vector<std::string> list = choices(*option);
    if (list.empty()) continue;
    const std::string line = fmt::format("COMPREPLY=($(compgen -W {} -- \"$current\"))",
                                         shell_word(fmt::format("{}", fmt::join(list, " "))));
    if (dashed.empty()) {
      positional = line;
    } else {
      values += fmt::format("        {}) {}; return ;;\n", fmt::join(dashed, "|"), line);
    }
  }
  cases += fmt::format("    {})\n", shell_word(path));
  if (!values.empty()) cases += "      case $previous in\n" + values + "      esac\n";
  cases += fmt::format("      options={}\n", shell_word(fmt::format("{}", fmt::join(words, " "))));
  if (const std::string files = file_pattern(command); !files.empty())
    cases += fmt::format("      files={}\n", shell_word(files));
  if (!positional.empty())
    cases += fmt::format("      [[ $current == -* ]] || {{ {}; return; }}\n", positional);
  cases += "      ;;\n";
  std::vector<std::string> names;
  for (const CLI::App* inner : shown_commands(command)) {
    if (inner->get_name().empty()) continue;  // A group of options.
    names.push_back(inner->get_name());
    add_bash_cases(*inner, path + " " + inner->get_name(), commands_of, cases);
  }
  if (!names.empty())
    commands_of +=
        fmt::format("    [{}]={}\n", shell_word(path), shell_word(fmt::format("{}", fmt::join(names, " "))));
}

}  // namespace

std::string bash_completion(const CLI::App& app) {
  const std::string program = app.get_name();
  std::string commands_of, cases;
  add_bash_cases(app, program, commands_of, cases);
  return fmt::format(
      "# bash completion for {0}; made from the command line's own help.\n"
      "_{0}() {{\n"
      "  local current=${{COMP_WORDS[COMP_CWORD]}} previous=${{COMP_WORDS[COMP_CWORD-1]}}\n"
      "  local options= files= path={0} word\n"
      "  local -A commands=(\n{1}  )\n"
      "  for word in \"${{COMP_WORDS[@]:1:COMP_CWORD-1}}\"; do\n"
      "    [[ \" ${{commands[$path]:-}} \" == *\" $word \"* ]] && path+=\" $word\"\n"
      "  done\n"
      "  case $path in\n"
      "{2}  esac\n"
      "  local names=${{commands[$path]:-}}\n"
      "  if [[ $current == -* ]]; then\n"
      "    COMPREPLY=($(compgen -W \"$options\" -- \"$current\"))\n"
      "  elif [[ -n $names ]]; then\n"
      "    [[ $path == {0} ]] && names+=\" help $options\"\n"
      "    COMPREPLY=($(compgen -W \"$names\" -- \"$current\"))\n"
      "  else\n"
      "    [[ -z $files ]] || mapfile -t COMPREPLY < <(compgen -f -X \"!$files\" -- \"$current\"; compgen -d "
      "-- \"$current\")\n"
      "    [[ ${{#COMPREPLY[@]}} -gt 0 ]] || mapfile -t COMPREPLY < <(compgen -f -- \"$current\")\n"
      "  fi\n"
      "}}\n"
      "complete -o filenames -F _{0} {0}\n",
      program, commands_of, cases);
}

std::string zsh_completion(const CLI::App& app) {
  std::string commands;
  std::string cases;
  for (const CLI::App* command : shown_commands(app)) {
    commands += fmt::format(
        "      {}\n", shell_word(command->get_name() + ":" + zsh_text(one_line(command->get_description()))));
    cases +=
        fmt::format("    {})\n      _arguments{}\n      ;;\n", command->get_name(), zsh_arguments(*command));
  }
  const std::string program = app.get_name();
  return fmt::format(
      "#compdef {0}\n"
      "# zsh completion for {0}; made from the command line's own help.\n"
      "_{0}() {{\n"
      "  if (( CURRENT == 2 )); then\n"
      "    local -a commands=(\n"
      "{1}    )\n"
      "    _describe command commands\n"
      "    return\n"
      "  fi\n"
      "  shift words\n"
      "  (( CURRENT-- ))\n"
      "  case $words[1] in\n"
      "{2}  esac\n"
      "}}\n"
      "_{0} \"$@\"\n",
      program, commands, cases);
}

void add_manual_option(CLI::App& app, const std::string& version) {
  app.add_option_function<std::string>(
         "--write-manual",
         [&app, version](const std::string& folder) {
           const std::filesystem::path target = folder;
           std::filesystem::create_directories(target);
           for (const auto& [name, text] : manual_pages(app, version, date_of_sources()))
             write_text(target / name, text);
           write_text(target / (app.get_name() + ".bash"), bash_completion(app));
           write_text(target / ("_" + app.get_name()), zsh_completion(app));
           throw CLI::Success();
         },
         "write manual pages and completions into a folder")
      ->group("")
      ->trigger_on_parse();
}

}  // namespace abcal
