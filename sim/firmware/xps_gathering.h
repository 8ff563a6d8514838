#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"

namespace abcal::sim {

/// Samples that an XPS controller takes of its axes while they move, at multiples of its servo cycle, until a
/// host reads them.
class XpsGathering {
 public:
  enum class Kind : std::uint8_t {
    kCurrentPosition,
    kSetpointPosition,
    kFollowingError,
    kCurrentVelocity,
    kSetpointVelocity
  };
  /// A quantity of an axis: "Group1.Pos.CurrentPosition".
  struct Quantity {
    std::string name;
    std::size_t axis;
    Kind kind;
  };
  /// Value of a quantity at a time that is not later than now, in degrees or degrees/s.
  using Measure = std::function<double(const Quantity&, Clock::Instant)>;

  static constexpr Clock::Duration kServoCycle = std::chrono::microseconds(125);
  static constexpr std::size_t kMostValues = 1'000'000;

  /// The kind behind the last dot of a name; absent: there is none.
  static std::optional<Kind> kind_of(std::string_view name);

  void configure(std::vector<Quantity> quantities);
  const std::vector<Quantity>& quantities() const { return quantities_; }
  std::size_t capacity() const { return quantities_.empty() ? 0 : kMostValues / quantities_.size(); }

  /// Takes `count` samples, one each `divisor` servo cycles, the first at `now`; earlier ones are dropped.
  void run(std::size_t count, unsigned divisor, Clock::Instant now);
  /// Takes the rest of a run that was stopped.
  void resume(Clock::Instant now);
  void stop() { next_.reset(); }
  void clear();
  bool running() const { return next_.has_value(); }

  /// Takes the samples that are due up to `now`.
  void sample_until(Clock::Instant now, const Measure& measure);
  /// Takes one sample.
  void take_one(Clock::Instant now, const Measure& measure);

  std::size_t size() const { return samples_.size(); }
  /// "0.5;1.25". @pre index < size()
  std::string line(std::size_t index) const;

 private:
  std::vector<Quantity> quantities_;
  std::vector<std::vector<double>> samples_;
  std::optional<Clock::Instant> next_;  ///< Time of the next sample.
  Clock::Duration period_ = kServoCycle;
  std::size_t wanted_ = 0;
};

}  // namespace abcal::sim
