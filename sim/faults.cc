#include "sim/faults.h"

#include <Random123/philox.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "drivers/instrument/instrument_error.h"

namespace abcal::sim {

const std::vector<FaultDescription>& fault_descriptions() {
  static const std::vector<FaultDescription> descriptions{
      {FaultKind::kSilence, "silence", "replies are missing", true},
      {FaultKind::kGarbage, "garbage", "random bytes precede the replies", true},
      {FaultKind::kFlippedBits, "flipped-bits", "one bit of a reply is wrong", true},
      {FaultKind::kDroppedBytes, "dropped-bytes", "one byte of a reply is missing", true},
      {FaultKind::kSplitFrame, "split-frame", "replies arrive one byte at a time", true},
      {FaultKind::kLateReply, "late-reply", "replies are late", true},
      {FaultKind::kReplacedReply, "replaced-reply", "replies are replaced by a text, e.g. a refusal", true},
      {FaultKind::kUnplug, "unplug", "the port is gone", true},
      {FaultKind::kPowerCycle, "power-cycle",
       "the port is gone and the instrument without power; it starts as at power on", true},
      {FaultKind::kStuckOutput, "stuck-output", "an output keeps its value", false},
      {FaultKind::kClippedOutput, "clipped-output", "the output clips at a small full scale", false},
      {FaultKind::kNotFinite, "not-finite", "the output is NaN", false},
      {FaultKind::kNoOutput, "no-output", "the accelerometer outputs nothing", false},
      {FaultKind::kStalledAxis, "stalled-axis", "an axis stops on its way and never reports completion",
       false},
      {FaultKind::kStopsShort, "stops-short",
       "moves end short of their target, and the controller reports success", false},
      {FaultKind::kLostReference, "lost-reference", "the controller forgets the reference of an axis", false},
      {FaultKind::kRefusedMove, "refused-move", "the controller refuses to move an axis", false},
      {FaultKind::kMissedStep, "missed-step", "an axis is at another angle, and its encoder does not show it",
       false},
      {FaultKind::kMovedAxis, "moved-axis", "an axis is at another angle, as its encoder shows", false},
      {FaultKind::kLostController, "lost-controller",
       "the controller of an axis is cut off from its daisy chain: it neither hears nor answers", false},
      {FaultKind::kChamberAlarm, "chamber-alarm", "the thermal chamber has an alarm", false},
      {FaultKind::kChamberDoor, "chamber-door", "the door of the thermal chamber is open", false},
  };
  return descriptions;
}

const FaultDescription& fault_description(std::string_view name) {
  std::vector<std::string_view> known;
  for (const FaultDescription& description : fault_descriptions()) {
    if (description.name == name) return description;
    known.push_back(description.name);
  }
  throw std::invalid_argument(
      fmt::format("fault: found \"{}\", required one of: {}", name, fmt::join(known, ", ")));
}

FaultyStream::FaultyStream(std::unique_ptr<wire::ByteStream> inner, Clock& clock,
                           std::vector<WireFault> faults, std::uint64_t seed, LinkTiming timing)
    : inner_(std::move(inner)), clock_(clock), seed_(seed), timing_(timing), last_look_(clock.now()) {
  if (timing.latency < Clock::Duration::zero() || timing.jitter < Clock::Duration::zero())
    throw std::invalid_argument("faulty stream: latency and jitter must not be negative");
  for (WireFault& fault : faults) add(std::move(fault));
}

void FaultyStream::add(WireFault fault) {
  for (const FaultDescription& description : fault_descriptions())
    if (description.kind == fault.kind && !description.on_the_wire)
      throw std::invalid_argument(
          fmt::format("faulty stream: found fault \"{}\", required: a fault of the wire, not of the world",
                      description.name));
  const std::lock_guard lock(mutex_);
  faults_.push_back(std::move(fault));
}

void FaultyStream::clear() {
  const std::lock_guard lock(mutex_);
  faults_.clear();
}

bool FaultyStream::unplugged() const {
  const std::lock_guard lock(mutex_);
  return active(FaultKind::kUnplug) != nullptr || active(FaultKind::kPowerCycle) != nullptr;
}

void FaultyStream::on_power(std::function<void(bool)> power) {
  const std::lock_guard lock(mutex_);
  power_ = std::move(power);
}

void FaultyStream::follow_power() {
  const Clock::Instant last_look = std::exchange(last_look_, clock_.now());
  const bool on = active(FaultKind::kPowerCycle) == nullptr;
  // The power may have failed and returned between two calls.
  const bool was_off = powered_ && std::any_of(faults_.begin(), faults_.end(), [&](const WireFault& fault) {
                         return fault.kind == FaultKind::kPowerCycle && fault.at && *fault.at >= last_look &&
                                fault.until && *fault.until > *fault.at && *fault.until <= last_look_;
                       });
  const bool changed = std::exchange(powered_, on) != on;
  if (!power_ || (!changed && !was_off)) return;
  held_.clear();
  if (!changed) power_(false);
  power_(on);
}

std::vector<FaultKind> FaultyStream::active() const {
  const std::lock_guard lock(mutex_);
  std::vector<FaultKind> kinds;
  for (const FaultDescription& description : fault_descriptions())
    if (active(description.kind) != nullptr) kinds.push_back(description.kind);
  return kinds;
}

std::optional<Clock::Instant> FaultyStream::next_due() const {
  const std::lock_guard lock(mutex_);
  return held_.empty() ? std::nullopt : std::optional(held_.front().due);
}

std::optional<Clock::Instant> FaultyStream::next_change() const {
  const std::lock_guard lock(mutex_);
  std::optional<Clock::Instant> due;
  for (const WireFault& fault : faults_)
    for (const auto& change : {fault.at, fault.until})
      if (change && *change > clock_.now()) due = due ? std::min(*due, *change) : *change;
  return due;
}

std::size_t FaultyStream::writes() const {
  const std::lock_guard lock(mutex_);
  return writes_;
}

const WireFault* FaultyStream::active(FaultKind kind) const {
  for (const WireFault& fault : faults_) {
    if (fault.kind != kind) continue;
    const std::size_t first = fault.at_write.value_or(0);
    if (writes_ < first || (fault.at && clock_.now() < *fault.at)) continue;
    if (fault.until && clock_.now() >= *fault.until) continue;
    if (fault.for_writes && writes_ >= first + *fault.for_writes) continue;
    return &fault;
  }
  return nullptr;
}

void FaultyStream::throw_if_unplugged() {
  follow_power();
  if (unplugged())
    throw InstrumentError(inner_->name(), Fault::kLinkLost,
                          powered_ ? "unplugged (scripted fault)" : "without power (scripted fault)");
}

std::uint64_t FaultyStream::draw() {
  r123::Philox2x64::ctr_type counter{};
  counter[0] = draws_++;
  r123::Philox2x64::key_type key{};
  key[0] = seed_;
  return r123::Philox2x64{}(counter, key)[0];
}

void FaultyStream::write(std::string_view bytes) {
  {
    const std::lock_guard lock(mutex_);
    ++writes_;
    throw_if_unplugged();
  }
  inner_->write(bytes);
}

std::string FaultyStream::distort(std::string bytes) {
  if (const WireFault* replaced = active(FaultKind::kReplacedReply)) {
    // The text is returned once for each write; other output of the instrument is dropped.
    if (replaced_for_write_ == writes_) return {};
    replaced_for_write_ = writes_;
    return replaced->text;
  }
  if (active(FaultKind::kFlippedBits) != nullptr && !bytes.empty()) {
    const std::uint64_t random = draw();
    char& victim = bytes[random % bytes.size()];
    victim = static_cast<char>(static_cast<unsigned char>(victim) ^ (1U << ((random >> 32U) % 8U)));
  }
  if (active(FaultKind::kDroppedBytes) != nullptr && !bytes.empty()) bytes.erase(draw() % bytes.size(), 1);
  if (active(FaultKind::kGarbage) != nullptr) {
    std::string garbage;
    for (std::uint64_t left = 1 + draw() % 16; left > 0; --left)
      garbage.push_back(static_cast<char>(draw() & 0xFFU));
    bytes.insert(0, garbage);
  }
  return bytes;
}

/// Keeps received bytes, with the faults in force, until they are due.
void FaultyStream::hold(std::string bytes, Clock::Instant arrival) {
  Clock::Instant due = arrival + timing_.latency;
  if (const WireFault* late = active(FaultKind::kLateReply)) due += late->delay;
  // 53 random bits: a fraction of the jitter in [0, 1).
  if (timing_.jitter > Clock::Duration::zero())
    due += from_seconds(to_seconds(timing_.jitter) * static_cast<double>(draw() >> 11U) * 0x1p-53);
  bytes = distort(std::move(bytes));
  // In order: nothing overtakes a late reply.
  if (!bytes.empty())
    held_.push_back({held_.empty() ? due : std::max(due, held_.back().due), std::move(bytes)});
}

wire::ReceivedBytes FaultyStream::read_until(Clock::Instant deadline) {
  for (;;) {
    Clock::Instant next = deadline;
    {
      const std::lock_guard lock(mutex_);
      throw_if_unplugged();
      if (!held_.empty() && held_.front().due <= clock_.now()) {
        Held& first = held_.front();
        wire::ReceivedBytes received{first.bytes.substr(0, 1), first.due};
        const bool split = active(FaultKind::kSplitFrame) != nullptr;
        if (!split) received.bytes = first.bytes;
        first.bytes.erase(0, received.bytes.size());
        if (first.bytes.empty()) held_.erase(held_.begin());
        return received;
      }
      if (!held_.empty()) next = std::min(next, held_.front().due);
      // A fault that begins while we wait must end the wait.
      for (const WireFault& fault : faults_)
        for (const auto& change : {fault.at, fault.until})
          if (change && *change > clock_.now()) next = std::min(next, *change);
    }
    const wire::ReceivedBytes received = inner_->read_until(next);
    const std::lock_guard lock(mutex_);
    throw_if_unplugged();
    if (!received.bytes.empty() && active(FaultKind::kSilence) == nullptr) {
      received.for_each_group(
          [this](std::string_view bytes, Clock::Instant arrival) { hold(std::string(bytes), arrival); });
      continue;
    }
    const bool waiting_for_held = !held_.empty() && held_.front().due <= clock_.now();
    if (received.bytes.empty() && clock_.now() >= deadline && !waiting_for_held) return {{}, clock_.now()};
    // Silence after the deadline: the inner stream may hold more, all of it to be swallowed.
  }
}

void FaultyStream::discard_input() {
  {
    const std::lock_guard lock(mutex_);
    throw_if_unplugged();
    std::erase_if(held_, [&](const Held& held) { return held.due <= clock_.now(); });
  }
  inner_->discard_input();
}

}  // namespace abcal::sim
