#pragma once

#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "app/laboratory/pilot/comparison_protocol.h"
#include "app/system/descriptor.h"
#include "drivers/instrument/clock.h"

namespace abcal {

/// An act of a comparison.
struct ChainEntry {
  /// "protocol": it was taken as agreed, or changed; "commit": a result by its SHA-256; "open": the file of a
  /// committed result; "replace": another result in place of a committed one; "withdraw"; "agree" and
  /// "statement" of a participant.
  std::string act{};
  std::string utc{};
  std::string participant{};  ///< Empty for "protocol".
  int measurement = 0;        ///< Number in the schedule, from 1; 0 for "protocol" and "statement".
  std::string sha256{};       ///< That of the protocol or result.
  std::string file{};         ///< Relative to the folder of the protocol; empty: only the hash is known.
  std::string text{};         ///< Reason or statement.
  std::string link{};         ///< SHA-256 over the link before and this entry.
};

/// A result that is not in its place, or a chain that was changed: usage, with what to do.
class ChainError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

/// How far a measurement of the schedule is.
enum class MeasurementStage { kOpen, kCommitted, kIn, kWithdrawn };
inline constexpr auto kMeasurementStages =
    names<MeasurementStage>({{MeasurementStage::kOpen, "open"},
                             {MeasurementStage::kCommitted, "committed"},
                             {MeasurementStage::kIn, "in"},
                             {MeasurementStage::kWithdrawn, "withdrawn"}});

/// The state of one measurement of the schedule.
struct MeasurementState {
  std::string sha256;  ///< Empty: nothing is committed.
  std::string file;    ///< Empty: not opened.
  std::string committed_utc;
  std::string withdrawn;  ///< Reason; empty: it is not.

  MeasurementStage stage() const {
    return !withdrawn.empty() ? MeasurementStage::kWithdrawn
           : sha256.empty()   ? MeasurementStage::kOpen
           : file.empty()     ? MeasurementStage::kCommitted
                              : MeasurementStage::kIn;
  }
};

/// The record of a comparison: a file of JSON lines next to its protocol, each line chained to the one
/// before. A result counts by its SHA-256 before anyone can see another one: no value is shown until all
/// planned measurements are committed. Another process that reads or adds waits while an object of this class
/// lives.
class ComparisonChain {
 public:
  /// Reads PROTOCOL.chain, which need not exist.
  /// @throws ChainError an entry was changed, left out or moved; the protocol cannot be locked
  explicit ComparisonChain(const ComparisonProtocol& protocol);

  const std::vector<ChainEntry>& entries() const { return entries_; }
  /// One for each measurement of the schedule.
  const std::vector<MeasurementState>& states() const { return states_; }
  /// Measurements that are committed or withdrawn.
  std::size_t committed() const;
  bool complete() const { return committed() == states_.size(); }
  /// Last link; empty: no entry.
  std::string head() const { return entries_.empty() ? std::string() : entries_.back().link; }

  /// Commits the next result of a participant by its SHA-256, with its file if it is there; or opens the file
  /// of a committed result.
  /// @param file  empty: only the hash is known
  /// @return the number of the measurement, from 1
  /// @throws ChainError a participant whose measurements are all committed, a file that is that of another
  /// measurement, a protocol that was changed
  int add_result(const std::string& participant, const std::string& sha256, const std::filesystem::path& file,
                 Clock::UtcTime now);
  /// Another result in place of the participant's last one, with a reason: a late change.
  int replace_result(const std::string& participant, const std::string& sha256,
                     const std::filesystem::path& file, const std::string& reason, Clock::UtcTime now);
  /// A participant's results do not count any more.
  void withdraw(const std::string& participant, const std::string& reason, Clock::UtcTime now);
  void add_statement(const std::string& participant, const std::string& text, Clock::UtcTime now);
  /// A participant agrees with Draft A. A later change of a result or of the protocol voids all agreements.
  /// @throws ChainError results are missing, or all of the participant are withdrawn
  void agree(const std::string& participant, Clock::UtcTime now);
  /// Participants with a result that have not agreed with Draft A as it is now.
  std::vector<std::string> not_agreed() const;
  /// @throws ChainError naming them, if there are any
  void require_agreement() const;
  /// The protocol as it is now counts, with a reason.
  void accept_protocol(const std::string& reason, Clock::UtcTime now);

  /// Late changes, withdrawals and changes of the protocol, in sentences.
  std::vector<std::string> changes() const;
  /// @throws ChainError if the protocol has no participant of this name
  void require_known(const std::string& participant) const;
  /// @throws ChainError if the protocol is not the accepted one
  void require_protocol() const;
  std::filesystem::path path_of(const std::string& file) const;

 private:
  void append(ChainEntry entry, Clock::UtcTime now);
  void apply(const ChainEntry& entry);
  void require_new(const std::string& sha256) const;
  std::string relative(const std::filesystem::path& file) const;

  const ComparisonProtocol protocol_;
  const std::filesystem::path file_;
  const Descriptor lock_;  ///< The protocol file, locked.
  std::vector<ChainEntry> entries_;
  std::vector<MeasurementState> states_;
  std::string accepted_;  ///< SHA-256 of the protocol; empty: none yet.
  std::set<std::string> agreed_;
};

}  // namespace abcal
