#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/iio/codec.h"
#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/byte_stream.h"

namespace abcal::iio {

/// Questions to an iiod, one at a time, and blocks of samples.
///
/// A reply does not name its question, but replies come in the order of the questions. So after one that is
/// missing or damaged nothing else is asked before the server has answered VERSION with its known version.
/// Whatever arrives before that answer is late and is discarded. One thread.
class Session {
 public:
  /// Both must outlive this. Sends nothing.
  Session(wire::ByteStream& stream, Clock& clock);

  void rename(std::string who) { who_ = std::move(who); }
  [[noreturn]] void fail(Fault fault, std::string_view detail) const;
  /// kRefused in words: `error` is a negative number of the system.
  [[noreturn]] void refuse(std::string_view command, std::int64_t error, std::string_view advice = {}) const;

  /// Forgets earlier questions, and asks for the server's version. @return its version
  /// @throws InstrumentError kNoReply, kWrongIdentity.
  std::string greet();

  /// `data` follows the command's line. Repeated if no reply arrives, except commands that must not be
  /// carried out twice.
  /// @throws InstrumentError kNoReply, kBadFrame.
  std::int64_t number(std::string_view command, std::string_view data = {}, bool may_repeat = true);
  /// Absent: it was refused; `error` then has the number.
  std::optional<std::string> text(std::string_view command, std::int64_t* error = nullptr,
                                  ReplyKind kind = ReplyKind::kText);

  /// Asks for a block of samples and does not wait.
  /// @pre None is under way. @throws InstrumentError kNoReply: the server is silent after a lost block.
  void begin_block(std::string_view command, std::size_t wanted, std::string_view mask,
                   Clock::Duration patience);
  bool block_under_way() const { return under_way_; }
  enum class BlockEnd { kNotYet, kLost, kDamaged, kComplete };
  BlockEnd await_block(Clock::Instant deadline, Samples& samples);

  Clock::Instant last_arrival() const { return last_arrival_; }
  std::uint64_t skipped_bytes() const { return skipped_bytes_; }

 private:
  bool receive(Clock::Instant deadline);
  void skip_version_lines();
  void catch_up();
  template <class Check>
  std::optional<std::string> await(Check check, Clock::Instant deadline);
  std::string ask(std::string_view command, std::string_view data, ReplyKind kind, bool may_repeat);

  wire::ByteStream& stream_;
  Clock& clock_;
  std::string who_;
  std::string version_;
  std::string received_;
  Clock::Instant last_arrival_;
  bool out_of_step_ = false;  ///< A reply is missing, or was damaged: it or its rest may still arrive.
  std::uint64_t skipped_bytes_ = 0;

  bool under_way_ = false;  ///< A block.
  Clock::Instant give_up_at_;
  std::size_t wanted_ = 0;
  std::string mask_;
};

}  // namespace abcal::iio
