#pragma once

#include <algorithm>
#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

namespace abcal {

/// Properties of a driver that a bench file depends on. Each driver states its own in its registration.
struct DriverTraits {
  // Stages.
  /// Last address of a controller in a daisy chain; the first is 1. 0: its controllers make no chains.
  int last_chain_address = 0;
  bool needs_chain_addresses = false;  ///< Each controller of a chain has an address in the bench file.

  // Accelerometers.
  bool reads_volts = false;   ///< Independent of the unit of its output after scaling.
  bool names_device = false;  ///< The key `names` is the name of one device, not of u, v and w.
  /// Whether the maker and the model that it reports are those of the item. False: they are the name of a
  /// protocol or of a framework, or unknown. A serial number that it reports is always that of the item.
  bool reports_maker = true, reports_model = true;

  // Chambers.
  bool tells_humidity = false;  ///< The chamber itself states whether it measures the relative humidity.
};

/// A driver as the catalogue has it: by its name, without the means of making an instrument.
struct CataloguedDriver {
  std::string name;
  bool has_port = true;       ///< False: a person sets the instrument.
  std::size_t ports = 1;      ///< Accelerometers: of one instrument.
  std::string output_unit{};  ///< Accelerometers: "g", "m/s2"; empty: that of the bench file.
  DriverTraits traits{};
};

struct DriverCatalogue {
  std::vector<CataloguedDriver> stages, accelerometers, chambers, environments;
};

/// All drivers of this program. abcal::drivers defines it, so that code which reads bench files links the
/// drivers without including any of them.
DriverCatalogue driver_catalogue();

/// The entry of a driver; one without traits if the list has no driver of this name, e.g. for "simulated".
inline CataloguedDriver find_in(const std::vector<CataloguedDriver>& drivers, std::string_view name) {
  const auto found = std::find_if(drivers.begin(), drivers.end(),
                                  [&](const CataloguedDriver& driver) { return driver.name == name; });
  return found == drivers.end() ? CataloguedDriver{} : *found;
}

}  // namespace abcal
