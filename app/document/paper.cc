#include "app/document/paper.h"

#include <algorithm>
#include <cstddef>
#include <iterator>
#include <utility>

namespace abcal {
namespace {

/// Pieces in the order of their places.
class Pages {
 public:
  explicit Pages(double height) : height_(height), pages_(1) {}

  /// Whether a block of pieces fits below the last one.
  bool fits(const Piece* first, const Piece* end) const {
    double y = y_, below = below_;
    bool at_head = pages_.back().empty();
    for (const Piece* piece = first; piece != end; ++piece) {
      y += (at_head ? 0.0 : std::max(below, piece->above)) + piece->height;
      below = piece->below;
      at_head = false;
    }
    constexpr double kRounding = 1e-6;
    return y <= height_ + kRounding;
  }

  bool is_at_head() const { return pages_.back().empty(); }

  void new_page(const Piece& next) {
    pages_.emplace_back();
    y_ = below_ = 0.0;
    if (next.head) place(*next.head, true);
  }

  void place(const Piece& piece, bool is_repeated = false) {
    if (!is_at_head()) y_ += std::max(below_, piece.above);
    pages_.back().push_back({&piece, y_, is_repeated});
    y_ += piece.height;
    below_ = piece.below;
  }

  std::vector<std::vector<PlacedPiece>> take() && { return std::move(pages_); }

 private:
  double height_, y_ = 0.0, below_ = 0.0;
  std::vector<std::vector<PlacedPiece>> pages_;
};

/// Opens and closes elements of the structure as the pieces need them.
class OpenTags {
 public:
  explicit OpenTags(cairo_t* cairo) : cairo_(cairo) {}
  void become(const std::vector<PaperTag>& tags) {
    const auto same =
        std::mismatch(open_.begin(), open_.end(), tags.begin(), tags.end()).first - open_.begin();
    while (std::ssize(open_) > same) {
      cairo_tag_end(cairo_, open_.back().name.c_str());
      open_.pop_back();
    }
    for (std::size_t k = open_.size(); k < tags.size(); ++k) {
      cairo_tag_begin(cairo_, tags[k].name.c_str(), nullptr);
      open_.push_back(tags[k]);
    }
  }

 private:
  cairo_t* cairo_;
  std::vector<PaperTag> open_;
};

}  // namespace

void PaperPen::in_element(const char* name, const std::function<void()>& draw) const {
  if (is_artifact) return draw();
  cairo_tag_begin(cairo, name, nullptr);
  draw();
  cairo_tag_end(cairo, name);
}

void PaperPen::as_artifact(const std::function<void()>& draw) const {
  // Before 1.18 cairo has no artifacts, and what is drawn outside every element has no mark.
  if (is_artifact || cairo_version() < CAIRO_VERSION_ENCODE(1, 18, 0)) return draw();
  in_element("Artifact", draw);
}

std::vector<std::vector<PlacedPiece>> pages_of(const std::vector<Piece>& pieces, double height_of_page) {
  Pages pages(height_of_page);
  const Piece* const all_end = pieces.data() + pieces.size();
  for (const Piece* first = pieces.data(); first != all_end;) {
    const Piece* end = first + 1;
    while (end != all_end && (end - 1)->keep_with_next && !end->on_new_page) ++end;
    if (!pages.is_at_head() && (first->on_new_page || !pages.fits(first, end))) pages.new_page(*first);
    for (; first != end; ++first) {
      if (!pages.is_at_head() && !pages.fits(first, first + 1)) pages.new_page(*first);
      pages.place(*first);
    }
  }
  return std::move(pages).take();
}

void draw_pages(cairo_t* cairo, const std::vector<std::vector<PlacedPiece>>& pages, double top,
                const std::function<void(int number)>& draw_margins) {
  OpenTags tags(cairo);
  int number = 0;
  for (const std::vector<PlacedPiece>& page : pages) {
    PaperPen{cairo}.as_artifact([&] { draw_margins(++number); });
    for (const auto& [piece, y, is_repeated] : page) {
      const auto draw = [&, at = top + y, of = piece](bool is_artifact) {
        of->draw({cairo, is_artifact}, at);
      };
      if (is_repeated) {
        PaperPen{cairo}.as_artifact([&] { draw(true); });
      } else {
        tags.become(piece->tags);
        draw(false);
      }
    }
    if (number == std::ssize(pages)) tags.become({});
    cairo_show_page(cairo);
  }
}

}  // namespace abcal
