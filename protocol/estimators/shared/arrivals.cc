#include "protocol/estimators/shared/arrivals.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <optional>

namespace abcal {
namespace {

/// Follows the stage from dwell to dwell.
class Way {
 public:
  explicit Way(const RunRecord& record) : order_(record.axes_order), approach_(record.approach) {}

  void go_to(const DwellRecord& dwell) {
    if (dwell.motion) {
      // A sweep ends some way beyond its last angle.
      forget();
      at_[dwell.experiment == 3 ? 1 : 0].reset();
      at_[dwell.experiment == 3 ? 0 : 1] = dwell.experiment == 3 ? dwell.commanded_x : dwell.commanded_z;
      return;
    }
    std::array<Angle, 2> target{dwell.commanded_x, dwell.commanded_z};
    for (std::size_t axis = 0; axis < 2; ++axis)
      if (!approach_ && at_[axis]) target[axis] = nearest(target[axis], *at_[axis]);
    const bool both = at_[0] && at_[1] && *at_[0] != target[0] && *at_[1] != target[1];
    if (both && order_ != AxesOrder::kXThenZ) forget();
    for (std::size_t axis = 0; axis < 2; ++axis) {
      if (!both || order_ == AxesOrder::kXThenZ) turn(axis, target[axis], target);
      at_[axis] = target[axis];
    }
    // It may have moved again, or not.
    if ((dwell.flags & kFlagRepeated) != 0U) forget();
  }

  Arrival take() {
    Arrival out{known_, std::move(legs_)};
    legs_.clear();
    known_ = true;
    return out;
  }

 private:
  /// An angle of a record that does not state how it was reached is known but for whole turns.
  static Angle nearest(Angle angle, Angle to) {
    return to + Angle::degrees(std::remainder((angle - to).deg(), 360.0));
  }

  void forget() {
    known_ = false;
    legs_.clear();
  }

  void turn(std::size_t axis, Angle target, const std::array<Angle, 2>& targets) {
    const std::optional<Angle> other = axis == 0 ? at_[1] : std::optional(targets[0]);
    if (at_[axis] == target) return;
    if (!at_[axis] || !other) return forget();
    const auto go = [&](Angle from, Angle to) {
      legs_.push_back({axis == 0, from.rad(), to.rad(), other->rad()});
    };
    if (target > *at_[axis]) return go(*at_[axis], target);
    if (!approach_) return forget();
    if (*approach_ > Angle{}) go(*at_[axis], target - *approach_);
    go(*approach_ > Angle{} ? target - *approach_ : *at_[axis], target);
  }

  std::optional<AxesOrder> order_;
  std::optional<Angle> approach_;
  std::array<std::optional<Angle>, 2> at_;
  bool known_ = false;
  std::vector<StageLeg> legs_;
};

}  // namespace

std::vector<ReadingArrival> arrivals_at(const RunRecord& record, std::span<const DwellRecord* const> dwells) {
  std::vector<ReadingArrival> out;
  Way way(record);
  for (const DwellRecord* dwell : dwells_in_time(record)) {
    way.go_to(*dwell);
    if (out.size() < dwells.size() && dwell == dwells[out.size()])
      out.push_back({dwell->experiment, dwell->face, way.take()});
  }
  out.resize(dwells.size());
  return out;
}

}  // namespace abcal
