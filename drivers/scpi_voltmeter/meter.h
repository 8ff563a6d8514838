#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/scpi_voltmeter/codec.h"
#include "drivers/wire/byte_stream.h"

namespace abcal::scpi {

/// The channels that a READ? measures, and the longest time it may take.
struct ScanPlan {
  std::vector<int> channels;  ///< Empty: a voltmeter of one channel, whose replies name none.
  Clock::Duration patience{};
};

/// How a scan ended.
struct ScanOutcome {
  std::vector<ChannelReading> readings;  ///< In the order of ScanPlan::channels; empty: the scan is lost.
  Clock::Instant arrival;                ///< Arrival of the reply's last byte.
  Fault fault = Fault::kNoReply;         ///< Why it is lost, and in words:
  std::string complaint;
};

/// One SCPI voltmeter on its line: asks it, sets it, and takes scans.
///
/// A reply names neither its query nor its scan. So there is never more than one query under way, and after
/// one that had no answer, or a damaged one, nothing is measured before the voltmeter has answered *IDN? with
/// its known identity: it answers in order, so replies before that one are late and are discarded. One
/// thread.
class Meter {
 public:
  Meter(std::unique_ptr<wire::ByteStream> stream, Clock& clock);

  /// Queries the identity, twice if necessary. Bytes that arrived before are discarded.
  /// @throws InstrumentError kNoReply, kWrongIdentity (the reply is not an identity; the message quotes it).
  Identity identify();

  /// Sends a command, and does not ask whether it was accepted.
  void send(std::string_view command);

  /// Sends commands without an answer, and after each reads the errors until there is none.
  /// @throws InstrumentError kRefused, in the instrument's words.
  void configure(const std::vector<std::string>& commands);

  /// The channels that the voltmeter itself reports that it scans. @throws InstrumentError kNoReply,
  /// kBadFrame.
  std::vector<int> scan_list();

  void set_plan(ScanPlan plan) { plan_ = std::move(plan); }

  /// Sends READ? and does not wait.
  /// @pre No scan is under way.
  void begin_scan();
  /// How the scan under way ended; nullopt if it has not by `deadline`. Lost if there is none.
  /// @throws InstrumentError kRefused if the instrument reports why there is no reading; kNoReply if it does
  /// not
  ///   answer *IDN? either.
  std::optional<ScanOutcome> await_scan(Clock::Instant deadline);

  /// Sends commands before the port is closed; a scan under way is abandoned.
  void leave(const std::vector<std::string>& commands) noexcept;

  /// For messages: "voltmeter 34970A (SN MY44012345) on tcp:10.0.0.7:5025".
  const std::string& instrument() const { return instrument_; }
  [[noreturn]] void fail(Fault fault, std::string_view detail) const;

  void restart_figures() { bad_frames_ = skipped_bytes_ = 0; }
  std::uint64_t bad_frames() const { return bad_frames_; }
  std::uint64_t skipped_bytes() const { return skipped_bytes_; }

 private:
  enum class Stage { kIdle, kScanning, kAwaitingIdentity, kAwaitingErrors };

  std::optional<std::string> take_reply(Clock::Instant deadline);
  void skip(std::string_view reply) { skipped_bytes_ += reply.size(); }
  template <class Parse>
  auto query(std::string_view command, Parse parse);
  std::vector<ErrorReport> take_errors();
  [[noreturn]] void refuse(const std::vector<ErrorReport>& errors, std::string_view command) const;

  std::optional<std::vector<ChannelReading>> decode_scan(std::string_view text, std::string& complaint) const;
  void resynchronise(Fault fault, std::string complaint);
  void run_out_of_time();
  std::optional<ScanOutcome> interpret(const std::string& reply);

  std::unique_ptr<wire::ByteStream> stream_;
  Clock& clock_;
  std::string instrument_;
  std::string received_;
  Clock::Instant last_arrival_;
  std::string identity_text_;  ///< The reply to *IDN? as received.
  ScanPlan plan_;

  Stage stage_ = Stage::kIdle;
  Clock::Instant give_up_at_;  ///< Deadline of the state stage_.
  int identity_asked_ = 0;
  Fault fault_ = Fault::kNoReply;  ///< Why the scan under way is lost, and in words:
  std::string complaint_;
  std::uint64_t bad_frames_ = 0;
  std::uint64_t skipped_bytes_ = 0;
};

}  // namespace abcal::scpi
