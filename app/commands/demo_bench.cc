#include "app/commands/demo_bench.h"

#include <fmt/format.h>

#include <stdexcept>
#include <string_view>

#include "app/commands/example_file.h"
#include "app/commands/toml_string.h"
#include "app/system/output_file.h"
#include "app/system/read_file.h"

namespace abcal {
namespace {

void replace_first(std::string& text, std::string_view before, const std::string& now) {
  const std::size_t at = text.find(before);
  if (at == std::string::npos) throw std::logic_error(fmt::format("the example has no {}", before));
  text.replace(at, before.size(), now);
}

std::string example_text(std::string_view path) {
  for (const ExampleFile& file : example_files())
    if (file.path == path) return std::string(file.body);
  throw std::logic_error(fmt::format("{} is not built in", path));
}

/// The example with these ports and this number of steps in a turn.
std::string example_bench(const std::string& stage, const std::string& accelerometer, int steps) {
  constexpr int kTurn = 360;
  if (steps < 1 || kTurn % steps != 0)
    throw std::invalid_argument(
        fmt::format("steps: found {}; required: a divisor of 360, as 24, 30, 36 or 72", steps));
  std::string text = example_text("emulated.toml");
  text.erase(0, text.find("schema ="));
  replace_first(text, "\"build/emulated/stage\"", stage);
  replace_first(text, "\"build/emulated/accelerometer\"", accelerometer);
  replace_first(text, "steps = 72\nstep_deg = 5.0",
                fmt::format("steps = {}\nstep_deg = {}.0", steps, kTurn / steps));
  return text;
}

}  // namespace

std::string demo_bench(const std::filesystem::path& folder, int steps) {
  std::string text = example_bench(toml_string((folder / "stage").string()),
                                   toml_string((folder / "accelerometer").string()), steps);
  text.insert(0,
              "# The bench of `abcal demo`. Its instruments are emulated over pseudo-terminals in real time. "
              "To serve them again:\n"
              "#   abcal emulate bench.toml --link-dir .     (in this folder)\n"
              "#   abcal run bench.toml                      (in another terminal)\n"
              "# The settle time and the number of readings suit a demonstration, not a calibration.\n");
  return text;
}

std::string emulated_sections() {
  const std::string text = example_text("emulated.toml");
  return text.substr(text.find("[environment]"));
}

std::string demo_bench_in_process(int steps) {
  return "# The bench of abcal.demo(). Its instruments are emulated inside the program that measures.\n" +
         example_bench("\"simulated\"", "\"simulated\"", steps);
}

std::filesystem::path write_demo_bench(const std::filesystem::path& folder, int steps) {
  const std::string text = demo_bench(folder, steps);
  const std::filesystem::path usual = folder / "bench.toml";
  if (std::filesystem::exists(usual) && read_file(usual) == text) return usual;
  const std::filesystem::path path = first_free_path(usual);
  OutputFile(path).write(text);
  return path;
}

}  // namespace abcal
