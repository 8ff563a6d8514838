#include "app/console/queue.h"

#include <fmt/format.h>

#include <algorithm>
#include <fstream>
#include <utility>

#include "app/console/live_view.h"
#include "app/console/request.h"
#include "app/document/json_text.h"
#include "app/system/output_file.h"
#include "protocol/record/message_json.h"

namespace abcal::console {
namespace {

using QueueJson = nlohmann::ordered_json;

constexpr const char* kSchema = "abcal.queue/1";
constexpr Term kNoEntry = "there is no such entry in the queue";

QueueJson entry_json(const QueueEntry& entry) {
  return {{"number", entry.number},
          {"choice", to_json(entry.choice)},
          {"wanted", entry.wanted},
          {"made", entry.made},
          {"now", entry.now},
          {"problem", entry.problem.english()},
          {"messages", messages_json({entry.problem})},
          {"interrupted", entry.interrupted}};
}

QueueEntry entry_of(const nlohmann::json& json) {
  QueueEntry entry;
  entry.number = json.at("number").get<std::int64_t>();
  entry.choice = parse_run_choice(json.at("choice"));
  if (!entry.choice.item) throw RequestError("an entry without an item");
  entry.wanted = json.at("wanted").get<int>();
  entry.made = json.at("made").get<std::vector<std::string>>();
  entry.now = json.at("now").get<std::string>();
  entry.problem = Message::bare(json.at("problem").get<std::string>());
  for (const nlohmann::json& each : json.value("messages", nlohmann::json::array()))
    if (const Message message = message_from_json(each); message == entry.problem.english())
      entry.problem = message;
  entry.interrupted = json.at("interrupted").get<std::string>();
  return entry;
}

}  // namespace

Queue::Queue(std::filesystem::path file) : file_(std::move(file)) {
  read();
}

void Queue::read() {
  std::error_code ignored;
  if (!std::filesystem::exists(file_, ignored)) return;
  try {
    std::ifstream stream(file_);
    const auto json = nlohmann::json::parse(stream);
    if (json.at("schema") != kSchema)
      throw RequestError(fmt::format("schema {}; required: {}", json.at("schema").dump(), kSchema));
    for (const nlohmann::json& each : json.at("entries")) entries_.push_back(entry_of(each));
    last_number_ = json.at("last_number").get<std::int64_t>();
  } catch (const std::exception& error) {
    entries_.clear();
    problem_ = Message("The queue cannot be read from {file}: {why}. Remove the file, or put it right.",
                       file_.string(), message_of(error));
  }
  for (QueueEntry& entry : entries_)
    if (const std::string run = std::exchange(entry.now, ""); !run.empty()) {
      entry.problem = Message("the program ended during run {run}, which can be resumed", run);
      entry.interrupted = run;
    }
}

Queue::Refusal Queue::keep() {
  if (!problem_.empty()) return problem_;
  QueueJson list = QueueJson::array();
  for (const QueueEntry& entry : entries_) list.push_back(entry_json(entry));
  const QueueJson json = {{"schema", kSchema}, {"last_number", last_number_}, {"entries", std::move(list)}};
  try {
    OutputFile(file_).write(json_text(json, 1) + "\n");
  } catch (const std::runtime_error& error) {
    return Message("the queue cannot be kept: {why}", message_of(error));
  }
  return std::nullopt;
}

QueueEntry* Queue::find(std::int64_t number) {
  const auto found = std::find_if(entries_.begin(), entries_.end(),
                                  [&](const QueueEntry& entry) { return entry.number == number; });
  return found == entries_.end() ? nullptr : &*found;
}

std::vector<QueueEntry>::const_iterator Queue::waiting() const {
  return std::find_if(entries_.begin(), entries_.end(),
                      [](const QueueEntry& entry) { return !entry.is_done() && entry.now.empty(); });
}

const QueueEntry* Queue::next() const {
  const auto found = waiting();
  return found == entries_.end() ? nullptr : &*found;
}

const QueueEntry* Queue::running() const {
  const auto found = std::find_if(entries_.begin(), entries_.end(),
                                  [](const QueueEntry& entry) { return !entry.now.empty(); });
  return found == entries_.end() ? nullptr : &*found;
}

Queue::Refusal Queue::add(const RunChoice& choice, int wanted) {
  if (entries_.size() >= kMostEntries)
    return Message("the queue has {entries} entries already; remove those that are done", entries_.size());
  QueueEntry entry;
  entry.number = ++last_number_;
  entry.choice = choice;
  entry.choice.bench_sha256 = entry.choice.form = "";  // Outdated by the time of the start.
  entry.wanted = wanted;
  entries_.push_back(std::move(entry));
  Refusal refusal = keep();
  if (refusal) entries_.pop_back();
  return refusal;
}

Queue::Refusal Queue::move(std::int64_t number, int by) {
  QueueEntry* const entry = find(number);
  if (entry == nullptr) return kNoEntry;
  const auto can_move = [](const QueueEntry& one) { return !one.is_done() && one.now.empty(); };
  if (!can_move(*entry)) return Message("what is done or in progress stays where it is");
  auto at = entry - entries_.data();
  const auto step = by < 0 ? -1 : 1;
  for (int left = std::abs(by); left > 0; --left) {
    const auto to = at + step;
    if (to < 0 || to >= static_cast<std::ptrdiff_t>(entries_.size()) ||
        !can_move(entries_[static_cast<std::size_t>(to)]))
      break;
    std::swap(entries_[static_cast<std::size_t>(at)], entries_[static_cast<std::size_t>(to)]);
    at = to;
  }
  return keep();
}

Queue::Refusal Queue::remove(std::int64_t number) {
  const QueueEntry* const entry = find(number);
  if (entry == nullptr) return kNoEntry;
  if (!entry->now.empty()) return Message("it is being measured; stop it first");
  entries_.erase(entries_.begin() + (entry - entries_.data()));
  return keep();
}

Queue::Refusal Queue::repeat(std::int64_t number) {
  QueueEntry* const entry = find(number);
  if (entry == nullptr) return kNoEntry;
  if (entry->is_done()) return add(RunChoice(entry->choice), 1);
  if (entry->wanted >= kMostRuns) return Message("at most {most} runs of one entry", kMostRuns);
  ++entry->wanted;
  return keep();
}

Queue::Refusal Queue::pause(bool paused) {
  if (!paused && !problem_.empty()) return problem_;
  paused_ = paused;
  if (paused) mounted_ = 0;
  return std::nullopt;
}

void Queue::checked(std::int64_t of, ItemCheck check) {
  check_ = Checked{of, std::move(check)};
}

Queue::Refusal Queue::may_check(std::int64_t number) const {
  if (paused_) return Message("the queue is paused; let it go on first");
  const QueueEntry* const entry = next();
  if (entry == nullptr || entry->number != number) return Message("this entry is not the next of the queue");
  return std::nullopt;
}

Queue::Refusal Queue::may_start(std::int64_t number) const {
  if (Refusal refusal = may_check(number)) return refusal;
  if (!check_ || check_->of != number)
    return Message("nobody has checked that its item is mounted; check it first");
  if (!check_->check.passed())
    return Message("the check of the mounted item found a problem; check it again");
  return std::nullopt;
}

void Queue::began(std::int64_t number, const std::string& run) {
  QueueEntry* const entry = find(number);
  if (entry == nullptr) return;
  entry->now = run;
  entry->problem = {};
  entry->interrupted.clear();
  before_.serial_number = entry->choice.item->serial_number;
  if (check_ && check_->of == number) before_.reported = check_->check.reported;
  unchecked();
  (void)keep();  // A failure to store it is reported at the next change.
}

bool Queue::ended(const std::string& run, bool complete, const Message& words) {
  const auto found = std::find_if(entries_.begin(), entries_.end(), [&](const QueueEntry& entry) {
    return !run.empty() && (entry.now == run || entry.interrupted == run);
  });
  if (found == entries_.end()) return false;
  QueueEntry& entry = *found;
  const bool was_on = std::exchange(entry.now, "") == run;
  if (complete) {
    entry.made.push_back(run);
    entry.problem = {};
    entry.interrupted.clear();
    mounted_ = was_on && !paused_ ? entry.number : 0;
  } else {
    entry.problem = words;
    entry.interrupted = run;
    paused_ = true;  // A person has to look first.
    mounted_ = 0;
  }
  (void)keep();
  return true;
}

void Queue::did_not_begin(std::int64_t number) {
  paused_ = true;
  if (QueueEntry* const entry = find(number))
    entry->problem = Message("its run did not begin; the log says why");
  (void)keep();
}

const QueueEntry* Queue::repeats() const {
  const QueueEntry* const entry = next();
  return paused_ || entry == nullptr || entry->number != mounted_ ? nullptr : entry;
}

QueueJson Queue::json() const {
  QueueJson json = {{"paused", paused_},
                    {"problem", problem_.english()},
                    {"messages", messages_json({problem_})},
                    {"next", nullptr},
                    {"check", nullptr}};
  if (const QueueEntry* const entry = next()) json["next"] = entry->number;
  if (check_) {
    json["check"] = {{"of", check_->of},
                     {"passed", check_->check.passed()},
                     {"findings", findings_json(check_->check.findings)}};
  }
  json["entries"] = QueueJson::array();
  for (const QueueEntry& entry : entries_) json["entries"].push_back(entry_json(entry));
  return json;
}

}  // namespace abcal::console
