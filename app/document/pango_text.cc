#include "app/document/pango_text.h"

#include <algorithm>
#include <cmath>

#include "app/document/valid_text.h"

namespace abcal {
namespace {

constexpr const char* kFamily = "DejaVu Sans, Liberation Sans, Arial, sans-serif";

int pango_units(double points) {
  return static_cast<int>(std::lround(points * PANGO_SCALE));
}

double points(int pango) {
  return static_cast<double>(pango) / PANGO_SCALE;
}

void add(PangoAttrList* list, PangoAttribute* attribute, std::size_t from, std::size_t to) {
  attribute->start_index = static_cast<guint>(from);
  attribute->end_index = static_cast<guint>(to);
  pango_attr_list_insert(list, attribute);
}

}  // namespace

void set_colour(cairo_t* cairo, PaperColour colour, double opacity) {
  constexpr double kMost = 255.0;
  cairo_set_source_rgba(cairo, ((colour >> 16) & 0xff) / kMost, ((colour >> 8) & 0xff) / kMost,
                        (colour & 0xff) / kMost, opacity);
}

TextSetter::TextSetter(const std::string& language)
    : context_(pango_font_map_create_context(pango_cairo_font_map_get_default())) {
  pango_context_set_language(context_.get(), pango_language_from_string(language.c_str()));
  const std::unique_ptr<cairo_font_options_t, decltype(&cairo_font_options_destroy)> options(
      cairo_font_options_create(), cairo_font_options_destroy);
  cairo_font_options_set_hint_style(options.get(), CAIRO_HINT_STYLE_NONE);
  cairo_font_options_set_hint_metrics(options.get(), CAIRO_HINT_METRICS_OFF);
  pango_cairo_context_set_font_options(context_.get(), options.get());
  pango_context_set_round_glyph_positions(context_.get(), FALSE);
}

TextLines::TextLines(const TextSetter& setter, const std::vector<TextRun>& runs, const TextStyle& style)
    : layout_(pango_layout_new(setter.context())), style_(style) {
  const std::unique_ptr<PangoFontDescription, decltype(&pango_font_description_free)> font(
      pango_font_description_new(), pango_font_description_free);
  pango_font_description_set_family_static(font.get(), kFamily);
  pango_font_description_set_absolute_size(font.get(), pango_units(style.size));
  pango_font_description_set_weight(font.get(), style.bold ? PANGO_WEIGHT_BOLD : PANGO_WEIGHT_NORMAL);
  pango_layout_set_font_description(layout_.get(), font.get());
  const std::unique_ptr<PangoAttrList, decltype(&pango_attr_list_unref)> attributes(pango_attr_list_new(),
                                                                                    pango_attr_list_unref);
  constexpr double kIndexSize = 0.93, kIndexBelow = 0.18;
  // A ligature would be one sign for programs that read the text.
  pango_attr_list_insert(attributes.get(), pango_attr_font_features_new("liga 0"));
  std::string text;
  for (const TextRun& run : runs) {
    const std::size_t from = text.size();
    text += valid_text(run.text);
    if (!run.is_index) continue;
    add(attributes.get(), pango_attr_size_new_absolute(pango_units(kIndexSize * style.size)), from,
        text.size());
    add(attributes.get(), pango_attr_rise_new(pango_units(-kIndexBelow * style.size)), from, text.size());
  }
  std::replace(text.begin(), text.end(), '\n', ' ');
  pango_layout_set_attributes(layout_.get(), attributes.get());
  // A word that is wider than the line is broken anywhere.
  pango_layout_set_wrap(layout_.get(), PANGO_WRAP_WORD_CHAR);
  pango_layout_set_text(layout_.get(), text.data(), static_cast<int>(text.size()));
  room_ = width();
}

TextLines& TextLines::fit(double room) {
  constexpr double kRounding = 0.01;
  room_ = room;
  if (width() > room + kRounding) pango_layout_set_width(layout_.get(), pango_units(room));
  return *this;
}

double TextLines::width() const {
  PangoRectangle logical{};
  pango_layout_get_extents(layout_.get(), nullptr, &logical);
  return points(logical.width);
}

double TextLines::base() const {
  // The letters stand in the middle of the line, as on a page of HTML.
  constexpr double kAscent = 0.928, kDescent = 0.236;  // DejaVu Sans, over its size.
  return (line_height() + (kAscent - kDescent) * style_.size) / 2.0;
}

void TextLines::draw(cairo_t* cairo, double x, double y, int first, int end) const {
  set_colour(cairo, style_.colour);
  for (int k = first; k < end; ++k) {
    PangoLayoutLine* line = pango_layout_get_line_readonly(layout_.get(), k);
    PangoRectangle logical{};
    pango_layout_line_get_extents(line, nullptr, &logical);
    cairo_move_to(cairo, x + style_.alignment * (room_ - points(logical.width)),
                  y + (k - first) * line_height() + base());
    pango_cairo_show_layout_line(cairo, line);
  }
}

}  // namespace abcal
