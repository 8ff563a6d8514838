#include "app/document/gnuplot.h"

#include <fmt/format.h>

#include <chrono>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <system_error>

#include "app/system/temporary_folder.h"

namespace abcal {

const Tool kGnuplot{"gnuplot", "figures need", "gnuplot-nox"};

namespace {

/// ~/.gnuplot is not read: it is a program, by which another person could change our figures.
constexpr const char* kNoStartupFiles = "-d";
constexpr std::chrono::seconds kLongestDrawing{120};

}  // namespace

std::string gnuplot_quoted(const std::string& text) {
  std::string result = "'";
  for (const char c : text) {
    if (static_cast<unsigned char>(c) < 0x20) {
      result += ' ';  // a line break would end the command
    } else {
      result += c == '\'' ? std::string("''") : std::string(1, c);
    }
  }
  return result + "'";
}

void run_gnuplot(const std::filesystem::path& script) {
  if (run_tool(kGnuplot, {kNoStartupFiles, script.string()}, ToolOutput::kShown, kLongestDrawing) != 0)
    throw std::runtime_error(fmt::format("gnuplot failed on {} (the script is kept)", script.string()));
}

void draw_file(const std::string& script, const std::filesystem::path& output) {
  std::filesystem::path kept = output;
  kept += ".gp";
  {
    std::ofstream file(kept);
    file << script;
    if (!file.flush()) throw std::runtime_error(fmt::format("{} cannot be written", kept.string()));
  }
  run_gnuplot(kept);
  std::error_code ignored;
  std::filesystem::remove(kept, ignored);
  if (!std::filesystem::exists(output))
    throw std::runtime_error(fmt::format("gnuplot wrote no {}", output.string()));
}

std::string draw_svg(const std::string& script, int height) {
  const TemporaryFolder folder;
  const std::filesystem::path path = folder / "figure.gp", picture = folder / "figure.svg";
  {
    std::ofstream file(path);
    file << fmt::format(
        "set terminal svg size 800,{} font 'DejaVu Sans,13' noenhanced background 'white'\nset output {}\n",
        height, gnuplot_quoted(picture.string()));
    file << script << "\nunset output\n";
    if (!file.flush()) throw std::runtime_error(fmt::format("{} cannot be written", path.string()));
  }
  if (run_tool(kGnuplot, {kNoStartupFiles, path.string()}, ToolOutput::kShown, kLongestDrawing) != 0)
    throw std::runtime_error("gnuplot failed to draw a figure");
  std::ifstream file(picture, std::ios::binary);
  std::ostringstream svg;
  svg << file.rdbuf();
  if (!file || svg.str().empty()) throw std::runtime_error("gnuplot drew nothing");
  return svg.str();
}

}  // namespace abcal
