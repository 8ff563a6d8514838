#include "app/system/helper_program.h"

#include <fmt/format.h>

#include <stdexcept>
#include <string_view>
#include <utility>

#include "app/system/exit_code.h"

namespace abcal {
namespace {

std::filesystem::path& helper_folder() {
  static std::filesystem::path folder = [] {
    std::error_code ignored;
    return std::filesystem::read_symlink("/proc/self/exe", ignored).parent_path();
  }();
  return folder;
}

void require_success(const std::string& name, const ToolResult& result) {
  if (result.exit_code == kExitDone) return;
  constexpr std::string_view kPrefix = "abcal: ";  // The caller that shows the message adds it again.
  std::string why = result.words;
  if (why.starts_with(kPrefix)) why.erase(0, kPrefix.size());
  if (why.empty()) why = fmt::format("{} ended with {} and without a message", name, result.exit_code);
  if (result.exit_code == kExitUsage) throw std::invalid_argument(why);
  throw std::runtime_error(why);
}

}  // namespace

Tool helper_program(const std::string& name, const std::string& needed_by) {
  const std::filesystem::path beside = helper_folder() / name;
  const std::filesystem::path installed = helper_folder().parent_path() / "libexec/abcal" / name;
  std::error_code ignored;
  const std::filesystem::path& found = std::filesystem::exists(installed, ignored) ? installed : beside;
  return {found.string(), needed_by, "abcal"};
}

void run_helper(const std::string& name, const std::string& needed_by,
                const std::vector<std::string>& arguments, std::chrono::seconds longest) {
  require_success(name, run_tool_for_words(helper_program(name, needed_by), arguments, longest));
}

void run_helper_on(std::string_view input, const std::string& name, const std::string& needed_by,
                   const std::vector<std::string>& arguments, const std::function<bool()>& cancelled) {
  ToolAwaitingInput helper(helper_program(name, needed_by), arguments);
  require_success(name, helper.finish(input, kLongestTool, cancelled));
}

std::filesystem::path program_data(const std::string& name) {
  std::error_code ignored;
  const std::filesystem::path beside = helper_folder() / name;
  return std::filesystem::exists(beside, ignored) ? beside
                                                  : helper_folder().parent_path() / "share/abcal" / name;
}

void set_helper_folder(std::filesystem::path folder) {
  helper_folder() = std::move(folder);
}

}  // namespace abcal
