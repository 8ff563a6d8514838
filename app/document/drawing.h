#pragma once

#include <array>
#include <string>
#include <variant>
#include <vector>

namespace abcal {

/// A place on a picture: x to the right, y down. A picture is kPictureWidth wide.
using PicturePoint = std::array<double, 2>;

inline constexpr double kPictureWidth = 800.0;
/// Height of common letters on a picture.
inline constexpr double kLetterSize = 13.0;

/// Lines or outlines that look alike.
struct PicturePath {
  std::vector<std::vector<PicturePoint>> lines;
  std::string stroke;     ///< "#rrggbb"; empty: no line.
  double width = 1.0;     ///< Thickness of the line.
  std::string fill = {};  ///< "#rrggbb"; empty: not filled. A filled line is closed.
  double opacity = 1.0;   ///< Opacity of the fill.
};

struct PictureLabel {
  std::string text;
  PicturePoint at{};       ///< On its base line.
  double alignment = 0.5;  ///< Part of the text before `at`: 0 (it begins there), 0.5, or 1 (it ends there).
  double size = kLetterSize;
  std::string colour = "#202020";
  bool upwards = false;  ///< It reads from below to above.
};

/// A picture: what a pen draws, in this order.
struct Drawing {
  double height = 300.0;  ///< Height of a picture that is kPictureWidth wide.
  std::vector<std::variant<PicturePath, PictureLabel>> elements;
};

}  // namespace abcal
