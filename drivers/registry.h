#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/wire/byte_stream.h"

namespace abcal {

/// How a driver's serial port is set where the bench file does not say.
struct SerialDefaults {
  unsigned baud = 115200;
  bool rts_cts = false;
};

struct StageDriver {
  std::string name;         ///< As in a bench file, e.g. "pi_gcs".
  std::string description;  ///< For lists and error messages.
  SerialDefaults serial;
  std::function<std::unique_ptr<RotationStage>(std::unique_ptr<wire::ByteStream>, Clock&,
                                               const StageSettings&)>
      make;
};

struct AccelerometerDriver {
  std::string name;
  std::string description;
  SerialDefaults serial;
  /// From as many streams as there are ports, nearly always one.
  std::function<std::unique_ptr<Accelerometer>(std::vector<std::unique_ptr<wire::ByteStream>>, Clock&,
                                               const AccelerometerSettings&)>
      make;
  std::size_t ports = 1;
};

/// The one list of drivers. A new instrument is a folder and a line here.
const std::vector<StageDriver>& stage_drivers();
const std::vector<AccelerometerDriver>& accelerometer_drivers();

}  // namespace abcal
