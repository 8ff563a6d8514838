#include "sim/firmware/vectornav_registers.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <initializer_list>
#include <stdexcept>

#include "drivers/text/text.h"

namespace abcal::sim {
namespace {

constexpr std::string_view kMatrixAndOffset = "1,0,0,0,1,0,0,0,1,0,0,0";
constexpr std::string_view kMatrix = "1,0,0,0,1,0,0,0,1";
constexpr std::string_view k12 = "ffffffffffff";
constexpr std::string_view k9 = "fffffffff";

}  // namespace

/// Layouts: docs/protocols/vectornav.md. The initial values of those that only tune the maker's filter are
/// [unverified against a device].
const std::vector<VectorNavRegister>& vectornav_registers() {
  constexpr bool kWritable = true;
  constexpr bool kReadOnly = false;
  constexpr bool kGnss = true;
  constexpr bool kAny = false;
  static const std::vector<VectorNavRegister> all{
      {21, kWritable, kAny, "ffffff", "1,0,1.8,0,0,-9.79375"},
      {22, kWritable, kAny, "eeeeffffff", "1e-9,1e-9,1e-9,1e-9,1,1,1,1,1,1"},
      {23, kWritable, kAny, k12, kMatrixAndOffset},
      {24, kWritable, kAny, "ffff", "1,0,1,0"},
      {25, kWritable, kAny, k12, kMatrixAndOffset},
      {26, kWritable, kAny, k9, kMatrix},
      {32, kWritable, kAny, "uuuuuuuuu", "3,0,0,0,6,1,0,100000000,0"},
      {33, kWritable, kAny, "uuu", "0,0,0"},
      {34, kWritable, kAny, "uuuufff", "1,0,1,1,0,0,0"},
      {35, kWritable, kAny, "uuuu", "1,1,1,1"},
      {36, kWritable, kAny, k9, "4,4,4,5,5,5,5.5,5.5,5.5"},
      {37, kWritable, kAny, k9, "0,0,0,0,0,0,0,0,0"},
      {38, kWritable, kAny, k9, "6,6,6,3,3,3,3,3,3"},
      {39, kWritable, kAny, k9, "0,0,0,0,0,0,0,0,0"},
      {40, kWritable, kAny, k9, "4,4,4,0,0,0,0,0,0"},
      {43, kWritable, kAny, "fff", "0,0,0"},
      {44, kWritable, kAny, "uuu", "1,3,5"},
      {47, kReadOnly, kAny, k12, kMatrixAndOffset},
      {48, kWritable, kAny, "fu", "0,0"},
      {50, kWritable, kAny, "fff", "0,0,0"},
      {51, kWritable, kAny, "uff", "1,0.1,0.01"},
      {52, kReadOnly, kAny, "uffffffff", "0,0,0,0,0,0,0,0,0"},
      {55, kWritable, kGnss, "uuuuu", "0,1,5,0,0"},
      {57, kWritable, kGnss, "fff", "0,0,0"},
      {58, kReadOnly, kGnss, "fuuuffffffffff", "0,0,0,0,0,0,0,0,0,0,0,0,0,0"},
      {59, kReadOnly, kGnss, "fuuuffffffffff", "0,0,0,0,0,0,0,0,0,0,0,0,0,0"},
      {63, kReadOnly, kGnss, "fuuffffffffffff", "0,0,0,0,0,0,0,0,0,0,0,0,0,0,0"},
      {64, kReadOnly, kGnss, "fuuffffffffffff", "0,0,0,0,0,0,0,0,0,0,0,0,0,0,0"},
      {67, kWritable, kGnss, "uuuu", "1,1,0,0"},
      {72, kReadOnly, kGnss, "fffffffffffffff", "0,0,0,0,0,0,0,0,0,0,0,0,0,0,0"},
      {73, kReadOnly, kGnss, "fffffffffffffff", "0,0,0,0,0,0,0,0,0,0,0,0,0,0,0"},
      {74, kWritable, kAny, "fffffff", "0,0,0,0,0,0,0"},
      {82, kWritable, kAny, "uuuuu", "0,0,0,0,0"},
      {83, kWritable, kAny, "uuuuuffff", "0,0,0,0,1000,0,0,0,0"},
      {84, kWritable, kAny, k12, kMatrixAndOffset},
      {85, kWritable, kAny, "uuuuuuuuuu", "0,4,0,0,0,0,3,0,0,0"},
      {93, kWritable, kGnss, "ffffff", "1,0,0,0,0,0"},
      {227, kWritable, kAny, "uuff", "800,800,0,0"},
  };
  return all;
}

const VectorNavRegister* vectornav_register(unsigned id) {
  const auto& all = vectornav_registers();
  const auto found = std::find_if(all.begin(), all.end(), [id](const auto& reg) { return reg.id == id; });
  return found == all.end() ? nullptr : &*found;
}

std::vector<double> factory_values(const VectorNavRegister& reg) {
  std::vector<double> values;
  for (const std::string_view text : pieces::split(reg.initial, ',')) {
    double value = 0.0;
    std::from_chars(text.data(), text.data() + text.size(), value);
    values.push_back(value);
  }
  if (values.size() != reg.cells.size())
    throw std::logic_error(fmt::format("simulated VectorNav: register {} has {} values for {} cells", reg.id,
                                       values.size(), reg.cells.size()));
  return values;
}

std::string register_text(const VectorNavRegister& reg, const std::vector<double>& values) {
  std::string text;
  for (std::size_t n = 0; n < values.size(); ++n) {
    if (n > 0) text += ',';
    switch (reg.cells[n]) {
      case 'u':
        text += fmt::format("{:.0f}", values[n]);
        break;
      case 'e':
        text += fmt::format("{:E}", values[n]);
        break;
      default:
        text += fmt::format("{:+09.6f}", values[n]);
    }
  }
  return text;
}

namespace vn {
namespace {

std::vector<BinaryField> zeros(std::initializer_list<std::uint8_t> sizes) {
  std::vector<BinaryField> fields;
  for (const std::uint8_t size : sizes) fields.push_back({{Content::kZero, size}});
  return fields;
}

}  // namespace

const std::vector<BinaryField>& fields_of_group(unsigned group) {
  using C = Content;
  static const std::vector<BinaryField> common{
      {{C::kTime, 8}},                                                // time since startup
      {{C::kZero, 8}},                                                // GPS time
      {{C::kTime, 8}},                                                // time since the last sync-in
      {{C::kYawPitchRoll, 12}},                                       // yaw, pitch, roll
      {{C::kQuaternion, 16}},                                         // quaternion
      {{C::kRate, 12}},                                               // angular rate
      {{C::kZero, 24}},                                               // latitude, longitude, altitude
      {{C::kZero, 12}},                                               // velocity
      {{C::kAcceleration, 12}},                                       // acceleration
      {{C::kUncompensated, 12}, {C::kRate, 12}},                      // IMU: acceleration, gyro
      {{C::kMagnetic, 12}, {C::kTemperature, 4}, {C::kPressure, 4}},  // magnetic field, temperature, pressure
      {{C::kDeltaTime, 4}, {C::kDeltaAngle, 12}, {C::kDeltaVelocity, 12}},
      {{C::kZero, 2}},   // status
      {{C::kZero, 4}},   // sync-in count
      {{C::kZero, 8}}};  // time since the GPS pulse
  static const std::vector<BinaryField> time{
      {{C::kTime, 8}}, {{C::kZero, 8}}, {{C::kZero, 8}}, {{C::kZero, 2}}, {{C::kTime, 8}},
      {{C::kZero, 8}}, {{C::kZero, 8}}, {{C::kZero, 4}}, {{C::kZero, 4}}, {{C::kZero, 1}}};
  static const std::vector<BinaryField> imu{{{C::kZero, 2}},
                                            {{C::kMagnetic, 12}},
                                            {{C::kUncompensated, 12}},
                                            {{C::kRate, 12}},
                                            {{C::kTemperature, 4}},
                                            {{C::kPressure, 4}},
                                            {{C::kDeltaTime, 4}, {C::kDeltaAngle, 12}},
                                            {{C::kDeltaVelocity, 12}},
                                            {{C::kMagnetic, 12}},
                                            {{C::kAcceleration, 12}},
                                            {{C::kRate, 12}},
                                            {{C::kZero, 2}},
                                            {{C::kZero, 40}}};
  static const std::vector<BinaryField> gnss = zeros({8, 8, 2, 1, 1, 24, 24, 12, 12, 12, 4, 4, 2, 28});
  static const std::vector<BinaryField> attitude{{{C::kZero, 2}},         {{C::kYawPitchRoll, 12}},
                                                 {{C::kQuaternion, 16}},  {{C::kRotationMatrix, 36}},
                                                 {{C::kMagneticNed, 12}}, {{C::kAccelerationNed, 12}},
                                                 {{C::kZero, 12}},        {{C::kZero, 12}},
                                                 {{C::kZero, 12}},        {{C::kZero, 12}},
                                                 {{C::kZero, 28}},        {{C::kZero, 24}},
                                                 {{C::kZero, 12}}};
  static const std::vector<BinaryField> ins = zeros({2, 24, 24, 12, 12, 12, 12, 12, 12, 4, 4, 68, 64});
  static const std::vector<BinaryField> none;
  switch (group) {
    case 0:
      return common;
    case 1:
      return time;
    case 2:
      return imu;
    case 3:
    case 6:
      return gnss;
    case 4:
      return attitude;
    case 5:
      return ins;
    default:
      return none;
  }
}

}  // namespace vn

}  // namespace abcal::sim
