#include "sim/emulated_serial_numbers.h"

#include <map>

#include "sim/firmware/described_firmware.h"
#include "sim/firmware/iio_firmware.h"
#include "sim/firmware/mavlink_firmware.h"
#include "sim/firmware/mip_firmware.h"
#include "sim/firmware/newport_esp_firmware.h"
#include "sim/firmware/pi_gcs_firmware.h"
#include "sim/firmware/scpi_voltmeter_firmware.h"
#include "sim/firmware/thorlabs_apt_firmware.h"
#include "sim/firmware/vectornav_firmware.h"
#include "sim/firmware/weiss_firmware.h"
#include "sim/firmware/xsens_mti_firmware.h"
#include "sim/firmware/zaber_ascii_firmware.h"

namespace abcal::sim {

std::vector<std::string> emulated_serial_numbers(const std::string& driver) {
  static const std::map<std::string, std::vector<std::string>> all = [] {
    const std::string voltmeter = ScpiVoltmeterSettings{}.serial_number;
    const NewportEspSettings newport;
    const PiGcsSettings pi;
    const ZaberAsciiSettings zaber;
    return std::map<std::string, std::vector<std::string>>{
        {"described", {DescribedSettings{}.serial_number, zaber.serial_number, zaber.z_serial_number}},
        {"iio", {IioSettings{}.serial_number}},
        {"mavlink", {MavlinkSettings{}.serial_number}},
        {"microstrain_mip", {MipSettings{}.serial_number}},
        {"newport_esp", {newport.serial_number, newport.z_serial_number}},
        {"pi_gcs", {pi.serial_number, pi.z_serial_number}},
        {"scpi_single", {voltmeter + "u", voltmeter + "v", voltmeter + "w"}},
        {"scpi_voltmeter", {voltmeter}},
        {"thorlabs_apt", {ThorlabsAptSettings{}.serial_number}},
        {"vectornav", {VectorNavSettings{}.serial_number}},
        {"xsens_mti", {XsensMtiSettings{}.device_id}},
        {"weiss_simserv", {WeissSettings{}.serial_number}},
        {"zaber_ascii", {zaber.serial_number, zaber.z_serial_number}}};
  }();
  const auto found = all.find(driver);
  return found == all.end() ? std::vector<std::string>{} : found->second;
}

}  // namespace abcal::sim
