// The contract suite that comes with abcal, for the factory's stage.

#include <memory>

#include "factory_stage.h"
#include "tests/contract/instrument_contract.h"

namespace abcal::contract {
namespace {

/// Time jumps: the suite takes no seconds.
class JumpingClock final : public Clock {
 public:
  Instant now() const override { return now_; }
  void sleep_until(Instant instant) override { now_ = std::max(now_, instant); }
  UtcTime utc_now() const override { return {}; }

 private:
  Instant now_{};
};

StageBench factory_bench() {
  auto clock = std::make_shared<JumpingClock>();
  return {clock, std::make_shared<factory::Stage>(*clock, 20.0)};
}

INSTANTIATE_TEST_SUITE_P(Factory, StageContract, testing::Values(StageCase{"stage", factory_bench}),
                         [](const auto& one) { return one.param.name; });

}  // namespace

// No accelerometer here.
GTEST_ALLOW_UNINSTANTIATED_PARAMETERIZED_TEST(AccelerometerContract);

}  // namespace abcal::contract
