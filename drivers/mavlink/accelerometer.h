#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/correction_registers.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/mavlink/codec.h"
#include "drivers/wire/packet_accelerometer.h"

namespace abcal {

/// The accelerometers of a flight controller that speaks MAVLink 1 or 2 (PX4, ArduPilot): output in m/s2, the
/// specific force along its own x (forward), y (right), z (down). HIGHRES_IMU, where the controller has it;
/// else SCALED_IMU, in steps of a thousandth of g.
///
/// Its messages are asked for with MAV_CMD_SET_MESSAGE_INTERVAL; stop() asks for the controller's own rate
/// again. A gap in the numbers of the messages and in their times shows how many readings are missing.
class MavlinkAccelerometer final : public wire::PacketAccelerometer<mavlink::FrameParser>,
                                   public CorrectionRegisters {
 public:
  /// @throws std::invalid_argument if settings.rate_hz is not a positive number or stream is null.
  MavlinkAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                       const AccelerometerSettings& settings);

  /// Identifies and asks for the messages. next() then throws kNotReady if the controller was restarted or
  /// its heartbeat is missing for 5 s.
  /// @throws InstrumentError kRefused if it has neither message at this rate, or if the link is too slow.
  void start() override;

  /// The parameters of the first accelerometer (CAL_ACC0_* of PX4, INS_ACCOFFS_* and INS_ACCSCAL_* of
  /// ArduPilot) and of the board's rotation; empty: it does not report them, or is another autopilot.
  std::map<std::string, std::string> correction_registers() override;

  // These parameters, but for the rotation.
  CorrectionRegisters* corrections() override { return this; }
  CorrectionAbility ability() override;
  OutputCorrection decode(const RegisterTexts& registers) override;
  RegisterTexts encode(const OutputCorrection& wanted, const RegisterTexts& now) override;
  /// @throws InstrumentError kRefused: armed
  void require_writable() override;
  void write(const RegisterTexts& registers) override;
  /// Does nothing: the instrument stores parameters at once.
  void save(const RegisterTexts&) override {}

 private:
  void make_quiet() override;
  AccelerometerInfo interrogate() override;
  wire::DecodedFrame decode(const mavlink::Frame& frame) override;
  wire::DecodedFrame decode_acceleration(const mavlink::Acceleration& acceleration);

  mavlink::Heartbeat await_heartbeat();
  mavlink::Parameter ask_parameter(const std::string& name, const std::string& bytes, std::string_view verb);
  Command command(std::uint16_t number, float first, float second, std::string_view name) const;
  std::optional<unsigned> set_interval(std::uint32_t message, double interval_us);

  std::uint8_t system_ = 1;
  std::uint8_t component_ = 1;
  std::uint8_t autopilot_ = 0;

  // Since start().
  std::uint32_t message_ = mavlink::kHighresImu;
  bool asked_for_ = false;  ///< The controller has been commanded to send it.
  double interval_us_ = 0.0;
  std::optional<std::uint8_t> last_sequence_;
  bool gap_ = false;  ///< Messages are missing since the last reading.
  std::optional<std::uint64_t> last_time_us_;
  std::optional<std::uint64_t> heartbeat_time_us_;  ///< Time of the last reading before the heartbeat.
};

}  // namespace abcal
