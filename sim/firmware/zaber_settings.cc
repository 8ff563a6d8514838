#include "sim/firmware/zaber_settings.h"

#include <algorithm>
#include <array>

namespace abcal::sim {
namespace {

constexpr bool kDevice = true;
constexpr bool kAxis = false;
constexpr bool kWritable = true;
constexpr bool kReadOnly = false;
constexpr bool kSince7 = true;
constexpr bool kAlways = false;

// Names, scopes and types: docs/protocols/zaber_ascii.md. The values belong to no particular device
// [unverified against a device].
constexpr auto kSettings = std::to_array<ZaberSetting>({
    {"cloop.enable", kAxis, kWritable, kSince7, "1", 0, 1},
    {"cloop.settle.period", kAxis, kWritable, kSince7, "20.0"},
    {"cloop.settle.tolerance", kAxis, kWritable, kSince7, "10"},
    {"cloop.stall.action", kAxis, kWritable, kSince7, "1", 0, 2},
    {"cloop.timeout", kAxis, kWritable, kSince7, "200"},
    {"comm.command.packets.max", kDevice, kReadOnly, kSince7, "3"},
    {"comm.next.owner", kDevice, kWritable, kSince7, "1", 0, 99},
    {"comm.packet.size.max", kDevice, kReadOnly, kSince7, "80"},
    {"comm.protocol", kDevice, kReadOnly, kAlways, "2"},
    {"comm.rs232.baud", kDevice, kReadOnly, kAlways, "115200"},
    {"comm.word.size.max", kDevice, kReadOnly, kSince7, "50"},
    {"device.hw.modified", kDevice, kReadOnly, kSince7, "0"},
    {"driver.current.hold", kAxis, kWritable, kAlways, "25", 0, 250},
    {"driver.current.max", kAxis, kReadOnly, kSince7, "100"},
    {"driver.current.run", kAxis, kWritable, kAlways, "50", 0, 250},
    {"driver.dir", kAxis, kReadOnly, kAlways, "0"},
    {"encoder.dir", kAxis, kReadOnly, kAlways, "0"},
    {"encoder.pos.error", kAxis, kReadOnly, kSince7, "0.00"},
    {"get.settings.max", kDevice, kReadOnly, kSince7, "10"},
    {"ictrl.type", kAxis, kReadOnly, kSince7, "0"},
    {"knob.dir", kAxis, kWritable, kAlways, "0", 0, 1},
    {"knob.distance", kAxis, kWritable, kAlways, "1000"},
    {"knob.maxspeed", kAxis, kWritable, kAlways, "100000"},
    {"knob.mode", kAxis, kWritable, kAlways, "0", 0, 1},
    {"knob.speedprofile", kAxis, kWritable, kAlways, "2", 1, 3},
    {"limit.approach.maxspeed", kAxis, kWritable, kAlways, "50000"},
    {"limit.away.state", kAxis, kReadOnly, kAlways, "0"},
    {"limit.away.triggered", kAxis, kReadOnly, kAlways, "0"},
    {"limit.home.action", kAxis, kReadOnly, kAlways, "0"},
    {"limit.home.edge", kAxis, kReadOnly, kAlways, "0"},
    {"limit.home.posupdate", kAxis, kReadOnly, kAlways, "2"},
    {"limit.home.preset", kAxis, kReadOnly, kAlways, "0"},
    {"limit.home.type", kAxis, kReadOnly, kAlways, "2"},
    {"limit.range.mode", kAxis, kReadOnly, kSince7, "0"},
    {"lockstep.numgroups", kDevice, kReadOnly, kAlways, "0"},
    {"motion.accel.ramptime", kAxis, kWritable, kSince7, "0.0"},
    {"motion.index.dist", kAxis, kWritable, kAlways, "10000"},
    {"motion.index.num", kAxis, kReadOnly, kAlways, "0"},
    {"peripheral.hw.modified", kAxis, kReadOnly, kSince7, "0"},
    {"peripheral.serial", kAxis, kReadOnly, kSince7, "0"},
    {"pvt.numseqs", kDevice, kReadOnly, kSince7, "0"},
    {"stream.numbufs", kDevice, kReadOnly, kAlways, "0"},
    {"stream.numstreams", kDevice, kReadOnly, kAlways, "0"},
    {"system.access", kDevice, kWritable, kAlways, "1", 1, 2},
    {"system.current.max", kDevice, kReadOnly, kSince7, "6.0"},
    {"system.led.enable", kDevice, kWritable, kAlways, "1", 0, 1},
    {"system.voltage", kDevice, kReadOnly, kAlways, "48.1"},
    {"trigger.numtriggers", kDevice, kReadOnly, kAlways, "0"},
    {"user.data.0", kDevice, kWritable, kSince7, "0", -9e15, 9e15},
    {"user.data.1", kDevice, kWritable, kSince7, "0", -9e15, 9e15},
    {"user.data.2", kDevice, kWritable, kSince7, "0", -9e15, 9e15},
    {"user.data.3", kDevice, kWritable, kSince7, "0", -9e15, 9e15},
});

}  // namespace

const ZaberSetting* zaber_setting(std::string_view name) {
  const auto found = std::find_if(kSettings.begin(), kSettings.end(),
                                  [name](const ZaberSetting& setting) { return setting.name == name; });
  return found == kSettings.end() ? nullptr : &*found;
}

}  // namespace abcal::sim
