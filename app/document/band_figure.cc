#include "app/document/band_figure.h"

#include <array>
#include <utility>

#include "app/document/plot.h"

namespace abcal {
namespace {

constexpr std::array<const char*, 3> kColours{"#D55E00", "#009E73", "#0072B2"};
constexpr double kBandHeight = 280.0, kMarkRadius = 3.0;

PlotSeries triangles(const std::vector<BandPanel::Place>& places, PlotMark mark) {
  PlotSeries series{
      .name = {}, .colour = "#202020", .mark = mark, .mark_radius = kMarkRadius, .x = {}, .y = {}};
  for (const BandPanel::Place& place : places) {
    series.x.push_back(place.x);
    series.y.push_back(place.y);
  }
  return series;
}

}  // namespace

Figure band_figure(const std::string& caption, const std::string& x_label,
                   const std::vector<BandPanel>& panels) {
  std::vector<PlotPanel> plotted;
  for (std::size_t j = 0; j < panels.size(); ++j) {
    const BandPanel& panel = panels[j];
    plotted.push_back({.title = panel.title,
                       .x = {.label = x_label, .unit = {}},
                       .y = {},
                       .series = {{.name = {},
                                   .colour = kColours.at(j % kColours.size()),
                                   .line = true,
                                   .x = panel.x,
                                   .y = panel.y,
                                   .half_width = panel.half_width},
                                  triangles(panel.open, PlotMark::kOpenTriangle),
                                  triangles(panel.filled, PlotMark::kTriangleDown)}});
  }
  return {caption, plot(plotted, kBandHeight)};
}

}  // namespace abcal
