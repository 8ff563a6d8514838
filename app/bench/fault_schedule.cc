#include "app/bench/fault_schedule.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <system_error>

namespace abcal {
namespace {

const sim::FaultDescription& description_of(const std::string& name) {
  const sim::FaultKind kind = sim::fault_kind(name);
  return *std::find_if(sim::fault_descriptions().begin(), sim::fault_descriptions().end(),
                       [&](const sim::FaultDescription& d) { return d.kind == kind; });
}

std::optional<std::size_t> count(const std::optional<int>& number) {
  return number ? std::optional(static_cast<std::size_t>(*number)) : std::nullopt;
}

}  // namespace

const std::vector<std::string>& fault_instruments() {
  static const std::vector<std::string> names{"",
                                              "stage",
                                              "stage-x",
                                              "stage-z",
                                              "accelerometer",
                                              "accelerometer-u",
                                              "accelerometer-v",
                                              "accelerometer-w",
                                              "environment",
                                              "chamber"};
  return names;
}

std::optional<int> item_of_instrument(std::string_view instrument) {
  constexpr std::string_view kItem = "item-";
  if (!instrument.starts_with(kItem)) return std::nullopt;
  instrument.remove_prefix(kItem.size());
  int item = 0;
  const auto [end, error] = std::from_chars(instrument.data(), instrument.data() + instrument.size(), item);
  const std::string_view rest(end, static_cast<std::size_t>(instrument.data() + instrument.size() - end));
  const bool known = rest.empty() || rest == "-u" || rest == "-v" || rest == "-w";
  return error == std::errc{} && item > 0 && known ? std::optional(item) : std::nullopt;
}

std::vector<std::string> fault_names() {
  std::vector<std::string> names;
  for (const sim::FaultDescription& description : sim::fault_descriptions())
    names.emplace_back(description.name);
  return names;
}

std::optional<std::string> problem_of(const FaultConfig& fault) {
  if (description_of(fault.kind).on_the_wire && fault.instrument.empty())
    return fmt::format("\"{}\" without instrument: a fault of the wire needs \"stage\" or \"accelerometer\"",
                       fault.kind);
  return std::nullopt;
}

std::optional<sim::WireFault> wire_fault(const FaultConfig& fault, Clock::Instant start) {
  if (!description_of(fault.kind).on_the_wire) return std::nullopt;
  const Clock::Instant at = start + from_seconds(fault.at_s);
  return sim::WireFault{
      .kind = sim::fault_kind(fault.kind),
      .at_write = count(fault.at_write),
      .at = at,
      .until = fault.for_s ? std::optional(at + from_seconds(*fault.for_s)) : std::nullopt,
      .for_writes = count(fault.for_writes),
      .text = fault.text,
      .delay = from_seconds(fault.delay_s),
  };
}

std::optional<sim::WorldFault> world_fault(const FaultConfig& fault, Clock::Instant start) {
  if (description_of(fault.kind).on_the_wire) return std::nullopt;
  const Clock::Instant at = start + from_seconds(fault.at_s);
  return sim::WorldFault{
      .kind = sim::fault_kind(fault.kind),
      .at = at,
      .until = fault.for_s ? at + from_seconds(*fault.for_s) : Clock::Instant::max(),
      .axis = fault.axis == "z" ? StageAxis::kZ : StageAxis::kX,
      .value = fault.value,
      .output = fault.output.empty() ? -1 : fault.output.front() - 'u',
  };
}

std::vector<sim::WireFault> wire_faults(const std::vector<FaultConfig>& faults, const std::string& instrument,
                                        Clock::Instant start) {
  std::vector<sim::WireFault> found;
  for (const FaultConfig& fault : faults) {
    if (fault.instrument != instrument) continue;
    if (auto of_the_wire = wire_fault(fault, start)) found.push_back(std::move(*of_the_wire));
  }
  return found;
}

void schedule(const std::vector<FaultConfig>& faults, const std::vector<ChangeConfig>& changes,
              sim::SimBench& world, std::optional<int> item) {
  for (const FaultConfig& fault : faults) {
    const std::optional<int> whose = item_of_instrument(fault.instrument);
    if (item && whose && whose != item) continue;
    if (const auto of_the_world = world_fault(fault, world.start())) world.inject(*of_the_world);
  }
  for (const ChangeConfig& change : changes)
    world.change(change.truth, world.start() + from_seconds(change.at_s));
}

}  // namespace abcal
