#include "protocol/run/item_channels.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace abcal {
namespace {

RunContext item_context(const RunContext& run, const ItemInstrument& item, bool beside_others) {
  RunContext context(run);
  context.item = item.k;
  context.beside_others = beside_others;
  context.settings.limits = item.limits;
  context.settings.tolerances = item.tolerances;
  context.settings.expected = item.expected;
  return context;
}

}  // namespace

ItemChannels::ItemChannels(const RunContext& context, const RunInstruments& instruments,
                           const std::map<int, double>& first_temperatures_degc)
    : context_(context),
      several_(instruments.has_several_items),
      can_reconnect_(instruments.reconnector != nullptr) {
  for (const ItemInstrument& item : instruments.items) {
    RunContext own = item_context(context, item, several_);
    std::optional<InstrumentError> failure;
    try {
      own.accelerometer_info = item.accelerometer.identify();
    } catch (const InstrumentError& error) {
      if (!several_) throw;
      failure = error;
    }
    const auto first = first_temperatures_degc.find(item.k);
    channels_.push_back(std::make_unique<ItemChannel>(
        own, item.k, item.accelerometer,
        first == first_temperatures_degc.end() ? std::nullopt : std::optional(first->second)));
    channels_.back()->failure = failure;
  }
  // The fastest first: readings that the others make meanwhile wait for their turn.
  std::ranges::stable_sort(channels_, std::greater{},
                           [](const auto& channel) { return channel->context.accelerometer_info.rate_hz; });
  link_sources();
}

void ItemChannels::link_sources() const {
  for (const auto& channel : channels_) {
    std::vector<ReadingSource*> others;
    for (const auto& other : channels_)
      if (other != channel) others.push_back(&other->readings);
    channel->readings.read_beside(std::move(others));
  }
}

ItemChannels::Channels ItemChannels::active() const {
  Channels channels;
  for (const auto& channel : channels_)
    if (!channel->failure) channels.push_back(channel.get());
  return channels;
}

ItemChannel& ItemChannels::of(int item) const {
  return **std::ranges::find(channels_, item, [](const auto& channel) { return channel->k; });
}

InstrumentError ItemChannels::named(const ItemChannel& channel, const InstrumentError& error) const {
  if (!several_ || error.instrument() == channel.context.accelerometer_name()) return error;
  return {channel.context.accelerometer_name(), error.fault(),
          Message("{instrument}: {detail}", error.instrument(), error.detail())};
}

void ItemChannels::each(const Channels& channels, const std::function<void(ItemChannel&)>& call) const {
  for (ItemChannel* channel : channels) {
    if (channel->failure) continue;
    try {
      call(*channel);
    } catch (const InstrumentError& error) {
      const Fault fault = error.fault();
      const bool ends_the_run = fault == Fault::kImplausible || fault == Fault::kWrongIdentity ||
                                (fault == Fault::kLinkLost && can_reconnect_);
      if (!several_ || ends_the_run || context_.clock.stop_requested()) throw named(*channel, error);
      channel->failure = named(*channel, error);
    }
  }
}

std::vector<std::unique_ptr<ItemChannel>> ItemChannels::take_failed() {
  std::vector<std::unique_ptr<ItemChannel>> failed;
  if (active().empty()) throw InstrumentError(*channels_.front()->failure);
  const auto is_sound = [](const auto& channel) { return !channel->failure.has_value(); };
  const auto first_failed = std::stable_partition(channels_.begin(), channels_.end(), is_sound);
  std::move(first_failed, channels_.end(), std::back_inserter(failed));
  channels_.erase(first_failed, channels_.end());
  if (!failed.empty()) link_sources();
  return failed;
}

void ItemChannels::start() const {
  for (const auto& channel : channels_) channel->readings.restart();
  each([](ItemChannel& channel) { channel.accelerometer.start(); });
}

void ItemChannels::stop() const noexcept {
  for (const auto& channel : channels_) channel->accelerometer.stop();
}

void ItemChannels::wait_until_stable() const {
  if (!(context_.settings.protocol.stability_s > 0.0)) return;
  context_.journal.set_activity(Message("waiting for stable outputs and temperature"));
  context_.journal.phase(0, RunPhase::kWarmingUp);
  const Clock::Instant begin = context_.clock.now();
  each([](ItemChannel& channel) { channel.readings.discard_pending(); });
  bool stable = false;
  while (!stable) {
    stable = true;
    each([&](ItemChannel& channel) { stable = channel.settling.is_stable_since(begin) && stable; });
  }
  const Clock::Duration elapsed = context_.clock.now() - begin;
  context_.journal.notify(
      "stable", Message("outputs and temperature are stable after {seconds:.0f} s", to_seconds(elapsed)));
  context_.stopwatch.add_settling(elapsed);
}

void ItemChannels::learn_noise() const {
  each([](ItemChannel& channel) { channel.readings.discard_pending(); });
  each([](ItemChannel& channel) { channel.settling.learn_noise(); });
}

std::vector<const ItemChannel*> ItemChannels::settle(const Channels& channels, Clock::Instant stopped) const {
  Channels by_time = channels;
  std::ranges::stable_sort(
      by_time, {}, [&](const ItemChannel* channel) { return channel->settling.listens_from(stopped); });
  each(by_time, [&](ItemChannel& channel) {
    context_.clock.wait_until(channel.settling.listens_from(stopped));
    channel.readings.discard_pending();
  });
  std::vector<const ItemChannel*> restless;
  Clock::Instant begin = stopped;
  each(channels, [&](ItemChannel& channel) {
    const Settling::Rest rest = channel.settling.find_rest(stopped);
    if (!rest.quiet) restless.push_back(&channel);
    begin = std::max(begin, rest.begin);
  });
  context_.clock.wait_until(begin);
  return restless;
}

}  // namespace abcal
