#include "app/witness/witness_log.h"

#include <fmt/format.h>

#include <chrono>
#include <string_view>
#include <utility>

#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"
#include "protocol/record/signature.h"

namespace abcal {
namespace {

constexpr const char* kTable = R"(
create table answer(
  counter integer primary key, run text not null, act text not null, k integer not null, line text not null,
  signature blob not null);
create unique index answer_of_run on answer(run, act, k);)";

/// The columns by which a line is found, and which no two lines have in common.
struct Place {
  std::string run;
  std::string act;
  std::int64_t k = 0;

  bool operator==(const Place&) const = default;
};

Place place_of(const WitnessRequest& request) {
  const std::string act(to_string(request.what));
  if (request.what == WitnessAct::kHead) return {request.register_identity, act, request.entries};
  return {request.run, act, request.what == WitnessAct::kLink ? request.k : 0};
}

template <class... Values>
[[noreturn]] void refuse_request(fmt::format_string<Values...> words, const Values&... values) {
  throw WitnessRefusal(fmt::vformat(words, fmt::make_format_args(values...)));
}

/// Longest wait for another program that writes the log.
constexpr auto kPatience = std::chrono::seconds(10);

/// The request without what the witness has added.
const WitnessRequest& request_of(const WitnessStatement& statement) {
  return statement;
}

}  // namespace

WitnessLog::WitnessLog(const std::filesystem::path& path, std::string private_pem,
                       std::function<WitnessMoment()> now)
    : file_(path.string()),
      private_pem_(std::move(private_pem)),
      public_pem_(public_key_of(private_pem_)),
      now_(std::move(now)),
      database_(path, SqliteDatabase::Mode::kCreate) {
  database_.wait_at_most(kPatience);
  database_.use_write_ahead_log();  // Two programs may make a log at the same time.
  database_.execute("pragma synchronous=full");
  {
    Transaction transaction(database_);
    if (!database_.has_table("answer")) database_.execute(kTable);
    transaction.commit();
  }
  SqliteStatement last =
      database_.prepare("select line, signature from answer order by counter desc limit 1");
  if (last.step() && !is_witnessed_by({last.text(0), last.blob(1)}, public_pem_))
    throw std::invalid_argument(fmt::format(
        "{}: its last line is not signed by the key with the fingerprint {}; required: the key of this log, "
        "or another log",
        file_, fingerprint_of(public_pem_)));
}

WitnessedLine WitnessLog::answer(const WitnessRequest& request, std::uint32_t uid) {
  try {
    require_valid(request);
  } catch (const std::invalid_argument& problem) {
    throw WitnessRefusal(problem.what());
  }
  Transaction transaction(database_);
  // A head that was signed once is refused when a later one has followed: the register was put back.
  if (request.what == WitnessAct::kHead) require_not_put_back(request);
  Place place = place_of(request);
  if (request.what == WitnessAct::kBegin) place.k = begins_of(request.run);
  const bool goes_on = request.what == WitnessAct::kBegin && place.k > 0;
  std::optional<WitnessedLine> stored =
      goes_on ? fetch_latest(request.run, request.what) : fetch(place.run, request.what, place.k);
  if (stored) {
    const WitnessStatement before = parse_witness_line(stored->line);
    if (request_of(before) == request) return *std::move(stored);
    // A run continues after angles that were not signed: its statements show the gap.
    const bool is_gap = goes_on && before.simulated == request.simulated && before.bench == request.bench &&
                        !latest(request.run, WitnessAct::kClose);
    if (!is_gap)
      refuse_request("found {}; the witness has signed {} already; required: the same again, or nothing",
                     to_json(request), stored->line);
  }
  if (request.what == WitnessAct::kLink) require_next_link(request);
  if (request.what == WitnessAct::kClose) require_last_link(request);
  WitnessedLine line = add(request, place.k, uid);
  transaction.commit();
  return line;
}

/// The beginning of a run that is not closed yet.
WitnessStatement WitnessLog::begin_of(const std::string& run) {
  const std::optional<WitnessStatement> begin = latest(run, WitnessAct::kBegin);
  if (!begin)
    refuse_request("run {}: found no beginning; required: a run that was begun before this witness", run);
  if (const std::optional<WitnessStatement> close = latest(run, WitnessAct::kClose))
    refuse_request("run {}: found closed at {} with {} dwells; required: a run that is not closed", run,
                   close->utc, close->k);
  return *begin;
}

/// Number and link of the last dwell that was signed; 0 and the head: none.
WitnessLog::LastLink WitnessLog::last_link(const WitnessStatement& begin) {
  const std::optional<WitnessStatement> link = latest(begin.run, WitnessAct::kLink);
  if (link && link->counter > begin.counter) return {link->k, link->now};
  return {link ? link->k : 0, begin.head};
}

void WitnessLog::require_next_link(const WitnessRequest& request) {
  const WitnessStatement begin = begin_of(request.run);
  if (begin.simulated)
    refuse_request("run {}: found a link of a simulated run; required: only its beginning and its end",
                   request.run);
  const LastLink last = last_link(begin);
  if (request.k != last.k + 1)
    refuse_request("run {}: found dwell {}; required: dwell {}, the next one", request.run, request.k,
                   last.k + 1);
  if (request.previous != last.link)
    refuse_request("run {}, dwell {}: found the link before {}; required: {}, as it was signed", request.run,
                   request.k, request.previous, last.link);
}

void WitnessLog::require_last_link(const WitnessRequest& request) {
  const WitnessStatement begin = begin_of(request.run);
  if (begin.simulated) return;
  const LastLink last = last_link(begin);
  if (request.k != last.k || request.now != last.link)
    refuse_request(
        "run {}: found an end with {} dwells and the last link {}; required: {} dwells and {}, as they were "
        "signed",
        request.run, request.k, request.now, last.k, last.link);
}

void WitnessLog::require_not_put_back(const WitnessRequest& request) {
  const std::optional<WitnessStatement> last = latest(request.register_identity, WitnessAct::kHead);
  if (last && request.entries < last->entries)
    refuse_request(
        "register {}: found {} entries with the head {}; required: at least the {} entries with the head {} "
        "that were signed at {}: the register has lost entries or was put back",
        request.register_identity, request.entries, request.head, last->entries, last->head, last->utc);
}

/// Number of signed beginnings of a run: more than one if it continued after angles that were not signed.
std::int64_t WitnessLog::begins_of(const std::string& run) {
  SqliteStatement row = database_.prepare("select count(*) from answer where run = ? and act = 'begin'");
  row.bind(1, std::string_view(run));
  return row.step() ? row.integer(0) : 0;
}

WitnessedLine WitnessLog::add(const WitnessRequest& request, std::int64_t k, std::uint32_t uid) {
  WitnessStatement statement;
  static_cast<WitnessRequest&>(statement) = request;
  SqliteStatement last = database_.prepare("select counter, line from answer order by counter desc limit 1");
  if (last.step()) {
    statement.counter = last.integer(0);
    statement.before = sha256_of(last.text(1));
  }
  ++statement.counter;
  const WitnessMoment now = now_();
  statement.utc = format_utc(now.utc);
  statement.boot_id = now.boot_id;
  statement.since_boot_ns = now.since_boot.count();
  statement.uid = uid;
  WitnessedLine line{to_line(statement), {}};
  line.signature = sign(line.line, private_pem_);
  const Place place = place_of(request);
  SqliteStatement insert = database_.prepare("insert into answer values(?, ?, ?, ?, ?, ?)");
  insert.bind(1, statement.counter).bind(2, std::string_view(place.run)).bind(3, std::string_view(place.act));
  insert.bind(4, k).bind(5, std::string_view(line.line)).bind_blob(6, line.signature).run();
  return line;
}

std::optional<WitnessedLine> WitnessLog::fetch(const std::string& run, WitnessAct act, std::int64_t k) {
  SqliteStatement row =
      database_.prepare("select line, signature from answer where run = ? and act = ? and k = ?");
  row.bind(1, std::string_view(run)).bind(2, to_string(act)).bind(3, k);
  if (!row.step()) return std::nullopt;
  return WitnessedLine{row.text(0), row.blob(1)};
}

std::optional<WitnessedLine> WitnessLog::fetch_latest(const std::string& run, WitnessAct act) {
  SqliteStatement row = database_.prepare(
      "select line, signature from answer where run = ? and act = ? order by k desc limit 1");
  row.bind(1, std::string_view(run)).bind(2, to_string(act));
  if (!row.step()) return std::nullopt;
  return WitnessedLine{row.text(0), row.blob(1)};
}

std::optional<WitnessStatement> WitnessLog::latest(const std::string& run, WitnessAct act) {
  const std::optional<WitnessedLine> line = fetch_latest(run, act);
  if (!line) return std::nullopt;
  return parse_witness_line(line->line);
}

std::vector<std::string> WitnessLog::verify() {
  std::vector<std::string> findings;
  SqliteStatement rows =
      database_.prepare("select counter, run, act, k, line, signature from answer order by counter");
  std::int64_t expected = 1;
  std::string hash_before;
  std::optional<WitnessStatement> before;
  for (; rows.step(); ++expected) {
    const std::int64_t counter = rows.integer(0);
    const WitnessedLine witnessed{rows.text(4), rows.blob(5)};
    const auto find = [&](const std::string& words) {
      findings.push_back(fmt::format("line {}: {}", counter, words));
    };
    if (counter != expected) find(fmt::format("line {} is missing before it", expected));
    expected = counter;
    if (!is_witnessed_by(witnessed, public_pem_)) find("its signature is not of this line by this key");
    try {
      const WitnessStatement statement = parse_witness_line(witnessed.line);
      const Place place{rows.text(1), rows.text(2), rows.integer(3)};
      if (statement.counter != counter) find(fmt::format("it has the number {}", statement.counter));
      if (statement.before != hash_before) find("it does not name the line before it");
      Place expected_place = place_of(statement);
      if (statement.what == WitnessAct::kBegin) expected_place.k = place.k;  // The number of the beginning.
      if (place != expected_place)
        find(fmt::format("it stands under run {}, {} {}", place.run, place.act, place.k));
      if (before && statement.utc < before->utc)
        find(fmt::format("its time {} is before that of line {}, {}: the clock was set back", statement.utc,
                         before->counter, before->utc));
      if (before && statement.boot_id == before->boot_id && statement.since_boot_ns < before->since_boot_ns)
        find(fmt::format("less time has passed since the start of the computer than at line {}",
                         before->counter));
      before = statement;
    } catch (const std::invalid_argument& problem) {
      find(problem.what());
    }
    hash_before = sha256_of(witnessed.line);
  }
  return findings;
}

std::int64_t WitnessLog::size() {
  return std::stoll(database_.value("select count(*) from answer").value_or("0"));
}

}  // namespace abcal
