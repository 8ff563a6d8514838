#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "app/laboratory/pilot/artefact_drift.h"
#include "app/laboratory/pilot/key_comparison.h"
#include "drivers/text/message.h"
#include "drivers/text/names.h"

namespace abcal {

/// A laboratory of a comparison.
struct ProtocolParticipant {
  std::string name;
  double coverage_factor = 2.0;  ///< k of its expanded uncertainties.
  /// Whether a certificate without correlations is refused, or its correlations are taken as zero.
  bool correlations_required = true;
};

/// A measurement that is planned.
struct ScheduledMeasurement {
  std::string participant;
  std::string date;  ///< ISO 8601; empty: none is planned.
};

/// A part of the uncertainty that participants have in common, with one number for each quantity.
struct ProtocolSource {
  std::string name;
  std::vector<std::string> participants;
  std::vector<double> uncertainty;  ///< Standard uncertainties.
  bool together = false;            ///< As SharedSource::together.
};

/// A correlation of participants' results that is possible and not known. The comparison is analysed without
/// it and with its bound.
struct ProtocolBound {
  std::string name;  ///< The source that they may have in common.
  std::vector<std::string> participants;
  double correlation = 0.0;             ///< As SharedSource::correlation.
  std::vector<std::string> quantities;  ///< Symbols.

  Message words() const;  ///< The bound as a sentence.
};

/// A participant's degrees of equivalence of an earlier comparison.
struct ProtocolLink {
  std::string participant;
  std::vector<double> differences, uncertainty;  ///< Standard uncertainties.
};

/// Names of procedures and drift models in a protocol.
inline constexpr auto kReferenceProcedures =
    names<ReferenceProcedure>({{ReferenceProcedure::kMeanOrMedian, "A-or-B"},
                               {ReferenceProcedure::kMean, "A"},
                               {ReferenceProcedure::kMedian, "B"},
                               {ReferenceProcedure::kSubset, "subset"},
                               {ReferenceProcedure::kSubsetPerQuantity, "subset-per-quantity"},
                               {ReferenceProcedure::kRandomEffects, "random-effects"}});

inline constexpr std::string_view kComparisonSchema = "abcal.comparison/1";

/// The protocol of a comparison (kComparisonSchema), as agreed before it begins. Sensitivities are
/// per m/s2 everywhere, angles in degrees, offsets in the response unit.
struct ComparisonProtocol {
  std::string path, sha256;
  std::string name;
  std::string pilot;                    ///< Participant that measures several times.
  std::string item_serial_number;       ///< That of the artefact.
  std::string response_unit;            ///< "V"
  std::vector<std::string> quantities;  ///< Symbols, in the order of kIntrinsicSymbols.
  ReferenceProcedure procedure = ReferenceProcedure::kMeanOrMedian;
  double level = 0.05;  ///< Level of the tests of consistency.
  int draws = 100'000;
  std::uint64_t seed = 1;
  DriftModel drift = DriftModel::kNone;
  bool drift_per_day = false;         ///< Otherwise by transfer.
  std::vector<double> repeatability;  ///< Standard uncertainty of the pilot's repeats, for each quantity.
  std::vector<double> sigma_pt;       ///< Divisors of z scores (ISO 13528); empty: none.
  std::vector<ProtocolParticipant> participants;
  std::vector<ScheduledMeasurement> schedule;
  std::vector<ProtocolSource> shared;
  std::vector<ProtocolBound> correlation_bounds;
  std::string linked_comparison;
  std::vector<ProtocolLink> links;

  /// Place of a symbol in `quantities`, which has it.
  Eigen::Index place(const std::string& symbol) const;
  /// Position of a quantity of the protocol in a Covariance9.
  std::vector<Eigen::Index> positions() const;
  /// Number of a participant. @throws std::out_of_range for a name that is none
  std::size_t participant(const std::string& participant_name) const;
  /// Quantities of one kind, by their places in `quantities`.
  std::vector<std::vector<Eigen::Index>> kinds() const;
};

/// @throws KeyComparisonError with all problems of the file
ComparisonProtocol read_comparison_protocol(const std::filesystem::path& path);

/// As read_comparison_protocol(), from text; `source` names it in messages.
ComparisonProtocol parse_comparison_protocol(std::string_view text, const std::string& source);

/// A protocol with comments, for a person to change.
std::string example_protocol();

}  // namespace abcal
