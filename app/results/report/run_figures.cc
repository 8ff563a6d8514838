#include "app/results/report/run_figures.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "app/document/gnuplot.h"
#include "app/document/number_text.h"
#include "drivers/text/letters.h"
#include "protocol/plan/faces.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

/// Distinguished by shape as well, and without full colour vision (the palette of Okabe and Ito).
struct Style {
  const char* name;
  const char* colour;
  int point;
};
constexpr std::array<Style, 3> kStyles{{{"u", "#D55E00", 7}, {"v", "#009E73", 13}, {"w", "#0072B2", 9}}};

constexpr const char* kFrame =
    "set grid lc rgb '#d0d0d0'\nset border lc rgb '#404040'\nset tics textcolor rgb '#202020'\n"
    "set key off\n";

std::string experiment_title(int experiment) {
  constexpr std::array<const char*, 3> kTurns{"about X", "about X, Z turned by -90 degrees",
                                              "about Z, X turned by -90 degrees"};
  return fmt::format("Experiment {}: {}", experiment, kTurns[static_cast<std::size_t>(experiment - 1)]);
}

/// A plot of the bars y - u to y + u, u in the column behind y; more plots follow.
std::string bars(const std::string& data, std::size_t x, std::size_t y, const std::string& colour) {
  return fmt::format("{0} using {1}:(${2}-${3}):(0):(2*${3}) with vectors nohead lc rgb '{4}' notitle, ",
                     data, x, y, y + 1, colour);
}

/// The power of ten in which an axis counts, so that its numbers are short: a multiple of 3.
struct AxisPower {
  int exponent = 0;
  double unit = 1.0;
  /// "10⁻⁶ V"; "V" where the exponent is 0.
  std::string label(const std::string& of) const {
    return exponent == 0 ? of : power_of_ten(exponent) + " " + of;
  }
};
AxisPower axis_power(double largest) {
  if (!(largest > 0.0) || !std::isfinite(largest)) return {};
  constexpr double kLeast = 0.1;  // 0.1 to 100 in front of the power.
  const int exponent = 3 * static_cast<int>(std::floor(std::log10(largest / kLeast) / 3.0));
  return {exponent, std::pow(10.0, exponent)};
}

/// Angle of a dwell on the axis of the figure, on which the fits of both faces are one curve.
Angle plotted_angle(const DwellRecord& dwell) {
  if (dwell.face == 1) return dwell.alpha;
  const double deg = angle_in_face_1(dwell.experiment, dwell.face, dwell.alpha).deg();
  return Angle::degrees(deg - 360.0 * std::floor(deg / 360.0));
}

const FitDiagnostic* find_fit(const CalibrationResult& result, int experiment, int accelerometer) {
  for (const FitDiagnostic& fit : result.diagnostics.fits) {
    if (fit.experiment == experiment && fit.accelerometer == accelerometer) return &fit;
  }
  return nullptr;
}

}  // namespace

Figure response_figure(const ReportData& data, int experiment) {
  const CalibrationResult& result = result_of(data.results, kPublishedEstimator);
  struct Residual {
    double alpha_deg = 0.0;
    std::array<double, 3> value{}, bar{};
  };
  std::string readings;
  std::vector<Residual> left_over;
  bool with_u = false;
  for (const DwellRecord& dwell : data.record.dwells) {
    if (dwell.experiment != experiment || dwell.closing || !dwell.mean.allFinite()) continue;
    const Angle alpha = plotted_angle(dwell);
    readings += fmt::format("{:.17g} {:.17g} {:.17g} {:.17g}\n", alpha.deg(), dwell.mean[0], dwell.mean[1],
                            dwell.mean[2]);
    Residual& residual = left_over.emplace_back();
    residual.alpha_deg = alpha.deg();
    for (int j = 0; j < 3; ++j) {
      const FitDiagnostic* fit = find_fit(result, experiment, j);
      if (fit == nullptr) return {experiment_title(experiment) + ": no fit", "", 10};
      const SinCos at = sincos(alpha);
      const auto output = static_cast<std::size_t>(j);
      residual.value[output] =
          dwell.mean[j] - (fit->sine.value * at.sin + fit->cosine.value * at.cos + fit->constant.value);
      residual.bar[output] = dwell.u_mean ? kCoverageFactor * (*dwell.u_mean)[j] : 0.0;
    }
    with_u = with_u || dwell.u_mean;
  }
  double largest = 0.0;
  for (const Residual& residual : left_over)
    for (const double value : residual.value) largest = std::max(largest, std::abs(value));
  const AxisPower axis = axis_power(largest);
  std::string residuals;
  for (const Residual& residual : left_over) {
    residuals += fmt::format("{:.17g}", residual.alpha_deg);
    for (std::size_t j = 0; j < 3; ++j)
      residuals +=
          fmt::format(" {:.17g} {:.17g}", residual.value[j] / axis.unit, residual.bar[j] / axis.unit);
    residuals += "\n";
  }
  std::string script = fmt::format("$r << EOD\n{}EOD\n$d << EOD\n{}EOD\n", readings, residuals);
  script += "set angles degrees\n";
  script += kFrame;
  script += "set multiplot layout 1,2\nset xtics 90\nset mxtics 3\nset xlabel 'rotation angle (degree)'\n";
  script += fmt::format(
      "set key on outside top center horizontal samplen 2\nset ylabel {}\nset samples 91\n"
      "set xrange [0:360]\nplot ",
      gnuplot_quoted(fmt::format("response ({})", result.response_unit)));
  for (std::size_t j = 0; j < 3; ++j) {
    const FitDiagnostic& fit = *find_fit(result, experiment, static_cast<int>(j));
    const Style& style = kStyles[j];
    script += fmt::format(
        "({:.17g})*sin(x)+({:.17g})*cos(x)+({:.17g}) with lines lw 1 lc rgb '{}' notitle, $r using 1:{} with "
        "points pt {} ps 0.4 lc rgb '{}' title '{}'{}",
        fit.sine.value, fit.cosine.value, fit.constant.value, style.colour, j + 2, style.point, style.colour,
        style.name, j < 2 ? ", " : "\n");
  }
  script += fmt::format("set ylabel {}\nplot 0 with lines lc rgb '#808080' notitle, ",
                        gnuplot_quoted(fmt::format("reading − fit ({})", axis.label(result.response_unit))));
  for (std::size_t j = 0; j < 3; ++j) {
    const Style& style = kStyles[j];
    // Bars and marks apart: gnuplot draws the bars as one path then.
    if (with_u) script += bars("$d", 1, 2 * j + 2, style.colour);
    script += fmt::format("$d using 1:{} with points pt {} ps 0.35 lc rgb '{}' title '{}'{}", 2 * j + 2,
                          style.point, style.colour, style.name, j < 2 ? ", " : "\n");
  }
  script += "unset multiplot\n";
  return {
      fmt::format(
          "{}. Left: averaged readings and fitted curves; right: readings minus fit{}{}.",
          experiment_title(experiment),
          with_u ? fmt::format(", bars: k = {:g} times the standard uncertainty of the mean", kCoverageFactor)
                 : std::string(),
          has_two_faces(data.record) ? "; readings of face 2 stand at the angle at which the item "
                                       "sees the same gravity in face 1"
                                     : ""),
      script, 220};
}

namespace {

/// Amplitude of a harmonic and the half-width of its bar.
std::pair<double, double> amplitude_of(const Harmonic& harmonic) {
  const double u =
      std::fmax(harmonic.sin_amplitude.standard_uncertainty, harmonic.cos_amplitude.standard_uncertainty);
  return {std::hypot(harmonic.sin_amplitude.value, harmonic.cos_amplitude.value),
          std::isfinite(u) ? kCoverageFactor * u : 0.0};
}

/// The highest end of a bar of harmonics 2 to 5; above 0.
double highest_harmonic(const CalibrationResult& result) {
  double highest = std::numeric_limits<double>::min();
  for (const FitDiagnostic& fit : result.diagnostics.fits) {
    for (const Harmonic& harmonic : fit.harmonics) {
      if (harmonic.order < 2) continue;
      const auto [amplitude, bar] = amplitude_of(harmonic);
      highest = std::max(highest, amplitude + bar);
    }
  }
  return highest;
}

}  // namespace

Figure harmonics_figure(const CalibrationResult& result) {
  std::string data, plots;
  const double highest = highest_harmonic(result);
  const AxisPower axis = axis_power(highest);
  constexpr double kRoomAbove = 1.05;
  for (int experiment = 1; experiment <= 3; ++experiment) {
    for (int j = 0; j < 3; ++j) {
      data += fmt::format("$h{}{} << EOD\n", experiment, j);
      const FitDiagnostic* fit = find_fit(result, experiment, j);
      for (const Harmonic& harmonic : fit != nullptr ? fit->harmonics : std::vector<Harmonic>()) {
        if (harmonic.order < 2) continue;
        const auto [amplitude, bar] = amplitude_of(harmonic);
        data += fmt::format("{:.17g} {:.17g} {:.17g}\n", harmonic.order + 0.2 * (j - 1),
                            amplitude / axis.unit, bar / axis.unit);
      }
      data += "EOD\n";
    }
    plots += fmt::format("set title 'Experiment {}' offset 0,-0.5\nplot ", experiment);
    for (std::size_t j = 0; j < 3; ++j) {
      const std::string data_name = fmt::format("$h{}{}", experiment, j);
      plots += bars(data_name, 1, 2, kStyles[j].colour);
      plots += fmt::format("{} using 1:2 with points pt {} ps 0.6 lc rgb '{}' title '{}'{}", data_name,
                           kStyles[j].point, kStyles[j].colour, kStyles[j].name, j < 2 ? ", " : "\n");
    }
  }
  std::string script = data + kFrame;
  script += fmt::format(
      "set multiplot layout 1,3\nset xrange [1.5:5.5]\nset xtics 1\nset xlabel 'harmonic'\n"
      "set key on outside bottom center horizontal samplen 1\nset yrange [0:{:.6g}]\nset ylabel {}\n",
      kRoomAbove * highest / axis.unit,
      gnuplot_quoted(fmt::format("amplitude ({})", axis.label(result.response_unit))));
  return {fmt::format("Amplitudes of harmonics 2 to 5; bars: k = {:g} times their standard uncertainty.",
                      kCoverageFactor),
          script + plots + "unset multiplot\n", 270};
}

Figure rate_response_figure(const MotionResult& motion) {
  constexpr double kMicro = 1e6, kMilli = 1e3;
  // Points of one rate stand beside each other.
  constexpr double kBeside = 0.02;
  std::array<std::string, 3> amplitudes;
  std::string phases;
  for (const RateResponse& response : motion.responses) {
    for (std::size_t j = 0; j < 3; ++j)
      amplitudes[j] += fmt::format("{:.17g} {:.17g} {:.17g}\n",
                                   response.frequency_hz * (1.0 + kBeside * (static_cast<double>(j) - 1.0)),
                                   kMicro * (response.amplitude[j].value - 1.0),
                                   kMicro * kCoverageFactor * response.amplitude[j].standard_uncertainty);
    phases += fmt::format("{:.17g} {:.17g} {:.17g}\n", response.frequency_hz, kMilli * response.phase.value,
                          kMilli * kCoverageFactor * response.phase.standard_uncertainty);
  }
  std::string script, plots = "plot ";
  for (std::size_t j = 0; j < 3; ++j) {
    const std::string name = fmt::format("$a{}", j);
    script += fmt::format("{} << EOD\n{}EOD\n", name, amplitudes[j]);
    plots += bars(name, 1, 2, kStyles[j].colour);
    plots += fmt::format("{} using 1:2 with points pt {} ps 0.7 lc rgb '{}' title '{}'{}", name,
                         kStyles[j].point, kStyles[j].colour, kStyles[j].name, j < 2 ? ", " : "\n");
  }
  script += fmt::format("$p << EOD\n{}EOD\n", phases) + kFrame;
  script +=
      "set multiplot layout 1,2\nset xlabel 'frequency of gravity (Hz)'\nset offsets graph 0.1, graph 0.1, "
      "graph 0.1, graph 0.1\nset key on outside bottom center horizontal samplen 1\nset ylabel 'amplitude - "
      "1 (10^{-6})'\n";
  script += plots + "set key off\nset ylabel 'phase (0.001 degree)'\nplot " +
            bars("$p", 1, 2, kStyles[0].colour) +
            fmt::format("$p using 1:2 with points pt 7 ps 0.7 lc rgb '{}' title ''\n", kStyles[0].colour);
  return {
      fmt::format("Response at each rate; bars: k = {:g} times the standard uncertainty.", kCoverageFactor),
      script + "unset multiplot\n", 270};
}

Figure step_error_figure(const RunRecord& record, const JointResult& joint) {
  std::string data, plots;
  for (std::size_t i = 0; i < 3; ++i) {
    data += fmt::format("$f{} << EOD\n", i + 1);
    for (std::size_t n = 0; n < joint.step_error[i].size(); ++n) {
      const Quantity& f = joint.step_error[i][n];
      if (!std::isfinite(f.value)) continue;
      constexpr double kMilli = 1e3;
      data += fmt::format(
          "{:.17g} {:.17g} {:.17g}\n", record.step.deg() * static_cast<double>(n), kMilli * f.value,
          std::isfinite(f.standard_uncertainty) ? kMilli * kCoverageFactor * f.standard_uncertainty : 0.0);
    }
    data += "EOD\n";
    plots += fmt::format(
        "set title 'Experiment {0}'\nplot 0 with lines lc rgb '#808080', {1}$f{0} using 1:2 with points pt 6 "
        "ps 0.3 "
        "lc rgb '#0072B2'\n",
        i + 1, bars(fmt::format("$f{}", i + 1), 1, 2, "#0072B2"));
  }
  std::string script = data + kFrame;
  script +=
      "set multiplot layout 1,3\nset xrange [0:360]\nset xtics 90\nset xlabel 'rotation angle (degree)'\n"
      "set ylabel 'step error (0.001 degree)'\n";
  return {
      fmt::format("Rotation-step errors that the joint estimator finds; bars: k = {:g} times their standard "
                  "uncertainty.",
                  kCoverageFactor),
      script + plots + "unset multiplot\n", 240};
}

namespace {

/// Three values with their bars in one panel: u, v, w or uv, vw, wu.
struct DeviationPanel {
  std::string title, unit;
  std::array<const char*, 3> names;
  std::array<double, 3> value{}, expanded{};
};

std::string panel_script(const DeviationPanel& panel, int number) {
  double largest = 0.0;
  for (std::size_t j = 0; j < 3; ++j)
    if (std::isfinite(panel.value[j]))
      largest = std::max(
          largest, std::abs(panel.value[j]) + (std::isfinite(panel.expanded[j]) ? panel.expanded[j] : 0.0));
  const AxisPower axis = axis_power(largest);
  std::string data = fmt::format("$d{} << EOD\n", number), tics;
  for (std::size_t j = 0; j < 3; ++j) {
    tics += fmt::format("{}'{}' {}", j == 0 ? "" : ", ", panel.names[j], j + 1);
    if (!std::isfinite(panel.value[j])) continue;
    data += fmt::format("{} {:.17g} {:.17g}\n", j + 1, panel.value[j] / axis.unit,
                        std::isfinite(panel.expanded[j]) ? panel.expanded[j] / axis.unit : 0.0);
  }
  return data +
         fmt::format(
             "EOD\nset title {}\nset xtics ({})\nset ylabel {}\nplot 0 with lines lc rgb '#808080' notitle, "
             "{}$d{} using 1:2 with points pt 7 ps 0.7 lc rgb '#0072B2' notitle\n",
             gnuplot_quoted(panel.title), tics, gnuplot_quoted(axis.label(panel.unit)),
             bars(fmt::format("$d{}", number), 1, 2, "#0072B2"), number);
}

}  // namespace

Figure deviation_figure(const CalibrationResult& result, std::optional<double> nominal) {
  DeviationPanel s{nominal ? "s from nominal" : "s from their mean", "%", kOutputNames},
      phi{"angles from 90°", "°", kOutputPairs}, offset{"offsets O", result.response_unit, kOutputNames};
  double mean = 0.0;
  for (const Quantity& q : result.intrinsic_sensitivity) mean += q.value / 3.0;
  const double ideal = nominal.value_or(mean);
  constexpr double kPercent = 100.0, kRightAngle = 90.0;
  for (std::size_t j = 0; j < 3; ++j) {
    const auto expanded = [](const Quantity& q) { return coverage_factor(q) * q.standard_uncertainty; };
    s.value[j] = kPercent * (result.intrinsic_sensitivity[j].value / ideal - 1.0);
    s.expanded[j] = kPercent * expanded(result.intrinsic_sensitivity[j]) / std::abs(ideal);
    phi.value[j] = result.intrinsic_angle[j].value - kRightAngle;
    phi.expanded[j] = expanded(result.intrinsic_angle[j]);
    offset.value[j] = result.offset[j].value;
    offset.expanded[j] = expanded(result.offset[j]);
  }
  std::string script = kFrame;
  script += "set multiplot layout 1,3\nset xrange [0.5:3.5]\nset offsets 0,0,graph 0.1,graph 0.1\n";
  script += panel_script(s, 1) + panel_script(phi, 2) + panel_script(offset, 3) + "unset multiplot\n";
  return {
      fmt::format("Deviation from an ideal accelerometer: sensitivities from {}, angles from 90°, offsets "
                  "from 0. Bars: U; where no bar is seen, U is smaller than the mark.",
                  nominal ? fmt::format("the nominal {:.6g} {} per g_loc", *nominal, result.response_unit)
                          : std::string("their mean (no nominal value is known)")),
      script, 240};
}

}  // namespace abcal
