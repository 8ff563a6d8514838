#include "drivers/registry.h"

#include <array>
#include <utility>

#include "drivers/microstrain_mip/accelerometer.h"
#include "drivers/newport_esp/stage.h"
#include "drivers/pi_gcs/stage.h"
#include "drivers/scpi_voltmeter/accelerometer.h"
#include "drivers/text_line/accelerometer.h"
#include "drivers/vectornav/accelerometer.h"
#include "drivers/witmotion/accelerometer.h"
#include "drivers/xsens_mti/accelerometer.h"
#include "drivers/zaber_ascii/stage.h"

namespace abcal {
namespace {

template <class Driver>
std::unique_ptr<RotationStage> make_stage(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                          const StageSettings& settings) {
  return std::make_unique<Driver>(std::move(stream), clock, settings);
}

template <class Driver>
std::unique_ptr<Accelerometer> make_accelerometer(std::vector<std::unique_ptr<wire::ByteStream>> streams,
                                                  Clock& clock, const AccelerometerSettings& settings) {
  return std::make_unique<Driver>(std::move(streams.at(0)), clock, settings);
}

std::unique_ptr<Accelerometer> make_three_voltmeters(std::vector<std::unique_ptr<wire::ByteStream>> streams,
                                                     Clock& clock, const AccelerometerSettings& settings) {
  std::array<std::unique_ptr<wire::ByteStream>, 3> three;
  for (std::size_t j = 0; j < 3; ++j) three[j] = std::move(streams.at(j));
  return std::make_unique<ScpiSingleVoltmeters>(std::move(three), clock, settings);
}

}  // namespace

const std::vector<StageDriver>& stage_drivers() {
  static const std::vector<StageDriver> drivers{
      {"pi_gcs",
       "PI controllers that speak GCS 2.0 (C-884, C-863, E-861, ...), serial or TCP port 50000",
       {115200, false},
       make_stage<pi_gcs::PiGcsStage>},
      {"newport_esp",
       "Newport ESP301, ESP300 and ESP302 over RS-232",
       {19200, true},
       make_stage<newport_esp::NewportEspStage>},
      {"zaber_ascii",
       "Zaber rotary stages that speak ASCII, on one controller or in a daisy chain",
       {115200, false},
       make_stage<zaber_ascii::ZaberAsciiStage>},
  };
  return drivers;
}

const std::vector<AccelerometerDriver>& accelerometer_drivers() {
  static const std::vector<AccelerometerDriver> drivers{
      {"microstrain_mip",
       "MicroStrain 3DM, CV, CX, GX and GV sensors that speak MIP, output in g",
       {115200, false},
       make_accelerometer<MipAccelerometer>},
      {"vectornav",
       "VectorNav VN-100, VN-200, VN-300 and their like, output in m/s2",
       {115200, false},
       make_accelerometer<VectorNavAccelerometer>},
      {"xsens_mti",
       "Xsens (Movella) MTi sensors that speak Xbus with MTData2, output in m/s2",
       {115200, false},
       make_accelerometer<XsensMtiAccelerometer>},
      {"scpi_voltmeter",
       "analog accelerometers behind a scanning voltmeter: Keysight 34970A, 34972A, DAQ970A, Keithley 2700, "
       "2001",
       {9600, false},
       make_accelerometer<ScpiScanningVoltmeter>},
      {"scpi_single",
       "analog accelerometers behind three voltmeters of one channel: Keysight 34401A, 34465A and their like",
       {9600, false},
       make_three_voltmeters,
       3},
      {"witmotion",
       "WitMotion sensors (WT61, WT901, HWT901, ...), output in g",
       {9600, false},
       make_accelerometer<WitMotionAccelerometer>},
      {"text_line",
       "boards that print lines of numbers, output in the unit of the bench file",
       {115200, false},
       make_accelerometer<TextLineAccelerometer>},
  };
  return drivers;
}

}  // namespace abcal
