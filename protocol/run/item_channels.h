#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "protocol/run/plausibility_check.h"
#include "protocol/run/reading_source.h"
#include "protocol/run/run_context.h"
#include "protocol/run/run_instruments.h"
#include "protocol/run/settling.h"

namespace abcal {

/// One item of a run: its accelerometer, and the state of the run for it.
struct ItemChannel {
  /// @param item_context of an accelerometer that is identified
  ItemChannel(const RunContext& item_context, int number, Accelerometer& its_accelerometer,
              std::optional<double> first_temperature_degc)
      : k(number),
        context(item_context),
        accelerometer(its_accelerometer),
        readings(context, accelerometer),
        settling(context, readings),
        plausibility(context, first_temperature_degc) {}
  ItemChannel(const ItemChannel&) = delete;
  ItemChannel& operator=(const ItemChannel&) = delete;

  int k = 1;  ///< Number in the run file.
  RunContext context;
  Accelerometer& accelerometer;
  ReadingSource readings;
  Settling settling;
  PlausibilityCheck plausibility;
  std::optional<InstrumentError> failure;  ///< Present: the item takes no further part.
};

/// The items of a run that take part in it. They settle and are read at once.
class ItemChannels {
 public:
  using Channels = std::vector<ItemChannel*>;

  /// Identifies the accelerometers. One of several that fails has failed.
  /// @param first_temperatures_degc by number of the item, of a run that continues
  ItemChannels(const RunContext& context, const RunInstruments& instruments,
               const std::map<int, double>& first_temperatures_degc);

  /// Those that have not failed, in their order.
  Channels active() const;
  bool several() const { return several_; }
  ItemChannel& first() const { return *channels_.front(); }
  ItemChannel& of(int item) const;
  std::size_t size() const { return channels_.size(); }

  /// Makes a call for each of some items that have not failed. One of several counts as failed if the others
  /// can continue without it.
  /// @throws InstrumentError that ends the run, or for which it waits: readings that cannot be true, another
  /// instrument, a port that may return
  void each(const Channels& channels, const std::function<void(ItemChannel&)>& call) const;
  void each(const std::function<void(ItemChannel&)>& call) const { each(active(), call); }

  /// Takes those that have failed out of the run. @throws InstrumentError of the first of them where none
  /// would be left
  std::vector<std::unique_ptr<ItemChannel>> take_failed();

  /// Starts the outputs again.
  void start() const;
  void stop() const noexcept;

  void wait_until_stable() const;
  void learn_noise() const;
  /// Waits until all of them are at rest. @return those that were not after quiet_timeout_s
  std::vector<const ItemChannel*> settle(const Channels& channels, Clock::Instant stopped) const;

 private:
  InstrumentError named(const ItemChannel& channel, const InstrumentError& error) const;
  void link_sources() const;

  const RunContext& context_;
  bool several_ = false;
  bool can_reconnect_ = false;
  std::vector<std::unique_ptr<ItemChannel>> channels_;
};

}  // namespace abcal
