#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/reading_stream.h"

namespace abcal::wire {

/// Answer of an instrument to a command: data, or an error code.
struct PacketAnswer {
  std::string data;
  std::optional<unsigned> error;
};

/// Commands to an instrument that may stream at the same time, and its answers among the packets of the
/// stream. One thread.
///
/// An answer is recognised by a mark that the command defines (an echo, a descriptor, a register). An error
/// counts only if its command is the only one outstanding: an error of an abandoned command may arrive late,
/// and most instruments do not report which command they refuse. If one is outstanding, the barrier is sent,
/// a question that is used for nothing else: an instrument answers in order, so after the barrier's answer
/// nothing is outstanding.
template <class Parser>
class PacketExchange {
 public:
  using Packet = typename ReadingStream<Parser>::Frame;

  struct Command {
    std::string bytes;  ///< Complete bytes to send.
    std::string shown;  ///< For messages: "\"product code\" (1C)".
    /// The answer, if this packet is one to this command, or an error that may be.
    std::function<std::optional<PacketAnswer>(const Packet&)> match;
  };

  /// Manner of communication of a family of instruments, with words for messages.
  struct Manner {
    std::string_view packet;                ///< "MIP packet"
    std::string_view damaged;               ///< "with a wrong checksum"
    std::string (*show)(std::string_view);  ///< Foreign bytes in a message.
    Clock::Duration answer_time;
    Command barrier;  ///< Harmless, always answered, and asked by settle() alone.
  };

  /// All must outlive this. Sends nothing.
  PacketExchange(ByteStream& stream, ReadingStream<Parser>& packets, Clock& clock, std::string who,
                 Manner manner)
      : stream_(stream),
        packets_(packets),
        clock_(clock),
        instrument_(std::move(who)),
        manner_(std::move(manner)) {}

  void rename(std::string who) { instrument_ = std::move(who); }

  [[noreturn]] void fail(Fault fault, std::string_view detail) const {
    throw InstrumentError(instrument_, fault, detail);
  }

  /// Ends the stream and discards received bytes; `parser` parses those that follow.
  void restart(Parser parser) {
    packets_.listen(std::move(parser));
    stream_.discard_input();
    fresh_ = true;
  }

  /// Sends a command, again if no answer arrives, and returns its answer or refusal.
  /// @throws InstrumentError kNoReply, kBadFrame, kWrongIdentity, each quoting what was received instead.
  PacketAnswer ask(const Command& command) {
    // An instrument that streams may need more than a second try: the line is full, an answer may get
    // damaged.
    constexpr int kTries = 2;
    constexpr int kTriesWhileStreaming = 4;
    if (outstanding_) settle();  // If that fails, errors do not count.
    const Clock::Instant begin = clock_.now();
    Evidence evidence;
    bool settled = false;
    auto answer = try_once(command, true, evidence);
    for (int tries = 1; !answer; ++tries) {
      if (tries >= (evidence.packets > 0 ? kTriesWhileStreaming : kTries))
        fail_without_answer(command, evidence, clock_.now() - begin);
      // An error arrived that may belong to an earlier command: the next attempt shows to which.
      if (evidence.has_stray_error && !std::exchange(settled, true)) settle();
      evidence = Evidence();
      answer = try_once(command, true, evidence);
    }
    // The late answer to an earlier try would pass for that to the next command like this one.
    if (outstanding_ && !settle())
      fail(Fault::kNoReply, fmt::format("it answered {} late, and then did not answer again", command.shown));
    return *std::move(answer);
  }

 private:
  /// After this time without a byte, an answer is searched for behind a false beginning.
  static constexpr std::chrono::milliseconds kSilence{50};
  /// Additional wait for an answer after an error that may belong to an earlier command.
  static constexpr std::chrono::milliseconds kAfterStrayError{500};

  /// Bytes received while an answer was awaited; for the message if none arrived.
  struct Evidence {
    std::size_t bytes = 0;
    std::string first_bytes;
    std::size_t packets = 0;
    std::uint64_t damaged = 0;
    bool has_stray_error = false;  ///< One that may be of an earlier command.
  };

  /// Waits until no answer is outstanding. False: the barrier was not answered.
  bool settle() {
    Evidence evidence;
    outstanding_ = !try_once(manner_.barrier, false, evidence);
    if (!outstanding_) fresh_ = false;
    return !outstanding_;
  }

  /// Sends a command once and waits for its answer; nothing at the deadline.
  std::optional<PacketAnswer> try_once(const Command& command, bool errors_count, Evidence& evidence) {
    stream_.write(command.bytes);
    auto answer = await(command, errors_count, evidence);
    if (answer)
      fresh_ = false;
    else
      outstanding_ = true;
    return answer;
  }

  std::optional<PacketAnswer> await(const Command& command, bool errors_count, Evidence& evidence) {
    constexpr std::size_t kShownBytes = 24;
    const bool only_one = errors_count && !outstanding_ && !fresh_;
    const std::uint64_t damaged_before = packets_.parser().bad_frames();
    Clock::Instant deadline = clock_.now() + manner_.answer_time;
    std::optional<PacketAnswer> answer;
    const auto look_at = [&](const std::optional<Packet>& packet) {
      if (!packet) return false;
      ++evidence.packets;
      auto said = command.match(*packet);
      if (said && said->error && !only_one) {
        if (errors_count) deadline = std::min(deadline, clock_.now() + kAfterStrayError);
        evidence.has_stray_error = true;
      } else {
        answer = std::move(said);
      }
      return true;
    };
    for (;;) {
      while (!answer && look_at(packets_.parser().next())) continue;
      if (answer) break;
      const ReceivedBytes received = packets_.fetch(std::min(deadline, clock_.now() + kSilence));
      if (received.bytes.empty()) {
        while (!answer && look_at(packets_.parser().next_behind_partial())) continue;
        if (answer || clock_.now() >= deadline) break;
        continue;
      }
      evidence.bytes += received.bytes.size();
      evidence.first_bytes +=
          received.bytes.substr(0, kShownBytes - std::min(kShownBytes, evidence.first_bytes.size()));
      if (clock_.now() >= deadline) {  // The stream may never pause: these bytes are parsed, and no more are
                                       // read.
        while (!answer && look_at(packets_.parser().next())) continue;
        break;
      }
    }
    evidence.damaged += packets_.parser().bad_frames() - damaged_before;
    return answer;
  }

  [[noreturn]] void fail_without_answer(const Command& command, const Evidence& evidence,
                                        Clock::Duration waited) const {
    const std::string asked =
        fmt::format("no answer to {} within {:.1f} s", command.shown, to_seconds(waited));
    if (evidence.bytes == 0) {
      fail(Fault::kNoReply,
           asked + ", and not one byte arrived: is it switched on, and is the baud rate that of the device?");
    }
    if (evidence.packets > 0) {
      fail(Fault::kNoReply, fmt::format("{}, although {} other {}s arrived ({} {})", asked, evidence.packets,
                                        manner_.packet, evidence.damaged, manner_.damaged));
    }
    if (evidence.damaged > 0) {
      fail(Fault::kBadFrame, fmt::format("{}; {} bytes arrived with {} {}s, every one {}", asked,
                                         evidence.bytes, evidence.damaged, manner_.packet, manner_.damaged));
    }
    fail(Fault::kWrongIdentity,
         fmt::format("{}; {} bytes arrived that are no {}, beginning {}: another instrument is on this port, "
                     "or the baud rate is wrong",
                     asked, evidence.bytes, manner_.packet, manner_.show(evidence.first_bytes)));
  }

  ByteStream& stream_;
  ReadingStream<Parser>& packets_;
  Clock& clock_;
  std::string instrument_;
  Manner manner_;
  bool outstanding_ = false;  ///< A command was not answered: its answer may still arrive.
  bool fresh_ = true;  ///< Nothing was answered since restart(): an error may be of an earlier command.
};

}  // namespace abcal::wire
