#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/accelerometer.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/scpi_voltmeter/meter.h"
#include "drivers/wire/byte_stream.h"

namespace abcal {

/// An analog accelerometer whose three outputs SCPI voltmeters measure (docs/protocols/scpi_voltmeters.md).
///
/// Reading::output is (V - bias) / scale by channel, in AccelerometerSettings::unit ("V" if that is empty);
/// cross-axis terms are the calibration's business. Each reading is one scan on request (READ?), begun
/// 1 / rate_hz after the one before or when next() is called, whichever is later; sequence counts the scans.
/// A channel beyond its range (9.9E37) reads as the end of the range, with over_range.
///
/// next() keeps its deadline: a scan that lasts longer stays under way, and the next call waits on. A scan
/// that has no reply, or a damaged one, is lost and counted; see scpi::Meter for why a late reply is never
/// taken for another one. SCPI has no checksum: a digit that changes on the line is not noticed.
class VoltmeterAccelerometer : public Accelerometer {
 public:
  ~VoltmeterAccelerometer() override;

  /// Queries the identity of every voltmeter. A scan under way is abandoned, and start() must be called
  /// again.
  /// @throws InstrumentError kWrongIdentity if one is not a known model (the message lists these); kNoReply.
  AccelerometerInfo identify() override;

  /// Identifies, resets (*RST) and sets the voltmeters, and takes one scan, which is not delivered
  /// (eleven if the first one was slower than the rate).
  /// @throws InstrumentError kRefused: in the voltmeter's words; or rate_hz is more than the integration time
  ///   permits (computed before anything is set), or than these scans took in the mean; kImplausible: it
  ///   reports that it scans other channels than commanded; kBadFrame: its reply has other channels.
  void start() override;

  /// @throws InstrumentError kNoReply and kBadFrame if three scans in a row are lost; kRefused if the
  /// voltmeter reports the reason.
  std::optional<Reading> next(Clock::Instant deadline) override;

  /// The scan under way, having begun before now, will be discarded. Does not wait for it.
  void discard_pending() override;
  StreamHealth health() const override;

  /// Aborts the scan where the model can, and returns it to its front panel.
  void stop() noexcept override;

 protected:
  enum class Wiring { kOneScanner, kThreeSingles };
  VoltmeterAccelerometer(Wiring wiring, std::vector<std::unique_ptr<wire::ByteStream>> streams, Clock& clock,
                         const AccelerometerSettings& settings);

 private:
  enum class Family { kKeysightScanner, kKeithley2700, kKeithley2001, kSingle };

  Family family_of(const scpi::Meter& meter, const scpi::Identity& identity) const;
  std::vector<std::string> setup(Family family) const;
  void check_rate_against_integration() const;
  void check_rate_by_trial();
  double trial_scan_s();
  void begin_scans();
  bool collect(Clock::Instant deadline);
  std::optional<std::size_t> loser() const;
  Reading make_reading() const;
  double slowest_scan_s() const;

  Wiring wiring_;
  Clock& clock_;
  AccelerometerSettings settings_;
  std::vector<scpi::Meter> meters_;
  std::vector<Family> families_;

  // Since start().
  bool started_ = false;
  Clock::Instant due_;                                      ///< When the next scan is to begin.
  bool under_way_ = false;                                  ///< A scan.
  std::vector<std::optional<scpi::ScanOutcome>> outcomes_;  ///< Outcomes of the scan under way, by voltmeter.
  bool discard_scan_ = false;                               ///< The scan under way is to be discarded.
  std::uint64_t sequence_ = 0;
  std::uint64_t readings_ = 0;
  std::uint64_t lost_ = 0;
  std::uint64_t lost_in_a_row_ = 0;
};

/// One voltmeter that scans the three outputs: Keysight (Agilent, HP) 34970A, 34972A, DAQ970A; Keithley 2700,
/// 2001. The model is read by *IDN?. Replies name their channels, so u, v, w are never mixed up, in any order
/// of the scan.
///
/// The channels are measured one after the other: u and w are two thirds of a scan apart. At rest this does
/// not matter.
class ScpiScanningVoltmeter final : public VoltmeterAccelerometer {
 public:
  /// @throws std::invalid_argument for invalid settings.
  ScpiScanningVoltmeter(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                        const AccelerometerSettings& settings);
};

/// Three voltmeters of one channel each (34401A and its successors), in the order u, v, w, each on its own
/// line. AccelerometerSettings::channels are not used.
///
/// READ? goes to all three before any reply is awaited. They integrate at the same time but for the time that
/// the three writes and the instruments' own reaction take: milliseconds on USB and Ethernet, up to some
/// 10 ms on serial lines of 9600 baud. Reading::arrival is that of the last reply.
class ScpiSingleVoltmeters final : public VoltmeterAccelerometer {
 public:
  /// @throws std::invalid_argument for invalid settings.
  ScpiSingleVoltmeters(std::array<std::unique_ptr<wire::ByteStream>, 3> streams, Clock& clock,
                       const AccelerometerSettings& settings);
};

}  // namespace abcal
