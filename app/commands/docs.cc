#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "app/commands/commands.h"
#include "app/system/browser.h"
#include "app/system/child_process.h"
#include "app/system/exit_code.h"
#include "app/system/helper_program.h"
#include "app/system/nearest_word.h"
#include "app/system/output.h"
#include "app/system/read_file.h"
#include "app/system/terminal.h"

namespace abcal {
namespace {

/// The folder of the pages: next to the program of a build, otherwise from the package abcal-doc.
std::filesystem::path docs_folder() {
  const std::filesystem::path beside = program_data("docs");
  const std::filesystem::path installed = beside.parent_path().parent_path() / "doc/abcal";
  std::error_code ignored;
  for (const std::filesystem::path& folder : {beside, installed})
    if (std::filesystem::exists(folder / "bench_file.md", ignored)) return folder;
  throw std::runtime_error(
      fmt::format("the pages are not installed ({}); required: apt install abcal-doc", installed.string()));
}

/// The pages and examples, as messages name them without "docs/": "effects.md", "examples/real.toml".
std::vector<std::string> page_names(const std::filesystem::path& folder) {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    const std::string extension = entry.path().extension().string();
    if (!entry.is_regular_file() || (extension != ".md" && extension != ".toml")) continue;
    std::string name = std::filesystem::relative(entry.path(), folder).string();
    if (!name.starts_with("site/")) names.push_back(std::move(name));
  }
  std::ranges::sort(names);
  return names;
}

/// The page that a person means: "docs/effects.md", "effects.md#k", "effects".
/// @throws std::invalid_argument
std::string find_page(std::string wanted, const std::vector<std::string>& names) {
  const std::string written = wanted;
  if (wanted.starts_with("docs/")) wanted.erase(0, 5);
  wanted = wanted.substr(0, wanted.find('#'));
  std::vector<std::string> words;
  for (const std::string& name : names) {
    if (name == wanted || name == wanted + ".md") return name;
    words.push_back(name.substr(0, name.rfind('.')));
  }
  const std::string meant = nearest_word(wanted.substr(0, wanted.rfind('.')), words);
  throw std::invalid_argument(
      fmt::format("there is no page \"{}\"; required: {}", written,
                  meant.empty() ? "one of those that `abcal docs` lists"
                                : fmt::format("a known page: did you mean `abcal docs {}`?", meant)));
}

/// The first heading of a page.
std::string title_of(const std::filesystem::path& page) {
  std::istringstream lines(read_file(page));
  for (std::string line; std::getline(lines, line);)
    if (line.starts_with("# ")) return line.substr(2);
  return {};
}

/// The built site with its search, which the package abcal-doc holds; empty if there is none.
std::string site_address(const std::filesystem::path& folder) {
  std::error_code missing;
  const std::filesystem::path front = std::filesystem::canonical(folder / "site/index.html", missing);
  return missing ? std::string() : "file://" + front.string();
}

void list_pages(const std::filesystem::path& folder, const std::vector<std::string>& names) {
  for (const std::string& name : names) {
    if (name.find('/') != std::string::npos) continue;
    print_result("{:<24} {}\n", name.substr(0, name.rfind('.')), title_of(folder / name));
  }
  print_result("\n`abcal docs PAGE` shows a page. All of them, with examples: {}\n", folder.string());
  const std::string site = site_address(folder);
  if (site.empty()) return;
  print_result("With a search, in a browser: {}\n", site);
  if (is_terminal(stdout)) (void)open_in_browser(site, "the pages are opened with");
}

/// Replaces this program by the pager. @throws std::runtime_error
[[noreturn]] void become_pager(const std::filesystem::path& page) {
  sigset_t none;
  ::sigemptyset(&none);
  ::pthread_sigmask(SIG_SETMASK, &none, nullptr);
  ::execl("/bin/sh", "sh", "-c", "exec ${PAGER:-less} \"$1\"", "sh", page.c_str(), nullptr);
  throw std::runtime_error(fmt::format("/bin/sh: {}", std::strerror(errno)));
}

void show_page(const std::filesystem::path& page) {
  const char* pager = std::getenv("PAGER");
  const bool has_pager =
      (pager != nullptr && *pager != '\0') || is_installed({"less", "pages are shown by", "less"});
  if (has_pager && is_terminal(stdout) && is_terminal(stdin)) become_pager(page);
  print_result("{}", read_file(page));
}

}  // namespace

CLI::App* add_docs(CLI::App& parent, int& exit_code) {
  auto page = std::make_shared<std::string>();
  CLI::App* command = parent.add_subcommand("docs", "Show a page of the documentation, as messages name it");
  command->add_option("PAGE", *page,
                      "page: effects, docs/effects.md (default: list all pages, and open them in a browser "
                      "if they are installed with a search)");
  command->callback([page, &exit_code] {
    const std::filesystem::path folder = docs_folder();
    const std::vector<std::string> names = page_names(folder);
    if (page->empty()) {
      list_pages(folder, names);
    } else {
      show_page(folder / find_page(*page, names));
    }
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
