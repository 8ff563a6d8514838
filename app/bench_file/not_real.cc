#include "app/bench_file/not_real.h"

#include <algorithm>
#include <string_view>

#include "app/bench_file/instrument_ports.h"
#include "sim/emulated_serial_numbers.h"

namespace abcal {
namespace {

/// Whether a bench file describes a simulated bench: its [simulation] differs from the default.
bool has_simulation(const BenchConfig& bench) {
  BenchConfig without = bench;
  without.simulation = {};
  for (BenchItemConfig& item : without.items) item.simulation = {};
  return without != bench;
}

/// Whether an instrument reported a serial number that the emulator uses.
bool reports_simulated_serial_number(const InstrumentIdentity& instrument,
                                     const std::vector<InstrumentPort>& ports) {
  return std::ranges::any_of(single_serial_numbers(instrument.serial_number), [&](const std::string& number) {
    return std::ranges::any_of(
        ports, [&](const InstrumentPort& port) { return is_emulated_serial_number(number, port.driver); });
  });
}

}  // namespace

std::vector<std::string> single_serial_numbers(std::string_view reported) {
  std::vector<std::string> single(1);
  for (const char c : reported) {
    if (c == '/' || c == '+' || c == ',') {
      single.emplace_back();
    } else if (c != ' ') {
      single.back() += c;
    }
  }
  std::erase(single, "");
  return single;
}

bool is_serial_number_reported(std::string_view reported) {
  constexpr std::string_view kSeparators = "+,";
  for (std::size_t begin = 0;;) {
    const std::size_t end = std::min(reported.find_first_of(kSeparators, begin), reported.size());
    const std::vector<std::string> part = single_serial_numbers(reported.substr(begin, end - begin));
    if (part.empty() || std::find(part.begin(), part.end(), "0") != part.end()) return false;
    if (end == reported.size()) return true;
    begin = end + 1;
  }
}

bool is_emulated_serial_number(std::string_view number, const std::string& driver) {
  return std::ranges::count(sim::emulated_serial_numbers(driver), number) > 0;
}

std::string stated_serial_number_label(const std::string& role) {
  return role + ".stated_serial_number";
}

std::string stated_serial_number_words(const std::string& serial_number) {
  return fmt::format("; serial number {} stated by the bench file, not reported by the instrument",
                     serial_number);
}

bool has_simulated_accelerometer(const BenchConfig& config) {
  return std::ranges::any_of(config.items, [](const BenchItemConfig& item) {
    return item.left_out.empty() && item.accelerometer.port == kSimulated;
  });
}

std::vector<std::string> simulated_instruments(const BenchConfig& config) {
  const auto simulated = [](const InstrumentPort& port) { return port.port == kSimulated; };
  const std::vector<InstrumentPort> stage = stage_ports(config.stage);
  const std::vector<InstrumentPort> accelerometer = all_accelerometer_ports(config);
  std::vector<std::string> list;
  if (config.stage.driver == kSimulated || std::any_of(stage.begin(), stage.end(), simulated))
    list.emplace_back("stage");
  if (has_simulated_accelerometer(config) ||
      std::any_of(accelerometer.begin(), accelerometer.end(), simulated))
    list.emplace_back("accelerometer");
  return list;
}

std::vector<std::string> instruments_not_real(const RunHeader& header, const BenchConfig& bench) {
  std::vector<std::string> list = simulated_instruments(bench);
  if (list.empty() && has_simulation(bench)) return {"stage", "accelerometer"};
  for (const char* name : {"stage", "accelerometer"}) {
    const std::vector<InstrumentPort> ports =
        std::string_view(name) == "stage" ? stage_ports(bench.stage) : all_accelerometer_ports(bench);
    const bool marked = std::any_of(
        header.instruments.begin(), header.instruments.end(), [&](const InstrumentIdentity& instrument) {
          return instrument.role.starts_with(name) && reports_simulated_serial_number(instrument, ports);
        });
    if (marked && std::find(list.begin(), list.end(), name) == list.end()) list.emplace_back(name);
  }
  return list;
}

}  // namespace abcal
