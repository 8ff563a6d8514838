#include "app/witness/witness_check.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <ctime>
#include <iomanip>
#include <map>
#include <optional>
#include <set>
#include <sstream>
#include <stdexcept>

#include "app/witness/witness_line.h"
#include "protocol/record/dwell_chain.h"
#include "protocol/record/run_file.h"

namespace abcal {
namespace {

constexpr const char* kWhat = "witness";

/// Seconds since 1970 of a time as format_utc() writes it; whole seconds are enough across a start.
double seconds_of(const std::string& utc) {
  std::tm time{};
  std::istringstream(utc) >> std::get_time(&time, "%Y-%m-%dT%H:%M:%S");
  return static_cast<double>(::timegm(&time));
}

/// The dwells that were stored together, one for each item, by their places in the file.
struct Angle {
  std::size_t first = 0, last = 0;
};

std::vector<Angle> angles_of(const std::vector<LinkedDwell>& dwells) {
  std::vector<Angle> angles;
  for (std::size_t i = 0; i < dwells.size(); ++i) {
    const bool is_next_item =
        i > 0 && dwells[i].position == dwells[i - 1].position && dwells[i].item > dwells[i - 1].item;
    if (is_next_item)
      angles.back().last = i;
    else
      angles.push_back({i, i});
  }
  return angles;
}

/// Compares the statements with the run, one after the other.
class Comparison {
 public:
  Comparison(const RunLinks& links, const Trust& trust)
      : links_(links), trust_(trust), angles_(angles_of(links.dwells)) {
    place_of_[links.head] = 0;
    for (std::size_t a = 0; a < angles_.size(); ++a) place_of_[links.dwells[angles_[a].last].link] = a + 1;
    is_signed_.resize(angles_.size());
    is_too_fast_.resize(angles_.size());
  }

  void add(const WitnessedLine& row) {
    if (!seen_.insert(row.line).second) return;  // It was fetched once more.
    WitnessStatement statement;
    try {
      statement = parse_witness_line(row.line);
    } catch (const std::invalid_argument& error) {
      return fail(fmt::format("statement {} is none of a witness: {}", seen_.size(), error.what()));
    }
    if (!trust_.keys.empty() && !is_of_trusted_key(row))
      return fail(fmt::format("statement {} (counter {}) was not signed by a trusted key", seen_.size(),
                              statement.counter));
    if (statement.run != links_.head)
      return fail(fmt::format("statement {} is about another run, {}; this one is {}", seen_.size(),
                              statement.run, links_.head));
    if (last_ && statement.counter <= last_->counter)
      return fail(fmt::format("statement {} has the counter {} after {}", seen_.size(), statement.counter,
                              last_->counter));
    if (last_ && seconds_since_last(statement) < 0.0)
      return fail(fmt::format("statement {} is of {}, before the one before it, of {}", seen_.size(),
                              statement.utc, last_->utc));
    take(statement);
    last_ = statement;
  }

  WitnessCheck result() const {
    WitnessCheck check;
    check.is_simulated = is_simulated_;
    check.signer = signer_;
    check.angles = angles_.size();
    for (const std::string& problem : problems_) check.checks.push_back({kWhat, false, problem});
    check.words = problems_.empty() ? words() : "contradicts what the witness has signed";
    if (problems_.empty()) check.checks.push_back({kWhat, true, check.words});
    check.is_signed = problems_.empty() && !trust_.keys.empty() && has_begun_ && has_ended_;
    check.is_witnessed = check.is_signed && !is_simulated_ && not_signed().empty() && too_fast().empty();
    return check;
  }

 private:
  void fail(std::string why) { problems_.push_back(std::move(why)); }

  bool is_of_trusted_key(const WitnessedLine& row) {
    const auto found = std::ranges::find_if(
        trust_.keys, [&](const TrustedKey& key) { return is_witnessed_by(row, key.public_pem); });
    if (found == trust_.keys.end()) return false;
    signer_ = found->owner;
    return true;
  }

  /// By the time since the start of the computer, which cannot be set; across a start, by UTC.
  double seconds_since_last(const WitnessStatement& now) const {
    if (!now.boot_id.empty() && now.boot_id == last_->boot_id)
      return 1e-9 * static_cast<double>(now.since_boot_ns - last_->since_boot_ns);
    return seconds_of(now.utc) - seconds_of(last_->utc);
  }

  /// @return the number of angles up to a link; nullopt if the run does not have this link
  std::optional<std::size_t> place_of(const std::string& link) const {
    const auto found = place_of_.find(link);
    return found == place_of_.end() ? std::nullopt : std::optional(found->second);
  }

  void take(const WitnessStatement& now) {
    switch (now.what) {
      case WitnessAct::kBegin:
        has_begun_ = true;
        is_simulated_ = is_simulated_ || now.simulated;
        bench_ = now.bench;
        place_ = place_of(now.head);
        if (!place_) fail("what stood before the first witnessed angle was changed, or an earlier angle");
        break;
      case WitnessAct::kLink:
        take_link(now);
        break;
      case WitnessAct::kClose:
        has_ended_ = true;
        if (now.events != links_.closing)
          fail("events, conditions, state or times are not those for which the end of the run was signed");
        if (place_of(now.now) != angles_.size())
          fail("the last angle is not the one for which the end of the run was signed");
        break;
      case WitnessAct::kHead:
        fail("a statement is about a register, not about a run");
        break;
    }
  }

  void take_link(const WitnessStatement& now) {
    const std::optional<std::size_t> place = place_of(now.now);
    if (!place) return fail(fmt::format("angle {} is not the one that was signed at {}", now.k, now.utc));
    if (!place_ || place_of(now.previous) != place_ || *place != *place_ + 1)
      return fail(fmt::format("angle {} does not follow on the one that was signed before it", now.k));
    place_ = place;
    const std::size_t angle = *place - 1;
    is_signed_[angle] = true;
    double reading_time_s = 0.0;
    for (std::size_t i = angles_[angle].first; i <= angles_[angle].last; ++i)
      reading_time_s = std::max(reading_time_s, links_.dwells[i].reading_time_s);
    is_too_fast_[angle] = seconds_since_last(now) < kLeastWitnessedTime * reading_time_s;
  }

  std::vector<std::string> names(const std::vector<bool>& wanted) const {
    std::vector<std::string> names;
    for (std::size_t a = 0; a < angles_.size(); ++a) {
      const LinkedDwell& dwell = links_.dwells[angles_[a].first];
      if (wanted[a])
        names.push_back(fmt::format("{} (experiment {}, n = {})", a + 1, dwell.experiment, dwell.n));
    }
    return names;
  }
  std::vector<std::string> not_signed() const {
    std::vector<bool> wanted(is_signed_);
    wanted.flip();
    return names(wanted);
  }
  std::vector<std::string> too_fast() const { return names(is_too_fast_); }

  static std::string list(const std::vector<std::string>& names) {
    constexpr std::size_t kMost = 5;
    const std::vector<std::string> first(names.begin(), names.begin() + std::min(kMost, names.size()));
    return fmt::format("{}{}", fmt::join(first, ", "), names.size() > kMost ? " ..." : "");
  }

  std::string words() const {
    if (is_simulated_)
      return fmt::format("a run with simulated time on {}; beginning and end signed{}", bench_,
                         signer_.empty() ? "" : " by the key of " + signer_);
    const std::vector<std::string> missing = not_signed(), fast = too_fast();
    std::string words =
        fmt::format("{} of {} angles witnessed{}", angles_.size() - missing.size() - fast.size(),
                    angles_.size(), signer_.empty() ? "" : " by the key of " + signer_);
    if (!missing.empty()) words += fmt::format("; not witnessed: {}", list(missing));
    if (!fast.empty())
      words += fmt::format("; witnessed sooner than their readings can have taken: {}", list(fast));
    if (!has_ended_) words += "; the end is not witnessed";
    if (trust_.keys.empty()) words += "; the signatures were not checked, since no key is trusted";
    return words;
  }

  const RunLinks& links_;
  const Trust& trust_;
  std::vector<Angle> angles_;
  std::map<std::string, std::size_t> place_of_;  ///< Number of angles up to a link.
  std::vector<bool> is_signed_, is_too_fast_;    ///< By angle.
  std::set<std::string> seen_;
  std::vector<std::string> problems_;
  std::optional<WitnessStatement> last_;
  std::optional<std::size_t> place_;  ///< Angles up to the link that was signed last.
  std::string bench_, signer_;
  bool has_begun_ = false, has_ended_ = false, is_simulated_ = false;
};

}  // namespace

WitnessCheck check_witness(const std::filesystem::path& run, const Trust& trust) {
  const std::vector<WitnessedLine> rows = RunFile::witnessed(run);
  if (rows.empty()) {
    WitnessCheck none;
    none.words = "not witnessed";
    return none;
  }
  const RunLinks links = run_links(run);
  Comparison comparison(links, trust);
  for (const WitnessedLine& row : rows) comparison.add(row);
  return comparison.result();
}

}  // namespace abcal
