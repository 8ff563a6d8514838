#include "protocol/uncertainty/random_shapes.h"

#include <cmath>
#include <numbers>

namespace abcal {

double standard_draw(Shape shape, RandomStream& stream) {
  switch (shape) {
    case Shape::kRectangular:
      return std::numbers::sqrt3 * (2.0 * stream.uniform() - 1.0);
    case Shape::kTriangular: {
      const double first = stream.uniform();
      return std::sqrt(6.0) * (first + stream.uniform() - 1.0);
    }
    case Shape::kUShaped:
      return std::numbers::sqrt2 * std::sin(2.0 * std::numbers::pi * stream.uniform());
    case Shape::kNormal:
      break;
  }
  return stream.normal();
}

double chi2_draw(double degrees_of_freedom, RandomStream& stream) {
  const double d = 0.5 * degrees_of_freedom - 1.0 / 3.0;
  const double c = 1.0 / std::sqrt(9.0 * d);
  while (true) {
    const double z = stream.normal();
    const double root = 1.0 + c * z;
    const double v = root * root * root;
    if (!(v > 0.0)) continue;
    if (std::log(stream.uniform()) < 0.5 * z * z + d * (1.0 - v + std::log(v))) return 2.0 * d * v;
  }
}

double student_t_draw(double degrees_of_freedom, RandomStream& stream) {
  const double z = stream.normal();
  if (!std::isfinite(degrees_of_freedom)) return z;
  return z / std::sqrt(chi2_draw(degrees_of_freedom, stream) / degrees_of_freedom);
}

}  // namespace abcal
