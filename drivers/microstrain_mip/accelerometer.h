#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/correction_registers.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/microstrain_mip/codec.h"
#include "drivers/wire/byte_stream.h"
#include "drivers/wire/packet_accelerometer.h"

namespace abcal {

/// A MicroStrain inertial sensor that speaks MIP (3DM-GX3 to -GX5, CX5, CV5, CV7, GV7...), used for its
/// accelerometers: scaled output in g, sign as in mip::decode_scaled_accelerometer.
///
/// Every exchange begins with "set idle", so that an answer can be distinguished from the stream; an answer
/// is recognised by its descriptor set and by the echo of its command, so data packets and late answers in
/// between do no harm. Changes the running configuration of the device, never the stored one.
class MipAccelerometer final : public wire::PacketAccelerometer<mip::PacketParser>,
                               public CorrectionRegisters {
 public:
  /// @throws std::invalid_argument if settings.rate_hz is not a positive number or stream is null.
  MipAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                   const AccelerometerSettings& settings);

  /// Identifies (the device may have been changed or restarted), sets the message format and lets the data
  /// flow.
  /// @throws InstrumentError kRefused also if no decimation gives rate_hz within 1 %, or if the link is too
  /// slow.
  void start() override;

  /// The accelerometer bias (0C,37), where the device has it.
  std::map<std::string, std::string> correction_registers() override;

  // The accelerometer bias; no model has a command for scales.
  CorrectionRegisters* corrections() override { return this; }
  CorrectionAbility ability() override;
  OutputCorrection decode(const RegisterTexts& registers) override;
  RegisterTexts encode(const OutputCorrection& wanted, const RegisterTexts& now) override;
  void write(const RegisterTexts& registers) override;
  /// This setting alone.
  void save(const RegisterTexts& registers) override;

 private:
  /// Abilities of the device that decide how it is configured.
  struct Abilities {
    bool modern = false;  ///< 0C,0E and 0C,0F; else 0C,06 and 0C,08.
    bool stream_control = false;
    bool reference_time = false;
    bool gps_timestamp = false;
    bool temperature = false;
    bool over_range = false;
    bool accelerometer_bias = false;
    std::vector<std::uint8_t> other_data_sets;  ///< Other data sets that share the line (filter, GNSS...).
    std::uint16_t base_rate_hz = 0;
    std::uint16_t decimation = 1;
  };

  // Commands. None of them is sent while it streams.
  void make_quiet() override;
  AccelerometerInfo interrogate() override;
  double rate_hz() const;
  std::vector<mip::FormatEntry> wanted_format() const;
  void check_rate_and_link(const std::vector<mip::FormatEntry>& format) const;
  void select_streams();

  // Data.
  wire::DecodedFrame decode(const mip::Packet& packet) override;
  std::optional<std::uint64_t> steps_since_last_reading(
      std::optional<std::uint64_t> reference_time_ns, const std::optional<mip::GpsTimestamp>& gps_timestamp);

  Abilities abilities_;

  // Since start().
  std::optional<std::uint64_t> last_reference_time_ns_;
  std::optional<mip::GpsTimestamp> last_gps_timestamp_;
  std::optional<double> temperature_degc_;
  Clock::Instant temperature_arrival_;
};

}  // namespace abcal
