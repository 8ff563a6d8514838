#pragma once

#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "abcal/model.h"
#include "abcal/record.h"

namespace abcal::python {

namespace py = pybind11;

/// An array on memory that `owner` keeps alive; it cannot be written to. Nothing is copied.
py::array view_of(const Eigen::MatrixXd& matrix, const py::object& owner);  ///< One column: shape (n,).
py::array view_of(const Eigen::VectorXd& vector, const py::object& owner);
py::array view_of(const Column& column, const py::object& owner);
py::array view_of(const Rows& rows, const py::object& owner);

template <class Number>
py::array_t<Number> copied(const std::vector<Number>& numbers) {
  return py::array_t<Number>(static_cast<py::ssize_t>(numbers.size()), numbers.data());
}

/// abcal.Record(...). @throws std::invalid_argument
Record record_of(const py::object& alpha_deg, const py::object& readings, const py::object& u,
                 const py::object& experiment, const py::object& time_s, const std::string& response_unit,
                 const std::string& estimator, std::optional<double> g_loc, double u_g_loc,
                 const std::string& g_loc_source, const std::map<std::string, double>& effects,
                 const std::string& source, const py::object& face);

/// abcal.simulate(...). @throws std::invalid_argument
SimulatedRecord simulated(const Eigen::Matrix3d& sensitivity_matrix, const Eigen::Vector3d& offset,
                          const Eigen::Vector3d& k2, const Eigen::Vector3d& k3, const StageErrors& stage,
                          double wobble_urad, double step_deg, double smooth_step_deg,
                          const Eigen::Vector3d& hysteresis, const Eigen::Vector3d& drift, double noise,
                          int steps, double angle_period_s, std::uint64_t seed,
                          const std::string& response_unit, const std::map<std::string, double>& effects);

}  // namespace abcal::python
