#pragma once

#include <string>
#include <vector>

#include "app/laboratory/certificate/certificate.h"
#include "app/laboratory/certificate/statements.h"

namespace abcal {

/// The record of a stage with this SHA-256 among the equipment of a laboratory; null: it has none.
const Equipment* find_stage_record(const std::vector<Equipment>& equipment, const std::string& sha256);

/// Whether equipment belongs to a result: all but the records of a stage that it does not use.
bool belongs_to(const Equipment& equipment, const CalibrationResult& result);

/// All reasons against certifying a result that uses a record of the stage. The record is not equipment of
/// the laboratory by its SHA-256, does not hold on the day of each run, is older than its own validity, was
/// taught by a run of the certificate, or was learned from the item itself, unless the laboratory states
/// that. None for a result without a record.
/// @param certified  every run of the certificate
/// @param of_result  those that the result is of
std::vector<Reason> against_stage_record(const LaboratoryFile& laboratory, const ReportData& data,
                                         const std::vector<const ReportData*>& certified,
                                         const std::vector<const ReportData*>& of_result,
                                         const Message& which);

/// The sizes of effects on which the uncertainties of a result rest. With a record of the stage, those of the
/// stage are 0 and have no source, but for those of which the budget has a line.
EffectSizes sizes_behind(const ReportData& data);

/// The statement of the certificate on the record that a result uses: its identity, age and validity, on what
/// it rests, its part of the uncertainty, and its test by this calibration.
Statement stage_record_statement(const Certificate& certificate, const ReportData& data,
                                 const Wording& title);

/// "wobble of X 0.72 (0.8); ...": for each part of the record that this calibration tests, how many times as
/// far from it the stage was found as the record expects, and the probability of that.
Message tests_of_record(const StageRecordUse& use);

}  // namespace abcal
