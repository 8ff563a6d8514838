#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "app/ground/evidence/laboratory_link.h"
#include "app/laboratory/certificate/laboratory_file.h"
#include "app/laboratory/register/register.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// The records that a run rests on: calibrations of its stage and voltmeter by their serial numbers, those
/// that local gravity and the sizes of effects name as their sources, and all for other quantities, since no
/// run says which thermometer stood in the room. Equipment of another stage or voltmeter is left out.
/// @param equipment  with the calibrations that held when the run began
std::vector<lab::UsedSource> sources_of(const StoredRun& run, const std::vector<Equipment>& equipment);

/// A closed run as the register is told of it. @param equipment  as for sources_of()
lab::RunRecord run_record_of(const std::filesystem::path& path, const std::string& sha256,
                             const StoredRun& run, const std::vector<Equipment>& equipment);

/// Tells the register that ABCAL_REGISTER names of a run that has ended, with what it rests on.
/// @return what a person has to know: that the register was not told, and why
std::vector<std::string> tell_register(const EndedRun& run, const std::string& login);

/// To whom a certificate was issued, and the hashes of its runs, as its XML says.
struct CertificateFacts {
  lab::Addressee addressee;
  std::vector<std::string> run_sha256s;
};
CertificateFacts certificate_facts(const std::string& name, const std::string& xml);

/// Tells the register of runs that ended before it kept what runs rest on, and of their certificates.
struct ToldRun {
  bool is_new = false;                    ///< The register did not know all of it.
  std::size_t sources = 0;                ///< How many records the run rests on.
  std::vector<std::string> certificates;  ///< Numbers of its certificates that the register has.
};
/// @throws std::invalid_argument for a run that is not closed; RunFileError, lab::RegisterError
ToldRun tell_of_run(lab::Register& opened, const lab::LoggedIn& by, const std::filesystem::path& run,
                    Clock::UtcTime now);

}  // namespace abcal
