#include "app/studies/calibration/rank_figures.h"

#include <fmt/format.h>

#include <cctype>
#include <cmath>
#include <string>

#include "app/document/gnuplot.h"

namespace abcal {
namespace {

std::string script_of(const KindOutcome& kind, const std::string& output) {
  std::string script = fmt::format(
      "set terminal svg size 900,560 background 'white'\nset output {}\nset multiplot layout 2,3 title {}\n"
      "unset key\nset grid ytics\nset style fill solid 0.6\nset boxwidth 0.9 relative\nset yrange [0:*]\n"
      "set xrange [0:1]\nset xtics 0.25\nset xlabel 'rank of the truth'\n",
      gnuplot_quoted(output), gnuplot_quoted(kind.kind.name + ": " + kind.kind.words));
  for (std::size_t group = 0; group < kOutputGroups; ++group) {
    std::array<int, kRankBins> counts{};
    double total = 0.0;
    for (std::size_t output_number = 0; output_number < kind.ranks.size(); ++output_number) {
      if (group_of_output(output_number) != group) continue;
      for (std::size_t bin = 0; bin < kRankBins; ++bin) {
        counts.at(bin) += kind.ranks.at(output_number).at(bin);
        total += kind.ranks.at(output_number).at(bin);
      }
    }
    if (total == 0.0) continue;
    constexpr double kOfBin = 1.0 / static_cast<double>(kRankBins);
    const double expected = total * kOfBin;
    const double half = 1.96 * std::sqrt(expected * (1.0 - kOfBin));
    script += fmt::format("$g{} << EOD\n", group);
    for (std::size_t bin = 0; bin < kRankBins; ++bin)
      script += fmt::format("{} {}\n", (static_cast<double>(bin) + 0.5) * kOfBin, counts.at(bin));
    script += fmt::format(
        "EOD\nset title {}\nplot $g{} using 1:2 with boxes lc rgb '#4477aa', {} lc rgb 'black', {} dt 2 lc "
        "rgb 'black', {} dt 2 lc rgb 'black'\n",
        gnuplot_quoted(output_group_names().at(group)), group, expected, expected - half, expected + half);
  }
  return script + "unset multiplot\nunset output\n";
}

}  // namespace

std::vector<std::filesystem::path> write_rank_figures(const CalibrationStudy& study,
                                                      const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  std::vector<std::filesystem::path> written;
  for (const KindOutcome& kind : study.kinds) {
    std::string name = std::filesystem::path(kind.kind.name).stem().string();
    for (char& c : name)
      if (std::isalnum(static_cast<unsigned char>(c)) == 0) c = '-';
    const std::filesystem::path output = folder / fmt::format("ranks-{}.svg", name);
    draw_file(script_of(kind, output.string()), output);
    written.push_back(output);
  }
  return written;
}

}  // namespace abcal
