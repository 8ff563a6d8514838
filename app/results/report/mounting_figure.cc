#include "app/results/report/mounting_figure.h"

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "drivers/text/letters.h"

namespace abcal {
namespace {

constexpr double kDrawingHeight = 165.0;
// Units of the picture in a unit of space, and the height that stands in its middle.
constexpr double kScale = 57.0, kMiddleHeight = 0.05;
// The eye sees x to the right and towards it, y to the right and away, z up.
constexpr double kAzimuth = -55.0 * std::numbers::pi / 180.0, kElevation = 25.0 * std::numbers::pi / 180.0;
/// Half the edges of the block along u, v, w: unequal, so that its position can be seen.
constexpr std::array<double, 3> kHalfEdge{0.55, 0.4, 0.25};
constexpr double kLarge = 15.0, kSmall = 13.0;  // Heights of letters.
constexpr double kPlatterRadius = 1.25, kArrow = 0.8, kLabelGap = 0.2;
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

/// At most this many letters of UTF-8.
std::string shortened(const std::string& text, std::size_t most) {
  std::size_t letters = 0;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if ((static_cast<unsigned char>(text[i]) & 0xC0U) == 0x80U) continue;
    if (letters++ == most) return text.substr(0, i) + "…";
  }
  return text;
}

class Pen {
 public:
  void polygon(const std::vector<Eigen::Vector2d>& corners, const std::string& fill) {
    PicturePath path{.lines = {{}}, .stroke = kDark, .fill = fill};
    for (const Eigen::Vector2d& corner : corners) path.lines[0].push_back(place(corner));
    drawing_.elements.emplace_back(std::move(path));
  }
  void arrow(const Eigen::Vector2d& from, const Eigen::Vector2d& by, const std::string& colour) {
    constexpr double kWidth = 2.5, kHead = 0.21, kHalfHead = 0.07;
    const double length = by.norm();
    const Eigen::Vector2d to = from + by;
    if (length < kHead) return;
    const Eigen::Vector2d along = by / length, across(-along[1], along[0]);
    const Eigen::Vector2d base = to - kHead * along;
    drawing_.elements.emplace_back(
        PicturePath{.lines = {{place(from), place(base)}}, .stroke = colour, .width = kWidth});
    drawing_.elements.emplace_back(PicturePath{
        .lines = {{place(to), place(base + kHalfHead * across), place(base - kHalfHead * across)}},
        .stroke = {},
        .fill = colour});
  }
  void label(const Eigen::Vector2d& at, const std::string& text, const std::string& colour,
             double size = kLarge) {
    // The middle of a letter is at the place.
    constexpr double kMiddle = 0.36;
    auto [x, y] = place(at);
    drawing_.elements.emplace_back(
        PictureLabel{.text = text, .at = {x, y + kMiddle * size}, .size = size, .colour = colour});
  }
  /// Words to the right of the picture, with a line from the place that they are about. Long ones are cut:
  /// the page has them in full.
  void note(const Eigen::Vector2d& about, double height, const std::string& text) {
    if (text.empty()) return;
    constexpr double kLeft = 1.75;
    constexpr std::size_t kMostLetters = 44;
    const auto [x, y] = place({kLeft, height});
    drawing_.elements.emplace_back(
        PicturePath{.lines = {{place(about), {x - 4.0, y}}}, .stroke = kDark, .width = 0.7});
    drawing_.elements.emplace_back(PictureLabel{.text = shortened(text, kMostLetters),
                                                .at = {x, y + 4.0},
                                                .alignment = 0.0,
                                                .size = kSmall,
                                                .colour = kDark});
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
  Drawing drawing() && { return std::move(drawing_); }

 private:
  static PicturePoint place(const Eigen::Vector2d& at) {
    return {kPictureWidth / 2.0 + kScale * at[0], kDrawingHeight / 2.0 - kScale * (at[1] - kMiddleHeight)};
  }
  Drawing drawing_{kDrawingHeight, {}};
};

void draw_platter(Pen& pen, double z) {
  constexpr int kCorners = 60;
  std::vector<Eigen::Vector2d> edge;
  for (int i = 0; i < kCorners; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / kCorners;
    edge.push_back(seen({kPlatterRadius * std::cos(angle), kPlatterRadius * std::sin(angle), z}));
  }
  pen.polygon(edge, "#f2f5f8");
}

/// The faces of the block that the eye sees.
void draw_block(Pen& pen, const Eigen::Matrix3d& directions) {
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
    pen.polygon(corners, kShades[static_cast<std::size_t>(k)]);
  }
}

}  // namespace

Figure mounting_figure(const Eigen::Matrix3d& directions, const MountingWords& words) {
  Pen pen;
  double height = 0.0;  // Half the height of the block above the platter.
  for (Eigen::Index k = 0; k < 3; ++k)
    height += std::abs(directions(k, 2)) * kHalfEdge[static_cast<std::size_t>(k)];
  draw_platter(pen, -height);
  const auto draw_output = [&](Eigen::Index k) {
    const Eigen::Vector3d direction = directions.row(k).transpose();
    const auto at = static_cast<std::size_t>(k);
    pen.axis(seen(direction * kHalfEdge[at]), seen(direction * kArrow), kOutputNames[at], kColours[at]);
  };
  const auto is_hidden = [&](Eigen::Index k) { return directions.row(k).dot(towards_eye()) < 0.0; };
  for (Eigen::Index k = 0; k < 3; ++k)
    if (is_hidden(k)) draw_output(k);
  draw_block(pen, directions);
  for (Eigen::Index k = 0; k < 3; ++k)
    if (!is_hidden(k)) draw_output(k);
  const Eigen::Vector3d front = towards_eye() - Eigen::Vector3d::UnitZ() * towards_eye().z();
  pen.note(seen(0.45 * front.normalized() - Eigen::Vector3d::UnitZ() * height), -0.05, words.surface);
  pen.note(seen(Eigen::Vector3d::UnitZ() * height), 0.95, words.marks);
  // The axes of the platter stand beside it, where u, v, w do not cover them.
  const Eigen::Vector2d origin(-2.5, -0.35);
  for (Eigen::Index k = 0; k < 3; ++k)
    pen.axis(origin, seen(Eigen::Vector3d::Unit(k)), kPlatterAxes[static_cast<std::size_t>(k)], kDark);
  pen.label(origin + seen(Eigen::Vector3d::UnitZ()) + Eigen::Vector2d(0.4, kLabelGap), words.up, kDark,
            kSmall);
  pen.label(seen({0.0, 0.0, -height}) + Eigen::Vector2d(1.75, -0.45), words.platter, kDark, kSmall);
  return {words.caption, std::move(pen).drawing()};
}

}  // namespace abcal
