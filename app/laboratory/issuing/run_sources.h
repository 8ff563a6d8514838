#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "app/laboratory/certificate/laboratory_file.h"
#include "app/laboratory/register/register.h"
#include "app/witness/laboratory_link.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// The records that a run rests on: calibrations of its stage and voltmeter by their serial numbers, those
/// that local gravity and the sizes of effects name as their sources, the record of its stage, and all for
/// other quantities, since no run records which thermometer was in the room. Equipment of another stage or
/// voltmeter is left out.
/// @param equipment  with the calibrations that held when the run began
std::vector<lab::UsedSource> sources_of(const StoredRun& run, const std::vector<Equipment>& equipment);

/// A closed run as it is reported to the register. @param equipment  as for sources_of()
lab::RegisteredRun run_record_of(const std::filesystem::path& path, const std::string& sha256,
                                 const StoredRun& run, const std::vector<Equipment>& equipment);

/// Reports a run that has ended, with what it rests on, to the register that ABCAL_REGISTER names.
/// @return messages for a person: why the run was not reported to the register
std::vector<std::string> tell_register(const EndedRun& run, const std::string& login);

/// The customer of a certificate and the hashes of its runs, from its XML.
struct CertificateFacts {
  lab::Addressee addressee;
  std::vector<std::string> run_sha256s;
};
CertificateFacts certificate_facts(const std::string& name, const std::string& xml);

/// Reports to the register runs that ended before it kept what runs rest on, and their certificates.
struct ToldRun {
  bool is_new = false;                    ///< The register did not know all of it.
  std::size_t sources = 0;                ///< How many records the run rests on.
  std::vector<std::string> certificates;  ///< Numbers of its certificates that the register has.
};
/// @throws std::invalid_argument for a run that is not closed; RunFileError, lab::RegisterError
ToldRun tell_of_run(lab::Register& opened, const lab::LoggedIn& by, const std::filesystem::path& run,
                    Clock::UtcTime now);

}  // namespace abcal
