#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/text/message.h"

// Contents of the register as plain data. Dates are "2026-03-01", times as format_utc() writes them; an empty
// text: not stated.

namespace abcal::lab {

/// Rights of a person of the laboratory.
enum class Right {
  kMeasure,     ///< Measure: be the operator of a run.
  kOperate,     ///< Change equipment, items and check standards.
  kApprove,     ///< Approve and issue certificates, baselines of charts, and the lifting of a block.
  kAdminister,  ///< Persons, keys, backups.
};
std::string_view to_string(Right right);
/// "measure, operate, approve, administer"
std::string all_rights();
/// @return nothing for any other word
std::optional<Right> right_from(std::string_view word);

struct Person {
  std::string name, role, email;
  std::vector<Right> rights;
  std::string valid_from, valid_to;  ///< Dates; an empty end: not retired.

  bool may(Right right) const;
};

struct Equipment {
  std::string identity;  ///< Its name in the register: "STAGE-1".
  std::string name, maker, model, serial_number;
  std::string quantity;  ///< "angle", "voltage", "gravity", "temperature", ...
  std::string retired;   ///< UTC; empty: in use.
};

/// A calibrated value with its uncertainty, which a bench file can name as the source of an effect.
struct CalibratedValue {
  std::string name, unit;
  double value = 0.0;
  double expanded_uncertainty = 0.0;
  double coverage_factor = 2.0;
};

/// A calibration of a piece of equipment.
struct Calibration {
  std::string certificate;  ///< Its number.
  std::string equipment;    ///< Identity.
  std::string issuer;
  std::string performed, due;  ///< Dates.
  std::string sha256;          ///< SHA-256 of the certificate's file.
  std::vector<CalibratedValue> values;

  /// Whether it holds on a date: performed not after it, and due not before it.
  bool holds_on(const std::string& date) const { return performed <= date && date <= due; }
};

struct Item {
  std::string identity;  ///< "MAKER MODEL SERIAL" unless another is given.
  std::string maker, model, serial_number, owner;
  std::string retired;
};

/// Public part of the Ed25519 key of a bench or person.
struct SigningKey {
  std::string fingerprint;  ///< SHA-256 of its DER form, in hexadecimal.
  std::string owner;        ///< Name of the bench or person.
  std::string kind;         ///< "bench" or "person"
  std::string public_pem;
  std::string valid_from, valid_to;
};

/// A certificate's number and its subject.
struct CertificateRecord {
  std::string number;
  std::string state;  ///< "reserved", "issued", "replaced", "withdrawn"
  std::string run_sha256, xml_sha256;
  std::string item;
  std::string measured_by, approved_by;
  std::string issue_date;
  std::string replaces, reason;
  std::string utc;       ///< Time of its last change.
  std::string approval;  ///< SHA-256 of the approved data, and the login that approved them.
};

/// An item that is measured again and again to watch a bench, with the baseline by which later runs are
/// judged. The register keeps the baseline as it was approved, and does not interpret it.
struct CheckStandard {
  std::string name;  ///< Name of the chart.
  std::string item;  ///< Identity.
  std::string baseline_json;
  std::string approved_by, approved_utc;
  std::string retired;
};

/// A later run of a check standard, with its verdict.
struct CheckPoint {
  std::string identity;  ///< "NAME/1"
  std::string check_standard;
  std::string run_sha256;
  std::string date;  ///< Date of the run, UTC.
  std::string values_json;
  bool outside = false;
  std::string found;         ///< Properties outside, in words; empty: none.
  bool begins_anew = false;  ///< Average and sums restart with it, since a block was lifted before it.
  std::string added_by, utc;
};

/// A run of a check standard, reported to the register when it ended. It waits until a person adds it to the
/// chart.
struct CheckRunNotice {
  std::string check_standard;
  std::string run_sha256;
  std::string file;  ///< Path at the time of the report.
  std::string date;  ///< Date of the run, UTC.
  std::string told_by, utc;
};

/// Blocks certificates for measurements on a bench until a person lifts it.
struct BenchBlock {
  std::string identity;  ///< "NAME/1": the point that set it.
  std::string check_standard;
  std::string stage, bench;  ///< Identity of the stage, and name of the bench; either is enough.
  std::string found, set_utc;
  std::string lifted_by, lifted_utc, reason;

  bool holds() const { return lifted_utc.empty(); }
};

/// Accredited or claimed capability of the laboratory: no smaller uncertainty is stated in this range.
struct ScopeEntry {
  std::string identity;
  std::string quantity;  ///< "sensitivity", "angle", "offset"
  std::string unit;      ///< Unit of the range; also of the CMC unless that is relative.
  double from = 0.0, to = 0.0;
  double cmc = 0.0;       ///< Expanded uncertainty, k = 2.
  bool relative = false;  ///< The CMC is a part of the value.
  std::string valid_from, retired;
};

/// One change: person, time, action, and the data before and after.
struct AuditEntry {
  std::size_t entry = 0;
  std::string utc, who, what, subject, before_json, after_json, chain;
};

/// The state of the audit after one of its entries. No later entry changes it, so that a certificate or a
/// backup that names it is evidence of all entries up to this one.
struct AuditHead {
  std::int64_t entries = 0;  ///< Number of the entry, from 1.
  std::string sha256;        ///< SHA-256 over the entry and all before it, 64 hexadecimal digits.
};

/// A record that a run rests on. Its kind is open: "calibration" for a calibration of equipment.
struct UsedSource {
  std::string kind, name;     ///< "calibration", "EX-ANGLE-0815"
  std::string serial_number;  ///< Serial number of the equipment; may be empty.
  std::string role;           ///< For what it was used: "angle of the stage; wobble_urad".
};
inline constexpr const char* kCalibrationKind = "calibration";
/// The quantity under which equipment is a record of the errors of a stage: its calibrations are the record
/// as it was learned from time to time.
inline constexpr const char* kStageRecordQuantity = "stage record";
inline constexpr const char* kCertificateKind = "certificate";

/// A run as the register knows it, with all that it rests on.
struct RegisteredRun {
  std::string run_sha256;
  std::string file;  ///< Path when it was reported to the register.
  std::string item;  ///< Maker, model and serial number; of several items, each.
  std::string date;  ///< UTC date of its end.
  std::vector<UsedSource> sources;
};

/// The customer named on a certificate.
struct Addressee {
  std::string name, address, email;
  std::string language;  ///< Language of the certificate, ISO 639-1.
};

/// A calibration, certificate or other record that no longer holds.
struct Withdrawal {
  std::string kind, name;
  std::string reason;
  std::string withdrawn_by, utc;

  std::string date() const { return utc.substr(0, 10); }
};

/// State of a certificate, which shows whether it may be relied on.
struct CertificateStatus {
  CertificateRecord record;
  bool training = false;
  std::string amended_by, amended_on;   ///< The certificate that replaces it, and its date; empty: none.
  std::optional<Withdrawal> withdrawn;  ///< Withdrawal of the certificate itself.
  /// Withdrawals of records that its runs rest on. The laboratory has to decide whether the certificate
  /// holds.
  std::vector<Withdrawal> sources_withdrawn;

  /// Issued, not amended, not withdrawn.
  bool is_valid() const { return record.state == "issued" && amended_by.empty() && !withdrawn; }
  /// Valid, and nothing that it rests on was withdrawn.
  bool holds() const { return is_valid() && sources_withdrawn.empty(); }
  /// "valid", "amended", "withdrawn" or "not issued".
  std::string_view word() const;
  /// "withdrawn on 2026-03-01 because TEXT; amended by EX-2026-0007 on 2026-03-02"
  Message words() const;
};

/// A certificate of a run that rests on a record.
struct AffectedCertificate {
  CertificateRecord record;
  std::optional<Addressee> addressee;  ///< Absent: it was not reported to the register.
};

/// Everything that rests on a record.
struct Affected {
  bool is_known = false;                          ///< Whether the register has anything of this name.
  std::vector<Withdrawal> withdrawn;              ///< Withdrawals of the records in question.
  std::vector<RegisteredRun> runs;                ///< By date, with the sources in question only.
  std::vector<AffectedCertificate> certificates;  ///< By number.
  /// Numbers of certificates of runs whose sources the register does not know: it is unknown whether these
  /// are affected.
  std::vector<std::string> unknown;
};

/// How long records of a kind are kept.
struct RetentionRule {
  std::string kind;  ///< "certificate", "run", "calibration"
  int years = 0;
  std::string set_by, utc;
};

/// A record whose time has passed.
struct RetainedRecord {
  std::string kind, name;
  std::string since;  ///< The date from which its time counts.
  std::string until;  ///< The last day for which the rule keeps it.
};

/// Facts about the register itself.
struct RegisterFacts {
  std::string identity;  ///< Random; distinguishes registers.
  std::string name;      ///< Name of the laboratory.
  bool training = false;
  std::string number_prefix;  ///< "EX-": numbers are EX-2026-0001.
};

}  // namespace abcal::lab
