#pragma once

#include <pango/pangocairo.h>

#include <memory>
#include <string>
#include <vector>

#include "app/document/page_text.h"

namespace abcal {

struct FreeGObject {
  void operator()(gpointer object) const { g_object_unref(object); }
};

/// A colour as 0xRRGGBB.
using PaperColour = unsigned;
inline constexpr PaperColour kInk = 0x1a1a1a;

/// Sets the colour and opacity of what is drawn next.
void set_colour(cairo_t* cairo, PaperColour colour, double opacity = 1.0);

/// How a text is set. Lengths are points (1/72 inch).
struct TextStyle {
  double size = 8.6;
  double leading = 1.4;  ///< Distance of base lines over size.
  bool bold = false;
  PaperColour colour = kInk;
  double alignment = 0.0;  ///< 0: left, 0.5: middle, 1: right.
};

/// Sets texts in one language, by Pango. Positions are not rounded to a grid of a screen.
class TextSetter {
 public:
  /// @param language  ISO 639-1
  explicit TextSetter(const std::string& language);
  PangoContext* context() const { return context_.get(); }

 private:
  std::unique_ptr<PangoContext, FreeGObject> context_;
};

/// A text in lines.
class TextLines {
 public:
  /// All in one line.
  TextLines(const TextSetter& setter, const std::vector<TextRun>& runs, const TextStyle& style);
  TextLines(const TextSetter& setter, const std::string& text, const TextStyle& style)
      : TextLines(setter, std::vector<TextRun>{{text}}, style) {}

  /// Breaks lines that are longer than `room`, and aligns them in it.
  TextLines& fit(double room);
  int count() const { return pango_layout_get_line_count(layout_.get()); }
  double line_height() const { return style_.size * style_.leading; }
  double height() const { return count() * line_height(); }
  /// Width of the longest line.
  double width() const;
  /// From the top of a line to its base line.
  double base() const;
  /// Draws the lines from `first` to the one before `end`.
  /// @param x, y  left end and top of the first line drawn
  void draw(cairo_t* cairo, double x, double y, int first, int end) const;
  void draw(cairo_t* cairo, double x, double y) const { draw(cairo, x, y, 0, count()); }

 private:
  std::unique_ptr<PangoLayout, FreeGObject> layout_;
  TextStyle style_;
  double room_;
};

}  // namespace abcal
