#include "app/measure/bench/instrument_leases.h"

#include <map>
#include <optional>
#include <utility>

#include "app/bench_file/not_real.h"
#include "drivers/wire/lease.h"

namespace abcal {
namespace {

/// Simulators of others count their instruments: "1" is the number of many.
constexpr std::size_t kShortestIdentity = 4;

class LeasedAccelerometer final : public Accelerometer {
 public:
  LeasedAccelerometer(std::unique_ptr<Accelerometer> accelerometer, std::string driver, std::string holder)
      : driver_(std::move(driver)), holder_(std::move(holder)), accelerometer_(std::move(accelerometer)) {}

  AccelerometerInfo identify() override {
    AccelerometerInfo info = accelerometer_->identify();
    for (const std::string& resource :
         resources_of_instrument(driver_, info.maker, info.model, info.serial_number))
      leases_[resource] = wire::Lease::take(resource, holder_);
    return info;
  }
  std::map<std::string, std::string> correction_registers() override {
    return accelerometer_->correction_registers();
  }
  CorrectionRegisters* corrections() override { return accelerometer_->corrections(); }
  void start() override { accelerometer_->start(); }
  std::optional<Reading> next(Clock::Instant deadline) override { return accelerometer_->next(deadline); }
  void discard_pending() override { accelerometer_->discard_pending(); }
  StreamHealth health() const override { return accelerometer_->health(); }
  void stop() noexcept override { accelerometer_->stop(); }

 private:
  const std::string driver_, holder_;
  std::map<std::string, std::shared_ptr<wire::Lease>> leases_;  ///< Released after the driver's last bytes.
  std::unique_ptr<Accelerometer> accelerometer_;
};

}  // namespace

std::vector<std::string> resources_of_instrument(const std::string& driver, const std::string& maker,
                                                 const std::string& model, const std::string& serial_number) {
  std::vector<std::string> resources;
  for (const std::string& number : single_serial_numbers(serial_number))
    if (number.size() >= kShortestIdentity && is_serial_number_reported(number) &&
        !is_emulated_serial_number(number, driver))
      resources.push_back(wire::Lease::of_instrument(maker, model, number));
  return resources;
}

std::unique_ptr<Accelerometer> leased_accelerometer(std::unique_ptr<Accelerometer> accelerometer,
                                                    std::string driver, std::string holder) {
  return std::make_unique<LeasedAccelerometer>(std::move(accelerometer), std::move(driver),
                                               std::move(holder));
}

}  // namespace abcal
