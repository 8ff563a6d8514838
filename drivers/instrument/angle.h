#pragma once

#include <cmath>
#include <compare>
#include <numbers>

namespace abcal {

/// A plane angle. Held in degrees, because every commanded angle of the protocol is an exact number of
/// degrees and a full turn must return exactly (sin of 180 degrees is 0, not 1.2e-16).
class Angle {
 public:
  constexpr Angle() = default;
  static constexpr Angle degrees(double degrees) { return Angle(degrees); }
  static constexpr Angle radians(double radians) { return Angle(radians * (180.0 / std::numbers::pi)); }

  constexpr double deg() const { return deg_; }
  constexpr double rad() const { return deg_ * (std::numbers::pi / 180.0); }

  constexpr Angle operator-() const { return Angle(-deg_); }
  constexpr Angle operator+(Angle other) const { return Angle(deg_ + other.deg_); }
  constexpr Angle operator-(Angle other) const { return Angle(deg_ - other.deg_); }
  constexpr Angle operator*(double factor) const { return Angle(deg_ * factor); }
  constexpr Angle& operator+=(Angle other) { return deg_ += other.deg_, *this; }
  constexpr auto operator<=>(const Angle&) const = default;

 private:
  explicit constexpr Angle(double degrees) : deg_(degrees) {}
  double deg_ = 0.0;
};

/// Sine and cosine of one angle.
struct SinCos {
  double sin = 0.0;
  double cos = 1.0;
};

/// Sine and cosine with the angle reduced, exactly, in degrees before it is converted to radians
/// (the habit of GeographicLib's sincosd): multiples of 90 degrees give exactly 0 and +-1.
inline SinCos sincos(Angle angle) {
  int quadrant = 0;
  const double reduced = std::remquo(angle.deg(), 90.0, &quadrant);  // in [-45, 45], exact
  const double r = reduced * (std::numbers::pi / 180.0);
  const double s = std::sin(r);
  const double c = std::cos(r);
  switch (static_cast<unsigned>(quadrant) & 3U) {
    case 0U:
      return {s, c};
    case 1U:
      return {c, 0.0 - s};
    case 2U:
      return {0.0 - s, 0.0 - c};
    default:
      return {0.0 - c, s};
  }
}

}  // namespace abcal
