#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace abcal::sim {

/// A register of a VectorNav that holds numbers and does nothing else in the simulation, but for 25.
struct VectorNavRegister {
  unsigned id;
  bool writable;
  bool gnss;               ///< A VN-100 does not have it.
  std::string_view cells;  ///< One letter a value: 'u' a whole number, 'f' with 6 digits, 'e' as 1.0E+00.
  std::string_view initial;
};

/// nullptr: there is none.
const VectorNavRegister* vectornav_register(unsigned id);

/// Their factory values. @throws std::logic_error if the table is wrong
std::vector<double> factory_values(const VectorNavRegister& reg);

/// "+01.000000,3".
std::string register_text(const VectorNavRegister& reg, const std::vector<double>& values);

/// All of them.
const std::vector<VectorNavRegister>& vectornav_registers();

namespace vn {

/// Content of a part of a field of a binary group.
enum class Content : std::uint8_t {
  kZero,
  kTime,
  kAcceleration,
  kUncompensated,
  kMagnetic,
  kTemperature,
  kPressure,
  kYawPitchRoll,
  kQuaternion,
  kRate,
  kDeltaTime,
  kDeltaAngle,
  kDeltaVelocity,
  kRotationMatrix,
  kMagneticNed,
  kAccelerationNed
};
struct Part {
  Content content;
  std::uint8_t bytes;
};
using BinaryField = std::vector<Part>;

inline constexpr unsigned kGroups = 7;

/// Fields of group 0 (common), 1 (time), 2 (IMU), 3 (GNSS), 4 (attitude), 5 (INS) or 6 (GNSS 2) in the order
/// of their bits. Fields that the device does not simulate are zero, also the GNSS and INS fields of a VN-100
/// [unverified against a device].
const std::vector<BinaryField>& fields_of_group(unsigned group);

}  // namespace vn

}  // namespace abcal::sim
