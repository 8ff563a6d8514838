#include "app/library/python/arrays.h"

#include <array>
#include <stdexcept>

namespace abcal::python {
namespace {

using Strided = py::array_t<double>;

py::array without_writing(py::array array) {
  py::detail::array_proxy(array.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
  return array;
}

std::string shape_of(const py::array& array) {
  return py::str(array.attr("shape")).cast<std::string>();
}

/// Numbers as they lie in memory where they are doubles already; else a copy.
Strided numbers(const py::object& given, const char* name) {
  try {
    return py::module_::import("numpy").attr("asarray")(given, "float64").cast<Strided>();
  } catch (py::error_already_set& error) {
    if (!error.matches(PyExc_TypeError) && !error.matches(PyExc_ValueError)) throw;
    throw std::invalid_argument(
        std::string(name) + ": found " + py::str(py::type::of(given).attr("__name__")).cast<std::string>() +
        " (" + py::str(error.value()).cast<std::string>() + "); required: an array of numbers");
  }
}

[[noreturn]] void wrong_shape(const char* name, const py::array& found, const std::string& required) {
  throw std::invalid_argument(std::string(name) + ": found shape " + shape_of(found) +
                              "; required: " + required);
}

constexpr py::ssize_t kDouble = sizeof(double);

/// Shape (M, 3) of (M, 3) or (3, N, 3); a view where the memory allows it.
Strided as_rows(const Strided& array) {
  return array.attr("reshape")(-1, 3).cast<Strided>();
}

/// A stride that is no whole number of doubles (a field of a structured array) cannot be mapped.
Strided mappable(const Strided& array) {
  for (py::ssize_t k = 0; k < array.ndim(); ++k)
    if (array.strides(k) % kDouble != 0 || array.strides(k) < 0) return array.attr("copy")().cast<Strided>();
  return array;
}

Rows rows_of(const Strided& array) {
  return {array.data(), array.shape(0), 3, {array.strides(0) / kDouble, array.strides(1) / kDouble}};
}

Column column_of(const Strided& array) {
  return {array.data(), array.shape(0), Eigen::InnerStride<Eigen::Dynamic>(array.strides(0) / kDouble)};
}

/// (N,), (3, N) or (M,), made (M,).
Strided as_column(const Strided& array, const Strided& readings, const char* name) {
  const bool circles = readings.ndim() == 3;
  const py::ssize_t n = circles ? readings.shape(1) : readings.shape(0);
  if (circles && array.ndim() == 1 && array.shape(0) == n)
    return py::module_::import("numpy").attr("tile")(array, 3).cast<Strided>();
  if (circles && array.ndim() == 2 && array.shape(0) == 3 && array.shape(1) == n)
    return array.attr("reshape")(-1).cast<Strided>();
  if (!circles && array.ndim() == 1 && array.shape(0) == n) return array;
  wrong_shape(name, array,
              circles ? "(N,) or (3, N), readings having (3, N, 3) with N = " + std::to_string(n)
                      : "(M,), readings having (M, 3) with M = " + std::to_string(n));
}

std::vector<int> experiments_of(const py::object& given, const Strided& readings) {
  std::vector<int> list;
  if (readings.ndim() == 3) {
    if (!given.is_none())
      throw std::invalid_argument("experiment: found one; required: none, as readings has shape (3, N, 3)");
    for (int experiment = 1; experiment <= 3; ++experiment)
      list.insert(list.end(), static_cast<std::size_t>(readings.shape(1)), experiment);
    return list;
  }
  if (given.is_none())
    throw std::invalid_argument(
        "experiment: found none; required: 1, 2 or 3 of each row, as readings has shape (M, 3)");
  const Strided array = numbers(given, "experiment");
  if (array.ndim() != 1) wrong_shape("experiment", array, "(M,)");
  for (py::ssize_t i = 0; i < array.shape(0); ++i) {
    const double value = array.at(i);
    list.push_back(value >= 1.0 && value <= 3.0 && value == static_cast<int>(value) ? static_cast<int>(value)
                                                                                    : 0);
  }
  return list;
}

/// 0 in place of each number that is neither 1 nor 2: the record refuses it, and names its row.
std::vector<int> faces_of(const py::object& given, const Strided& readings) {
  std::vector<int> list;
  if (given.is_none()) return list;
  const Strided array = as_column(mappable(numbers(given, "face")), readings, "face");
  for (py::ssize_t i = 0; i < array.shape(0); ++i)
    list.push_back(array.at(i) == 1.0 ? 1 : array.at(i) == 2.0 ? 2 : 0);
  return list;
}

Strided readings_of(const py::object& given, const char* name) {
  const Strided array = mappable(numbers(given, name));
  const bool circles = array.ndim() == 3 && array.shape(0) == 3 && array.shape(2) == 3;
  if (!circles && !(array.ndim() == 2 && array.shape(1) == 3))
    wrong_shape(name, array, "(3, N, 3) or (M, 3)");
  return array;
}

}  // namespace

py::array view_of(const Eigen::MatrixXd& matrix, const py::object& owner) {
  if (matrix.cols() == 1)
    return without_writing(py::array_t<double>({matrix.rows()}, {kDouble}, matrix.data(), owner));
  return without_writing(py::array_t<double>({matrix.rows(), matrix.cols()},
                                             {kDouble, kDouble * matrix.rows()}, matrix.data(), owner));
}

py::array view_of(const Eigen::VectorXd& vector, const py::object& owner) {
  return without_writing(py::array_t<double>({vector.size()}, {kDouble}, vector.data(), owner));
}

py::array view_of(const Column& column, const py::object& owner) {
  return without_writing(
      py::array_t<double>({column.size()}, {kDouble * column.innerStride()}, column.data(), owner));
}

py::array view_of(const Rows& rows, const py::object& owner) {
  return without_writing(py::array_t<double>({rows.rows(), py::ssize_t{3}},
                                             {kDouble * rows.outerStride(), kDouble * rows.innerStride()},
                                             rows.data(), owner));
}

// The number of parameters equals that of the Python function's keywords.
// NOLINTNEXTLINE(readability-function-size)
Record record_of(const py::object& alpha_deg, const py::object& readings, const py::object& u,
                 const py::object& experiment, const py::object& time_s, const std::string& response_unit,
                 const std::string& estimator, std::optional<double> g_loc, double u_g_loc,
                 const std::string& g_loc_source, const std::map<std::string, double>& effects,
                 const std::string& source, const py::object& face) {
  const Strided given = readings_of(readings, "readings");
  const Strided rows = mappable(as_rows(given));
  const Strided alpha = mappable(as_column(mappable(numbers(alpha_deg, "alpha_deg")), given, "alpha_deg"));
  const std::vector<int> experiments = experiments_of(experiment, given);
  Strided u_rows, times;
  if (!u.is_none()) {
    const Strided array = readings_of(u, "u");
    if (array.ndim() != given.ndim() || array.size() != given.size())
      wrong_shape("u", array, "that of readings, " + shape_of(given));
    u_rows = mappable(as_rows(array));
  }
  if (!time_s.is_none()) times = mappable(as_column(mappable(numbers(time_s, "time_s")), given, "time_s"));
  const RecordSettings settings{source,  response_unit, estimator, g_loc.value_or(0.0),
                                u_g_loc, g_loc_source,  effects};
  const RecordArrays arrays{experiments, column_of(alpha), rows_of(rows),
                            u.is_none() ? no_rows() : rows_of(u_rows),
                            time_s.is_none() ? no_column() : column_of(times)};
  return {arrays, faces_of(face, given), settings};
}

// NOLINTNEXTLINE(readability-function-size)
SimulatedRecord simulated(const Eigen::Matrix3d& sensitivity_matrix, const Eigen::Vector3d& offset,
                          const Eigen::Vector3d& k2, const Eigen::Vector3d& k3, const StageErrors& stage,
                          double wobble_urad, double step_deg, double smooth_step_deg,
                          const Eigen::Vector3d& hysteresis, const Eigen::Vector3d& drift, double noise,
                          int steps, double angle_period_s, std::uint64_t seed,
                          const std::string& response_unit, const std::map<std::string, double>& effects) {
  SimulatedWorld world;
  world.item = {sensitivity_matrix, offset, k2, k3};
  world.stage = stage;
  world.wobble_urad = wobble_urad;
  world.step_deg = step_deg;
  world.smooth_step_deg = smooth_step_deg;
  world.hysteresis = hysteresis;
  world.drift = drift;
  world.noise = noise;
  world.steps = steps;
  world.angle_period_s = angle_period_s;
  world.seed = seed;
  world.response_unit = response_unit;
  world.effects = effects;
  const py::gil_scoped_release release;
  return simulate(world);
}

}  // namespace abcal::python
