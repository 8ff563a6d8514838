#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"

namespace abcal {

/// The subject of a group of quantities.
enum class QuantityKind {
  kOutput,         ///< The purpose of a calibration: reported, certified, compared.
  kStage,          ///< Errors of the stage, found from the same readings.
  kAccelerometer,  ///< Further properties of the accelerometer, found from the same readings.
  kMotion,         ///< Properties that only a run at constant rates shows.
};

/// "output", "stage", "accelerometer", "motion".
std::string_view to_string(QuantityKind kind);

/// The axes in which the numbers of a group are stated.
enum class QuantityFrame {
  kItem,     ///< The accelerometer's own: the numbers do not depend on its mounting.
  kPlatter,  ///< Those of the platter at the default orientation: the mounting is part of the numbers.
  kStage,    ///< Those of the stage: the numbers do not belong to the accelerometer.
};

/// "item", "platter", "stage".
std::string_view to_string(QuantityFrame frame);

/// A group of quantities of a result that are of one kind, such as the three offsets. Everything that writes
/// results renders the groups of quantity_groups(): a quantity is described there and nowhere else.
struct QuantityGroup {
  std::string key;      ///< "intrinsic_angle": its name in JSON, HDF5, C++, Python; with "abc_" in a DCC.
  Term heading;         ///< "Intrinsic angles"
  std::string meaning;  ///< One phrase: the numbers, and what they belong to.
  QuantityKind kind = QuantityKind::kOutput;
  QuantityFrame frame = QuantityFrame::kItem;
  std::vector<std::string> symbols;  ///< The symbols of its values, row by row.
  std::size_t columns = 1;           ///< Values of a row: 3 for a matrix, 1 for a list, 0 for a single value.
  /// Its values in a result, as many as symbols; empty: the result has none.
  std::function<std::vector<Quantity>(const CalibrationResult&)> values;
  std::string within = {};   ///< Member of abcal.result/1 that holds it; empty: the result itself does.
  bool of_protocol = false;  ///< An output of the ABC protocol, which reports show in tables of their own.

  /// JSON pointer to its values in abcal.result/1.
  std::string path() const { return (within.empty() ? "/" : "/" + within + "/") + key; }
};

/// All groups, in the order of reports.
const std::vector<QuantityGroup>& quantity_groups();

/// A value with its symbol.
struct NamedQuantity {
  std::string name;
  Quantity quantity;
};

/// A group that a result has.
struct FoundGroup {
  const QuantityGroup& about;
  std::vector<NamedQuantity> values;  ///< Never empty.
};

/// The groups that a result has, in the order of reports: all, those of a kind, or the outputs beyond those
/// of the protocol.
std::vector<FoundGroup> found_groups(const CalibrationResult& result);
std::vector<FoundGroup> found_groups(const CalibrationResult& result, QuantityKind kind);
std::vector<FoundGroup> further_outputs(const CalibrationResult& result);

/// All outputs in the order of reports: matrix row by row, intrinsic sensitivities, intrinsic angles,
/// offsets. A value that the result does not have is NaN, so that the outputs of any two results are in the
/// same places.
std::vector<NamedQuantity> outputs(const CalibrationResult& result);

/// The published result in the form of a result, to which the same groups apply.
CalibrationResult as_result(const PublishedResult& published);

/// Adds a group while it lives: for tests, and for programs with quantities of their own. Not for use while
/// another thread writes results.
class AddedQuantityGroup {
 public:
  explicit AddedQuantityGroup(QuantityGroup group);
  AddedQuantityGroup(const AddedQuantityGroup&) = delete;
  AddedQuantityGroup& operator=(const AddedQuantityGroup&) = delete;
  ~AddedQuantityGroup();
};

}  // namespace abcal
