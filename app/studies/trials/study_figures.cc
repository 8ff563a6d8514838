#include "app/studies/trials/study_figures.h"

#include <fmt/format.h>

#include <stdexcept>

#include "app/document/gnuplot.h"

namespace abcal {

std::string figure_script(const SimulatedReadings& readings, bool residuals, const std::string& terminal,
                          const std::string& output) {
  std::string script = fmt::format("set terminal {}\nset output {}\n", terminal, gnuplot_quoted(output));
  for (std::size_t i = 0; i < 3; ++i) {
    const Eigen::MatrixX3d& data = residuals ? readings.residuals[i] : readings.readings[i];
    script += fmt::format("$e{} << EOD\n", i + 1);
    for (Eigen::Index n = 0; n < data.rows(); ++n) {
      script += fmt::format("{:.17g} {:.17g} {:.17g} {:.17g}\n",
                            readings.alpha[i][static_cast<std::size_t>(n)].deg(), data(n, 0), data(n, 1),
                            data(n, 2));
    }
    script += "EOD\n";
  }
  // The paper's arrangement: experiment 1 upper right, 2 lower left, 3 lower right; the key in the free
  // corner.
  script +=
      "set multiplot layout 2,2\n"
      "unset border\nunset tics\nset key center center\n"
      "plot [0:1][0:1] NaN with points pt 1 lc rgb 'red' title 'U', NaN with points pt 2 lc rgb 'dark-green' "
      "title 'V', NaN with points pt 6 lc rgb 'blue' title 'W'\n"
      "set border\nset tics\nset xtics 90\nset grid\nset xrange [0:360]\nset xlabel 'rotation angle "
      "(degree)'\n"
      "unset key\n";
  script += residuals ? "set ylabel 'difference (R)'\nset format y '%.0e'\n" : "set ylabel 'response (R)'\n";
  for (int experiment = 1; experiment <= 3; ++experiment) {
    script += fmt::format(
        "set title 'experiment {0}'\n"
        "plot $e{0} using 1:2 with points pt 1 ps 0.6 lc rgb 'red', $e{0} using 1:3 with points pt 2 ps 0.6 "
        "lc rgb 'dark-green', $e{0} using 1:4 with points pt 6 ps 0.6 lc rgb 'blue'\n",
        experiment);
  }
  return script + "unset multiplot\nunset output\n";
}

std::vector<std::filesystem::path> write_study_figures(const StudyResult& study,
                                                       const std::filesystem::path& folder) {
  if (study.set != "1" && study.set != "2") {
    throw std::invalid_argument(fmt::format(
        "figures: set {} has none; figures 1 and 2 belong to set 1, 3 and 4 to set 2", study.set));
  }
  const SimulatedReadings& readings = study.cases.at(0).readings.value();
  std::filesystem::create_directories(folder);
  std::vector<std::filesystem::path> written;
  const int first = study.set == "1" ? 1 : 3;
  for (int figure = first; figure < first + 2; ++figure) {
    for (const auto& [ending, terminal] :
         {std::pair{"svg", "svg size 900,700 background 'white'"}, {"png", "pngcairo size 1200,930"}}) {
      const std::filesystem::path output = folder / fmt::format("figure{}.{}", figure, ending);
      draw_file(figure_script(readings, figure != first, terminal, output.string()), output);
      written.push_back(output);
    }
  }
  return written;
}

}  // namespace abcal
