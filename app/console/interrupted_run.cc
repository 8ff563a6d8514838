#include "app/console/interrupted_run.h"

#include <algorithm>
#include <utility>

#include "protocol/plan/faces.h"
#include "protocol/record/run_file.h"

namespace abcal::console {
namespace {

Message in_words(const PlannedAngle& angle) {
  if (angle.check) return {"check pose {n}", angle.n};
  const Message circle = circle_words(angle.experiment, angle.face);
  if (angle.closing) return {"{circle}, {alpha:g} degrees (closing angle)", circle, angle.alpha.deg()};
  return {"{circle}, {alpha:g} degrees", circle, angle.alpha.deg()};
}

std::optional<std::filesystem::path> newest_run(const std::filesystem::path& folder) {
  std::optional<std::filesystem::path> newest;
  std::filesystem::file_time_type when;
  std::error_code error;
  for (std::filesystem::directory_iterator at(folder, error), end; !error && at != end; at.increment(error)) {
    std::error_code ignored;
    if (at->path().extension() != ".run" ||
        !std::filesystem::is_regular_file(std::filesystem::symlink_status(at->path(), ignored)))
      continue;
    const auto time = at->last_write_time(ignored);
    if (newest && time <= when) continue;
    newest = at->path();
    when = time;
  }
  return newest;
}

/// The text of the last interruption. Events of persons may be stored after it: a note, a request to stop.
Message why_interrupted(const std::vector<RunEvent>& events) {
  const auto last = std::find_if(events.rbegin(), events.rend(), [](const RunEvent& event) {
    return event.kind == to_string(RunState::kInterrupted);
  });
  return last == events.rend() ? Message() : last->text;
}

}  // namespace

InterruptedRun describe_interrupted(std::string file, Message words, const std::vector<PlannedAngle>& plan,
                                    const std::set<std::size_t>& measured) {
  InterruptedRun run{std::move(file), std::move(words), measured.size(), plan.size(), {}};
  for (std::size_t position = 0; position < plan.size() && run.angle.empty(); ++position)
    if (!measured.contains(position)) run.angle = in_words(plan[position]);
  return run;
}

std::optional<InterruptedRun> find_interrupted_run(const std::filesystem::path& folder) {
  const auto path = newest_run(folder);
  if (!path) return std::nullopt;
  try {
    const StoredRun run = RunFile::load(*path);
    if (run.state != RunState::kRunning && run.state != RunState::kInterrupted) return std::nullopt;
    Message words("Its program died, or another program is measuring it now.");
    if (run.state == RunState::kInterrupted) words = why_interrupted(run.events);
    InterruptedRun interrupted =
        describe_interrupted(path->filename().string(), std::move(words), run.header.plan,
                             {run.measured.begin(), run.measured.end()});
    const auto takes_part = [](const ItemProgress& item) { return !item.dropped_at; };
    for (const RunEvent& event : run.events) {
      const bool is_new = event.kind == to_string(RunState::kInterrupted);
      if (!is_new && event.kind != kAcknowledgedEvent) continue;
      interrupted.acknowledged_by = is_new ? "" : event.text.english();
      interrupted.acknowledged_utc = is_new ? "" : event.utc;
    }
    interrupted.items = static_cast<std::size_t>(std::ranges::count_if(run.items, takes_part));
    return interrupted;
  } catch (const RunFileError&) {
    return std::nullopt;  // The list of runs reports why it cannot be read.
  }
}

void acknowledge_interrupted_run(const std::filesystem::path& run, const std::string& utc,
                                 const std::string& who) {
  RunFile::open_for_append(run).append_event(utc, kAcknowledgedEvent, Message::bare(who));
}

}  // namespace abcal::console
