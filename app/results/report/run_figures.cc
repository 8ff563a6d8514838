#include "app/results/report/run_figures.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "app/document/plot.h"
#include "drivers/text/letters.h"
#include "protocol/plan/faces.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

/// Distinguished by shape as well, and without full colour vision (the palette of Okabe and Ito).
struct Style {
  const char* name;
  const char* colour;
  PlotMark mark;
};
constexpr std::array<Style, 3> kStyles{{{"u", "#D55E00", PlotMark::kDisc},
                                        {"v", "#009E73", PlotMark::kDiamond},
                                        {"w", "#0072B2", PlotMark::kTriangle}}};
constexpr const char* kBlue = kStyles[2].colour;

PlotAxis angle_axis() {
  return {.label = "rotation angle (degree)", .unit = {}, .low = 0.0, .high = 360.0, .step = 90.0};
}

/// The marks of an output, without points.
PlotSeries series_of(std::size_t output, double radius) {
  const Style& style = kStyles[output];
  return {.name = style.name,
          .colour = style.colour,
          .mark = style.mark,
          .mark_radius = radius,
          .x = {},
          .y = {}};
}

PlotSeries blue_marks(PlotMark mark, double radius) {
  return {.name = {}, .colour = kBlue, .mark = mark, .mark_radius = radius, .x = {}, .y = {}};
}

void add(PlotSeries& series, double x, double y, double half_width) {
  series.x.push_back(x);
  series.y.push_back(y);
  series.half_width.push_back(std::isfinite(half_width) ? half_width : 0.0);
}

/// The line y = 0.
PlotSeries zero_line(double low, double high) {
  return {.name = {}, .colour = "#808080", .line = true, .x = {low, high}, .y = {0.0, 0.0}};
}

std::string experiment_title(int experiment) {
  constexpr std::array<const char*, 3> kTurns{"about X", "about X, Z turned by -90 degrees",
                                              "about Z, X turned by -90 degrees"};
  return fmt::format("Experiment {}: {}", experiment, kTurns[static_cast<std::size_t>(experiment - 1)]);
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
  constexpr double kHeight = 220.0, kFullTurn = 360.0;
  constexpr int kSamples = 91;
  std::vector<PlotSeries> curves, readings, residuals;
  bool with_u = false;
  for (std::size_t j = 0; j < 3; ++j) {
    const auto output = static_cast<Eigen::Index>(j);
    const FitDiagnostic* fit = find_fit(result, experiment, static_cast<int>(j));
    if (fit == nullptr) return {experiment_title(experiment) + ": no fit", {10.0, {}}};
    const auto fitted = [fit](const Angle& alpha) {
      const SinCos at = sincos(alpha);
      return fit->sine.value * at.sin + fit->cosine.value * at.cos + fit->constant.value;
    };
    PlotSeries& curve = curves.emplace_back(
        PlotSeries{.name = {}, .colour = kStyles[j].colour, .line = true, .x = {}, .y = {}});
    for (int k = 0; k < kSamples; ++k) {
      curve.x.push_back(kFullTurn * k / (kSamples - 1));
      curve.y.push_back(fitted(Angle::degrees(curve.x.back())));
    }
    PlotSeries& reading = readings.emplace_back(series_of(j, 2.0));
    PlotSeries& residual = residuals.emplace_back(series_of(j, 1.8));
    for (const DwellRecord& dwell : data.record.dwells) {
      if (dwell.experiment != experiment || dwell.closing || !dwell.mean.allFinite()) continue;
      const Angle alpha = plotted_angle(dwell);
      add(reading, alpha.deg(), dwell.mean[output], 0.0);
      add(residual, alpha.deg(), dwell.mean[output] - fitted(alpha),
          dwell.u_mean ? kCoverageFactor * (*dwell.u_mean)[output] : 0.0);
      with_u = with_u || dwell.u_mean;
    }
  }
  curves.insert(curves.end(), readings.begin(), readings.end());
  residuals.insert(residuals.begin(), zero_line(0.0, kFullTurn));
  return {
      fmt::format(
          "{}. Left: averaged readings and fitted curves; right: readings minus fit{}{}.",
          experiment_title(experiment),
          with_u ? fmt::format(", bars: k = {:g} times the standard uncertainty of the mean", kCoverageFactor)
                 : std::string(),
          has_two_faces(data.record)
              ? "; readings of face 2 stand at the angle at which the item sees the same gravity in face 1"
              : ""),
      plot({{.title = {},
             .x = angle_axis(),
             .y = {.label = "response", .unit = result.response_unit},
             .series = std::move(curves)},
            {.title = {},
             .x = angle_axis(),
             .y = {.label = "reading − fit", .unit = result.response_unit},
             .series = std::move(residuals)}},
           kHeight)};
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
  constexpr double kRoomAbove = 1.05, kHeight = 270.0, kBeside = 0.2;
  const double highest = highest_harmonic(result);
  std::vector<PlotPanel> panels;
  for (int experiment = 1; experiment <= 3; ++experiment) {
    PlotPanel& panel = panels.emplace_back(PlotPanel{
        .title = fmt::format("Experiment {}", experiment),
        .x = {.label = "harmonic", .unit = {}, .low = 1.5, .high = 5.5, .step = 1.0},
        .y = {.label = "amplitude", .unit = result.response_unit, .low = 0.0, .high = kRoomAbove * highest},
        .series = {}});
    for (std::size_t j = 0; j < 3; ++j) {
      PlotSeries& series = panel.series.emplace_back(series_of(j, 3.0));
      const FitDiagnostic* fit = find_fit(result, experiment, static_cast<int>(j));
      for (const Harmonic& harmonic : fit != nullptr ? fit->harmonics : std::vector<Harmonic>()) {
        if (harmonic.order < 2) continue;
        const auto [amplitude, bar] = amplitude_of(harmonic);
        add(series, harmonic.order + kBeside * (static_cast<double>(j) - 1.0), amplitude, bar);
      }
    }
  }
  return {fmt::format("Amplitudes of harmonics 2 to 5; bars: k = {:g} times their standard uncertainty.",
                      kCoverageFactor),
          plot(panels, kHeight)};
}

Figure rate_response_figure(const MotionResult& motion) {
  // Points of one rate stand beside each other.
  constexpr double kBeside = 0.02, kRadius = 3.2, kHeight = 270.0;
  std::vector<PlotSeries> amplitudes;
  for (std::size_t j = 0; j < 3; ++j) {
    PlotSeries& series = amplitudes.emplace_back(series_of(j, kRadius));
    for (const RateResponse& response : motion.responses)
      add(series, response.frequency_hz * (1.0 + kBeside * (static_cast<double>(j) - 1.0)),
          response.amplitude[j].value - 1.0, kCoverageFactor * response.amplitude[j].standard_uncertainty);
  }
  PlotSeries phases = blue_marks(PlotMark::kDisc, kRadius);
  for (const RateResponse& response : motion.responses)
    add(phases, response.frequency_hz, response.phase.value,
        kCoverageFactor * response.phase.standard_uncertainty);
  const PlotAxis frequency{.label = "frequency of gravity (Hz)", .unit = {}};
  return {
      fmt::format("Response at each rate; bars: k = {:g} times the standard uncertainty.", kCoverageFactor),
      plot({{.title = {}, .x = frequency, .y = {.label = "amplitude − 1", .unit = {}}, .series = amplitudes},
            {.title = {}, .x = frequency, .y = {.label = "phase", .unit = "degree"}, .series = {phases}}},
           kHeight)};
}

Figure step_error_figure(const RunRecord& record, const JointResult& joint) {
  constexpr double kHeight = 240.0, kFullTurn = 360.0;
  std::vector<PlotPanel> panels;
  for (std::size_t i = 0; i < 3; ++i) {
    PlotSeries errors = blue_marks(PlotMark::kOpenCircle, 1.7);
    for (std::size_t n = 0; n < joint.step_error[i].size(); ++n) {
      const Quantity& f = joint.step_error[i][n];
      if (std::isfinite(f.value))
        add(errors, record.step.deg() * static_cast<double>(n), f.value,
            kCoverageFactor * f.standard_uncertainty);
    }
    panels.push_back({.title = fmt::format("Experiment {}", i + 1),
                      .x = angle_axis(),
                      .y = {.label = "step error", .unit = "degree"},
                      .series = {zero_line(0.0, kFullTurn), std::move(errors)}});
  }
  return {fmt::format("Rotation-step errors that the joint estimator finds; bars: k = {:g} times their "
                      "standard uncertainty.",
                      kCoverageFactor),
          plot(panels, kHeight)};
}

Figure deviation_figure(const CalibrationResult& result, std::optional<double> nominal) {
  constexpr double kPercent = 100.0, kRightAngle = 90.0, kFirst = 0.5, kLast = 3.5, kHeight = 240.0;
  const auto panel = [&](const char* title, const std::string& unit,
                         const std::array<const char*, 3>& names) {
    return PlotPanel{.title = title,
                     .x = {.label = {},
                           .unit = {},
                           .low = kFirst,
                           .high = kLast,
                           .step = 1.0,
                           .names = {names.begin(), names.end()}},
                     .y = {.label = {}, .unit = unit},
                     .series = {zero_line(kFirst, kLast), blue_marks(PlotMark::kDisc, 3.2)}};
  };
  std::vector<PlotPanel> panels{panel(nominal ? "s from nominal" : "s from their mean", "%", kOutputNames),
                                panel("angles from 90°", "°", kOutputPairs),
                                panel("offsets O", result.response_unit, kOutputNames)};
  double mean = 0.0;
  for (const Quantity& q : result.intrinsic_sensitivity) mean += q.value / 3.0;
  const double ideal = nominal.value_or(mean);
  for (std::size_t j = 0; j < 3; ++j) {
    const auto expanded = [](const Quantity& q) { return coverage_factor(q) * q.standard_uncertainty; };
    const auto put = [&](std::size_t of, double value, double half_width) {
      if (std::isfinite(value)) add(panels[of].series.back(), static_cast<double>(j + 1), value, half_width);
    };
    const Quantity& s = result.intrinsic_sensitivity[j];
    put(0, kPercent * (s.value / ideal - 1.0), kPercent * expanded(s) / std::abs(ideal));
    put(1, result.intrinsic_angle[j].value - kRightAngle, expanded(result.intrinsic_angle[j]));
    put(2, result.offset[j].value, expanded(result.offset[j]));
  }
  return {fmt::format("Deviation from an ideal accelerometer: sensitivities from {}, angles from 90°, "
                      "offsets from 0. Bars: U; where no bar is seen, U is smaller than the mark.",
                      nominal ? fmt::format("the nominal {:.6g} {} per g_loc", *nominal, result.response_unit)
                              : std::string("their mean (no nominal value is known)")),
          plot(panels, kHeight)};
}

}  // namespace abcal
