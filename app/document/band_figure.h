#pragma once

#include <string>
#include <vector>

#include "app/document/document.h"

namespace abcal {

/// One curve with its band, and points about it.
struct BandPanel {
  struct Place {
    double x = 0.0, y = 0.0;
  };
  std::string title;
  std::vector<double> x, y, half_width;  ///< Points of the curve; the band is y - half_width to y +
                                         ///< half_width.
  std::vector<Place> open, filled;       ///< Triangles.
};

/// Panels next to each other, each with a colour of its own.
Figure band_figure(const std::string& caption, const std::string& x_label,
                   const std::vector<BandPanel>& panels);

}  // namespace abcal
