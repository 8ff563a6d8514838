#include "app/commands/terminal_listener.h"
#include "app/system/output.h"

#include <fmt/format.h>

#include <utility>

#include "app/system/terminal.h"
#include "protocol/plan/faces.h"
#include "protocol/run/run_observer.h"

namespace abcal {

void TerminalListener::on(const SessionEvent& event) {
  std::visit([this](const auto& each) { show(each); }, event);
}

void TerminalListener::begin(std::vector<PlannedAngle> plan) {
  plan_ = std::move(plan);
  measured_.clear();
  bar_ = std::make_unique<ProgressBar>(options_.title, clock_);
}

void TerminalListener::finish() {
  bar_.reset();
}

void TerminalListener::line(const std::string& text) {
  const std::string shown = emphasised(stderr, Emphasis::kWarning, text);
  if (bar_) {
    bar_->line(shown);
  } else {
    print_log("{}\n", shown);
  }
}

void TerminalListener::show(const RunBeganEvent& event) {
  if (options_.introduce && !event.resumed) {
    print_log(
        "Stage: {} {} (SN {})\nAccelerometer: {} {} (SN {}), {:g} readings/s in {}\n{} angles, about {}{}\n",
        event.stage.maker, event.stage.model, event.stage.serial_number, event.accelerometer.maker,
        event.accelerometer.model, event.accelerometer.serial_number, event.rate_hz, event.unit,
        event.plan.size(), describe_duration(event.estimated_s),
        event.simulated_time ? " of simulated time (everything is simulated)" : "");
  }
  for (const ItemSummary& item : event.items) {
    if (!options_.introduce) break;
    if (item.missing.empty()) {
      print_log("Item {}: {} (SN {}), {:g} readings/s in {}\n", item.k, item.model, item.name, item.rate_hz,
                item.unit);
    } else {
      print_log("Item {}: not there\n", item.k);
    }
  }
  begin(event.plan);
  for (const DwellDoneEvent& each : event.measured) measured_.insert(each.position);
}

void TerminalListener::show(const PhaseEvent& event) {
  if (!bar_) return;
  std::string words(to_string(event.phase));
  if (event.position < plan_.size() && event.phase != RunPhase::kHoming &&
      event.phase != RunPhase::kWarmingUp) {
    const PlannedAngle& angle = plan_[event.position];
    words += angle.experiment > 0 ? fmt::format(", {}, alpha = {:g} deg",
                                                circle_words(angle.experiment, angle.face), angle.alpha.deg())
                                  : fmt::format(", {}X = {:g} deg, Z = {:g} deg",
                                                angle.check ? fmt::format("check pose {}, ", angle.n) : "",
                                                angle.x.deg(), angle.z.deg());
  }
  bar_->show(static_cast<double>(measured_.size()), static_cast<double>(plan_.size()), words);
}

void TerminalListener::show(const DwellDoneEvent& event) {
  measured_.insert(event.position);
}

void TerminalListener::show(const ReplayComparedEvent& event) {
  print_log("Replay: {} of {} angles are exactly as recorded; {}\n", event.same, event.replayed,
            event.ended_alike
                ? "it ended as the recorded run did"
                : "it did not end as the recorded run did, which reported: " + event.recorded_end);
}

void TerminalListener::show(const FinishedEvent& event) {
  finish();
  if (event.complete || !options_.tell_what_is_kept) return;
  print_log("{} of {} angles are measured and stored in {}{}\n", event.measured, event.planned, event.file,
            options_.tell_how_to_resume ? "; continue with: abcal resume " + event.file : "");
}

}  // namespace abcal
