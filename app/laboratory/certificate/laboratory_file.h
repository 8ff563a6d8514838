#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "app/laboratory/certificate/decision.h"
#include "app/laboratory/certificate/scope.h"
#include "protocol/plan/run_config.h"

namespace abcal {

using Date = std::chrono::year_month_day;

/// "2026-03-01".
std::string format_date(Date date);
/// The date from the first ten characters of a date or time of ISO 8601; nothing if they are none.
std::optional<Date> parse_date(std::string_view text);

/// A name with an address. Laboratory, customer.
struct Contact {
  std::string name, street, post_code, city, state, country_code;
  std::string email, phone;
};

/// The laboratory (ISO/IEC 17025 7.8.2.1 b, c).
struct Laboratory {
  Contact contact;
  std::string accreditation;                                    ///< Its number; empty: none.
  std::string performance_location = "laboratory";              ///< Name in the schema of the certificate.
  std::string gravity_site;                                     ///< Where exactly g_loc holds, in words.
  std::optional<double> latitude_deg, longitude_deg, height_m;  ///< WGS 84; height above the ellipsoid.
  /// How a result is treated whose record of the stage was learned from the item itself: "refused", or
  /// "stated" on the certificate.
  std::string record_of_own_item = "refused";
};

/// A person of the laboratory, with rights.
struct Person {
  std::string name, role, email;
  std::vector<std::string> may;  ///< "measure", "approve"
};

/// An instrument of the measurement, and its own calibration. A record of a stage (lab::kStageRecordQuantity)
/// is equipment as well: its certificate is the record, with its number, issued by the person who approved
/// it.
struct Equipment {
  std::string name, maker, model, serial_number;
  std::string
      quantity;  ///< The quantity that it makes traceable: "angle", "voltage", "gravity", "temperature", ...
  std::string certificate, certificate_issuer;
  std::string certificate_sha256;  ///< SHA-256 of that certificate's file; empty: not known.
  std::optional<Date> performed;   ///< When it was calibrated.
  std::optional<Date> due;         ///< Until when its calibration holds.
  std::uint32_t line = 0;          ///< In the file.
};

/// Data on the item and the job that a run file does not contain.
struct Job {
  std::string item_name = "Triaxial accelerometer";
  std::string condition;  ///< Condition of the item on receipt (7.8.2.1 g).
  std::string owner_id;   ///< The customer's own number of the item.
  std::string order;      ///< The customer's order.
  std::optional<Date> received;
  std::string procedure;                       ///< The laboratory's own procedure, by its number.
  std::string sampling;                        ///< 7.8.2.1 k; empty: no sampling.
  std::string deviations;                      ///< Additions, deviations, exclusions (n); empty: none.
  std::string external_results;                ///< Results from others (p); empty: none.
  std::string opinions;                        ///< 7.8.4.1 f; empty: none.
  std::string adjustment;                      ///< Adjustment of the item between as found and as left.
  std::vector<std::string> customer_supplied;  ///< Data supplied by the customer and not checked (7.8.2.2).
  std::optional<Date> recalibration;           ///< Only on the customer's request (7.8.4.3).
};

/// A laboratory file (schema abcal.laboratory/1): the data of a certificate that a run does not contain.
struct LaboratoryFile {
  std::string source;  ///< Its path, for messages.
  std::string text;    ///< Content as read, to be kept with an issued certificate.
  Laboratory laboratory;
  std::vector<Person> persons;
  Contact customer;
  Job job;
  std::vector<Equipment> equipment;
  std::optional<DecisionRule> decision;
  std::vector<SpecificationLimit> limits;
  std::string language = "en";    ///< Language of the certificate (ISO 639-1).
  std::vector<ScopeLimit> scope;  ///< No smaller uncertainty is stated.
  std::vector<std::string>
      units;  ///< Units of sensitivity in addition to those of the certificate: "mV/g_n".

  /// The person of this name if it has the right "measure" or "approve"; else null.
  const Person* person_who_may(const std::string& right, const std::string& name) const;
};

/// Reports all problems of a laboratory file that cannot be used, with their lines.
class LaboratoryFileError : public std::invalid_argument {
 public:
  LaboratoryFileError(const std::string& source, std::vector<Problem> problems);
  const std::vector<Problem>& problems() const { return problems_; }

 private:
  std::vector<Problem> problems_;
};

/// The file and its problems. With any problem the file serves for messages only.
struct ReadLaboratoryFile {
  LaboratoryFile file;
  std::vector<Problem> problems;
};

/// Reads a laboratory file. Nothing is thrown, so that its problems can be shown together with those of the
/// run.
ReadLaboratoryFile read_laboratory_file(const std::filesystem::path& path);

/// Like read_laboratory_file(), from text; `source` names it in messages.
ReadLaboratoryFile parse_laboratory_file(std::string_view toml, const std::string& source);

}  // namespace abcal
