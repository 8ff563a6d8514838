#include <fmt/format.h>

#include <algorithm>

#include "app/laboratory/register/register.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"

namespace abcal::lab {
namespace {

constexpr const char* kColumns =
    "number, state, run_sha256, xml_sha256, item, measured_by, approved_by, issue_date, replaces, reason, "
    "utc, approval";
constexpr std::size_t kColumnCount = 12;
constexpr const char* kNumberGiven = "number given";
constexpr const char* kWithdrawn = "withdrawn";

CertificateRecord record_of(const Database::Row& row) {
  return {row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11]};
}

}  // namespace

std::vector<CertificateRecord> Register::certificates() {
  std::vector<CertificateRecord> list;
  for (const auto& row :
       database_.query(kColumnCount, fmt::format("select {} from certificate order by number", kColumns)))
    list.push_back(record_of(row));
  return list;
}

std::vector<CertificateRecord> Register::certificates_where(const char* column, const std::string& value) {
  std::vector<CertificateRecord> list;
  for (const auto& row : database_.query(
           kColumnCount,
           fmt::format("select {} from certificate where {} = :value order by number", kColumns, column),
           {{"value", value}}))
    list.push_back(record_of(row));
  return list;
}

std::vector<CertificateRecord> Register::certificates_of(const std::string& run_sha256) {
  return certificates_where("run_sha256", run_sha256);
}

bool Register::witness_head(std::vector<std::string>& warnings) {
  if (!witness_) return true;
  DatabaseTransaction transaction(database_);
  lock_audit();
  const AuditHead head = audit_head();
  const std::optional<WitnessedLine> answer = witness_(head.entries, head.sha256);
  if (!answer) {
    warnings.push_back(fmt::format(
        "the witness does not answer: the head of the register at entry {} is not witnessed", head.entries));
    return false;
  }
  database_.execute(
      "insert into witnessed_head(entries, line, signature) values(:entries, :line, :signature) on "
      "conflict(entries) do nothing",
      {{"entries", std::to_string(head.entries)}, {"line", answer->line}, {"signature", answer->signature}});
  transaction.commit();
  return true;
}

AuditHead Register::head_of_number(const std::string& number) {
  const auto rows = database_.query(
      2, "select entry, chain from audit where subject = :subject and what = :what order by entry limit 1",
      {{"subject", "certificate/" + number}, {"what", kNumberGiven}});
  if (rows.empty())
    throw RegisterError(fmt::format(
        "register {}: its audit does not say when it gave number {}; required: `abcal lab verify`",
        without_password(location()), number));
  return {std::stoll(rows[0][0]), rows[0][1]};
}

ReservedNumber Register::reserve_number(const LoggedIn& by, const NumberRequest& request,
                                        Clock::UtcTime now) {
  require(by, Right::kApprove);
  if (by.name() == request.measured_by)
    throw RegisterError(fmt::format(
        "{} measured the run and cannot approve its certificate; required: another person", by.name()));
  ReservedNumber reserved;
  const bool is_answered = witness_head(reserved.warnings);
  {
    DatabaseTransaction transaction(database_);
    lock_audit();
    if (const std::string why = clock_before_last_certificate(now); !why.empty())
      reserved.warnings.push_back(why);
    require_not_blocked(request);
    require_not_withdrawn(request);
    reserved.number = give_number(by, request, now);
    reserved.head = head_of_number(reserved.number);
    for (const RegisteredRun& run : request.runs) (void)note_run(by, run, now);
    transaction.commit();
  }
  if (is_answered) (void)witness_head(reserved.warnings);
  return reserved;
}

std::string Register::clock_before_last_certificate(Clock::UtcTime now) {
  const auto rows = database_.query(3,
                                    "select entry, utc, subject from audit where entry = (select max(entry) "
                                    "from audit where subject like 'certificate/%')");
  const std::string utc = format_utc(now + waited_);
  if (rows.empty() || !runs_backwards(rows[0][1], utc)) return {};
  return fmt::format(
      "the clock says {}, before {} of entry {} of the register, which is of {}; the certificate has its "
      "date from this clock; required: a clock that is right",
      utc, rows[0][1], rows[0][0], rows[0][2]);
}

std::string Register::successor_of(const std::string& number) {
  const auto rows = database_.query(
      1, "select number from certificate where replaces = :number and state <> 'reserved' order by number",
      {{"number", number}});
  return rows.empty() ? std::string() : rows[0][0];
}

std::string Register::give_number(const LoggedIn& by, const NumberRequest& request, Clock::UtcTime now) {
  for (const CertificateRecord& one : certificates_of(request.run_sha256)) {
    if (one.item != request.item) continue;  // It belongs to another item of the same run.
    if (one.state == "reserved" && one.replaces == request.replaces)
      return one.number;  // Its program ended too early.
    if (one.state == "issued" && one.number != request.replaces)
      throw RegisterError(
          fmt::format("this run has certificate {} already; amend it with --replaces {} --reason TEXT",
                      one.number, one.number));
    if (one.state == kWithdrawn && one.number != request.replaces && successor_of(one.number).empty())
      throw RegisterError(fmt::format(
          "certificate {} of this run was withdrawn; a new one replaces it: --replaces {} --reason TEXT",
          one.number, one.number));
  }
  if (!request.replaces.empty()) {
    const auto replaced =
        database_.query(3, "select state, run_sha256, item from certificate where number = :number",
                        {{"number", request.replaces}});
    if (replaced.empty() || (replaced[0][0] != "issued" && replaced[0][0] != kWithdrawn))
      throw RegisterError(fmt::format("certificate {}: is {}; required: an issued one to replace",
                                      request.replaces,
                                      replaced.empty() ? "not in the register" : replaced[0][0]));
    if (const std::string successor = successor_of(request.replaces); !successor.empty())
      throw RegisterError(
          fmt::format("certificate {}: was withdrawn and is replaced by {}; required: --replaces {}",
                      request.replaces, successor, successor));
    if (replaced[0][2] != request.item)
      throw RegisterError(
          fmt::format("certificate {}: is of {}, another item; required: one of {}, which is to be "
                      "certified. A certificate that names the wrong item is not replaced by one of another",
                      request.replaces, replaced[0][2], request.item));
  }
  const auto last =
      database_.query(1, "update counter set last = last + 1 where name = 'certificate' returning last");
  if (last.size() != 1)
    throw RegisterError(
        fmt::format("register {}: has no counter of certificates", without_password(location())));
  const std::string utc = format_utc(now);
  const std::string number =
      fmt::format("{}{}-{:04}", facts_.number_prefix, utc.substr(0, 4), std::stoul(last[0][0]));
  // A person with write access to the database could set back the counter alone.
  if (!database_
           .query(1, "select entry from audit where subject = :subject",
                  {{"subject", "certificate/" + number}})
           .empty())
    throw RegisterError(
        fmt::format("register {}: certificate {} was given before, though its counter says otherwise: it was "
                    "changed; required: `abcal lab verify`, and a backup that is whole",
                    without_password(location()), number));
  change({by.name(), kNumberGiven, "certificate", number, {}}, now, [&] {
    database_.insert("certificate", {{"number", number},
                                     {"state", "reserved"},
                                     {"run_sha256", request.run_sha256},
                                     {"xml_sha256", ""},
                                     {"item", request.item},
                                     {"measured_by", request.measured_by},
                                     {"approved_by", ""},
                                     {"issue_date", ""},
                                     {"replaces", request.replaces},
                                     {"reason", request.reason},
                                     {"utc", utc},
                                     {"approval", ""}});
  });
  return number;
}

std::vector<std::string> Register::record_issued(const LoggedIn& by, const std::string& number,
                                                 const std::string& xml_sha256, const std::string& issue_date,
                                                 Clock::UtcTime now) {
  require(by, Right::kApprove);
  std::vector<std::string> warnings;
  const bool is_answered = witness_head(warnings);
  write_issued(by, number, xml_sha256, issue_date, now);
  if (is_answered) (void)witness_head(warnings);
  return warnings;
}

void Register::write_issued(const LoggedIn& by, const std::string& number, const std::string& xml_sha256,
                            const std::string& issue_date, Clock::UtcTime now) {
  DatabaseTransaction transaction(database_);
  lock_audit();
  const auto found = certificates_where("number", number);
  if (found.empty())
    throw RegisterError(fmt::format("certificate {}: its number was not given here", number));
  const CertificateRecord& record = found.front();
  if (record.state != "reserved")
    throw RegisterError(fmt::format("certificate {}: is {} already", number, record.state));
  if (record.measured_by == by.name())
    throw RegisterError(
        fmt::format("{} measured the run of certificate {} and cannot approve it", by.name(), number));
  const std::string utc = format_utc(now);
  // Hash of the approved data, bound to the approver and the time.
  const std::string approval =
      sha256_of(fmt::format("{}\n{}\n{}\n{}\n{}", number, record.run_sha256, xml_sha256, by.name(), utc));
  change({by.name(), "certificate approved and issued", "certificate", number, {}}, now, [&] {
    database_.execute(
        "update certificate set state = 'issued', xml_sha256 = :xml, approved_by = :by, issue_date = :date, "
        "utc = :utc, approval = :approval where number = :number",
        {{"xml", xml_sha256},
         {"by", by.name()},
         {"date", issue_date},
         {"utc", utc},
         {"approval", approval},
         {"number", number}});
  });
  if (!record.replaces.empty()) {
    // One that was withdrawn stays so: its successor names it.
    change({by.name(), "certificate replaced", "certificate", record.replaces, record.reason}, now, [&] {
      database_.execute(
          "update certificate set state = case state when 'withdrawn' then state else 'replaced' end, utc = "
          ":utc where number = :number",
          {{"utc", utc}, {"number", record.replaces}});
    });
  }
  transaction.commit();
}

std::vector<RegisterFinding> compare_with_run(const std::vector<CertificateRecord>& registered,
                                              const std::vector<KeptCertificate>& kept) {
  std::vector<RegisterFinding> findings;
  const auto kept_as = [&](const std::string& number) {
    return std::find_if(kept.begin(), kept.end(),
                        [&](const KeptCertificate& one) { return one.number == number; });
  };
  for (const CertificateRecord& one : registered) {
    const std::string what = "certificate " + one.number;
    if (one.state == "reserved") {
      findings.push_back({what, true, "its number is given, but it is not issued yet"});
      continue;
    }
    const auto found = kept_as(one.number);
    if (found == kept.end()) {
      findings.push_back(
          {what, false, "the register knows it as " + one.state + ", but the run does not have it"});
    } else if (found->xml_sha256 != one.xml_sha256) {
      findings.push_back({what, false, "its XML is not what was approved"});
    } else {
      findings.push_back(
          {what, true, fmt::format("{}, approved by {}, its XML as approved", one.state, one.approved_by)});
    }
  }
  for (const KeptCertificate& one : kept) {
    const bool known =
        std::any_of(registered.begin(), registered.end(),
                    [&](const CertificateRecord& record) { return record.number == one.number; });
    if (!known)
      findings.push_back(
          {"certificate " + one.number, false, "the register did not give this number to this run"});
  }
  return findings;
}

}  // namespace abcal::lab
