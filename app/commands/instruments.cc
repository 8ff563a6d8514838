#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <optional>

#include "app/bench_file/stage_description_file.h"
#include "app/commands/commands.h"
#include "app/commands/port_listing.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "drivers/registry.h"
#include "drivers/wire/port_list.h"

namespace abcal {
namespace {

/// @param probed  absent: nothing was asked
void print_as_json(const std::vector<wire::PortInfo>& ports,
                   const std::optional<std::vector<Probed>>& probed) {
  nlohmann::ordered_json output{{"schema", "abcal.instruments/1"}};
  output["ports"] = nlohmann::ordered_json::array();
  for (const wire::PortInfo& port : ports) output["ports"].push_back(port_json(port));
  if (probed) {
    output["probed"] = nlohmann::ordered_json::array();
    for (const Probed& one : *probed) output["probed"].push_back(probed_json(one));
  }
  for (const auto& driver : stage_drivers())
    output["stage_drivers"].push_back({{"name", driver.name}, {"description", driver.description}});
  for (const ShippedDescription& described : shipped_descriptions())
    output["stage_descriptions"].push_back(described.name);
  for (const auto& driver : accelerometer_drivers())
    output["accelerometer_drivers"].push_back({{"name", driver.name}, {"description", driver.description}});
  for (const auto& driver : chamber_drivers())
    output["chamber_drivers"].push_back({{"name", driver.name}, {"description", driver.description}});
  print_result("{}\n", output.dump(2));
}

/// @param probed  absent: nothing was asked
void print_as_text(const std::vector<wire::PortInfo>& ports,
                   const std::optional<std::vector<Probed>>& probed) {
  print_result("Serial ports:\n");
  if (ports.empty()) print_result("  none\n");
  for (const wire::PortInfo& port : ports) print_result("{}", port_text(port));
  if (probed) {
    print_result("Asked:\n");
    if (probed->empty()) print_result("  no port is free and accessible to this user\n");
    for (const Probed& one : *probed) print_result("  {}: {}\n", one.port, in_words(one));
  }
  print_result("Stage drivers:\n");
  for (const auto& driver : stage_drivers()) print_result("  {:<18} {}\n", driver.name, driver.description);
  print_result(
      "Stages with driver = \"described\" and description = \"NAME\", or the path of a description:\n");
  for (const ShippedDescription& described : shipped_descriptions()) print_result("  {}\n", described.name);
  print_result("Accelerometer drivers:\n");
  for (const auto& driver : accelerometer_drivers())
    print_result("  {:<18} {}\n", driver.name, driver.description);
  print_result("Chamber drivers:\n");
  for (const auto& driver : chamber_drivers()) print_result("  {:<18} {}\n", driver.name, driver.description);
  print_result(
      "For stages and accelerometers: driver = \"simulated\" (without bytes), or port = \"simulated\" with a "
      "driver above (its bytes, in this program).\n");
}

}  // namespace

CLI::App* add_instruments(CLI::App& parent, int& exit_code) {
  struct Options {
    bool json = false, probe = false;
    std::vector<std::string> ports;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command =
      parent.add_subcommand("instruments", "List the serial ports of this machine, and the drivers");
  command->add_flag("--json", options->json, "print one JSON object");
  CLI::Option* probe_flag = command->add_flag(
      "--probe", options->probe,
      "identify the instrument on every free port; nothing moves, but streams may be stopped");
  command->add_option("--port", options->ports, "with --probe: this port only, e.g. tcp:HOST:PORT")
      ->needs(probe_flag);
  command->callback([options, &exit_code] {
    const std::vector<wire::PortInfo> ports = wire::list_ports();
    std::optional<std::vector<Probed>> probed;
    if (options->probe) {
      std::vector<std::string> asked = options->ports;
      if (asked.empty()) asked = ports_to_ask(ports);
      probed = probe_with_bar(asked);
    }
    if (options->json) {
      print_as_json(ports, probed);
    } else {
      print_as_text(ports, probed);
    }
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
