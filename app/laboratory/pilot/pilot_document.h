#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "app/document/document.h"
#include "app/laboratory/pilot/pilot_analysis.h"

namespace abcal {

/// Reports of a comparison (CIPM MRA-G-11): A goes to the participants, B is what all of them agreed with.
enum class PilotDraft { kA, kB };
inline constexpr auto kPilotDrafts = names<PilotDraft>({{PilotDraft::kA, "A"}, {PilotDraft::kB, "B"}});

/// The draft of a comparison: participants, artefact, reference value, degrees of equivalence with a figure
/// for each quantity, matrices of pairs, claims, notes, participants' statements.
/// @param created_utc  ISO 8601
Document pilot_document(const PilotAnalysis& analysis, PilotDraft draft, const std::string& created_utc);

/// The state of a comparison before its analysis: no value of any result.
Document pilot_status(const ComparisonProtocol& protocol, const ComparisonChain& chain);

/// Schema abcal.pilot/1. Numbers that were not determined are null.
nlohmann::ordered_json pilot_json(const PilotAnalysis& analysis);
nlohmann::ordered_json pilot_status_json(const ComparisonProtocol& protocol, const ComparisonChain& chain);

}  // namespace abcal
