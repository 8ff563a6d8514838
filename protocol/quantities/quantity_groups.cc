#include "protocol/quantities/quantity_groups.h"

#include <fmt/format.h>

#include <array>
#include <utility>

#include "drivers/text/names.h"
#include "protocol/quantities/output_names.h"

namespace abcal {
namespace {

using Values = std::vector<Quantity>;

template <class Range>
Values list(const Range& quantities) {
  return {quantities.begin(), quantities.end()};
}

/// Values row by row.
template <class Rows>
Values rows(const Rows& matrix) {
  Values all;
  for (const auto& row : matrix) all.insert(all.end(), row.begin(), row.end());
  return all;
}

/// The values that `member` finds in the joint result; empty without one.
auto joint(auto member) {
  return
      [member](const CalibrationResult& result) { return result.joint ? member(*result.joint) : Values(); };
}
auto motion(auto member) {
  return joint([member](const JointResult& from) { return from.motion ? member(*from.motion) : Values(); });
}

std::vector<std::string> labels(std::string_view format, const std::array<const char*, 3>& of) {
  std::vector<std::string> all;
  for (const char* one : of) all.push_back(fmt::format(fmt::runtime(format), one));
  return all;
}

std::vector<std::string> matrix_labels(std::string_view symbol) {
  std::vector<std::string> all;
  for (const char* row : kOutputNames)
    for (const char* column : kPlatterAxes) all.push_back(fmt::format("{}_{}{}", symbol, row, column));
  return all;
}

/// The outputs of the protocol.
std::vector<QuantityGroup> output_groups() {
  using enum QuantityKind;
  using Frame = QuantityFrame;
  return {
      {"sensitivity_matrix", "Sensitivity matrix (default orientation, LGCS)",
       "rows U, V, W; columns x, y, z", kOutput, Frame::kPlatter, matrix_labels("s"), 3,
       [](const CalibrationResult& r) {
         return r.sensitivity_matrix ? rows(*r.sensitivity_matrix) : Values();
       }},
      {"intrinsic_sensitivity", "Intrinsic sensitivities", "of U, V, W", kOutput, Frame::kItem,
       labels("s_{}", kOutputNames), 1,
       [](const CalibrationResult& r) { return list(r.intrinsic_sensitivity); }},
      {"intrinsic_angle", "Intrinsic angles", "between UV, VW, WU", kOutput, Frame::kItem,
       labels("phi_{}", kOutputPairs), 1, [](const CalibrationResult& r) { return list(r.intrinsic_angle); }},
      {"offset", "Zero-acceleration offsets", "zero-acceleration offset of U, V, W", kOutput, Frame::kItem,
       labels("O_{}", kOutputNames), 1, [](const CalibrationResult& r) { return list(r.offset); }},
  };
}

/// Stage and accelerometer by the joint fit.
std::vector<QuantityGroup> joint_groups() {
  using enum QuantityKind;
  using Frame = QuantityFrame;
  return {
      {"alignment",
       "Alignment of the axes",
       "alignment Zx, Zy, Xz of the axes of the stage",
       kStage,
       Frame::kStage,
       {"Zx", "Zy", "Xz"},
       1,
       joint([](const JointResult& j) { return list(j.alignment); })},
      {"initial_turn_error",
       "Errors of the initial turns",
       "errors of the turns before experiments 2 and 3",
       kStage,
       Frame::kStage,
       {"d2", "d3"},
       1,
       joint([](const JointResult& j) { return list(j.initial_turn_error); })},
      {"turn_error_face_2",
       "Errors of the turns to the second face",
       "errors of the turns to the second face before experiments 1, 2, 3",
       kStage,
       Frame::kStage,
       {"d1 face 2", "d2 face 2", "d3 face 2"},
       1,
       joint(
           [](const JointResult& j) { return j.turn_error_face_2 ? list(*j.turn_error_face_2) : Values(); })},
      {"mean_step_error",
       "Zeros of the axes",
       "mean errors of the steps about X and Z",
       kStage,
       Frame::kStage,
       {"F_X", "F_Z"},
       1,
       joint([](const JointResult& j) { return list(j.mean_step_error); })},
      {"drift", "Drift", "drift of the outputs U, V, W over the run", kAccelerometer, Frame::kItem,
       labels("b_{}", kOutputNames), 1, joint([](const JointResult& j) { return list(j.drift); })},
      {"k2", "Quadratic non-linearity", "k2 of U, V, W", kAccelerometer, Frame::kItem,
       labels("k2_{}", kOutputNames), 1, joint([](const JointResult& j) { return list(j.k2); }),
       "nonlinearity"},
      {"k3", "Cubic non-linearity", "k3 of U, V, W", kAccelerometer, Frame::kItem,
       labels("k3_{}", kOutputNames), 1, joint([](const JointResult& j) { return list(j.k3); }),
       "nonlinearity"},
      {"drift_at_end", "Offset at the end", "offset at the end of the run minus its mean over the run",
       kAccelerometer, Frame::kItem, labels("b_{},end", kOutputNames), 1,
       joint([](const JointResult& j) { return list(j.drift_at_end); })},
  };
}

/// Groups of a run at constant rates.
std::vector<QuantityGroup> motion_groups() {
  using enum QuantityKind;
  using Frame = QuantityFrame;
  return {
      {"position", "Places of the elements",
       "apparent places of the elements of U, V, W along x, y, z: from the Z axis, along Z from the X axis",
       kMotion, Frame::kPlatter, matrix_labels("r"), 3,
       motion([](const MotionResult& m) { return rows(m.position); }), "motion"},
      {"delay",
       "Delay",
       "delay of the item behind the encoders of X and Z",
       kMotion,
       Frame::kItem,
       {"delay X", "delay Z"},
       1,
       motion([](const MotionResult& m) { return list(m.delay); }),
       "motion"},
      {"delay_difference", "Delay of each output", "delay of each output beyond that of the item", kMotion,
       Frame::kItem, labels("delay {}", kOutputNames), 1,
       motion([](const MotionResult& m) { return list(m.delay_difference); }), "motion"},
      {"rate_offset", "Offset with the rate", "change of the offset at 60 degrees/s", kMotion, Frame::kItem,
       labels("O_{}(60)", kOutputNames), 1, motion([](const MotionResult& m) { return list(m.rate_offset); }),
       "motion"},
      {"axes_distance",
       "Distance of the axes",
       "distance of the axes X and Z",
       kMotion,
       Frame::kStage,
       {"d_XZ"},
       0,
       motion([](const MotionResult& m) { return Values{m.axes_distance}; }),
       "motion"},
  };
}

std::vector<QuantityGroup>& all_groups() {
  static std::vector<QuantityGroup> groups = [] {
    std::vector<QuantityGroup> all = output_groups();
    for (QuantityGroup& group : all) group.of_protocol = true;
    for (const std::vector<QuantityGroup>& more : {joint_groups(), motion_groups()})
      all.insert(all.end(), more.begin(), more.end());
    return all;
  }();
  return groups;
}

/// The groups of a result that `is_wanted` wants.
template <class Wanted>
std::vector<FoundGroup> found_if(const CalibrationResult& result, Wanted is_wanted) {
  std::vector<FoundGroup> found;
  for (const QuantityGroup& group : all_groups()) {
    if (!is_wanted(group)) continue;
    std::vector<NamedQuantity> values;
    for (Quantity& quantity : group.values(result))
      values.push_back({group.symbols.at(values.size()), std::move(quantity)});
    if (!values.empty()) found.push_back({group, std::move(values)});
  }
  return found;
}

}  // namespace

std::string_view to_string(QuantityKind kind) {
  static constexpr auto kNames = names<QuantityKind>({{QuantityKind::kOutput, "output"},
                                                      {QuantityKind::kStage, "stage"},
                                                      {QuantityKind::kAccelerometer, "accelerometer"},
                                                      {QuantityKind::kMotion, "motion"}});
  return kNames.of(kind);
}

std::string_view to_string(QuantityFrame frame) {
  static constexpr auto kNames = names<QuantityFrame>({{QuantityFrame::kItem, "item"},
                                                       {QuantityFrame::kPlatter, "platter"},
                                                       {QuantityFrame::kStage, "stage"}});
  return kNames.of(frame);
}

const std::vector<QuantityGroup>& quantity_groups() {
  return all_groups();
}

std::vector<FoundGroup> found_groups(const CalibrationResult& result) {
  return found_if(result, [](const QuantityGroup&) { return true; });
}

std::vector<FoundGroup> found_groups(const CalibrationResult& result, QuantityKind kind) {
  return found_if(result, [kind](const QuantityGroup& group) { return group.kind == kind; });
}

std::vector<FoundGroup> further_outputs(const CalibrationResult& result) {
  return found_if(result, [](const QuantityGroup& group) {
    return group.kind == QuantityKind::kOutput && !group.of_protocol;
  });
}

std::vector<NamedQuantity> outputs(const CalibrationResult& result) {
  std::vector<NamedQuantity> all;
  for (const QuantityGroup& group : quantity_groups()) {
    if (group.kind != QuantityKind::kOutput) continue;
    std::vector<Quantity> values = group.values(result);
    values.resize(group.symbols.size());
    for (std::size_t i = 0; i < values.size(); ++i) all.push_back({group.symbols[i], std::move(values[i])});
  }
  return all;
}

CalibrationResult as_result(const PublishedResult& published) {
  CalibrationResult result;
  result.sensitivity_matrix = published.sensitivity_matrix;
  result.offset = published.offset;
  result.intrinsic_sensitivity = published.intrinsic_sensitivity;
  result.intrinsic_angle = published.intrinsic_angle;
  result.covariance = published.covariance;
  result.covariance_intrinsic = published.covariance_intrinsic;
  return result;
}

AddedQuantityGroup::AddedQuantityGroup(QuantityGroup group) {
  all_groups().push_back(std::move(group));
}

AddedQuantityGroup::~AddedQuantityGroup() {
  all_groups().pop_back();
}

}  // namespace abcal
