#include "protocol/estimators/circle/two_faces.h"

#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include "protocol/linear/products.h"
#include "protocol/plan/faces.h"

namespace abcal {
namespace {

constexpr int kOfOutput = 4;  // s_jx, s_jy, s_jz, O_j

Eigen::Index place_in_outputs(int output, int i) {
  return i < 3 ? s_index(output, i) : offset_index(output);
}

/// The readings of one face.
ReadingSeries series_of_face(const ReadingSeries& both, std::span<const DwellRecord* const> dwells,
                             int face) {
  ReadingSeries out;
  out.experiment = both.experiment;
  out.accelerometer = both.accelerometer;
  out.place_of.assign(both.place_of.size(), -1);
  for (std::size_t i = 0; i < dwells.size(); ++i) {
    if (both.place_of[i] < 0 || dwells[i]->face != face) continue;
    const auto from = static_cast<std::size_t>(both.place_of[i]);
    out.place_of[i] = static_cast<int>(out.readings.size());
    out.alpha.push_back(both.alpha[from]);
    out.readings.push_back(both.readings[from]);
    if (!both.u.empty()) out.u.push_back(both.u[from]);
  }
  return out;
}

/// Adds the derivatives of the ABC result of an output (rows: s_jx, s_jy, s_jz, O_j) by its readings of one
/// experiment (columns: dwells).
void add_derivatives(const ReadingSeries& series, const HarmonicFit& fit, Eigen::MatrixXd& by_reading) {
  // The fit's order is constant, sin, cos; that of the equations A (sin), B (cos), C.
  constexpr std::array<std::pair<AbcTerm, Eigen::Index>, 3> kTerms{{{kA, 1}, {kB, 2}, {kC, 0}}};
  for (int i = 0; i < kOfOutput; ++i) {
    const Eigen::Index row = place_in_outputs(series.accelerometer, i);
    for (const auto& [term, coefficient] : kTerms) {
      const double factor = abc_equations()(row, abc_index(series.experiment, series.accelerometer, term));
      for (std::size_t n = 0; n < series.place_of.size(); ++n) {
        if (const int place = series.place_of[n]; place >= 0)
          by_reading(i, static_cast<Eigen::Index>(n)) += factor * fit.estimator(coefficient, place);
      }
    }
  }
}

/// Readings of one output, and the derivatives of its results: of both faces, of face 1, of face 2.
struct OutputReadings {
  Eigen::VectorXd cleaned;   ///< R, by dwell.
  Eigen::VectorXd variance;  ///< R^2; NaN: the scatter is not known.
  Eigen::MatrixXd together;  ///< 4 x dwells.
  std::array<Eigen::MatrixXd, kFaces> alone;
};

OutputReadings readings_of(const BothFaces& both, std::size_t output) {
  const auto count = static_cast<Eigen::Index>(both.dwells.size());
  OutputReadings out;
  out.cleaned = Eigen::VectorXd::Zero(count);
  out.variance = Eigen::VectorXd::Constant(
      count, both.reading_variance[output].value_or(std::numeric_limits<double>::quiet_NaN()));
  out.together = Eigen::MatrixXd::Zero(kOfOutput, count);
  out.alone.fill(out.together);
  for (std::size_t i = output; i < both.cleaned.size(); i += 3) {
    const ReadingSeries& series = both.cleaned[i];
    add_derivatives(series, both.fits[i], out.together);
    for (std::size_t n = 0; n < series.place_of.size(); ++n) {
      if (series.place_of[n] < 0) continue;
      const auto place = static_cast<std::size_t>(series.place_of[n]);
      out.cleaned(static_cast<Eigen::Index>(n)) = series.readings[place];
      if (!series.u.empty()) out.variance(static_cast<Eigen::Index>(n)) = series.u[place] * series.u[place];
    }
    for (int face = 1; face <= kFaces; ++face) {
      const ReadingSeries own = series_of_face(series, both.dwells, face);
      add_derivatives(own, fit_harmonics(own.alpha, own.readings, own.u, 1),
                      out.alone.at(static_cast<std::size_t>(face - 1)));
    }
  }
  return out;
}

Eigen::Vector4d type_a(const Eigen::MatrixXd& by_reading, const OutputReadings& readings) {
  return product_with_vector(by_reading.cwiseAbs2(), readings.variance);
}

/// Type B variances of four linear functions of the readings of one output.
class FunctionVariances {
 public:
  FunctionVariances(const BothFaces& both, int output) : both_(both), output_(output) {}

  /// @param is_result  the functions are the results themselves: less the effects by way of k2 and k3, and
  /// less the change of the measurand
  Eigen::Vector4d type_b(const Eigen::MatrixXd& by_reading, bool is_result) const {
    Eigen::Vector4d sum = by_reading.rowwise().squaredNorm() * (both_.resolution * both_.resolution / 12.0);
    for (const InputEffect& effect : both_.effects) {
      Eigen::Vector4d change = Eigen::Vector4d::Zero();
      for (std::size_t n = 0; n < effect.effect.size(); ++n)
        change +=
            by_reading.col(static_cast<Eigen::Index>(effect.first_reading + n)) * effect.effect[n](output_);
      if (is_result) change -= through_the_item(effect);
      sum += (effect.standard_uncertainty * change).cwiseAbs2();
    }
    return sum;
  }

 private:
  Eigen::Vector4d through_the_item(const InputEffect& effect) const {
    const Eigen::Matrix<double, 12, 1> change =
        product_with_vector(both_.curvature->correction(),
                            both_.curvature->change_of_k(effect.first_reading, effect.effect)) +
        effect.line;
    Eigen::Vector4d out;
    for (int i = 0; i < kOfOutput; ++i) out(i) = change(place_in_outputs(output_, i));
    return out;
  }

  const BothFaces& both_;
  int output_;
};

/// Fills the row of one output.
void fill_row(LineResult& line, std::size_t output, const BothFaces& both,
              const std::array<Eigen::Vector4d, 3>& value_a_b) {
  const auto& [value, a, b] = value_a_b;
  for (int i = 0; i < kOfOutput; ++i) {
    Quantity& quantity =
        i < 3 ? line.sensitivity_matrix[output][static_cast<std::size_t>(i)] : line.offset[output];
    quantity.value = value(i);
    quantity.unit = i < 3 ? both.per_g : both.response_unit;
    quantity.type_b = std::sqrt(b(i));
    if (std::isfinite(a(i))) quantity.type_a = std::sqrt(a(i));
    quantity.standard_uncertainty = std::sqrt(b(i) + (quantity.type_a ? a(i) : 0.0));
  }
}

}  // namespace

FaceResults results_of_faces(const BothFaces& both) {
  FaceResults out;
  for (int j = 0; j < 3; ++j) {
    const auto output = static_cast<std::size_t>(j);
    const OutputReadings readings = readings_of(both, output);
    const FunctionVariances variances(both, j);
    Eigen::Vector4d result;
    for (int i = 0; i < kOfOutput; ++i) result(i) = both.outputs(place_in_outputs(j, i));
    for (std::size_t face = 0; face < kFaces; ++face) {
      const Eigen::MatrixXd& own = readings.alone.at(face);
      const Eigen::Vector4d deviation = product_with_vector(own - readings.together, readings.cleaned);
      fill_row(out.face.at(face), output, both,
               {result + deviation, type_a(own, readings), variances.type_b(own, true)});
    }
    const Eigen::MatrixXd difference = readings.alone[0] - readings.alone[1];
    fill_row(out.difference, output, both,
             {product_with_vector(difference, readings.cleaned), type_a(difference, readings),
              variances.type_b(difference, false)});
  }
  return out;
}

}  // namespace abcal
