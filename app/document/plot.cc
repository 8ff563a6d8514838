#include "app/document/plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <utility>

#include "app/document/number_text.h"
#include "app/system/text_layout.h"

namespace abcal {
namespace {

constexpr const char* kGrid = "#d8d8d8";
constexpr const char* kFrame = "#404040";
/// Width of a letter over its size, on average and rather too large.
constexpr double kLetterWidth = 0.62;

double text_width(const std::string& text) {
  return kLetterWidth * kLetterSize * static_cast<double>(display_width(text));
}

/// An axis whose range, step and numbers are decided.
struct Scale {
  double low = 0.0, high = 1.0, step = 1.0;  ///< In the unit of the data.
  int exponent = 0;                          ///< The numbers count in this power of ten.
  int decimals = 0;

  double unit() const { return std::pow(10.0, exponent); }
  /// Part of the axis below a value.
  double part(double value) const { return (value - low) / (high - low); }
  std::vector<double> steps() const {
    // A number at an end may be off by the rounding of the end.
    constexpr double kRounding = 1e-9;
    std::vector<double> all;
    for (double k = std::ceil(low / step - kRounding); k * step <= high + kRounding * step; k += 1.0)
      all.push_back(k * step);
    return all;
  }
  std::string number(double value) const {
    return typeset_numbers(without_negative_zero(fmt::format("{:.{}f}", value / unit(), decimals)));
  }
};

/// 1, 2 or 5 times a power of ten: at most `most` of them in the range.
double round_step(double range, double most) {
  const double least = range / most, power = std::pow(10.0, std::floor(std::log10(least)));
  for (const double factor : {1.0, 2.0, 5.0})
    if (factor * power >= least) return factor * power;
  return 10.0 * power;
}

/// @param low, high  of the data
Scale scale_of(const PlotAxis& axis, double low, double high, double most_steps, bool may_count_in_powers) {
  Scale scale;
  if (!(low <= high)) low = high = 0.0;  // no data
  if (low == high) {
    const double room = low == 0.0 ? 1.0 : std::abs(low) / 2.0;
    low -= room;
    high += room;
  }
  constexpr double kRoom = 0.06;
  scale.low = axis.low.value_or(low - kRoom * (high - low));
  scale.high = axis.high.value_or(high + kRoom * (high - low));
  scale.step = axis.step > 0.0 ? axis.step : round_step(scale.high - scale.low, most_steps);
  // Numbers of 0.1 to 100 before the power, whose exponent is a multiple of 3.
  constexpr double kLeast = 0.1;
  const double largest = std::max(std::abs(scale.low), std::abs(scale.high));
  if (may_count_in_powers)
    scale.exponent = 3 * static_cast<int>(std::floor(std::log10(largest / kLeast) / 3.0));
  scale.decimals = std::max(0, -static_cast<int>(std::floor(std::log10(scale.step / scale.unit()) + 1e-9)));
  return scale;
}

/// "response (10⁻⁶ V)"
std::string label_of(const PlotAxis& axis, const Scale& scale) {
  std::string unit = axis.unit;
  if (scale.exponent != 0) unit = power_of_ten(scale.exponent) + (unit.empty() ? "" : " " + unit);
  if (axis.label.empty() || unit.empty()) return axis.label + unit;
  return fmt::format("{} ({})", axis.label, unit);
}

std::pair<double, double> range_of(const std::vector<PlotSeries>& series, bool of_x) {
  double low = HUGE_VAL, high = -HUGE_VAL;
  for (const PlotSeries& each : series)
    for (std::size_t i = 0; i < each.x.size(); ++i) {
      if (!std::isfinite(each.y[i])) continue;
      const double value = of_x ? each.x[i] : each.y[i];
      const double half = of_x || each.half_width.empty() ? 0.0 : each.half_width[i];
      low = std::min(low, value - half);
      high = std::max(high, value + half);
    }
  return {low, high};
}

std::vector<PicturePoint> outline(PlotMark mark, PicturePoint at, double radius) {
  // Corners, and the angle of the first one from above, clockwise.
  const auto polygon = [&](int corners, double size, double turned) {
    std::vector<PicturePoint> points;
    for (int k = 0; k < corners; ++k) {
      const double angle = 2.0 * std::numbers::pi * (k / static_cast<double>(corners) + turned);
      points.push_back({at[0] + size * std::sin(angle), at[1] - size * std::cos(angle)});
    }
    points.push_back(points.front());
    return points;
  };
  switch (mark) {
    case PlotMark::kDiamond:
      return polygon(4, 1.35 * radius, 0.0);
    case PlotMark::kTriangle:
    case PlotMark::kOpenTriangle:
      return polygon(3, 1.4 * radius, 0.0);
    case PlotMark::kTriangleDown:
      return polygon(3, 1.4 * radius, 0.5);
    case PlotMark::kNone:
    case PlotMark::kDisc:
    case PlotMark::kOpenCircle:
      break;
  }
  return polygon(16, radius, 0.0);
}

bool is_open(PlotMark mark) {
  return mark == PlotMark::kOpenCircle || mark == PlotMark::kOpenTriangle;
}

class PanelPen {
 public:
  PanelPen(const PlotPanel& panel, double left, double width, Drawing& drawing)
      : panel_(panel), drawing_(drawing) {
    const auto [x_low, x_high] = range_of(panel.series, true);
    const auto [y_low, y_high] = range_of(panel.series, false);
    constexpr double kGap = 8.0, kRow = 1.5 * kLetterSize;
    const bool has_top =
        !panel.title.empty() ||
        std::ranges::any_of(panel.series, [](const PlotSeries& each) { return !each.name.empty(); });
    top_ = has_top ? kRow + 2.0 : kGap;
    bottom_ = drawing.height - kRow - (panel.x.label.empty() ? 2.0 : kRow);
    constexpr double kRoomOfNumber = 2.4 * kLetterSize;
    y_ = scale_of(panel.y, y_low, y_high, (bottom_ - top_) / kRoomOfNumber, true);
    y_label_ = label_of(panel.y, y_);
    double widest = 0.0;
    for (const double value : y_.steps()) widest = std::max(widest, text_width(y_.number(value)));
    left_ = left + (y_label_.empty() ? 0.0 : kRow) + widest + kGap;
    label_at_ = left + kLetterSize;
    right_ = left + width - 1.5 * kGap;
    constexpr double kRoomOfWideNumber = 4.0 * kLetterSize;
    x_ = scale_of(panel.x, x_low, x_high, (right_ - left_) / kRoomOfWideNumber, false);
  }

  void draw() {
    grid();
    for (const PlotSeries& series : panel_.series) draw(series);
    frame();
    words();
  }

 private:
  double at_x(double x) const { return left_ + (right_ - left_) * x_.part(x); }
  double at_y(double y) const { return bottom_ - (bottom_ - top_) * y_.part(y); }
  void label(std::string text, PicturePoint at, double alignment, bool upwards = false) {
    drawing_.elements.emplace_back(
        PictureLabel{.text = std::move(text), .at = at, .alignment = alignment, .upwards = upwards});
  }
  void lines(std::vector<std::vector<PicturePoint>> all, const char* colour, double width) {
    drawing_.elements.emplace_back(PicturePath{.lines = std::move(all), .stroke = colour, .width = width});
  }

  void grid() {
    std::vector<std::vector<PicturePoint>> all;
    for (const double x : x_.steps()) all.push_back({{at_x(x), top_}, {at_x(x), bottom_}});
    for (const double y : y_.steps()) all.push_back({{left_, at_y(y)}, {right_, at_y(y)}});
    lines(std::move(all), kGrid, 0.7);
  }

  void frame() {
    constexpr double kTick = 4.0;
    std::vector<std::vector<PicturePoint>> all{
        {{left_, top_}, {right_, top_}, {right_, bottom_}, {left_, bottom_}, {left_, top_}}};
    for (const double x : x_.steps()) all.push_back({{at_x(x), bottom_}, {at_x(x), bottom_ - kTick}});
    for (const double y : y_.steps()) all.push_back({{left_, at_y(y)}, {left_ + kTick, at_y(y)}});
    lines(std::move(all), kFrame, 1.0);
  }

  void words() {
    constexpr double kBelow = 1.25 * kLetterSize, kMiddle = 0.36 * kLetterSize, kBeside = 4.0;
    const std::vector<std::string>& names = panel_.x.names;
    for (std::size_t k = 0; k < names.size(); ++k)
      label(names[k], {at_x(static_cast<double>(k + 1)), bottom_ + kBelow}, 0.5);
    if (names.empty())
      for (const double x : x_.steps()) label(x_.number(x), {at_x(x), bottom_ + kBelow}, 0.5);
    for (const double y : y_.steps()) label(y_.number(y), {left_ - kBeside, at_y(y) + kMiddle}, 1.0);
    const double middle = (left_ + right_) / 2.0, above = top_ - 0.5 * kLetterSize;
    if (!panel_.x.label.empty())
      label(label_of(panel_.x, x_), {middle, drawing_.height - 0.5 * kLetterSize}, 0.5);
    if (!y_label_.empty()) label(y_label_, {label_at_, (top_ + bottom_) / 2.0}, 0.5, true);
    double key = right_;
    for (auto series = panel_.series.rbegin(); series != panel_.series.rend(); ++series) {
      if (series->name.empty()) continue;
      label(series->name, {key, above}, 1.0);
      key -= text_width(series->name) + kLetterSize;
      marks(*series, {{key + 0.5 * kLetterSize, above - kMiddle}});
      key -= kLetterSize;
    }
    const bool has_key = key < right_;
    if (!panel_.title.empty()) label(panel_.title, {has_key ? left_ : middle, above}, has_key ? 0.0 : 0.5);
  }

  void marks(const PlotSeries& series, const std::vector<PicturePoint>& places) {
    PicturePath path;
    for (const PicturePoint& at : places) path.lines.push_back(outline(series.mark, at, series.mark_radius));
    (is_open(series.mark) ? path.stroke : path.fill) = series.colour;
    drawing_.elements.emplace_back(std::move(path));
  }

  /// A series within the frame.
  void draw(const PlotSeries& series) {
    std::vector<PicturePoint> places, upper, lower;
    std::vector<std::vector<PicturePoint>> bars;
    const auto inside = [&](double y) { return at_y(std::clamp(y, y_.low, y_.high)); };
    for (std::size_t i = 0; i < series.x.size(); ++i) {
      if (!std::isfinite(series.y[i]) || x_.part(series.x[i]) < 0.0 || x_.part(series.x[i]) > 1.0) continue;
      places.push_back({at_x(series.x[i]), inside(series.y[i])});
      if (series.half_width.empty()) continue;
      const PicturePoint low{places.back()[0], inside(series.y[i] - series.half_width[i])};
      const PicturePoint high{low[0], inside(series.y[i] + series.half_width[i])};
      if (series.line) {
        lower.push_back(low);
        upper.push_back(high);
      } else if (low[1] != high[1]) {
        bars.push_back({low, high});
      }
    }
    if (places.empty()) return;
    if (!upper.empty()) {
      constexpr double kBand = 0.25;
      upper.insert(upper.end(), lower.rbegin(), lower.rend());
      drawing_.elements.emplace_back(
          PicturePath{.lines = {upper}, .stroke = {}, .fill = series.colour, .opacity = kBand});
    }
    if (!bars.empty()) lines(std::move(bars), series.colour.c_str(), 1.0);
    if (series.line) lines({places}, series.colour.c_str(), 1.0);
    if (series.mark != PlotMark::kNone) marks(series, places);
  }

  const PlotPanel& panel_;
  Drawing& drawing_;
  double left_ = 0.0, right_ = 0.0, top_ = 0.0, bottom_ = 0.0, label_at_ = 0.0;
  Scale x_, y_;
  std::string y_label_;
};

}  // namespace

Drawing plot(const std::vector<PlotPanel>& panels, double height) {
  Drawing drawing{height, {}};
  const double width = kPictureWidth / static_cast<double>(panels.size());
  double left = 0.0;
  for (const PlotPanel& panel : panels) {
    PanelPen(panel, left, width, drawing).draw();
    left += width;
  }
  return drawing;
}

}  // namespace abcal
