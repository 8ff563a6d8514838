#include <fmt/format.h>

#include <exception>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "app/bench/probe.h"
#include "app/bench/real_clock.h"
#include "app/commands/commands.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/progress.h"
#include "drivers/registry.h"
#include "drivers/wire/port_list.h"

namespace abcal {
namespace {

/// What probing one port came to.
struct Probed {
  std::string port;
  std::optional<ProbeAnswer> answer;
  std::string failure;  ///< Why the port could not be asked; empty: it was.

  std::string words() const {
    if (!failure.empty()) return failure;
    if (!answer) return "no instrument that a driver recognises answered";
    if (answer->driver.empty())
      return fmt::format("no driver recognises the instrument that answers \"{}\"", answer->said);
    const std::string others =
        answer->ports > 1 ? fmt::format(", with {} more of its kind", answer->ports - 1) : std::string();
    return fmt::format("{} {}{}{}: driver = \"{}\" under [{}]{}", answer->maker, answer->model,
                       answer->serial_number.empty() ? "" : ", serial number ", answer->serial_number,
                       answer->driver, answer->stage ? "stage" : "accelerometer", others);
  }
  nlohmann::ordered_json json() const {
    nlohmann::ordered_json object{{"port", port}};
    if (!failure.empty()) {
      object["failure"] = failure;
    } else if (answer && answer->driver.empty()) {
      object["role"] = nullptr;
      object["said"] = answer->said;
    } else if (answer) {
      object["role"] = answer->stage ? "stage" : "accelerometer";
      object["driver"] = answer->driver;
      object["maker"] = answer->maker;
      object["model"] = answer->model;
      object["serial_number"] = answer->serial_number;
      object["firmware"] = answer->firmware;
    } else {
      object["role"] = nullptr;
    }
    return object;
  }
};

/// All ports at once, each in a thread of its own.
std::vector<Probed> probe(const std::vector<std::string>& ports) {
  RealClock bar_clock;
  ProgressBar bar("Asking", bar_clock);
  std::mutex bar_mutex;
  std::size_t asked = 0;
  const auto drivers = static_cast<double>(stage_drivers().size() + accelerometer_drivers().size());
  std::vector<Probed> all(ports.size());
  {
    std::vector<std::jthread> threads;
    for (std::size_t n = 0; n < ports.size(); ++n) {
      threads.emplace_back([&, n] {
        RealClock clock;
        all[n].port = ports[n];
        try {
          all[n].answer = probe_port(ports[n], clock, [&](const std::string& driver) {
            const std::lock_guard lock(bar_mutex);
            bar.show(static_cast<double>(asked++), static_cast<double>(ports.size()) * drivers,
                     ports[n] + " for " + driver);
          });
        } catch (const std::exception& error) {
          all[n].failure = error.what();
        }
      });
    }
  }
  bar.clear();
  return all;
}

/// As a bench file names a port of USB; empty for any other.
std::string usb_name(const wire::PortInfo& port) {
  if (!port.usb_vendor || !port.usb_product) return {};
  return fmt::format("usb:{:04X}:{:04X}{}{}", *port.usb_vendor, *port.usb_product,
                     port.serial_number.empty() ? "" : ":", port.serial_number);
}

/// @param probed  absent: nothing was asked
void print_as_json(const std::vector<wire::PortInfo>& ports,
                   const std::optional<std::vector<Probed>>& probed) {
  nlohmann::ordered_json output{{"schema", "abcal.instruments/1"}};
  output["ports"] = nlohmann::ordered_json::array();
  for (const wire::PortInfo& port : ports) {
    output["ports"].push_back({{"path", port.path},
                               {"by_id", port.by_id},
                               {"usb", usb_name(port)},
                               {"description", port.description},
                               {"owner_group", port.owner_group},
                               {"permitted", port.permitted},
                               {"holder", port.holder}});
  }
  if (probed) {
    output["probed"] = nlohmann::ordered_json::array();
    for (const Probed& one : *probed) output["probed"].push_back(one.json());
  }
  for (const auto& driver : stage_drivers())
    output["stage_drivers"].push_back({{"name", driver.name}, {"description", driver.description}});
  for (const auto& driver : accelerometer_drivers())
    output["accelerometer_drivers"].push_back({{"name", driver.name}, {"description", driver.description}});
  print_result("{}\n", output.dump(2));
}

void print_port(const wire::PortInfo& port) {
  print_result("  {}  {}\n", port.path, port.description);
  if (const std::string id = usb_name(port); !id.empty()) print_result("    port = \"{}\"\n", id);
  if (!port.by_id.empty()) print_result("    {}\n", port.by_id);
  if (!port.permitted) {
    print_result("    not permitted for this user: sudo usermod -aG {} $USER, then log in again\n",
                 port.owner_group.empty() ? "dialout" : port.owner_group);
  }
  if (!port.holder.empty()) print_result("    in use by {}\n", port.holder);
  if (port.latency_timer_ms && *port.latency_timer_ms > 2) {
    print_result(
        "    its adapter delays short replies by {} ms; `setserial {} low_latency` reduces this to 1 ms\n",
        *port.latency_timer_ms, port.path);
  }
}

/// @param probed  absent: nothing was asked
void print_as_text(const std::vector<wire::PortInfo>& ports,
                   const std::optional<std::vector<Probed>>& probed) {
  print_result("Serial ports:\n");
  if (ports.empty()) print_result("  none\n");
  for (const wire::PortInfo& port : ports) print_port(port);
  if (probed) {
    print_result("Asked:\n");
    if (probed->empty()) print_result("  no port is free and accessible to this user\n");
    for (const Probed& one : *probed) print_result("  {}: {}\n", one.port, one.words());
  }
  print_result("Stage drivers:\n");
  for (const auto& driver : stage_drivers()) print_result("  {:<18} {}\n", driver.name, driver.description);
  print_result("Accelerometer drivers:\n");
  for (const auto& driver : accelerometer_drivers())
    print_result("  {:<18} {}\n", driver.name, driver.description);
  print_result(
      "For both: driver = \"simulated\" (without bytes), or port = \"simulated\" with a driver above (its "
      "bytes, in this program).\n");
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
      if (asked.empty()) {
        for (const wire::PortInfo& port : ports)
          if (port.permitted && port.holder.empty()) asked.push_back(port.path);
      }
      probed = probe(asked);
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
