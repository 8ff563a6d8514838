#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "app/laboratory/register/audit_chain.h"
#include "app/laboratory/register/database.h"
#include "app/laboratory/register/outside_evidence.h"
#include "app/laboratory/register/password.h"
#include "app/laboratory/register/records.h"
#include "drivers/instrument/clock.h"
#include "protocol/record/witnessed_line.h"

namespace abcal::lab {

/// A person of the register whose identity has been proved. Only a Register makes one.
class LoggedIn {
 public:
  const std::string& name() const { return person_.name; }
  const Person& person() const { return person_; }
  const std::string& register_identity() const { return register_identity_; }
  const std::string& expires_utc() const { return expires_utc_; }

 private:
  friend class Register;
  LoggedIn(Person person, std::string register_identity, std::string expires_utc);
  Person person_;
  std::string register_identity_, expires_utc_;
};

/// Properties of a new register.
struct NewRegister {
  std::string laboratory;     ///< Its name.
  bool training = false;      ///< Its certificates are marked TRAINING and have numbers "T-...".
  std::string number_prefix;  ///< Ignored for training.
  std::string administrator;  ///< The first person, with every right.
  std::string password;
  PasswordCost cost = PasswordCost::kUsual;
};

/// A certificate that needs a number.
struct NumberRequest {
  std::string run_sha256;
  std::string item;
  std::string measured_by;
  std::string replaces, reason;        ///< Empty: the first certificate of its run.
  std::string stage = {}, bench = {};  ///< Instruments of the run; a block of either refuses the number.
  /// The runs of the certificate with all that they rest on. A source that is withdrawn refuses the number.
  std::vector<RegisteredRun> runs = {};
};

/// A number that was given to a certificate.
struct ReservedNumber {
  std::string number;
  AuditHead
      head;  ///< Head of the entry that gave it: the same each time the number is given to the run again.
  std::vector<std::string> warnings;
};

/// Asks a witness to sign a head of the audit: numbers of entries only grow, and each has one hash. The
/// register asks for its newest head while it is locked, so that heads are asked for in their order.
/// @return nullopt if the witness does not answer
/// @throws RegisterError with the words of the witness if it refuses, since it has signed a later head or
/// another one of this entry: the register was copied back
using HeadWitness =
    std::function<std::optional<WitnessedLine>(std::int64_t entries, const std::string& sha256)>;

/// The register of a laboratory. Every change is one transaction that also appends to the audit: person,
/// time, action, the row before and after, chained by SHA-256. The audit's head is locked first, so that
/// writers follow one another. Times are arguments; an entry has the time of its call plus the time
/// for which it waited for others and for the hash of a password. All functions throw RegisterError.
class Register {
 public:
  /// Makes a register in an empty database. An SQLite file must not exist.
  static Register create(const std::string& location, const NewRegister& facts, Clock::UtcTime now);
  /// Opens a register; one of an older schema step is brought to the newest.
  static Register open(const std::string& location, Clock::UtcTime now);

  const RegisterFacts& facts() const { return facts_; }
  const std::string& location() const { return database_.location(); }

  // ---- Persons
  /// Adds a person. @param password  empty: the person cannot log in.
  void add_person(const LoggedIn& by, const Person& person, const std::string& password, Clock::UtcTime now,
                  PasswordCost cost = PasswordCost::kUsual);
  void set_password(const LoggedIn& by, const std::string& name, const std::string& password,
                    Clock::UtcTime now, PasswordCost cost = PasswordCost::kUsual);
  /// Ends a person's rights. Their name stays: records name it.
  void retire_person(const LoggedIn& by, const std::string& name, const std::string& reason,
                     Clock::UtcTime now);
  std::vector<Person> persons();
  std::optional<Person> find_person(const std::string& name);

  /// @return a token that proves a person's identity until it expires; a refused attempt is recorded in the
  /// audit.
  std::string log_in(const std::string& name, const std::string& password, Clock::UtcTime now,
                     std::chrono::minutes validity);
  void log_out(const std::string& token, Clock::UtcTime now);
  /// The person to whom a token belongs. @throws RegisterError if it is unknown or expired, or its person
  /// retired
  LoggedIn who(const std::string& token, Clock::UtcTime now);

  // ---- Equipment, items, keys
  void add_equipment(const LoggedIn& by, const Equipment& equipment, Clock::UtcTime now);
  void retire_equipment(const LoggedIn& by, const std::string& identity, const std::string& reason,
                        Clock::UtcTime now);
  /// Adds a calibration to its equipment; all its problems are reported at once. A record of a stage is added
  /// with its SHA-256 by the person who approves it.
  void add_calibration(const LoggedIn& by, const Calibration& calibration, Clock::UtcTime now);
  void add_item(const LoggedIn& by, const Item& item, Clock::UtcTime now);
  void add_key(const LoggedIn& by, const SigningKey& key, Clock::UtcTime now);
  void retire_key(const LoggedIn& by, const std::string& fingerprint, const std::string& reason,
                  Clock::UtcTime now);
  std::vector<Equipment> equipment();
  std::vector<Calibration> calibrations();
  std::vector<Item> items();
  std::vector<SigningKey> keys();

  // ---- Check standards, blocks, scope
  /// Stores an approved baseline. @throws RegisterError if the item is not in the register
  void add_check_standard(const LoggedIn& by, const CheckStandard& standard, Clock::UtcTime now);
  void retire_check_standard(const LoggedIn& by, const std::string& name, const std::string& reason,
                             Clock::UtcTime now);
  std::vector<CheckStandard> check_standards();
  /// @throws RegisterError if no check standard has that name
  CheckStandard check_standard(const std::string& name);
  /// Stores a point, whose identity, person and time are set here; one that is outside blocks its bench in
  /// the same transaction, unless the chart blocks it already.
  /// @param points_before  number of points that the verdict took into account: another may have been added
  /// since
  /// @return the stored point
  CheckPoint add_check_point(const LoggedIn& by, CheckPoint point, std::size_t points_before,
                             const BenchBlock& block, Clock::UtcTime now);
  std::vector<CheckPoint> check_points(const std::string& check_standard);
  /// Stores that a run of a check standard ended; once for each run and chart.
  void tell_check_run(const LoggedIn& by, CheckRunNotice notice, Clock::UtcTime now);
  /// Runs that were reported to the register and that no chart has judged, in the order of their dates.
  std::vector<CheckRunNotice> waiting_check_runs(const std::string& check_standard);
  std::vector<BenchBlock> blocks();
  /// Lifts the block of a chart. @throws RegisterError if the chart has none
  void lift_block(const LoggedIn& by, const std::string& check_standard, const std::string& reason,
                  Clock::UtcTime now);
  /// Adds an entry; all its problems are reported at once.
  void add_scope(const LoggedIn& by, const ScopeEntry& entry, Clock::UtcTime now);
  void retire_scope(const LoggedIn& by, const std::string& identity, const std::string& reason,
                    Clock::UtcTime now);
  std::vector<ScopeEntry> scope();

  // ---- Certificates
  /// Gives a certificate its number, once and for all: "EX-2026-0001". A run whose certificate got a number
  /// but was not issued (the program ended in between) gets the same one again.
  /// @throws RegisterError if the run has a certificate and the request does not replace it, the bench is
  ///         blocked, or the witness refuses
  ReservedNumber reserve_number(const LoggedIn& by, const NumberRequest& request, Clock::UtcTime now);
  /// The certificate is approved and issued. The approval names the hashes of run and XML.
  /// @return warnings
  std::vector<std::string> record_issued(const LoggedIn& by, const std::string& number,
                                         const std::string& xml_sha256, const std::string& issue_date,
                                         Clock::UtcTime now);
  std::vector<CertificateRecord> certificates();
  std::vector<CertificateRecord> certificates_of(const std::string& run_sha256);

  /// The certificate of a number; nullopt if the register did not give it.
  std::optional<CertificateStatus> status_of(const std::string& number);

  // ---- What runs rest on, and what was withdrawn
  /// Stores a run and what it rests on. What the register knows already stays; what is new is added.
  /// @return whether anything was new
  bool tell_run(const LoggedIn& by, const RegisteredRun& run, Clock::UtcTime now);
  /// Who was logged in when the register was first told of a run; empty: it does not know the run.
  std::string told_by(const std::string& run_sha256);
  /// Stores to whom a certificate was issued, and further runs that it is of, unless the register knows it.
  /// @return whether anything was new
  bool tell_certificate(const LoggedIn& by, const std::string& number, const Addressee& addressee,
                        const std::vector<std::string>& run_sha256s, Clock::UtcTime now);
  /// Withdraws a record, once. A certificate needs the right to approve, any other record that to operate.
  /// @param kind  "calibration", "certificate", or the kind of a source that the register knows of a run
  Withdrawal withdraw(const LoggedIn& by, const std::string& kind, const std::string& name,
                      const std::string& reason, Clock::UtcTime now);
  std::vector<Withdrawal> withdrawals();
  /// Everything that rests on a record.
  /// @param name  of a calibration or other source, of a certificate, or identity or serial number of
  ///              equipment; nothing is affected by one that is not known
  Affected affected_by(const std::string& name);

  // ---- Retention
  /// Sets for how long records of a kind are kept. @throws RegisterError for another kind, and for the audit
  void set_retention(const LoggedIn& by, const std::string& kind, int years, Clock::UtcTime now);
  std::vector<RetentionRule> retention();
  /// Records whose time has passed. Nothing is deleted.
  std::vector<RetainedRecord> past_retention(Clock::UtcTime now);

  // ---- Evidence
  std::vector<AuditEntry> audit();
  /// Whether the audit is complete, its times are in order, every row agrees with it, and every number was
  /// given once. A register that was copied back or rebuilt is consistent: compare_with() finds it.
  std::vector<RegisterFinding> verify();
  /// Whether the register still has what a certificate or backup states of it: its entries, and the
  /// certificate under its number.
  std::vector<RegisterFinding> compare_with(const RegisterEvidence& evidence);
  /// The part of compare_with() about the audit; nullopt if the evidence names no entry.
  std::optional<RegisterFinding> compare_audit_with(const RegisterEvidence& evidence);
  /// Entry of the newest head that a witness signed; nullopt: none did.
  std::optional<std::int64_t> newest_witnessed_head();
  /// From now on this witness signs the heads of the audit when a number is given and when a certificate is
  /// issued: before, so that nothing is written if it refuses, and after. Empty: none does.
  void set_witness(HeadWitness witness) { witness_ = std::move(witness); }

  // ---- Copies
  /// All of the register as one JSON text (schema abcal.register/1).
  std::string backup();
  /// Makes a register of a backup in an empty database, which may be of the other kind.
  /// @throws RegisterError if the backup is not whole
  static Register restore(const std::string& location, const std::string& backup, Clock::UtcTime now);
  /// A table as CSV (RFC 4180). Passwords and logins are left out.
  std::string export_csv(const std::string& table);
  /// All tables as JSON, for people and other programs; without passwords and logins.
  std::string export_json();
  /// The names of the tables that are exported.
  static std::vector<std::string> exported_tables();

 private:
  explicit Register(Database database);

  struct Change {
    std::string who, what;
    std::string table, key;  ///< Row that changes.
    std::string reason;      ///< Empty: none.
  };
  /// Within a transaction: `write` changes the row, and the audit gets the row before and after.
  void change(const Change& change, Clock::UtcTime now, const std::function<void()>& write);
  /// Appends an entry, and before it one that records that the clock was set back, if it was.
  void append_audit(const Change& change, const std::string& before, const std::string& after,
                    Clock::UtcTime now);
  /// Hashes or checks a password; the entry that follows counts the time this takes.
  template <typename Hash>
  auto count_time_of(const Hash& hash) {
    const auto begun = std::chrono::steady_clock::now();
    auto result = hash();
    hashing_ = std::chrono::steady_clock::now() - begun;
    return result;
  }
  void append_entry(AuditEntry entry, const AuditEntry& predecessor);
  /// The last entry of the audit; without one, an entry 0.
  AuditEntry last_entry();
  AuditHead audit_head();
  /// Brings an older database to the newest schema step, within a transaction.
  void bring_to_newest_step(int database_step, Clock::UtcTime now);
  /// The first part of reserve_number(), within a transaction. @return the number
  std::string give_number(const LoggedIn& by, const NumberRequest& request, Clock::UtcTime now);
  AuditHead head_of_number(const std::string& number);
  std::vector<CertificateRecord> certificates_where(const char* column, const std::string& value);
  /// The issued certificate that replaces one; empty: none does.
  std::string successor_of(const std::string& number);
  void write_issued(const LoggedIn& by, const std::string& number, const std::string& xml_sha256,
                    const std::string& issue_date, Clock::UtcTime now);
  /// A warning if the clock is before the last entry of a certificate; empty: it is not.
  std::string clock_before_last_certificate(Clock::UtcTime now);
  /// Has the newest head signed. @return whether the witness answered, or there is none
  bool witness_head(std::vector<std::string>& warnings);
  /// The first statement of every transaction that writes: others wait here.
  void lock_audit();
  std::string row_json(const std::string& table, const std::string& key);
  void require(const LoggedIn& by, Right right) const;
  void require_new(const std::string& table, const std::string& key);
  /// Whether equipment of this identity is a record of a stage.
  bool is_stage_record(const std::string& identity);
  void require_known(const std::string& table, const std::string& key);
  void require_not_blocked(const NumberRequest& request);
  void require_not_withdrawn(const NumberRequest& request);
  /// tell_run() within a transaction.
  bool note_run(const LoggedIn& by, const RegisteredRun& run, Clock::UtcTime now);
  /// Why a record cannot be withdrawn; throws.
  void require_withdrawable(const std::string& kind, const std::string& name);
  void read_facts();
  /// A change in a transaction of its own.
  void change_alone(const Change& change, Clock::UtcTime now, const std::function<void()>& write);

  Database database_;
  RegisterFacts facts_;
  HeadWitness witness_;
  /// For others, at the beginning of the last transaction, and for the hash of a password before it.
  std::chrono::nanoseconds waited_{0};
  std::chrono::nanoseconds hashing_{0};  ///< Time that a call has spent on a password before its transaction.
};

/// Certificates stored with a run, for comparison with the register: numbers, and hashes of the XML.
struct KeptCertificate {
  std::string number, xml_sha256;
};
std::vector<RegisterFinding> compare_with_run(const std::vector<CertificateRecord>& registered,
                                              const std::vector<KeptCertificate>& kept);

}  // namespace abcal::lab
