#pragma once

#include <span>
#include <string_view>

namespace abcal::sim {

/// A parameter of an axis of a PI controller (SPA, SEP), as HPA? lists it.
struct PiParameter {
  /// Command level above those that CCL reaches: written by the maker only.
  static constexpr int kMaker = 3;

  unsigned id;
  int write_level;           ///< CCL level from which on it may be written.
  std::string_view type;     ///< "INT", "FLOAT" or "CHAR", the words that hosts know.
  std::string_view initial;  ///< At first power-on; empty: computed from the stage.
  std::string_view description;
};

/// In order of the ids.
std::span<const PiParameter> pi_parameters();

/// nullptr: there is none.
const PiParameter* pi_parameter(unsigned id);

namespace pi_id {
inline constexpr unsigned kAcceleration = 0x0B;
inline constexpr unsigned kDeceleration = 0x0C;
inline constexpr unsigned kPositiveLimit = 0x15;
inline constexpr unsigned kNegativeLimit = 0x30;
inline constexpr unsigned kMaxVelocity = 0x0A;
inline constexpr unsigned kStageName = 0x3C;
inline constexpr unsigned kSettleTime = 0x3F;
inline constexpr unsigned kVelocity = 0x49;
inline constexpr unsigned kMaxAcceleration = 0x4A;
inline constexpr unsigned kMaxDeceleration = 0x4B;
}  // namespace pi_id

}  // namespace abcal::sim
