#include "app/measure/bench/fault_schedule.h"

namespace abcal {
namespace {

std::optional<std::size_t> count(const std::optional<int>& number) {
  return number ? std::optional(static_cast<std::size_t>(*number)) : std::nullopt;
}

}  // namespace

std::optional<sim::WireFault> wire_fault(const FaultConfig& fault, Clock::Instant start) {
  if (!sim::fault_description(fault.kind).on_the_wire) return std::nullopt;
  const Clock::Instant at = start + from_seconds(fault.at_s);
  return sim::WireFault{
      .kind = sim::fault_description(fault.kind).kind,
      .at_write = count(fault.at_write),
      .at = at,
      .until = fault.for_s ? std::optional(at + from_seconds(*fault.for_s)) : std::nullopt,
      .for_writes = count(fault.for_writes),
      .text = fault.text,
      .delay = from_seconds(fault.delay_s),
  };
}

std::optional<sim::WorldFault> world_fault(const FaultConfig& fault, Clock::Instant start) {
  if (sim::fault_description(fault.kind).on_the_wire) return std::nullopt;
  const Clock::Instant at = start + from_seconds(fault.at_s);
  return sim::WorldFault{
      .kind = sim::fault_description(fault.kind).kind,
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

}  // namespace abcal
