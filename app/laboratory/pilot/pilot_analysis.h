#pragma once

#include <array>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "app/laboratory/compare/compared_result.h"
#include "app/laboratory/pilot/artefact_drift.h"
#include "app/laboratory/pilot/comparison_chain.h"
#include "app/laboratory/pilot/comparison_protocol.h"
#include "app/laboratory/pilot/key_comparison.h"
#include "drivers/instrument/clock.h"
#include "drivers/text/message.h"

namespace abcal {

/// A measurement of the schedule that takes part.
struct PilotMeasurement {
  std::size_t number = 0;  ///< In the schedule, from 1.
  std::string participant;
  ComparedResult result;  ///< Sensitivities per m/s2, in the response unit of the protocol.
};

/// The outcome of a comparison for one covariance of the results.
struct ComparisonOutcome {
  TransferredResults transferred;
  ComparisonConsistency consistency;
  ReferenceValue reference;
  std::vector<ClaimTest> claims;
  std::vector<FaultyParticipant> faulty;  ///< Participants that differ from the others, which agree.

  /// All participants agree and the artefact did not break.
  /// @param level  of the test of consistency
  bool agree(double level) const {
    return faulty.empty() && !transferred.step && consistency.joint.probability >= level;
  }
};

/// A comparison with all its numbers. Those of ComparisonOutcome are without the correlations that are
/// possible and not known.
struct PilotAnalysis : ComparisonOutcome {
  ComparisonProtocol protocol;
  std::vector<std::string> participants;  ///< Those that take part, in the order of all vectors here.
  std::vector<PilotMeasurement> measurements;
  std::vector<std::string> units;  ///< Those of the quantities of the protocol.
  /// Reference values by the other procedures, for comparison; without those that are not possible.
  std::vector<ReferenceValue> others;
  /// n p: error of one quantity with which a participant is named with the probability kNamingPower.
  Eigen::VectorXd detectable;
  std::optional<LinkedDifferences> linked;
  /// With the bounds of correlation of the protocol, if it states any between participants that take part.
  std::optional<ComparisonOutcome> at_bounds;
  /// These bounds, and each statement that differs between the two outcomes, in sentences.
  std::vector<std::string> bound_statements;
  /// Assumptions, changes, and results that do not take part, in sentences.
  std::vector<std::string> notes;
  std::vector<std::pair<std::string, std::string>> statements;  ///< Participant and its words.
  std::string chain_head;

  /// In all outcomes.
  bool agree() const {
    return ComparisonOutcome::agree(protocol.level) && (!at_bounds || at_bounds->agree(protocol.level));
  }
  /// Who agrees, in words; of both outcomes if they differ.
  Message verdict() const;
  std::string step_words() const;  ///< Empty without a step.
  /// Place of a participant's quantity in the vectors of results.
  Eigen::Index place(std::size_t participant, std::size_t quantity) const {
    return static_cast<Eigen::Index>(participant) * transferred.results.quantities +
           static_cast<Eigen::Index>(quantity);
  }
};

/// Probability below which a participant is named, and a step of the artefact reported.
inline constexpr double kNamingLevel = 0.01;

/// Probability with which a fault as large as PilotAnalysis::detectable is named.
inline constexpr double kNamingPower = 0.9;

/// Why a certificate does not hold any more, by its number; empty: it holds, or that is not known.
using CertificateDoubt = std::function<std::string(const std::string& number)>;

/// Reads one result for a comparison.
/// @throws std::runtime_error, std::invalid_argument as load_compared(); KeyComparisonError with all reasons
/// why it cannot be a result of the comparison: another item, another unit, a quantity that is not given, no
/// uncertainties, no correlations where these are required
ComparedResult read_pilot_result(const ComparisonProtocol& protocol, const std::string& participant,
                                 const std::filesystem::path& file);

/// The certificates that the register of this laboratory has as withdrawn or replaced.
/// @param location  of the register; empty: nothing is known
CertificateDoubt doubt_of_register(const std::string& location, Clock::UtcTime now);

/// The whole analysis.
/// @throws ChainError results that are missing, not opened, or of another SHA-256; KeyComparisonError with
/// all problems of the results, fewer than three participants that take part, and as reference_value()
PilotAnalysis analyse_comparison(const ComparisonProtocol& protocol, const ComparisonChain& chain,
                                 const CertificateDoubt& doubt = {});

/// As analyse_comparison(), of a protocol file and its chain, with the doubts of the register.
/// @throws as read_comparison_protocol() and analyse_comparison()
PilotAnalysis analyse_comparison(const std::filesystem::path& protocol_file,
                                 const std::string& register_location, Clock::UtcTime now);

}  // namespace abcal
