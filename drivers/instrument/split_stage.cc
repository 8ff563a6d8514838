#include "drivers/instrument/split_stage.h"

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

bool SplitStage::halt() noexcept {
  bool x_stopped = false;
  std::thread beside;
  try {
    beside = std::thread([this, &x_stopped] { x_stopped = x_->halt(); });
  } catch (const std::system_error&) {  // No thread to be had: one after the other.
    x_stopped = x_->halt();
  }
  const bool z_stopped = z_->halt();
  if (beside.joinable()) beside.join();
  return x_stopped && z_stopped;
}

}  // namespace abcal
