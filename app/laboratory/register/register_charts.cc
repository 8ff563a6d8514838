#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "app/laboratory/register/register.h"
#include "drivers/text/number.h"
#include "protocol/record/run_file.h"

namespace abcal::lab {
namespace {

constexpr const char* kOutside = "outside";
constexpr const char* kInside = "inside";
constexpr const char* kAnew = "anew";
constexpr const char* kRelative = "relative";
constexpr const char* kAbsolute = "absolute";
constexpr std::array kScopeQuantities{"sensitivity", "angle", "offset"};

/// All problems of an entry of the scope.
std::vector<std::string> problems_of(const ScopeEntry& entry) {
  std::vector<std::string> problems;
  if (entry.identity.empty()) problems.emplace_back("it has no name");
  if (std::find(kScopeQuantities.begin(), kScopeQuantities.end(), entry.quantity) == kScopeQuantities.end())
    problems.push_back(fmt::format("quantity \"{}\"; required: one of {}", entry.quantity,
                                   fmt::join(kScopeQuantities, ", ")));
  if (entry.unit.empty()) problems.emplace_back("no unit is given");
  if (!std::isfinite(entry.from) || !std::isfinite(entry.to) || !(entry.from <= entry.to))
    problems.push_back(
        fmt::format("range from {} to {}; required: finite, from not above to", entry.from, entry.to));
  if (!(entry.cmc > 0.0) || !std::isfinite(entry.cmc))
    problems.push_back(fmt::format("CMC {}; required: a number > 0", entry.cmc));
  return problems;
}

}  // namespace

void Register::add_check_standard(const LoggedIn& by, const CheckStandard& standard, Clock::UtcTime now) {
  require(by, Right::kApprove);
  DatabaseTransaction transaction(database_);
  lock_audit();
  if (row_json("item", standard.item).empty())
    throw RegisterError(fmt::format(
        "item {}: is not in the register; `abcal lab add item` adds it, under this name", standard.item));
  require_new("check_standard", standard.name);
  change({by.name(), "baseline approved", "check_standard", standard.name, {}}, now, [&] {
    database_.insert("check_standard", {{"name", standard.name},
                                        {"item", standard.item},
                                        {"baseline_json", standard.baseline_json},
                                        {"approved_by", by.name()},
                                        {"approved_utc", format_utc(now)},
                                        {"retired", ""}});
  });
  transaction.commit();
}

void Register::retire_check_standard(const LoggedIn& by, const std::string& name, const std::string& reason,
                                     Clock::UtcTime now) {
  require(by, Right::kApprove);
  if (reason.empty()) throw RegisterError("retiring chart " + name + ": no reason is given");
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_known("check_standard", name);
  change({by.name(), "chart retired", "check_standard", name, reason}, now, [&] {
    database_.execute("update check_standard set retired = :utc where name = :name",
                      {{"utc", format_utc(now)}, {"name", name}});
  });
  transaction.commit();
}

std::vector<CheckStandard> Register::check_standards() {
  std::vector<CheckStandard> list;
  for (const auto& row : database_.query(6,
                                         "select name, item, baseline_json, approved_by, approved_utc, "
                                         "retired from check_standard order by name"))
    list.push_back({row[0], row[1], row[2], row[3], row[4], row[5]});
  return list;
}

CheckStandard Register::check_standard(const std::string& name) {
  std::string known;
  for (CheckStandard& standard : check_standards()) {
    if (standard.name == name) return std::move(standard);
    known += (known.empty() ? "" : ", ") + standard.name;
  }
  throw RegisterError(
      fmt::format("chart {}: is not in the register, which has {}; `abcal lab chart approve` makes one", name,
                  known.empty() ? "none" : known));
}

CheckPoint Register::add_check_point(const LoggedIn& by, CheckPoint point, std::size_t points_before,
                                     const BenchBlock& block, Clock::UtcTime now) {
  require(by, Right::kMeasure);
  DatabaseTransaction transaction(database_);
  lock_audit();
  const std::string& chart = point.check_standard;
  if (!check_standard(chart).retired.empty()) throw RegisterError(fmt::format("chart {}: is retired", chart));
  const std::vector<CheckPoint> before = check_points(chart);
  if (before.size() != points_before)
    throw RegisterError(
        fmt::format("chart {}: another point was added meanwhile; add this one again", chart));
  for (const CheckPoint& one : before)
    if (one.run_sha256 == point.run_sha256)
      throw RegisterError(fmt::format("chart {}: this run is its point {} already", chart, one.identity));
  point.identity = fmt::format("{}/{}", chart, before.size() + 1);
  point.added_by = by.name();
  point.utc = format_utc(now);
  change(
      {by.name(), point.outside ? "check run outside" : "check run added", "check_point", point.identity, {}},
      now, [&] {
        database_.insert("check_point", {{"identity", point.identity},
                                         {"check_standard", chart},
                                         {"run_sha256", point.run_sha256},
                                         {"date", point.date},
                                         {"values_json", point.values_json},
                                         {"state", point.outside ? kOutside : kInside},
                                         {"found", point.found},
                                         {"begins", point.begins_anew ? kAnew : ""},
                                         {"added_by", point.added_by},
                                         {"utc", point.utc}});
      });
  bool blocked = false;
  for (const BenchBlock& one : blocks()) blocked = blocked || (one.check_standard == chart && one.holds());
  if (point.outside && !blocked) {
    change({by.name(), "bench blocked", "bench_block", point.identity, {}}, now, [&] {
      database_.insert("bench_block", {{"identity", point.identity},
                                       {"check_standard", chart},
                                       {"stage", block.stage},
                                       {"bench", block.bench},
                                       {"found", point.found},
                                       {"set_utc", point.utc},
                                       {"lifted_by", ""},
                                       {"lifted_utc", ""},
                                       {"reason", ""}});
    });
  }
  transaction.commit();
  return point;
}

std::vector<CheckPoint> Register::check_points(const std::string& chart) {
  std::vector<CheckPoint> list;
  for (const auto& row : database_.query(
           10,
           "select identity, check_standard, run_sha256, date, values_json, state, found, begins, added_by, "
           "utc from check_point where check_standard = :chart order by length(identity), identity",
           {{"chart", chart}}))
    list.push_back({row[0], row[1], row[2], row[3], row[4], row[5] == kOutside, row[6], row[7] == kAnew,
                    row[8], row[9]});
  return list;
}

void Register::tell_check_run(const LoggedIn& by, CheckRunNotice notice, Clock::UtcTime now) {
  require(by, Right::kMeasure);
  const std::string identity = fmt::format("{}/{}", notice.check_standard, notice.run_sha256);
  DatabaseTransaction transaction(database_);
  lock_audit();
  if (!row_json("check_run", identity).empty()) return;
  change({by.name(), "check run measured", "check_run", identity, {}}, now, [&] {
    database_.insert("check_run", {{"identity", identity},
                                   {"check_standard", notice.check_standard},
                                   {"run_sha256", notice.run_sha256},
                                   {"file", notice.file},
                                   {"date", notice.date},
                                   {"told_by", by.name()},
                                   {"utc", format_utc(now)}});
  });
  transaction.commit();
}

std::vector<CheckRunNotice> Register::waiting_check_runs(const std::string& chart) {
  std::vector<CheckRunNotice> list;
  for (const auto& row :
       database_.query(6,
                       "select check_standard, run_sha256, file, date, told_by, utc from check_run where "
                       "check_standard = :chart and run_sha256 not in (select run_sha256 from check_point "
                       "where check_standard = :chart) order by date, identity",
                       {{"chart", chart}}))
    list.push_back({row[0], row[1], row[2], row[3], row[4], row[5]});
  return list;
}

std::vector<BenchBlock> Register::blocks() {
  std::vector<BenchBlock> list;
  for (const auto& row :
       database_.query(9,
                       "select identity, check_standard, stage, bench, found, set_utc, lifted_by, "
                       "lifted_utc, reason from bench_block order by set_utc, identity"))
    list.push_back({row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8]});
  return list;
}

void Register::lift_block(const LoggedIn& by, const std::string& chart, const std::string& reason,
                          Clock::UtcTime now) {
  require(by, Right::kApprove);
  if (reason.find_first_not_of(" \t") == std::string::npos)
    throw RegisterError(fmt::format("lifting the block of chart {}: no reason is given", chart));
  DatabaseTransaction transaction(database_);
  lock_audit();
  for (const BenchBlock& block : blocks()) {
    if (block.check_standard != chart || !block.holds()) continue;
    change({by.name(), "block lifted", "bench_block", block.identity, reason}, now, [&] {
      database_.execute(
          "update bench_block set lifted_by = :by, lifted_utc = :utc, reason = :reason where identity = "
          ":identity",
          {{"by", by.name()}, {"utc", format_utc(now)}, {"reason", reason}, {"identity", block.identity}});
    });
    transaction.commit();
    return;
  }
  throw RegisterError(fmt::format("chart {}: blocks no bench", chart));
}

void Register::require_not_blocked(const NumberRequest& request) {
  for (const BenchBlock& block : blocks()) {
    const bool same = (!block.stage.empty() && block.stage == request.stage) ||
                      (!block.bench.empty() && block.bench == request.bench);
    if (!block.holds() || !same) continue;
    throw RegisterError(fmt::format(
        "bench {} (stage {}) is blocked since {} by chart {}: {}; required: that the cause is treated, and a "
        "person with the right to approve lifts it: `abcal lab chart lift {} --reason TEXT`",
        block.bench.empty() ? "without a name" : block.bench, block.stage, block.set_utc,
        block.check_standard, block.found, block.check_standard));
  }
}

void Register::add_scope(const LoggedIn& by, const ScopeEntry& entry, Clock::UtcTime now) {
  require(by, Right::kApprove);
  if (const auto problems = problems_of(entry); !problems.empty())
    throw RegisterError(fmt::format("scope {}: {}", entry.identity, fmt::join(problems, "; ")));
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_new("scope", entry.identity);
  change({by.name(), "scope added", "scope", entry.identity, {}}, now, [&] {
    database_.insert("scope", {{"identity", entry.identity},
                               {"quantity", entry.quantity},
                               {"unit", entry.unit},
                               {"range_from", fmt::format("{}", entry.from)},
                               {"range_to", fmt::format("{}", entry.to)},
                               {"cmc", fmt::format("{}", entry.cmc)},
                               {"kind", entry.relative ? kRelative : kAbsolute},
                               {"valid_from", format_utc(now).substr(0, 10)},
                               {"retired", ""}});
  });
  transaction.commit();
}

void Register::retire_scope(const LoggedIn& by, const std::string& identity, const std::string& reason,
                            Clock::UtcTime now) {
  require(by, Right::kApprove);
  if (reason.empty()) throw RegisterError("retiring scope " + identity + ": no reason is given");
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_known("scope", identity);
  change({by.name(), "scope retired", "scope", identity, reason}, now, [&] {
    database_.execute("update scope set retired = :utc where identity = :identity",
                      {{"utc", format_utc(now)}, {"identity", identity}});
  });
  transaction.commit();
}

std::vector<ScopeEntry> Register::scope() {
  std::vector<ScopeEntry> list;
  const auto number = [&](const std::string& text) {
    if (const auto value = pieces::number<double>(text)) return *value;
    throw RegisterError(fmt::format("register {}: its scope has the number \"{}\"; it is damaged",
                                    without_password(location()), text));
  };
  for (const auto& row : database_.query(9,
                                         "select identity, quantity, unit, range_from, range_to, cmc, kind, "
                                         "valid_from, retired from scope order by identity"))
    list.push_back({row[0], row[1], row[2], number(row[3]), number(row[4]), number(row[5]),
                    row[6] == kRelative, row[7], row[8]});
  return list;
}

}  // namespace abcal::lab
