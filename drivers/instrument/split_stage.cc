#include "drivers/instrument/split_stage.h"

#include <algorithm>
#include <stdexcept>
#include <string>
#include <system_error>
#include <thread>
#include <utility>

namespace abcal {
namespace {

std::string merged(const std::string& x, const std::string& z) {
  return x == z ? x : x + " + " + z;
}

}  // namespace

SplitStage::SplitStage(std::unique_ptr<RotationStage> x, std::unique_ptr<RotationStage> z)
    : x_(std::move(x)), z_(std::move(z)) {
  if (x_ == nullptr || z_ == nullptr)
    throw std::invalid_argument(std::string("SplitStage: no controller for axis ") +
                                (x_ == nullptr ? "X" : "Z"));
}

StageInfo SplitStage::identify() {
  const StageInfo x = x_->identify();
  const StageInfo z = z_->identify();
  StageInfo info;
  info.maker = merged(x.maker, z.maker);
  info.model = merged(x.model, z.model);
  info.serial_number = merged(x.serial_number, z.serial_number);
  info.firmware = merged(x.firmware, z.firmware);
  info.axes = {x.axes[index(StageAxis::kX)], z.axes[index(StageAxis::kZ)]};
  return info;
}

HaltReport SplitStage::halt_axes() noexcept {
  HaltReport x;
  std::thread beside;
  try {
    beside = std::thread([this, &x] { x = x_->halt_axes(); });
  } catch (const std::system_error&) {  // No thread is available: one after the other.
    x = x_->halt_axes();
  }
  const HaltReport z = z_->halt_axes();
  if (beside.joinable()) beside.join();
  return {{x.axes[index(StageAxis::kX)], z.axes[index(StageAxis::kZ)]}};
}

std::vector<HaltRecipe> SplitStage::halt_recipes() {
  std::vector<HaltRecipe> recipes = x_->halt_recipes();
  for (HaltRecipe& recipe : z_->halt_recipes()) recipes.push_back(std::move(recipe));
  return recipes;
}

Clock::Duration SplitStage::reply_deadline() const {
  return std::max(x_->reply_deadline(), z_->reply_deadline());
}

std::vector<StageEvent> SplitStage::take_events() {
  std::vector<StageEvent> events = x_->take_events();
  for (StageEvent& event : z_->take_events()) events.push_back(std::move(event));
  return events;
}

}  // namespace abcal
