#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>

#include "app/laboratory/register/affected_queries.h"
#include "app/laboratory/register/register.h"
#include "protocol/record/run_file.h"

namespace abcal::lab {
namespace {

constexpr const char* kRunKind = "run";
constexpr std::array kRetentionKinds{kCertificateKind, kRunKind, kCalibrationKind};

constexpr const char* kWithdrawalColumns = "kind, name, reason, withdrawn_by, utc";

Withdrawal withdrawal_of(const Database::Row& row) {
  return {row[0], row[1], row[2], row[3], row[4]};
}

std::vector<Withdrawal> withdrawals_of(const std::vector<Database::Row>& rows) {
  std::vector<Withdrawal> list;
  for (const Database::Row& row : rows) list.push_back(withdrawal_of(row));
  return list;
}

Message words_of(const Withdrawal& withdrawal) {
  return {"withdrawn on {date} because {reason}", withdrawal.date(), withdrawal.reason};
}

std::string identity_of(const std::string& kind, const std::string& name) {
  return kind + "/" + name;
}

/// The same day some years later; of 29 February, the last of the month.
std::string years_after(const std::string& date, int years) {
  using namespace std::chrono;
  const auto number = [&](std::size_t from, std::size_t length) {
    int value = 0;
    std::from_chars(date.data() + from, date.data() + from + length, value);
    return value;
  };
  if (date.size() != 10) return {};
  year_month_day day{year(number(0, 4) + years), month(static_cast<unsigned>(number(5, 2))),
                     std::chrono::day(static_cast<unsigned>(number(8, 2)))};
  if (!day.ok()) day = day.year() / day.month() / last;
  return fmt::format("{:04}-{:02}-{:02}", static_cast<int>(day.year()), static_cast<unsigned>(day.month()),
                     static_cast<unsigned>(day.day()));
}

}  // namespace

std::string_view CertificateStatus::word() const {
  if (withdrawn) return "withdrawn";
  if (record.state == "reserved") return "not issued";
  return amended_by.empty() ? "valid" : "amended";
}

Message CertificateStatus::words() const {
  std::vector<Message> words;
  if (training) words.push_back(Message("TRAINING, certifies nothing"));
  if (withdrawn) {
    words.push_back(words_of(*withdrawn));
  } else if (record.state == "reserved") {
    words.push_back(Message("not issued: its number is given"));
  } else if (amended_by.empty()) {
    words.push_back(Message("valid, issued on {date}", record.issue_date));
  }
  if (!amended_by.empty()) words.push_back(Message("amended by {number} on {date}", amended_by, amended_on));
  for (const Withdrawal& source : sources_withdrawn)
    words.push_back(Message("it rests on {kind} {name}, {what}", source.kind, source.name, words_of(source)));
  return in_sequence(words);
}

bool Register::note_run(const LoggedIn& by, const RegisteredRun& run, Clock::UtcTime now) {
  bool is_new = row_json("known_run", run.run_sha256).empty();
  if (is_new) {
    change({by.name(), "run told", "known_run", run.run_sha256, {}}, now, [&] {
      database_.insert("known_run", {{"run_sha256", run.run_sha256},
                                     {"file", run.file},
                                     {"item", run.item},
                                     {"date", run.date},
                                     {"told_by", by.name()},
                                     {"utc", format_utc(now)}});
    });
  }
  for (const UsedSource& source : run.sources) {
    const std::string identity = fmt::format("{}/{}", run.run_sha256, identity_of(source.kind, source.name));
    if (!row_json("used_source", identity).empty()) continue;
    is_new = true;
    change({by.name(), "source of a run told", "used_source", identity, {}}, now, [&] {
      database_.insert("used_source", {{"identity", identity},
                                       {"run_sha256", run.run_sha256},
                                       {"kind", source.kind},
                                       {"name", source.name},
                                       {"serial_number", source.serial_number},
                                       {"role", source.role}});
    });
  }
  return is_new;
}

bool Register::tell_run(const LoggedIn& by, const RegisteredRun& run, Clock::UtcTime now) {
  require(by, Right::kMeasure);
  DatabaseTransaction transaction(database_);
  lock_audit();
  const bool is_new = note_run(by, run, now);
  transaction.commit();
  return is_new;
}

std::string Register::told_by(const std::string& run_sha256) {
  const auto rows =
      database_.query(1, "select told_by from known_run where run_sha256 = :run", {{"run", run_sha256}});
  return rows.empty() ? std::string() : rows[0][0];
}

bool Register::tell_certificate(const LoggedIn& by, const std::string& number, const Addressee& addressee,
                                const std::vector<std::string>& run_sha256s, Clock::UtcTime now) {
  if (!by.person().may(Right::kApprove)) require(by, Right::kMeasure);
  DatabaseTransaction transaction(database_);
  lock_audit();
  const std::vector<CertificateRecord> found = certificates_where("number", number);
  if (found.empty())
    throw RegisterError(fmt::format("certificate {}: its number was not given here", number));
  bool is_new = false;
  for (const std::string& run : run_sha256s) {
    const std::string identity = fmt::format("{}/{}", number, run);
    if (run == found[0].run_sha256 || !row_json("certified_run", identity).empty()) continue;
    is_new = true;
    change({by.name(), "further run of a certificate", "certified_run", identity, {}}, now, [&] {
      database_.insert("certified_run",
                       {{"identity", identity}, {"certificate", number}, {"run_sha256", run}});
    });
  }
  if (row_json("addressee", number).empty()) {
    is_new = true;
    change({by.name(), "customer of a certificate", "addressee", number, {}}, now, [&] {
      database_.insert("addressee", {{"certificate", number},
                                     {"name", addressee.name},
                                     {"address", addressee.address},
                                     {"email", addressee.email},
                                     {"language", addressee.language}});
    });
  }
  transaction.commit();
  return is_new;
}

void Register::require_withdrawable(const std::string& kind, const std::string& name) {
  for (const Withdrawal& earlier : withdrawals_of(database_.query(
           5,
           fmt::format("select {} from withdrawal where name = :name and kind = :kind", kWithdrawalColumns),
           {{"name", name}, {"kind", kind}})))
    throw RegisterError(
        fmt::format("{} {}: was {} already, by {}", kind, name, words_of(earlier), earlier.withdrawn_by));
  if (kind == kCertificateKind) {
    const auto status = status_of(name);
    if (!status) throw RegisterError(fmt::format("certificate {}: its number was not given here", name));
    if (!status->is_valid())
      throw RegisterError(
          fmt::format("certificate {}: is {}; required: one that is valid", name, status->words()));
    return;
  }
  if (kind == kCalibrationKind && !row_json("calibration", name).empty()) return;
  if (!database_
           .query(1, "select identity from used_source where name = :name and kind = :kind",
                  {{"name", name}, {"kind", kind}})
           .empty())
    return;
  std::vector<std::string> kinds{kCertificateKind, kCalibrationKind};
  for (const auto& row : database_.query(1, "select distinct kind from used_source order by kind"))
    if (row[0] != kCalibrationKind) kinds.push_back(row[0]);
  throw RegisterError(
      fmt::format("{} {}: is not in the register, and no run that it knows used it; required: a record of "
                  "one of the kinds {} (`abcal lab list calibration`)",
                  kind, name, fmt::join(kinds, ", ")));
}

Withdrawal Register::withdraw(const LoggedIn& by, const std::string& kind, const std::string& name,
                              const std::string& reason, Clock::UtcTime now) {
  require(by, kind == kCertificateKind ? Right::kApprove : Right::kOperate);
  if (reason.find_first_not_of(" \t\r\n") == std::string::npos)
    throw RegisterError(fmt::format("withdrawing {} {}: no reason is given", kind, name));
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_withdrawable(kind, name);
  const Withdrawal withdrawal{kind, name, reason, by.name(), format_utc(now)};
  const std::string identity = identity_of(kind, name);
  change({by.name(), kind + " withdrawn", "withdrawal", identity, reason}, now, [&] {
    database_.insert("withdrawal", {{"identity", identity},
                                    {"kind", kind},
                                    {"name", name},
                                    {"reason", reason},
                                    {"withdrawn_by", withdrawal.withdrawn_by},
                                    {"utc", withdrawal.utc}});
  });
  if (kind == kCertificateKind) {
    change({by.name(), "certificate withdrawn", "certificate", name, reason}, now, [&] {
      database_.execute("update certificate set state = 'withdrawn', utc = :utc where number = :number",
                        {{"utc", withdrawal.utc}, {"number", name}});
    });
  }
  transaction.commit();
  return withdrawal;
}

std::vector<Withdrawal> Register::withdrawals() {
  return withdrawals_of(database_.query(
      5, fmt::format("select {} from withdrawal order by utc, identity", kWithdrawalColumns)));
}

void Register::require_not_withdrawn(const NumberRequest& request) {
  std::string problems;
  for (const RegisteredRun& run : request.runs)
    for (const UsedSource& source : run.sources)
      for (const Withdrawal& withdrawal : withdrawals_of(
               database_.query(5,
                               fmt::format("select {} from withdrawal where name = :name and kind = :kind",
                                           kWithdrawalColumns),
                               {{"name", source.name}, {"kind", source.kind}})))
        problems += fmt::format("\n  {}, {}: {} {}, {}", run.file, source.role, source.kind, source.name,
                                words_of(withdrawal));
  if (problems.empty()) return;
  throw RegisterError(
      fmt::format("what is to be certified rests on records that were withdrawn; required: a run with "
                  "records that hold:{}",
                  problems));
}

std::optional<CertificateStatus> Register::status_of(const std::string& number) {
  const std::vector<CertificateRecord> found = certificates_where("number", number);
  if (found.empty()) return std::nullopt;
  CertificateStatus status;
  status.record = found.front();
  status.training = facts_.training;
  status.amended_by = successor_of(number);
  if (!status.amended_by.empty())
    status.amended_on = certificates_where("number", status.amended_by).front().issue_date;
  for (Withdrawal& withdrawal : withdrawals_of(database_.query(
           5, fmt::format("select {} from withdrawal where identity = :identity", kWithdrawalColumns),
           {{"identity", identity_of(kCertificateKind, number)}})))
    status.withdrawn = std::move(withdrawal);
  status.sources_withdrawn = withdrawals_of(database_.query(
      5,
      "select distinct w.kind, w.name, w.reason, w.withdrawn_by, w.utc from (select run_sha256 from "
      "certificate where number = :number union select run_sha256 from certified_run where certificate = "
      ":number) r join used_source u on u.run_sha256 = r.run_sha256 join withdrawal w on w.name = u.name and "
      "w.kind = u.kind order by w.utc, w.name",
      {{"number", number}}));
  return status;
}

Affected Register::affected_by(const std::string& name) {
  Affected affected;
  const std::vector<Parameter> named{{"name", name}};
  affected.is_known =
      database_
          .query(1,
                 "select certificate from calibration where certificate = :name union select identity from "
                 "equipment where identity = :name or serial_number = :name union select number from "
                 "certificate where number = :name union select name from used_source where name = :name "
                 "union select name from used_source where serial_number = :name",
                 named)
          .size() > 0;
  affected.withdrawn = withdrawals_of(
      database_.query(5,
                      "select kind, name, reason, withdrawn_by, utc from withdrawal where name = :name union "
                      "select w.kind, w.name, w.reason, w.withdrawn_by, w.utc from equipment e join "
                      "calibration c on c.equipment = e.identity join withdrawal w on w.name = c.certificate "
                      "where e.identity = :name or e.serial_number = :name order by 5",
                      named));
  for (const Database::Row& row : database_.query(8, affected_runs(), named)) {
    if (affected.runs.empty() || affected.runs.back().run_sha256 != row[0])
      affected.runs.push_back({row[0], row[1], row[2], row[3], {}});
    affected.runs.back().sources.push_back({row[4], row[5], row[6], row[7]});
  }
  for (const Database::Row& row : database_.query(16, affected_certificates(), named)) {
    AffectedCertificate one;
    one.record = {row[0], row[1], row[2], row[3], row[4],  row[5],
                  row[6], row[7], row[8], row[9], row[10], row[11]};
    if (!row[12].empty()) one.addressee = Addressee{row[12], row[13], row[14], row[15]};
    affected.certificates.push_back(std::move(one));
  }
  for (const Database::Row& row :
       database_.query(1,
                       "select number from certificate where state <> 'reserved' and run_sha256 not in "
                       "(select run_sha256 from known_run) order by number"))
    affected.unknown.push_back(row[0]);
  return affected;
}

void Register::set_retention(const LoggedIn& by, const std::string& kind, int years, Clock::UtcTime now) {
  require(by, Right::kAdminister);
  constexpr int kLongest = 100;
  if (kind == "audit")
    throw RegisterError(
        "retention of the audit: it is kept without end, since each entry proves those after it");
  if (std::find(kRetentionKinds.begin(), kRetentionKinds.end(), kind) == kRetentionKinds.end())
    throw RegisterError(
        fmt::format("retention of {}: required: one of {}", kind, fmt::join(kRetentionKinds, ", ")));
  if (years < 1 || years > kLongest)
    throw RegisterError(fmt::format("retention of {}: {} years; required: 1 to {}", kind, years, kLongest));
  change_alone({by.name(), "retention set", "retention", kind, {}}, now, [&] {
    database_.execute(
        "insert into retention(kind, years, set_by, utc) values(:kind, :years, :by, :utc) on conflict(kind) "
        "do update set years = excluded.years, set_by = excluded.set_by, utc = excluded.utc",
        {{"kind", kind}, {"years", std::to_string(years)}, {"by", by.name()}, {"utc", format_utc(now)}});
  });
}

std::vector<RetentionRule> Register::retention() {
  std::vector<RetentionRule> rules;
  for (const auto& row : database_.query(4, "select kind, years, set_by, utc from retention order by kind"))
    rules.push_back({row[0], std::stoi(row[1]), row[2], row[3]});
  return rules;
}

std::vector<RetainedRecord> Register::past_retention(Clock::UtcTime now) {
  const std::string today = format_utc(now).substr(0, 10);
  std::vector<RetainedRecord> past;
  for (const RetentionRule& rule : retention()) {
    // A run is evidence of its certificates: its time counts from the last of them.
    const char* const records =
        rule.kind == kCertificateKind
            ? "select number, issue_date from certificate where state <> 'reserved' order by 2, 1"
        : rule.kind == kRunKind
            ? "select r.file, coalesce(max(c.issue_date), '') as issued, r.date from known_run r left join "
              "certificate c on c.run_sha256 = r.run_sha256 and c.state <> 'reserved' group by r.run_sha256, "
              "r.file, r.date order by r.date, r.file"
            : "select certificate, due from calibration order by 2, 1";
    for (const auto& row : database_.query(rule.kind == kRunKind ? 3 : 2, records)) {
      const std::string since = row.size() == 3 ? std::max(row[1], row[2]) : row[1];
      const std::string until = years_after(since, rule.years);
      if (!until.empty() && until < today) past.push_back({rule.kind, row[0], since, until});
    }
  }
  return past;
}

}  // namespace abcal::lab
