#include "sim/firmware/firmware_stream.h"

#include <algorithm>
#include <utility>

namespace abcal::sim {

FirmwareStream::FirmwareStream(std::shared_ptr<Firmware> firmware, Clock& clock, std::string name,
                               std::size_t capacity)
    : firmware_(std::move(firmware)),
      clock_(clock),
      name_(std::move(name)),
      capacity_(capacity),
      last_arrival_(clock.now()) {}

std::optional<Clock::Instant> FirmwareStream::collect(Clock::Instant now) {
  auto due = firmware_->next_due();
  // Instant by instant, so that the arrival of the last byte is known.
  for (; due && *due <= now; due = firmware_->next_due()) {
    last_arrival_ = std::max(last_arrival_, *due);
    waiting_.append(firmware_->transmit(*due), last_arrival_);
    // Trimmed by a quarter at a time: dropping each byte as it overflows would move the whole buffer every
    // time.
    const std::size_t size = waiting_.bytes.size();
    if (size > capacity_) {
      const std::size_t surplus = std::min(size, size - capacity_ + capacity_ / 4);
      waiting_.drop_front(surplus);
      dropped_ += surplus;
    }
  }
  return due;
}

void FirmwareStream::write(std::string_view bytes) {
  const std::lock_guard lock(mutex_);
  const Clock::Instant now = clock_.now();
  collect(now);  // output from before the command arrived
  firmware_->receive(bytes, now);
}

wire::ReceivedBytes FirmwareStream::read_until(Clock::Instant deadline) {
  for (;;) {
    Clock::Instant next = deadline;
    {
      const std::lock_guard lock(mutex_);
      const Clock::Instant now = clock_.now();
      const auto due = collect(now);
      if (!waiting_.bytes.empty()) return std::exchange(waiting_, {});
      if (now >= deadline) return {{}, now};
      if (due) next = std::min(deadline, *due);
    }
    clock_.sleep_until(next);
  }
}

void FirmwareStream::discard_input() {
  const std::lock_guard lock(mutex_);
  collect(clock_.now());
  waiting_ = {};
}

void FirmwareStream::power(bool on) {
  const std::lock_guard lock(mutex_);
  const Clock::Instant now = clock_.now();
  collect(now);
  waiting_ = {};
  firmware_->power(on, now);
}

std::size_t FirmwareStream::dropped_bytes() const {
  const std::lock_guard lock(mutex_);
  return dropped_;
}

}  // namespace abcal::sim
