#pragma once

#include <string_view>

namespace abcal::sim {

/// A setting of a Zaber device or axis that a host can read and perhaps write, and that does nothing else
/// here.
struct ZaberSetting {
  std::string_view name;
  bool of_device;  ///< False: of each axis.
  bool writable;
  bool since_7;  ///< Unknown to firmware 6.
  std::string_view initial;
  double lowest = 0.0;  ///< Limits of values that may be written.
  double highest = 1e12;
};

/// Null if no setting has this name.
const ZaberSetting* zaber_setting(std::string_view name);

}  // namespace abcal::sim
