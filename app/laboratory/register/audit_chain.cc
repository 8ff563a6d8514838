#include "app/laboratory/register/audit_chain.h"

#include <fmt/format.h>

#include <charconv>
#include <chrono>
#include <optional>
#include <string_view>

#include "protocol/record/sha256.h"

namespace abcal::lab {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kTolerance{1000};
/// Versions before 1.1 gave an entry the time at which its command began, also if others wrote before it
/// ended.
constexpr milliseconds kToleranceBeforeStep4 = std::chrono::hours(1);

/// "2026-03-01T12:00:00.000Z" since 1970; nothing for another text.
std::optional<milliseconds> time_of(std::string_view utc) {
  using namespace std::chrono;
  constexpr std::string_view kForm = "0000-00-00T00:00:00.000Z";
  if (utc.size() != kForm.size()) return std::nullopt;
  for (std::size_t k = 0; k < kForm.size(); ++k) {
    const bool is_digit = utc[k] >= '0' && utc[k] <= '9';
    if (kForm[k] == '0' ? !is_digit : utc[k] != kForm[k]) return std::nullopt;
  }
  const auto number = [&](std::size_t from, std::size_t length) {
    int value = 0;
    std::from_chars(utc.data() + from, utc.data() + from + length, value);
    return value;
  };
  const year_month_day date{year(number(0, 4)), month(static_cast<unsigned>(number(5, 2))),
                            day(static_cast<unsigned>(number(8, 2)))};
  if (!date.ok()) return std::nullopt;
  return sys_days(date).time_since_epoch() + hours(number(11, 2)) + minutes(number(14, 2)) +
         seconds(number(17, 2)) + milliseconds(number(20, 3));
}

bool is_before(const std::string& earlier_utc, const std::string& utc, milliseconds tolerance) {
  const auto earlier = time_of(earlier_utc), time = time_of(utc);
  return earlier && time && *time + tolerance < *earlier;
}

}  // namespace

bool runs_backwards(const std::string& earlier_utc, const std::string& utc) {
  return is_before(earlier_utc, utc, kTolerance);
}

std::string clock_set_back(const AuditEntry& predecessor, const std::string& utc) {
  return fmt::format("clock set back: it says {}, and said {} at entry {}", utc, predecessor.utc,
                     predecessor.entry);
}

std::string chain_of(const std::string& previous, const AuditEntry& entry) {
  return next_link(previous, {std::to_string(entry.entry), entry.utc, entry.who, entry.what, entry.subject,
                              entry.before_json, entry.after_json});
}

RegisterFinding check_audit_chain(const std::vector<AuditEntry>& entries, const AuditHead& head,
                                  std::map<std::string, std::string>& last) {
  const std::string what = "audit";
  std::string link;
  std::size_t count = 0;
  for (const AuditEntry& entry : entries) {
    ++count;
    if (entry.entry != count) return {what, false, fmt::format("entry {} is missing", count)};
    link = chain_of(link, entry);
    if (link != entry.chain)
      return {what, false, fmt::format("entry {}, or one before it, was changed", count)};
    const auto before = last.find(entry.subject);
    if ((before == last.end() ? std::string() : before->second) != entry.before_json)
      return {what, false,
              fmt::format("entry {}: {} was changed without an entry before it", count, entry.subject)};
    last[entry.subject] = entry.after_json;
  }
  if (head.entries != static_cast<std::int64_t>(count) || head.sha256 != link)
    return {what, false, "its last entries are missing: it does not end as its head says"};
  return {what, true, fmt::format("{} entries, each linked to the one before", count)};
}

RegisterFinding check_audit_times(const std::vector<AuditEntry>& entries) {
  // Up to here an older program may have written.
  std::size_t old = 0;
  while (old < entries.size() && entries[old].subject != kTimesFromHere) ++old;
  if (old == entries.size()) old = 0;
  std::string wrong;
  std::size_t set_back = 0, last_set_back = 0;
  for (std::size_t k = 0; k < entries.size(); ++k) {
    const AuditEntry& entry = entries[k];
    if (!time_of(entry.utc)) {
      wrong +=
          fmt::format("{}entry {} has the time \"{}\"", wrong.empty() ? "" : "; ", entry.entry, entry.utc);
      continue;
    }
    if (k == 0) continue;
    const AuditEntry& before = entries[k - 1];
    if (!is_before(before.utc, entry.utc, k <= old ? kToleranceBeforeStep4 : kTolerance)) continue;
    if (entry.subject == kClock && entry.what == clock_set_back(before, entry.utc)) {
      ++set_back;
      last_set_back = entry.entry;
      continue;
    }
    wrong += fmt::format("{}entry {} of {} is before entry {} of {}", wrong.empty() ? "" : "; ", entry.entry,
                         entry.utc, before.entry, before.utc);
  }
  if (!wrong.empty())
    return {kTimesOfAudit, false,
            wrong + "; required: times that do not run backwards without an entry that says so"};
  std::string found = "none runs backwards without an entry that says so";
  if (set_back > 0)
    found += fmt::format("; the clock was set back {} times, last at entry {}", set_back, last_set_back);
  return {kTimesOfAudit, true, found};
}

}  // namespace abcal::lab
