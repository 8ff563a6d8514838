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
#include "protocol/record/run_operator.h"

namespace abcal {
namespace {

constexpr const char* kWhat = "witness";

/// Seconds since 1970 of a time as format_utc() writes it; whole seconds are enough across a start.
double seconds_of(const std::string& utc) {
  std::tm time{};
  std::istringstream(utc) >> std::get_time(&time, "%Y-%m-%dT%H:%M:%S");
  return static_cast<double>(::timegm(&time));
}

/// Compares the statements with the run, one after the other.
class Comparison {
 public:
  Comparison(const RunLinks& links, const Trust& trust, std::vector<RunOperator> operators)
      : links_(links), trust_(trust), operators_(std::move(operators)) {
    place_of_[links.head] = 0;
    for (std::size_t k = 0; k < links.stored.size(); ++k) {
      place_of_[links.stored[k].link] = k + 1;
      angles_ += links.stored[k].angles;
    }
    is_signed_.resize(links.stored.size());
    is_too_fast_.resize(links.stored.size());
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
    check.angles = angles_;
    for (const std::string& problem : problems_) check.checks.push_back({kWhat, false, problem});
    check.words = problems_.empty() ? words() : "contradicts what the witness has signed";
    if (problems_.empty()) check.checks.push_back({kWhat, true, check.words});
    check.is_signed = problems_.empty() && !trust_.keys.empty() && has_begun_ && has_ended_;
    check.is_witnessed =
        check.is_signed && !is_simulated_ && angles_of(not_signed()) + angles_of(is_too_fast_) == 0;
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

  /// @return the number of links up to a link; nullopt if the run does not have this link
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
        if (!now.person.empty() &&
            std::ranges::find(operators_, now.person, &RunOperator::name) == operators_.end())
          fail(fmt::format("the run was begun by {}, who is not among its operators", now.person));
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
        if (place_of(now.now) != links_.stored.size())
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
    const std::size_t k = *place - 1;
    is_signed_[k] = true;
    is_too_fast_[k] = seconds_since_last(now) < kLeastWitnessedTime * links_.stored[k].reading_time_s;
  }

  /// Number of angles of the plan of the wanted links.
  std::size_t angles_of(const std::vector<bool>& wanted) const {
    std::size_t angles = 0;
    for (std::size_t k = 0; k < wanted.size(); ++k) angles += wanted[k] ? links_.stored[k].angles : 0;
    return angles;
  }

  std::vector<std::string> names(const std::vector<bool>& wanted) const {
    std::vector<std::string> names;
    for (std::size_t k = 0; k < wanted.size(); ++k) {
      const StoredTogether& stored = links_.stored[k];
      if (wanted[k])
        names.push_back(fmt::format("{} (experiment {}, n = {}{})", k + 1, stored.experiment, stored.n,
                                    stored.is_swept ? ", with its sweep" : ""));
    }
    return names;
  }
  std::vector<bool> not_signed() const {
    std::vector<bool> wanted(is_signed_);
    wanted.flip();
    return wanted;
  }

  static std::string list(const std::vector<std::string>& names) {
    constexpr std::size_t kMost = 5;
    const std::vector<std::string> first(names.begin(), names.begin() + std::min(kMost, names.size()));
    return fmt::format("{}{}", fmt::join(first, ", "), names.size() > kMost ? " ..." : "");
  }

  std::string words() const {
    if (is_simulated_)
      return fmt::format("a run with simulated time on {}; beginning and end signed{}", bench_,
                         signer_.empty() ? "" : " by the key of " + signer_);
    const std::vector<std::string> missing = names(not_signed()), fast = names(is_too_fast_);
    std::string words = fmt::format("{} of {} angles witnessed{}",
                                    angles_ - angles_of(not_signed()) - angles_of(is_too_fast_), angles_,
                                    signer_.empty() ? "" : " by the key of " + signer_);
    if (!missing.empty()) words += fmt::format("; not witnessed: {}", list(missing));
    if (!fast.empty())
      words += fmt::format("; witnessed sooner than their readings can have taken: {}", list(fast));
    if (!has_ended_) words += "; the end is not witnessed";
    if (trust_.keys.empty()) words += "; the signatures were not checked, since no key is trusted";
    return words;
  }

  const RunLinks& links_;
  const Trust& trust_;
  const std::vector<RunOperator> operators_;
  std::size_t angles_ = 0;                       ///< Number of the run's angles.
  std::map<std::string, std::size_t> place_of_;  ///< Number of links of RunLinks::stored up to a link.
  std::vector<bool> is_signed_, is_too_fast_;    ///< By link of RunLinks::stored.
  std::set<std::string> seen_;
  std::vector<std::string> problems_;
  std::optional<WitnessStatement> last_;
  std::optional<std::size_t> place_;  ///< That of the link that was signed last.
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
  Comparison comparison(links, trust, operators_of(RunFile::load(run)));
  for (const WitnessedLine& row : rows) comparison.add(row);
  return comparison.result();
}

}  // namespace abcal
