#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "app/laboratory/certificate/laboratory_file.h"
#include "app/laboratory/certificate/reason.h"
#include "app/results/analysis/report_data.h"
#include "protocol/plan/run_config.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// All reasons against calling the results of a run traceable. Instruments that are not real, a run that was
/// replayed, a quantity (angle, gravity, temperature, and voltage for an output in volts or measured by a
/// voltmeter) without a calibration that holds on the day of the run, which for stage and voltmeter is that
/// of exactly this instrument, local gravity by formula or from another source than the equipment for
/// gravity, an effect whose size is a default or has no source.
/// @param which  name of the run in the reasons: "run", "as-found run"
std::vector<Reason> against_traceability(const LaboratoryFile& laboratory, const ReportData& data,
                                         const Message& which);

/// Whether a calibration of equipment holds on a day.
bool holds_on(const Equipment& equipment, Date day);

/// "2026-03-01", or that it is not stated.
Message date_words(const std::optional<Date>& date);

/// The first of an instrument's serial numbers ("123/456", or "123 + 456" if it names several) that no
/// equipment of a quantity has exactly; empty: each has one, or one piece of equipment has all of them
/// together.
std::string serial_number_without_equipment(const std::vector<Equipment>& equipment,
                                            const std::string& quantity, const std::string& serial_numbers);

/// The serial numbers of an instrument of a run by its role ("stage", "accelerometer"): as it reported them,
/// or as the bench file stated them for one that reports none. Empty: neither.
std::string serial_numbers_of(const ReportData& data, const std::string& role);
std::string serial_numbers_of(const StoredRun& run, const std::string& role);

/// Whether serial_numbers_of() gives those that the bench file stated.
bool is_serial_number_stated(const ReportData& data, const std::string& role);

/// The equipment that a run stored from the register when it began; empty for runs without a register.
/// @throws std::runtime_error if the stored text cannot be read
std::vector<Equipment> equipment_of_run(const ReportData& data);
std::vector<Equipment> equipment_of_run(const StoredRun& run);

/// Whether a text has a number as a word of its own: "EX-7" is in "certificate EX-7.", not in "EX-71",
/// "EX-7/2".
bool names_number(std::string_view text, std::string_view number);

/// Whether the values of the room were typed in: stated by the operator, not observed.
bool is_environment_stated(const ReportData& data);

}  // namespace abcal
