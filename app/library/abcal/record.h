#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <filesystem>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "abcal/export.h"

namespace abcal::v1 {
/// Rows of numbers wherever they lie; nothing is copied.
using Rows = Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>, Eigen::Unaligned,
                        Eigen::Stride<Eigen::Dynamic, Eigen::Dynamic>>;
using Column = Eigen::Map<const Eigen::VectorXd, Eigen::Unaligned, Eigen::InnerStride<Eigen::Dynamic>>;

/// No rows: the quantity is not known.
inline Rows no_rows() {
  return {nullptr, 0, 3, {3, 1}};
}
inline Column no_column() {
  return {nullptr, 0, Eigen::InnerStride<Eigen::Dynamic>(1)};
}

/// Averaged readings as arrays, one row an angle, in the order of measurement.
struct RecordArrays {
  std::span<const int> experiment;  ///< 1, 2 or 3 as in the paper.
  Column alpha_deg =
      no_column();  ///< Desired angle; one that repeats the first one 360 degrees later closes the circle.
  Rows readings = no_rows();    ///< Mean outputs u, v, w in the response unit.
  Rows u = no_rows();           ///< Their standard uncertainties; no rows: not known.
  Column time_s = no_column();  ///< True time of the middle of each dwell; no rows: equal spacing.
};

/// Facts of a record that its arrays do not contain. Sizes of effects that are not stated have their
/// defaults, which results report.
struct RecordSettings {
  std::string source = "arrays";    ///< Names the record in messages.
  std::string response_unit = "R";  ///< "g", "m/s2", "V", "LSB", ...
  std::string estimator =
      {};                     ///< Chosen before the first angle: "abc", "joint", "norm"; empty: not recorded.
  double g_loc_mps2 = 0.0;    ///< Local gravity; 0: not known.
  double g_loc_u_mps2 = 0.0;  ///< Its standard uncertainty.
  std::string g_loc_source = {};
  /// Standard uncertainties of [stage_uncertainty] and [item_uncertainty] by their keys in a bench file:
  /// "alignment_deg", "wobble_urad", ...
  std::map<std::string, double> effects = {};
};

/// Averaged readings of the three rotation experiments: a run file, a CSV, or arrays. Cheap to copy, never
/// changed.
class Record {
 public:
  /// @throws std::invalid_argument with every problem: sizes that differ, numbers that are not finite, too
  /// few angles, an effect that does not exist
  Record(const RecordArrays& arrays, const RecordSettings& settings = {});
  /// The same of a run in two faces (docs/measurement.md, "Two faces").
  /// @param face  1 or 2 of each row
  Record(const RecordArrays& arrays, std::span<const int> face, const RecordSettings& settings = {});

  std::string source() const;
  std::string response_unit() const;
  std::string estimator() const;  ///< Chosen before the first angle; empty: not recorded.
  std::size_t size() const;       ///< Angles, closing ones included.
  std::size_t flagged() const;    ///< Angles at which something was noticed (not quiet, readings lost, ...).
  double g_loc_mps2() const;      ///< NaN: not known.

  std::vector<int> experiment() const;
  std::vector<int> face() const;  ///< 1 or 2 (docs/measurement.md, "Two faces").
  /// These views point into the record and remain valid as long as this or a copy exists.
  Column alpha_deg() const;
  Rows readings() const;
  std::vector<double> time_s() const;                  ///< NaN: not known.
  Eigen::Matrix<double, Eigen::Dynamic, 3> u() const;  ///< NaN: not known.
  std::vector<bool> closing() const;
  /// Sizes of all effects, stated or default, by their keys in a bench file.
  std::map<std::string, double> effects() const;
  std::vector<std::string> default_effects() const;  ///< Words of the sizes that were not stated.

  struct Data;
  explicit Record(std::shared_ptr<const Data> data) : data_(std::move(data)) {}
  const Data& data() const { return *data_; }

 private:
  std::shared_ptr<const Data> data_;
};

/// Reads a run file, or any table of readings (docs/your_file.md); the content decides which it is.
/// "RUN#2" is item 2 of a run with several items.
/// @throws std::runtime_error that names the error in the file; std::invalid_argument for a run with several
///         items of which none is named, or one that it does not have
Record load(const std::filesystem::path& path);

/// As load().
Record load_poses(const std::filesystem::path& path);

/// Statements about a table that it does not make itself, as the options of `abcal analyse`; empty: none.
struct TableSettings {
  std::string columns = {};    ///< "t,x,y,z": names of the columns in place of a header.
  std::string unit = {};       ///< "g", "m/s2", "LSB"
  std::string time_unit = {};  ///< "s", "ms", "us", "ns"
  std::string topic = {};      ///< The one to be read of a log with several.
};

/// Reads a table of readings, of a file or of a text whose name is `source` in messages.
/// @throws std::runtime_error  with every problem
Record load_table(const std::filesystem::path& path, const TableSettings& settings = {});
Record read_table(const std::string& text, const std::string& source, const TableSettings& settings = {});

}  // namespace abcal::v1
