#include "app/document/band_figure.h"

#include <fmt/format.h>

#include <array>

#include "app/document/gnuplot.h"

namespace abcal {
namespace {

constexpr std::array<const char*, 3> kColours{"#D55E00", "#009E73", "#0072B2"};
constexpr int kHeight = 280;

std::string rows_of(const std::vector<BandPanel::Place>& places) {
  std::string rows;
  for (const BandPanel::Place& place : places) rows += fmt::format("{:.6g} {:.9g}\n", place.x, place.y);
  return rows;
}

}  // namespace

Figure band_figure(const std::string& caption, const std::string& x_label,
                   const std::vector<BandPanel>& panels) {
  std::string script = fmt::format(
      "set grid lc rgb '#d0d0d0'\nset border lc rgb '#404040'\nset tics textcolor rgb '#202020'\n"
      "set multiplot layout 1,{}\nset xlabel {}\nset key off\nset format y '%.3g'\n",
      panels.size(), gnuplot_quoted(x_label));
  for (std::size_t j = 0; j < panels.size(); ++j) {
    const BandPanel& panel = panels[j];
    std::string curve;
    for (std::size_t n = 0; n < panel.x.size(); ++n)
      curve += fmt::format("{:.6g} {:.9g} {:.9g} {:.9g}\n", panel.x[n], panel.y[n],
                           panel.y[n] - panel.half_width[n], panel.y[n] + panel.half_width[n]);
    script += fmt::format("$c{0} << EOD\n{1}EOD\n$a{0} << EOD\n{2}EOD\n$b{0} << EOD\n{3}EOD\n", j, curve,
                          rows_of(panel.open), rows_of(panel.filled));
    script += fmt::format(
        "set title {}\nplot $c{} using 1:3:4 with filledcurves fc rgb '{}' fs transparent solid 0.25 "
        "notitle, $c{} using 1:2 with lines lc rgb '{}' notitle",
        gnuplot_quoted(panel.title), j, kColours.at(j % kColours.size()), j,
        kColours.at(j % kColours.size()));
    if (!panel.open.empty())
      script += fmt::format(", $a{} using 1:2 with points pt 8 ps 0.7 lc rgb '#202020' notitle", j);
    if (!panel.filled.empty())
      script += fmt::format(", $b{} using 1:2 with points pt 11 ps 0.7 lc rgb '#202020' notitle", j);
    script += "\n";
  }
  script += "unset multiplot\n";
  return {caption, script, kHeight};
}

}  // namespace abcal
