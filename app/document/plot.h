#pragma once

#include <optional>
#include <string>
#include <vector>

#include "app/document/drawing.h"

namespace abcal {

/// Marks of a series; shapes distinguish series without colours.
enum class PlotMark { kNone, kDisc, kDiamond, kTriangle, kOpenCircle, kOpenTriangle, kTriangleDown };

/// Points of a diagram, joined by a line or marked or both. Points that are not finite are left out.
struct PlotSeries {
  std::string name;  ///< In the key; empty: not in the key.
  std::string colour;
  PlotMark mark = PlotMark::kNone;
  double mark_radius = 2.5;  ///< In units of the picture.
  bool line = false;
  std::vector<double> x, y;
  std::vector<double> half_width = {};  ///< Empty, or the half of a bar at each point; of a line, of a band.
};

struct PlotAxis {
  std::string label;  ///< May be empty.
  std::string unit;   ///< Unit of the numbers given; the axis may count in a power of ten of it.
  std::optional<double> low = {}, high = {};  ///< Ends; by the data where none is given.
  double step = 0.0;                          ///< Between numbers; 0: chosen.
  std::vector<std::string> names = {};        ///< In place of the numbers 1, 2, ...
};

struct PlotPanel {
  std::string title;
  PlotAxis x, y;
  std::vector<PlotSeries> series;
};

/// Panels beside each other on one picture, each with frame, grid, axes, title and key.
Drawing plot(const std::vector<PlotPanel>& panels, double height);

}  // namespace abcal
