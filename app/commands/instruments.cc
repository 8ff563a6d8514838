#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "app/commands/commands.h"
#include "app/exit_code.h"
#include "drivers/registry.h"
#include "drivers/wire/port_list.h"

namespace abcal {

CLI::App* add_instruments(CLI::App& parent, int& exit_code) {
  auto json = std::make_shared<bool>(false);
  CLI::App* command =
      parent.add_subcommand("instruments", "List the serial ports of this machine, and the drivers");
  command->add_flag("--json", *json, "print one JSON object");
  command->callback([json, &exit_code] {
    const std::vector<wire::PortInfo> ports = wire::list_ports();
    const auto usb = [](const wire::PortInfo& port) {
      return port.usb_vendor && port.usb_product
                 ? fmt::format("usb:{:04X}:{:04X}{}{}", *port.usb_vendor, *port.usb_product,
                               port.serial_number.empty() ? "" : ":", port.serial_number)
                 : std::string();
    };
    if (*json) {
      nlohmann::ordered_json output{{"schema", "abcal.instruments/1"}};
      output["ports"] = nlohmann::ordered_json::array();
      for (const wire::PortInfo& port : ports) {
        output["ports"].push_back({{"path", port.path},
                                   {"by_id", port.by_id},
                                   {"usb", usb(port)},
                                   {"description", port.description},
                                   {"owner_group", port.owner_group},
                                   {"permitted", port.permitted},
                                   {"holder", port.holder}});
      }
      for (const auto& driver : stage_drivers())
        output["stage_drivers"].push_back({{"name", driver.name}, {"description", driver.description}});
      for (const auto& driver : accelerometer_drivers())
        output["accelerometer_drivers"].push_back(
            {{"name", driver.name}, {"description", driver.description}});
      fmt::print("{}\n", output.dump(2));
    } else {
      fmt::print("Serial ports:\n");
      if (ports.empty()) fmt::print("  none\n");
      for (const wire::PortInfo& port : ports) {
        fmt::print("  {}  {}\n", port.path, port.description);
        if (const std::string id = usb(port); !id.empty()) fmt::print("    port = \"{}\"\n", id);
        if (!port.by_id.empty()) fmt::print("    {}\n", port.by_id);
        if (!port.permitted) {
          fmt::print("    not permitted for this user: sudo usermod -aG {} $USER, then log in again\n",
                     port.owner_group.empty() ? "dialout" : port.owner_group);
        }
        if (!port.holder.empty()) fmt::print("    in use by {}\n", port.holder);
        if (port.latency_timer_ms && *port.latency_timer_ms > 2) {
          fmt::print(
              "    its adapter waits {} ms before it passes a short reply on; setserial {} low_latency makes "
              "it 1 ms\n",
              *port.latency_timer_ms, port.path);
        }
      }
      fmt::print("Stage drivers:\n");
      for (const auto& driver : stage_drivers()) fmt::print("  {:<18} {}\n", driver.name, driver.description);
      fmt::print("Accelerometer drivers:\n");
      for (const auto& driver : accelerometer_drivers())
        fmt::print("  {:<18} {}\n", driver.name, driver.description);
      fmt::print(
          "Both: \"simulated\" as driver (no bytes), or as the port of a driver above (its bytes, in this "
          "program).\n");
    }
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
