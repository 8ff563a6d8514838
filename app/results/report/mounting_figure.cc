#include "app/results/report/mounting_figure.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

#include "app/document/gnuplot.h"
#include "drivers/text/letters.h"

namespace abcal {
namespace {

constexpr int kHeight = 165;
// The eye sees x to the right and towards it, y to the right and away, z up.
constexpr double kAzimuth = -55.0 * std::numbers::pi / 180.0, kElevation = 25.0 * std::numbers::pi / 180.0;
/// Half the edges of the block along u, v, w: unequal, so that its position can be seen.
constexpr std::array<double, 3> kHalfEdge{0.55, 0.4, 0.25};
constexpr int kSmall = 12;  // Points.
constexpr double kPlatterRadius = 1.25, kArrow = 0.8, kLabelGap = 0.2;
// Not grey: the page joins grey lines as those of a frame.
constexpr const char* kDark = "#10324e";
constexpr std::array<const char*, 3> kColours{"#D55E00", "#009E73", "#0072B2"};

Eigen::Vector3d towards_eye() {
  return {std::cos(kElevation) * std::cos(kAzimuth), std::cos(kElevation) * std::sin(kAzimuth),
          std::sin(kElevation)};
}

/// The place of a point on the drawing.
Eigen::Vector2d seen(const Eigen::Vector3d& point) {
  const Eigen::Vector3d right(-std::sin(kAzimuth), std::cos(kAzimuth), 0.0);
  return {right.dot(point), towards_eye().cross(right).dot(point)};
}

class Drawing {
 public:
  void polygon(const std::vector<Eigen::Vector2d>& corners, const std::string& fill) {
    std::string rows;
    for (const Eigen::Vector2d& corner : corners)
      rows += fmt::format("{:.4f} {:.4f}\n", corner[0], corner[1]);
    rows += fmt::format("{:.4f} {:.4f}\n", corners.front()[0], corners.front()[1]);
    add(rows, fmt::format("with filledcurves closed fc rgb '{}' fs solid 1.0 border rgb '{}'", fill, kDark));
  }
  void arrow(const Eigen::Vector2d& from, const Eigen::Vector2d& by, const std::string& colour) {
    add(fmt::format("{:.4f} {:.4f} {:.4f} {:.4f}\n", from[0], from[1], by[0], by[1]),
        fmt::format("with vectors head filled size screen 0.018,18 lw 2.5 lc rgb '{}'", colour));
  }
  void label(const Eigen::Vector2d& at, const std::string& text, const std::string& colour, int points = 15) {
    labels_ += fmt::format("set label {} at {:.4f},{:.4f} center front tc rgb '{}' font ',{}'\n",
                           gnuplot_quoted(text), at[0], at[1], colour, points);
  }
  /// An axis with its letter at the end.
  void axis(const Eigen::Vector2d& from, const Eigen::Vector2d& by, const std::string& letter,
            const std::string& colour) {
    arrow(from, by, colour);
    // An axis along the line of sight is a point, with its letter above.
    const double length = by.norm();
    label(from + by +
              (length > 1e-6 ? Eigen::Vector2d(by / length * kLabelGap) : Eigen::Vector2d(0.0, kLabelGap)),
          letter, colour);
  }
  std::string script() const {
    return "unset border\nunset tics\nset key off\nset margins 0,0,0,0\nset size ratio -1\n"
           "set xrange [-6:6]\nset yrange [-1.4:1.5]\n" +
           data_ + labels_ + "plot " + plots_ + "\n";
  }

 private:
  void add(const std::string& rows, const std::string& how) {
    data_ += fmt::format("$d{} << EOD\n{}EOD\n", count_, rows);
    plots_ += fmt::format("{}$d{} {} notitle", count_ == 0 ? "" : ", ", count_, how);
    ++count_;
  }
  int count_ = 0;
  std::string data_, plots_, labels_;
};

void draw_platter(Drawing& drawing, double z) {
  constexpr int kCorners = 60;
  std::vector<Eigen::Vector2d> edge;
  for (int i = 0; i < kCorners; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / kCorners;
    edge.push_back(seen({kPlatterRadius * std::cos(angle), kPlatterRadius * std::sin(angle), z}));
  }
  drawing.polygon(edge, "#f2f5f8");
}

/// The faces of the block that the eye sees.
void draw_block(Drawing& drawing, const Eigen::Matrix3d& directions) {
  constexpr std::array<const char*, 3> kShades{"#cfdbe6", "#b9cad9", "#e3ebf2"};
  for (Eigen::Index k = 0; k < 3; ++k) {
    const Eigen::Vector3d normal =
        directions.row(k).transpose() * (directions.row(k).dot(towards_eye()) > 0.0 ? 1.0 : -1.0);
    const Eigen::Index i = (k + 1) % 3, j = (k + 2) % 3;
    const auto edge = [&](Eigen::Index of) -> Eigen::Vector3d {
      return directions.row(of).transpose() * kHalfEdge[static_cast<std::size_t>(of)];
    };
    const Eigen::Vector3d centre = normal * kHalfEdge[static_cast<std::size_t>(k)];
    std::vector<Eigen::Vector2d> corners;
    for (const auto& [a, b] : {std::pair{1.0, 1.0}, {-1.0, 1.0}, {-1.0, -1.0}, {1.0, -1.0}})
      corners.push_back(seen(centre + a * edge(i) + b * edge(j)));
    drawing.polygon(corners, kShades[static_cast<std::size_t>(k)]);
  }
}

}  // namespace

Figure mounting_figure(const Eigen::Matrix3d& directions, const MountingWords& words) {
  Drawing drawing;
  double height = 0.0;  // Half the height of the block above the platter.
  for (Eigen::Index k = 0; k < 3; ++k)
    height += std::abs(directions(k, 2)) * kHalfEdge[static_cast<std::size_t>(k)];
  draw_platter(drawing, -height);
  const auto draw_output = [&](Eigen::Index k) {
    const Eigen::Vector3d direction = directions.row(k).transpose();
    const auto at = static_cast<std::size_t>(k);
    drawing.axis(seen(direction * kHalfEdge[at]), seen(direction * kArrow), kOutputNames[at], kColours[at]);
  };
  const auto is_hidden = [&](Eigen::Index k) { return directions.row(k).dot(towards_eye()) < 0.0; };
  for (Eigen::Index k = 0; k < 3; ++k)
    if (is_hidden(k)) draw_output(k);
  draw_block(drawing, directions);
  for (Eigen::Index k = 0; k < 3; ++k)
    if (!is_hidden(k)) draw_output(k);
  // The axes of the platter stand beside it, where u, v, w do not cover them.
  const Eigen::Vector2d origin(-2.5, -0.35);
  for (Eigen::Index k = 0; k < 3; ++k)
    drawing.axis(origin, seen(Eigen::Vector3d::Unit(k)), kPlatterAxes[static_cast<std::size_t>(k)], kDark);
  drawing.label(origin + seen(Eigen::Vector3d::UnitZ()) + Eigen::Vector2d(0.4, kLabelGap), words.up, kDark,
                kSmall);
  drawing.label(seen({0.0, 0.0, -height}) + Eigen::Vector2d(1.75, -0.45), words.platter, kDark, kSmall);
  return {words.caption, drawing.script(), kHeight};
}

}  // namespace abcal
