#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

// What the register holds, as plain data. Dates are "2026-03-01", times as format_utc() writes them; an empty
// text: not stated.

namespace abcal::lab {

/// What a person of the laboratory may do.
enum class Right {
  kMeasure,     ///< Measure: be the operator of a run.
  kOperate,     ///< Change equipment, items and check standards.
  kApprove,     ///< Approve and issue certificates, baselines of charts, and the lifting of a block.
  kAdminister,  ///< Persons, keys, backups.
};
std::string_view to_string(Right right);
/// "measure, operate, approve, administer"
std::string all_rights();
/// @return nothing for a word that is none of them
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
  std::string sha256;          ///< Of the certificate's file.
  std::vector<CalibratedValue> values;

  /// Whether it holds on a date: performed not after it, and due not before it.
  bool holds_on(const std::string& date) const { return performed <= date && date <= due; }
};

struct Item {
  std::string identity;  ///< "MAKER MODEL SERIAL" unless another is given.
  std::string maker, model, serial_number, owner;
  std::string retired;
};

/// What a bench or a person signs with: the public part of an Ed25519 key.
struct SigningKey {
  std::string fingerprint;  ///< SHA-256 of its DER form, in hexadecimal.
  std::string owner;        ///< Name of the bench or person.
  std::string kind;         ///< "bench" or "person"
  std::string public_pem;
  std::string valid_from, valid_to;
};

/// A certificate's number and what it was given to.
struct CertificateRecord {
  std::string number;
  std::string state;  ///< "reserved", "issued", "replaced"
  std::string run_sha256, xml_sha256;
  std::string item;
  std::string measured_by, approved_by;
  std::string issue_date;
  std::string replaces, reason;
  std::string utc;       ///< Of its last change.
  std::string approval;  ///< SHA-256 of what was approved, and by which login.
};

/// An item that is measured again and again to watch a bench, with the baseline by which later runs are
/// judged. The baseline is the business of whoever judges; the register keeps it as it was approved.
struct CheckStandard {
  std::string name;  ///< Of the chart.
  std::string item;  ///< Identity.
  std::string baseline_json;
  std::string approved_by, approved_utc;
  std::string retired;
};

/// A later run of a check standard, as it was judged.
struct CheckPoint {
  std::string identity;  ///< "NAME/1"
  std::string check_standard;
  std::string run_sha256;
  std::string date;  ///< Of the run, UTC.
  std::string values_json;
  bool outside = false;
  std::string found;         ///< What is outside, in words; empty where nothing is.
  bool begins_anew = false;  ///< Average and sums begin with it, since a block was lifted before it.
  std::string added_by, utc;
};

/// A run of a check standard that the register was told of when it ended. It waits until a person adds it to
/// the chart.
struct CheckRunNotice {
  std::string check_standard;
  std::string run_sha256;
  std::string file;  ///< Where it was then.
  std::string date;  ///< Of the run, UTC.
  std::string told_by, utc;
};

/// No certificate is issued for what was measured on a bench, until a person lifts it.
struct BenchBlock {
  std::string identity;  ///< "NAME/1": the point that set it.
  std::string check_standard;
  std::string stage, bench;  ///< Identity of the stage, and name of the bench; either is enough.
  std::string found, set_utc;
  std::string lifted_by, lifted_utc, reason;

  bool holds() const { return lifted_utc.empty(); }
};

/// What the laboratory is accredited for, or claims: no smaller uncertainty is stated in this range.
struct ScopeEntry {
  std::string identity;
  std::string quantity;  ///< "sensitivity", "angle", "offset"
  std::string unit;      ///< Of the range; that of the CMC unless it is relative.
  double from = 0.0, to = 0.0;
  double cmc = 0.0;       ///< Expanded uncertainty, k = 2.
  bool relative = false;  ///< The CMC is a part of the value.
  std::string valid_from, retired;
};

/// One change: who, when, what, before, after.
struct AuditEntry {
  std::size_t entry = 0;
  std::string utc, who, what, subject, before_json, after_json, chain;
};

/// What a register says of itself.
struct RegisterFacts {
  std::string identity;  ///< Random; tells registers apart.
  std::string name;      ///< Of the laboratory.
  bool training = false;
  std::string number_prefix;  ///< "EX-": numbers are EX-2026-0001.
};

}  // namespace abcal::lab
