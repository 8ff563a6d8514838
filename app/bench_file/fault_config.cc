#include "app/bench_file/fault_config.h"

#include <fmt/format.h>

#include <charconv>
#include <system_error>

#include "sim/fault_kinds.h"

namespace abcal {

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
  if (sim::fault_description(fault.kind).on_the_wire && fault.instrument.empty())
    return fmt::format("\"{}\" without instrument: a fault of the wire needs \"stage\" or \"accelerometer\"",
                       fault.kind);
  return std::nullopt;
}

}  // namespace abcal
