#include "sim/firmware/pi_gcs_parameters.h"

#include <algorithm>
#include <array>

namespace abcal::sim {
namespace {

constexpr int kMaker = PiParameter::kMaker;

// Ids and meanings: docs/protocols/pi_gcs.md. The levels are [unverified against a device], but for those
// that host programs write without a CCL before.
constexpr auto kParameters = std::to_array<PiParameter>({
    {0x01, 0, "INT", "40", "P term"},
    {0x02, 0, "INT", "1800", "I term"},
    {0x03, 0, "INT", "3300", "D term"},
    {0x08, 0, "FLOAT", "2", "Maximum position error"},
    {0x09, 0, "INT", "32767", "Maximum motor output"},
    {pi_id::kMaxVelocity, kMaker, "FLOAT", "", "Maximum closed-loop velocity"},
    {pi_id::kAcceleration, 0, "FLOAT", "", "Closed-loop acceleration"},
    {pi_id::kDeceleration, 0, "FLOAT", "", "Closed-loop deceleration"},
    {0x0E, kMaker, "INT", "10000", "Numerator of the counts-per-physical-unit factor"},
    {0x0F, kMaker, "INT", "1", "Denominator of the counts-per-physical-unit factor"},
    {0x14, kMaker, "INT", "1", "Stage has a reference"},
    {pi_id::kPositiveLimit, kMaker, "FLOAT", "", "Maximum travel in positive direction"},
    {0x16, kMaker, "FLOAT", "0", "Value at reference position"},
    {pi_id::kNegativeLimit, kMaker, "FLOAT", "", "Maximum travel in negative direction"},
    {0x32, kMaker, "INT", "0", "Stage has no limit switches"},
    {pi_id::kStageName, kMaker, "CHAR", "", "Stage name"},
    {pi_id::kSettleTime, 0, "FLOAT", "", "Settling time"},
    {pi_id::kVelocity, 0, "FLOAT", "", "Closed-loop velocity"},
    {pi_id::kMaxAcceleration, kMaker, "FLOAT", "", "Maximum closed-loop acceleration"},
    {pi_id::kMaxDeceleration, kMaker, "FLOAT", "", "Maximum closed-loop deceleration"},
    {0x50, 0, "FLOAT", "10", "Velocity for reference moves"},
    {0x56, 0, "INT", "1", "Activate encoder"},
    {0x57, kMaker, "FLOAT", "25", "Temperature of the controller"},
    {0x58, kMaker, "FLOAT", "85", "Maximum temperature of the controller"},
    {0x406, 0, "FLOAT", "10", "Window enter size"},
    {0x407, 0, "FLOAT", "12", "Window exit size"},
    {0x7000000, kMaker, "FLOAT", "0", "Travel range minimum"},
    {0x7000601, kMaker, "CHAR", "DEG", "User unit"},
});

}  // namespace

std::span<const PiParameter> pi_parameters() {
  return kParameters;
}

const PiParameter* pi_parameter(unsigned id) {
  const auto found = std::find_if(kParameters.begin(), kParameters.end(),
                                  [id](const PiParameter& parameter) { return parameter.id == id; });
  return found == kParameters.end() ? nullptr : &*found;
}

}  // namespace abcal::sim
