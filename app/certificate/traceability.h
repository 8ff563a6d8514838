#pragma once

#include <string>
#include <vector>

#include "app/certificate/laboratory_file.h"
#include "app/results/report_data.h"
#include "protocol/plan/run_config.h"

namespace abcal {

/// What speaks against calling the results of a run traceable: every reason. Instruments that are not real, a
/// run that was replayed, a quantity (angle, gravity, temperature, and voltage for an output in volts)
/// without a calibration that holds on the day of the run, local gravity by formula, an effect whose size is
/// a default.
/// @param which  "run", "as-found run": how the reasons name it
std::vector<Problem> against_traceability(const LaboratoryFile& laboratory, const ReportData& data,
                                          const std::string& which);

/// Whether equipment has exactly the serial number of an instrument, or, for controllers that name several
/// stages
/// ("123/456"), that of one of them.
bool has_serial_number(const Equipment& equipment, const std::string& instrument_serial_number);

/// The equipment that a run froze from the register when it began; nothing for runs without a register.
/// @throws std::runtime_error if what is stored cannot be read
std::vector<Equipment> equipment_of_run(const ReportData& data);

/// Whether the values of the room were typed in: stated by the operator, not observed.
bool is_environment_stated(const ReportData& data);

}  // namespace abcal
