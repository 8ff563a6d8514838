#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <exception>
#include <stdexcept>
#include <string>

#include "abcal/abcal.h"
#include "app/library/python/arrays.h"
#include "app/library/python/signals.h"

// The classes and functions of abcal/*.h for Python, under the same names. Docstrings stand in
// abcal/__init__.pyi and here.

namespace abcal::python {
namespace {

using namespace pybind11::literals;

/// None: not given. (An empty path would become pathlib.Path("."), which is a different path.)
using MaybePath = std::optional<std::filesystem::path>;
std::filesystem::path path_of(const MaybePath& path) {
  return path.value_or(std::filesystem::path());
}

py::object dict_of(const std::string& json) {
  return py::module_::import("json").attr("loads")(json);
}

/// Messages may hold bytes that are no UTF-8, e.g. of the name of a file.
void raise(PyObject* type, const std::exception& error) {
  const std::string what = error.what();
  PyObject* const text =
      PyUnicode_DecodeUTF8(what.data(), static_cast<py::ssize_t>(what.size()), "backslashreplace");
  if (text == nullptr) return;
  PyErr_SetObject(type, text);
  Py_DECREF(text);
}

void add_exceptions(py::module_& m) {
  static py::exception<Stopped> stopped(m, "Stopped", PyExc_RuntimeError);
  stopped.attr("__doc__") = "A run was stopped; the stage was halted, and the run file can be resumed.";
  static py::exception<InstrumentError> instrument_error(m, "InstrumentError", PyExc_RuntimeError);
  instrument_error.attr("__doc__") = "An instrument failed: who, what, found, required.";
  py::register_exception_translator([](std::exception_ptr thrown) {
    try {
      if (thrown) std::rethrow_exception(thrown);
    } catch (const Stopped& error) {
      raise(stopped.ptr(), error);
    } catch (const InstrumentError& error) {
      raise(instrument_error.ptr(), error);
    } catch (const py::builtin_exception&) {
      throw;  // An exception of pybind11, which translates it.
    } catch (const std::logic_error& error) {
      raise(PyExc_ValueError, error);
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& error) {
      raise(PyExc_RuntimeError, error);
    }
  });
}

void add_values(py::module_& m) {
  const auto member = [](Eigen::MatrixXd Values::*which) {
    return [which](const py::object& self) { return view_of(self.cast<const Values&>().*which, self); };
  };
  py::class_<Values>(m, "Values",
                     "Numbers of one kind with their uncertainties; NaN: not determined or not evaluated.")
      .def_property_readonly("value", member(&Values::value), "Values, in `unit`.")
      .def_property_readonly("u", member(&Values::u), "Standard uncertainties, type A and B combined.")
      .def_property_readonly("type_a", member(&Values::type_a), "From the scatter of the readings.")
      .def_property_readonly("type_b", member(&Values::type_b), "From what is known of stage and instrument.")
      .def_property_readonly("degrees_of_freedom", member(&Values::degrees_of_freedom), "Effective, of `u`.")
      .def_readonly("unit", &Values::unit)
      .def("__repr__", [](const py::object& self) {
        return py::str("Values(value={!r}, u={!r}, unit={!r})")
            .format(self.attr("value"), self.attr("u"), self.attr("unit"));
      });
  py::class_<Covariance>(m, "Covariance", "A covariance matrix whose rows and columns have names.")
      .def_readonly("labels", &Covariance::labels)
      .def_readonly("units", &Covariance::units)
      .def_property_readonly(
          "values",
          [](const py::object& self) { return view_of(self.cast<const Covariance&>().values, self); },
          "The quantities themselves, in the order of `labels`.")
      .def_property_readonly(
          "matrix",
          [](const py::object& self) { return view_of(self.cast<const Covariance&>().matrix, self); },
          "Covariances, shape (n, n).")
      .def("__len__", [](const Covariance& self) { return self.labels.size(); })
      .def(
          "__getitem__",
          [](const Covariance& self, const std::pair<std::string, std::string>& names) {
            const auto at = [&](const std::string& name) {
              const auto found = std::find(self.labels.begin(), self.labels.end(), name);
              if (found == self.labels.end())
                throw py::key_error("covariance: found \"" + name + "\"; required: one of its labels");
              return static_cast<Eigen::Index>(found - self.labels.begin());
            };
            return self.matrix(at(names.first), at(names.second));
          },
          "Covariance of two quantities by their labels: covariance['s_ux', 'O_u'].");
}

void add_record(py::module_& m) {
  py::class_<Record>(m, "Record", "Averaged readings of the three rotation experiments; never changed.")
      .def(
          py::init(&record_of), "alpha_deg"_a, "readings"_a, "u"_a = py::none(), py::kw_only(),
          "experiment"_a = py::none(), "time_s"_a = py::none(), "response_unit"_a = "R", "estimator"_a = "",
          "g_loc"_a = py::none(), "u_g_loc"_a = 0.0, "g_loc_source"_a = "",
          "effects"_a = std::map<std::string, double>{}, "source"_a = "arrays", "face"_a = py::none(),
          "From arrays.\n\nalpha_deg: desired angles in degrees, shape (N,) for all three experiments or (3, "
          "N); or (M,).\n"
          "readings: mean outputs u, v, w in the response unit, shape (3, N, 3); or (M, 3) with experiment.\n"
          "u: their standard uncertainties, same shape. experiment: 1, 2 or 3, shape (M,).\n"
          "time_s: middle of each dwell, face: 1 or 2 (none: all 1), shape as alpha_deg. g_loc, u_g_loc: "
          "local gravity in m/s2.\n"
          "effects: standard uncertainties by their bench-file keys, e.g. {'wobble_urad': 20.0}.\n"
          "Raises ValueError with every problem.")
      .def_property_readonly("source", &Record::source)
      .def_property_readonly("response_unit", &Record::response_unit)
      .def_property_readonly("estimator", &Record::estimator)
      .def_property_readonly("flagged", &Record::flagged)
      .def_property_readonly("g_loc", &Record::g_loc_mps2, "m/s2; NaN: not known.")
      .def_property_readonly("experiment", [](const Record& r) { return copied(r.experiment()); })
      .def_property_readonly(
          "face", [](const Record& r) { return copied(r.face()); }, "1 or 2, shape (M,).")
      .def_property_readonly(
          "alpha_deg",
          [](const py::object& self) { return view_of(self.cast<const Record&>().alpha_deg(), self); },
          "Desired angles in degrees, shape (M,): a view of the record.")
      .def_property_readonly(
          "readings",
          [](const py::object& self) { return view_of(self.cast<const Record&>().readings(), self); },
          "Mean outputs u, v, w, shape (M, 3): a view of the record.")
      .def_property_readonly("u", &Record::u, "Their standard uncertainties, shape (M, 3); NaN: not known.")
      .def_property_readonly("time_s", [](const Record& r) { return copied(r.time_s()); })
      .def_property_readonly("closing", [](const Record& r) { return r.closing(); })
      .def_property_readonly("effects", &Record::effects)
      .def_property_readonly("default_effects", &Record::default_effects)
      .def("__len__", &Record::size);
  m.def("load", &load, "path"_a, py::call_guard<py::gil_scoped_release>(),
        "Reads a run file or a table of readings; RUN#2 is item 2 of a run with several items. Raises "
        "RuntimeError with what is wrong.");
  m.def("load_poses", &load_poses, "path"_a, py::call_guard<py::gil_scoped_release>(), "As load().");
  m.def(
      "_load_table",
      [](const std::filesystem::path& path, const std::string& columns, const std::string& unit,
         const std::string& time_unit, const std::string& topic) {
        return load_table(path, {.columns = columns, .unit = unit, .time_unit = time_unit, .topic = topic});
      },
      py::call_guard<py::gil_scoped_release>());
  m.def(
      "_read_table",
      [](const std::string& text, const std::string& columns, const std::string& unit,
         const std::string& time_unit) {
        return read_table(text, "array",
                          {.columns = columns, .unit = unit, .time_unit = time_unit, .topic = {}});
      },
      py::call_guard<py::gil_scoped_release>());
}

void add_result(py::module_& m) {
  py::class_<EffectFound>(m, "EffectFound", "An effect that was estimated and tested by the joint estimator.")
      .def_readonly("name", &EffectFound::name)
      .def_readonly("key", &EffectFound::key)
      .def_readonly("times_stated", &EffectFound::times_stated)
      .def_readonly("probability", &EffectFound::probability)
      .def_readonly("agrees", &EffectFound::agrees);
  constexpr auto kInside = py::return_value_policy::reference_internal;
  py::class_<Published>(
      m, "Published",
      "The result of 'abc' by the formula of the paper, not corrected for k2 and k3; members as of Result.")
      .def_readonly("sensitivity_matrix", &Published::sensitivity_matrix)
      .def_readonly("offset", &Published::offset)
      .def_readonly("intrinsic_sensitivity", &Published::intrinsic_sensitivity)
      .def_readonly("intrinsic_angle", &Published::intrinsic_angle)
      .def_readonly("covariance", &Published::covariance)
      .def_readonly("covariance_intrinsic", &Published::covariance_intrinsic);
  py::class_<QuantityGroup>(m, "QuantityGroup", "Quantities of one kind in a result, with their description.")
      .def_readonly("key", &QuantityGroup::key, "As in JSON and HDF5.")
      .def_readonly("heading", &QuantityGroup::heading)
      .def_readonly("meaning", &QuantityGroup::meaning)
      .def_readonly("kind", &QuantityGroup::kind, "'output', 'stage', 'accelerometer' or 'motion'.")
      .def_readonly("frame", &QuantityGroup::frame,
                    "Whose axes: 'item' (free of the mounting), 'platter', 'stage'.")
      .def_readonly("symbols", &QuantityGroup::symbols, "Of the values, row by row.")
      .def_readonly("values", &QuantityGroup::values);
  py::class_<Result>(m, "Result", "The result of one estimator on one record; never changed.")
      .def_property_readonly("estimator", &Result::estimator)
      .def_property_readonly("verdict", &Result::verdict, "'usable', 'doubtful' or 'not_usable'.")
      .def_property_readonly("why", &Result::why, "One sentence: the reason for the verdict.")
      .def_property_readonly("response_unit", &Result::response_unit)
      .def_property_readonly("notes", &Result::notes)
      .def_property_readonly("sensitivity_matrix", &Result::sensitivity_matrix, kInside,
                             "Shape (3, 3), rows u v w, columns x y z; R/g_loc.")
      .def_property_readonly("offset", &Result::offset, kInside, "Shape (3,): u v w; R.")
      .def_property_readonly("intrinsic_sensitivity", &Result::intrinsic_sensitivity, kInside,
                             "Shape (3,): u v w; R/g_loc.")
      .def_property_readonly("intrinsic_angle", &Result::intrinsic_angle, kInside,
                             "Shape (3,): uv vw wu; degree.")
      .def_property_readonly("covariance", &Result::covariance, kInside,
                             "Of s (row by row) and O, shape (12, 12).")
      .def_property_readonly("covariance_intrinsic", &Result::covariance_intrinsic, kInside,
                             "Of the nine intrinsic properties, shape (9, 9).")
      .def_property_readonly("quantities", &Result::quantities, kInside,
                             "Every quantity of the result, in groups with their descriptions.")
      .def_property_readonly("effects", &Result::effects)
      .def_property_readonly("alignment", &Result::alignment,
                             "Zx, Zy, Xz of the joint estimator, shape (3,).")
      .def_property_readonly(
          "published", [](const Result& r) { return r.published() ? &*r.published() : nullptr; }, kInside,
          "By the paper's own formula, for comparison with other laboratories' ABC results; None but for "
          "'abc'.")
      .def("to_json", &Result::to_json, "As `abcal analyse --json`.")
      .def(
          "to_dict", [](const Result& r) { return dict_of(r.to_json()); }, "The same as a dict.")
      .def("to_text", &Result::to_text, "As `abcal analyse` prints it.")
      .def("to_html", &Result::to_html, py::call_guard<py::gil_scoped_release>(),
           "As a notebook shows it: verdict, values with their expanded uncertainties, and a figure.")
      .def("_repr_html_", &Result::to_html, py::call_guard<py::gil_scoped_release>())
      .def("__repr__",
           [](const Result& r) { return "<abcal.Result " + r.estimator() + ": " + r.verdict() + ">"; });
  m.def(
      "analyse", &analyse, "record"_a, "estimator"_a = "", py::call_guard<py::gil_scoped_release>(),
      "One estimator on a record: 'abc', 'joint' or 'norm'; '': the one chosen before the run. A record that "
      "the\n"
      "estimator refuses gives the verdict 'not_usable' and the reason. Raises ValueError for another name.");
  m.def("analyse_measurement", &analyse_measurement, "files"_a, py::call_guard<py::gil_scoped_release>(),
        "The joint results of the items of a measurement, from one fit of all its runs: of a list of one\n"
        "measurement file (`abcal combine`), or of run files. Raises ValueError for runs of other items or "
        "stages.");
  m.def("estimators", &estimators);
}

void add_studies(py::module_& m) {
  constexpr auto kInside = py::return_value_policy::reference_internal;
  py::class_<MonteCarloStudy>(m, "MonteCarloStudy",
                              "Uncertainty of a record's result by Monte Carlo (JCGM 101).")
      .def_property_readonly("trials", &MonteCarloStudy::trials)
      .def_property_readonly("interrupted", &MonteCarloStudy::interrupted)
      .def_property_readonly("covariance", &MonteCarloStudy::covariance, kInside,
                             "Of the 18 outputs, (18, 18).")
      .def_property_readonly(
          "coverage_interval",
          [](const py::object& self) {
            return view_of(self.cast<const MonteCarloStudy&>().coverage_interval(), self);
          },
          "95.45 % coverage intervals of the errors, shape (18, 2): low, high.")
      .def_property_readonly("warnings", &MonteCarloStudy::warnings)
      .def("to_json", &MonteCarloStudy::to_json)
      .def("to_dict", [](const MonteCarloStudy& s) { return dict_of(s.to_json()); });
  m.def(
      "monte_carlo",
      [](const Record& record, std::uint64_t trials, int digits, std::uint64_t seed, unsigned threads,
         std::optional<double> resolution) {
        std::atomic<bool> stop{false};
        return carry_out<MonteCarloStudy>(
            [&](const Listener&) {
              MonteCarloChoices choices;
              choices.trials = trials;
              choices.digits = digits;
              choices.seed = seed;
              choices.threads = threads;
              choices.resolution = resolution;
              choices.progress = [&](std::uint64_t, std::uint64_t) { return !stop; };
              return monte_carlo(record, choices);
            },
            [&] { stop = true; }, py::none());
      },
      "record"_a, "trials"_a = 200'000, py::kw_only(), "digits"_a = 2, "seed"_a = 1, "threads"_a = 0,
      "resolution"_a = py::none(),
      "Type A and B by Monte Carlo, with all processors (threads=0). trials=0: as many as `digits` require.");
  m.def("simulation_sets", &simulation_sets);
  m.def(
      "simulation_set",
      [](const std::string& set, std::uint64_t trials, std::uint64_t seed, unsigned threads) {
        std::string json;
        {
          const py::gil_scoped_release release;
          json = simulation_set(set, trials, seed, threads);
        }
        return dict_of(json);
      },
      "set"_a, "trials"_a = 0, py::kw_only(), "seed"_a = 1, "threads"_a = 0,
      "A simulation of Geist & Gaitan (2021) as a dict, schema abcal.study/1; trials=0: as many as in the "
      "paper.");
}

void add_model(py::module_& m) {
  py::class_<StageErrors>(m, "StageErrors", "Errors of a stage of the published model; angles in degrees.")
      .def(py::init([](double zx, double zy, double xz, double initial_turn_z_deg, double initial_turn_x_deg,
                       double mean_step_x_deg, double mean_step_z_deg) {
             return StageErrors{
                 zx, zy, xz, initial_turn_z_deg, initial_turn_x_deg, mean_step_x_deg, mean_step_z_deg};
           }),
           py::kw_only(), "zx"_a = 0.0, "zy"_a = 0.0, "xz"_a = 0.0, "initial_turn_z_deg"_a = 0.0,
           "initial_turn_x_deg"_a = 0.0, "mean_step_x_deg"_a = 0.0, "mean_step_z_deg"_a = 0.0)
      .def_readwrite("zx", &StageErrors::zx)
      .def_readwrite("zy", &StageErrors::zy)
      .def_readwrite("xz", &StageErrors::xz)
      .def_readwrite("initial_turn_z_deg", &StageErrors::initial_turn_z_deg)
      .def_readwrite("initial_turn_x_deg", &StageErrors::initial_turn_x_deg)
      .def_readwrite("mean_step_x_deg", &StageErrors::mean_step_x_deg)
      .def_readwrite("mean_step_z_deg", &StageErrors::mean_step_z_deg);
  m.def("specific_force", &specific_force, "experiment"_a, "alpha_deg"_a, "errors"_a = StageErrors{},
        "Specific force at rest in g_loc along x, y, z, shape (3,), at an angle of experiment 1, 2 or 3.");
  py::class_<SimulatedRecord>(m, "SimulatedRecord", "A simulated run, and what a calibration is to find.")
      .def_readonly("record", &SimulatedRecord::record)
      .def_readonly("true_sensitivity_matrix", &SimulatedRecord::true_sensitivity_matrix)
      .def_readonly("true_offset", &SimulatedRecord::true_offset);
  m.def("simulate", &simulated, "sensitivity_matrix"_a = Eigen::Matrix3d(Eigen::Matrix3d::Identity()),
        "offset"_a = Eigen::Vector3d(Eigen::Vector3d::Zero()), py::kw_only(),
        "k2"_a = Eigen::Vector3d(Eigen::Vector3d::Zero()), "k3"_a = Eigen::Vector3d(Eigen::Vector3d::Zero()),
        "stage"_a = StageErrors{}, "wobble_urad"_a = 0.0, "step_deg"_a = 0.0, "smooth_step_deg"_a = 0.0,
        "hysteresis"_a = Eigen::Vector3d(Eigen::Vector3d::Zero()),
        "drift"_a = Eigen::Vector3d(Eigen::Vector3d::Zero()), "noise"_a = 1e-5, "steps"_a = 72,
        "angle_period_s"_a = 12.0, "seed"_a = 1, "response_unit"_a = "R",
        "effects"_a = std::map<std::string, double>{},
        "A run in a simulated world. sensitivity_matrix: (3, 3), R/g_loc; offset, hysteresis, drift: (3,), "
        "R; noise: of a\n"
        "mean, R; wobble_urad, step_deg, smooth_step_deg: standard deviations drawn from the seed; effects: "
        "stated sizes.");
}

void add_plans(py::module_& m) {
  py::class_<PredictedPlan>(m, "PredictedPlan", "A plan with the uncertainties that its result will state.")
      .def_readonly("steps", &PredictedPlan::steps)
      .def_readonly("step_deg", &PredictedPlan::step_deg)
      .def_readonly("dwell_readings", &PredictedPlan::dwell_readings)
      .def_readonly("estimator", &PredictedPlan::estimator)
      .def_readonly("moving_s", &PredictedPlan::moving_s)
      .def_readonly("settling_s", &PredictedPlan::settling_s)
      .def_readonly("dwelling_s", &PredictedPlan::dwelling_s)
      .def_property_readonly("duration_s", &PredictedPlan::duration_s)
      .def_readonly("u", &PredictedPlan::u, "By group: 's', 'off', 'O' (relative, g_loc), 'phi' (degree).")
      .def_readonly("largest_part", &PredictedPlan::largest_part)
      .def_readonly("rate_deg_per_s", &PredictedPlan::rate_deg_per_s, "Empty: in steps.")
      .def_readonly("sweeps", &PredictedPlan::sweeps, "Of each circle, at a constant rate.");
  py::class_<PlanAnswer>(m, "PlanAnswer", "The plan that was found, or why there is none.")
      .def_readonly("plan", &PlanAnswer::plan)
      .def_readonly("out_of_reach", &PlanAnswer::out_of_reach);
  const auto question = [](const std::string& reach, double within_s, std::optional<double> noise,
                           const MaybePath& noise_of, const std::string& estimator) {
    return PlanQuestion{reach, within_s, noise, path_of(noise_of), estimator};
  };
  m.def(
      "plan",
      [question](const std::filesystem::path& bench, const std::string& reach, double within_s,
                 std::optional<double> noise, const MaybePath& noise_of, const std::string& estimator) {
        return plan(bench, question(reach, within_s, noise, noise_of, estimator));
      },
      "bench"_a, "reach"_a = "", py::kw_only(), "within_s"_a = 0.0, "noise"_a = py::none(),
      "noise_of"_a = py::none(), "estimator"_a = "", py::call_guard<py::gil_scoped_release>(),
      "The shortest plan of a bench file that reaches 's=2e-5, off=2e-4, O=5e-5, phi=1e-3 deg' (default: the "
      "paper's\n"
      "type B), or the best one within a time. noise: standard deviation of one reading, g_loc; noise_of: an "
      "earlier run, which tells angles and offsets of the item as well.");
  m.def(
      "predict",
      [question](const std::filesystem::path& bench, int steps, int dwell_readings,
                 std::optional<double> noise, const MaybePath& noise_of, const std::string& estimator) {
        return predict(bench, steps, dwell_readings, question("", 0.0, noise, noise_of, estimator));
      },
      "bench"_a, "steps"_a, "dwell_readings"_a, py::kw_only(), "noise"_a = py::none(),
      "noise_of"_a = py::none(), "estimator"_a = "", py::call_guard<py::gil_scoped_release>(),
      "What one plan of 3 x steps angles will state.");
}

void add_certificates(py::module_& m) {
  py::class_<Comparison>(m, "Comparison", "Whether results of one item agree.")
      .def_property_readonly("agree", &Comparison::agree)
      .def_property_readonly("why", &Comparison::why)
      .def_property_readonly("largest_e_n", [](const Comparison& c) { return copied(c.largest_e_n()); })
      .def("to_json", &Comparison::to_json)
      .def("to_dict", [](const Comparison& c) { return dict_of(c.to_json()); })
      .def("to_text", &Comparison::to_text);
  m.def(
      "compare",
      [](const std::vector<std::filesystem::path>& files, const std::string& estimator, bool shared_stage,
         bool any_item, const std::string& group_by) {
        return compare(files, {estimator, shared_stage, any_item, group_by});
      },
      "files"_a, py::kw_only(), "estimator"_a = "", "shared_stage"_a = false, "any_item"_a = false,
      "group_by"_a = "", py::call_guard<py::gil_scoped_release>(),
      "Run files, CSVs and certificates, two at least: the first against the others.");
  constexpr auto kInside = py::return_value_policy::reference_internal;
  py::class_<Certificate>(m, "Certificate", "A digital calibration certificate (DCC 3) as it was read.")
      .def(py::init<const std::filesystem::path&>(), "path"_a, py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("number", &Certificate::number)
      .def_property_readonly("date", &Certificate::date)
      .def_property_readonly("item", &Certificate::item)
      .def_property_readonly("serial_number", &Certificate::serial_number)
      .def_property_readonly("response_unit", &Certificate::response_unit)
      .def_property_readonly("g_loc", &Certificate::g_loc_mps2, "m/s2; NaN: not given.")
      .def_property_readonly("sensitivity_matrix", &Certificate::sensitivity_matrix,
                             "R/(m/s2), (3, 3); or None.")
      .def_property_readonly("intrinsic", &Certificate::intrinsic, kInside,
                             "The nine properties with covariances.")
      .def_property_readonly("with_correlations", &Certificate::with_correlations)
      .def_property_readonly("notes", &Certificate::notes);
  m.def(
      "certificate_xml",
      [](const std::filesystem::path& run, const MaybePath& laboratory, const MaybePath& as_found,
         const MaybePath& schemas, const std::string& language) {
        return certificate_xml(run, {path_of(laboratory), path_of(as_found), path_of(schemas), language});
      },
      "run"_a, "laboratory"_a = py::none(), py::kw_only(), "as_found"_a = py::none(),
      "schemas"_a = py::none(), "language"_a = "", py::call_guard<py::gil_scoped_release>(),
      "XML of a run's issued certificate, or else of a draft from a laboratory file.");
}

void add_bench(py::module_& m) {
  py::class_<CheckFinding>(m, "CheckFinding", "One check of a bench.")
      .def_readonly("grade", &CheckFinding::grade, "'good', 'warning', 'problem', 'left out'.")
      .def_readonly("what", &CheckFinding::what)
      .def_readonly("found", &CheckFinding::found)
      .def_readonly("advice", &CheckFinding::advice);
  py::class_<CompleteRun>(m, "CompleteRun", "A complete run and its results.")
      .def_readonly("file", &CompleteRun::file)
      .def_readonly("sha256", &CompleteRun::sha256)
      .def_readonly("result", &CompleteRun::result)
      .def_readonly("all_results", &CompleteRun::all_results);
  m.def("demo_bench", &demo_bench, "steps"_a = 30,
        "The bench file of `abcal demo` as text, with the emulated instruments inside this process: a run on "
        "it takes\n"
        "less than a second. steps: angles of each experiment, a divisor of 360.");
  const auto halt = [](Bench& bench) { return [&bench] { bench.halt(); }; };
  py::class_<Bench>(m, "Bench", "A bench file and its instruments, run as the command line runs it.")
      .def(py::init<const std::filesystem::path&>(), "path"_a, py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("name", &Bench::name)
      .def_property_readonly("toml", &Bench::toml)
      .def_property_readonly("warnings", &Bench::warnings)
      .def_property_readonly("simulated", &Bench::simulated)
      .def(
          "check",
          [halt](Bench& bench, bool motion, const py::object& callback) {
            return carry_out<std::vector<CheckFinding>>(
                [&](const Listener& listener) { return bench.check(motion, listener); }, halt(bench),
                callback);
          },
          py::kw_only(), "motion"_a = true, "callback"_a = py::none(),
          "Talks to both instruments, and turns both axes by 30 degrees unless motion=False.")
      .def(
          "run",
          [halt](Bench& bench, const MaybePath& run_file, const py::object& callback) {
            return carry_out<CompleteRun>(
                [&](const Listener& listener) { return bench.run(path_of(run_file), listener); }, halt(bench),
                callback);
          },
          "run_file"_a = py::none(), py::kw_only(), "callback"_a = py::none(),
          "Measures a new run to its end. callback(event) gets each event as a dict, in the calling thread. "
          "Ctrl-C, and\n"
          "any exception of the callback, halts the stage at once; the run file can then be resumed.\n"
          "Raises Stopped after halt(); InstrumentError; RuntimeError.")
      .def(
          "resume",
          [halt](Bench& bench, const std::filesystem::path& run_file, const py::object& callback) {
            return carry_out<CompleteRun>(
                [&](const Listener& listener) { return bench.resume(run_file, listener); }, halt(bench),
                callback);
          },
          "run_file"_a, py::kw_only(), "callback"_a = py::none(),
          "Continues an interrupted run to its end; see run().")
      .def("hold", &Bench::hold, py::call_guard<py::gil_scoped_release>(),
           "The stage stands still after this angle.")
      .def("go_on", &Bench::go_on, py::call_guard<py::gil_scoped_release>(), "After hold().")
      .def("halt", &Bench::halt, py::call_guard<py::gil_scoped_release>(),
           "Halts the stage at once and ends the run, from any thread.");
  m.def("stage_drivers", &stage_driver_list);
  m.def("accelerometer_drivers", &accelerometer_driver_list);
}

}  // namespace
}  // namespace abcal::python

PYBIND11_MODULE(_abcal, m) {
  m.doc() = "Calibration of triaxial accelerometers with gravity.";
  m.attr("__version__") = abcal::version();
  abcal::python::add_exceptions(m);
  abcal::python::add_values(m);
  abcal::python::add_record(m);
  abcal::python::add_result(m);
  abcal::python::add_studies(m);
  abcal::python::add_model(m);
  abcal::python::add_plans(m);
  abcal::python::add_certificates(m);
  abcal::python::add_bench(m);
}
