#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include "drivers/instrument/clock.h"

namespace abcal {

/// "1 h 05 min", "3 min 20 s", "12 s".
std::string describe_duration(double seconds);

/// A progress bar with the remaining time, on one line of a terminal; on other streams a line each 30 s.
class ProgressBar {
 public:
  /// On standard error, because standard output belongs to results.
  ProgressBar(std::string title, const Clock& clock);
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  /// `done` of `total`, with a few words on the current activity. Redraws at most ten times a second.
  void show(double done, double total, std::string_view words = {});
  /// Prints a separate line above the bar, also on a stream that is not a terminal.
  void line(std::string_view text);
  /// Removes the bar.
  void clear();

 private:
  std::string title_;
  const Clock& clock_;
  bool visible_;
  bool drawn_ = false;
  Clock::Instant started_;
  Clock::Instant last_draw_;
  double done_at_start_ = -1.0;
};

/// The bar of a job that does not report its progress, by the usual duration of such jobs.
class UsualDurationBar {
 public:
  /// @param usual_s  jobs that usually take less than 1 s get no bar
  UsualDurationBar(std::string title, double usual_s, const Clock& clock);

  /// To be called now and then. The bar stops shortly before its end where the job takes longer than usual.
  void show();

 private:
  ProgressBar bar_;
  const Clock& clock_;
  double usual_s_;
  Clock::Instant started_;
};

}  // namespace abcal
