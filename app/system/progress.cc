#include "app/system/progress.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "app/system/output.h"
#include "app/system/terminal.h"

namespace abcal {

std::string describe_duration(double seconds) {
  const auto whole = static_cast<long long>(std::llround(std::max(0.0, seconds)));
  if (whole >= 3600) return fmt::format("{} h {:02} min", whole / 3600, whole % 3600 / 60);
  if (whole >= 60) return fmt::format("{} min {:02} s", whole / 60, whole % 60);
  return fmt::format("{} s", whole);
}

ProgressBar::ProgressBar(std::string title, const Clock& clock)
    : title_(std::move(title)),
      clock_(clock),
      visible_(is_terminal(stderr)),
      started_(clock.now()),
      last_draw_(started_) {}

ProgressBar::~ProgressBar() {
  clear();
}

void ProgressBar::show(double done, double total, std::string_view words) {
  if (!(total > 0.0)) return;
  const Clock::Instant now = clock_.now();
  if (done_at_start_ < 0.0) {
    done_at_start_ = done;
    started_ = now;
  }
  constexpr Clock::Duration kRedraw = std::chrono::milliseconds(100), kLine = std::chrono::seconds(30);
  if (!visible_ && now - std::max(started_, last_draw_) < kLine) return;
  if (drawn_ && now - last_draw_ < kRedraw && done < total) return;
  last_draw_ = now;
  const double fraction = std::clamp(done / total, 0.0, 1.0);
  std::string left = "";
  if (done > done_at_start_) {
    const double per_unit = to_seconds(now - started_) / (done - done_at_start_);
    left = describe_duration(per_unit * (total - done)) + " left";
  }
  if (!visible_) {
    print_log("{}: {:.0f} %{}{}{}{}\n", title_, 100.0 * fraction, left.empty() ? "" : ", ", left,
              words.empty() ? "" : ", ", words);
    return;
  }
  drawn_ = true;
  constexpr int kCells = 24;
  const int full = static_cast<int>(std::lround(fraction * kCells));
  std::string text =
      fmt::format("{} [{}{}] {:3.0f} %  {}", title_, std::string(static_cast<std::size_t>(full), '#'),
                  std::string(static_cast<std::size_t>(kCells - full), '.'), 100.0 * fraction, left);
  if (!words.empty()) text.append("  ").append(words);
  winsize size{};
  const std::size_t width =
      ::ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 10 ? size.ws_col : 80;
  if (text.size() >= width) text.resize(width - 1);
  print_to_terminal(fmt::format("\r{}\x1b[K", printable_text(text)));
}

void ProgressBar::line(std::string_view text) {
  clear();
  print_log("{}\n", text);
}

void ProgressBar::clear() {
  if (!drawn_) return;
  print_to_terminal("\r\x1b[K");
  drawn_ = false;
}

UsualDurationBar::UsualDurationBar(std::string title, double usual_s, const Clock& clock)
    : bar_(std::move(title), clock), clock_(clock), usual_s_(usual_s), started_(clock.now()) {}

void UsualDurationBar::show() {
  constexpr double kWorthABar = 1.0, kNearTheEnd = 0.97;
  if (usual_s_ < kWorthABar) return;
  bar_.show(std::min(to_seconds(clock_.now() - started_), kNearTheEnd * usual_s_), usual_s_);
}

}  // namespace abcal
