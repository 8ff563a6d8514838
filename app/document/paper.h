#pragma once

#include <cairo/cairo.h>

#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace abcal {

/// An element of the structure of a PDF (ISO 32000-1, 14.8.4) that contains pieces: "Table", "TR".
struct PaperTag {
  std::string name;
  int number = 0;  ///< Pieces one after the other with the same number are in the same element.
  bool operator==(const PaperTag&) const = default;
};

/// The means of drawing on pages.
struct PaperPen {
  cairo_t* cairo = nullptr;
  bool is_artifact =
      false;  ///< The drawing is no part of the content: a page number, a head that is repeated.

  /// Draws within an element of the structure.
  void in_element(const char* name, const std::function<void()>& draw) const;
  /// Draws what is no part of the content.
  void as_artifact(const std::function<void()>& draw) const;
};

/// A piece of a page that is never broken. Lengths are points.
struct Piece {
  double height = 0.0;
  double above = 0.0, below = 0.0;  ///< Room that two pieces share; none at the head of a page.
  bool keep_with_next = false;
  bool on_new_page = false;
  std::vector<PaperTag> tags = {};                          ///< From the outermost.
  std::function<void(const PaperPen& pen, double y)> draw;  ///< `y` is its top.
  /// Repeated where a page begins with this piece: the head of its table.
  std::shared_ptr<const Piece> head = {};
};

/// A piece and its place.
struct PlacedPiece {
  const Piece* piece = nullptr;
  double y = 0.0;  ///< Below the top of the content.
  bool is_repeated = false;
};

/// Distributes pieces to pages. Pieces that are kept together begin a new page where they do not fit on the
/// rest of one; those that fit on no page are broken.
std::vector<std::vector<PlacedPiece>> pages_of(const std::vector<Piece>& pieces, double height_of_page);

/// Draws one page after the other, in elements of the structure that go on over pages.
/// @param draw_margins  draws what every page has; numbers from 1
void draw_pages(cairo_t* cairo, const std::vector<std::vector<PlacedPiece>>& pages, double top,
                const std::function<void(int number)>& draw_margins);

}  // namespace abcal
