#include "app/measure/bench/probe_ports.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <exception>
#include <nlohmann/json.hpp>
#include <thread>

#include "app/bench_file/item_identity.h"
#include "app/system/real_clock.h"

namespace abcal {

std::vector<Probed> probe_ports(
    const std::vector<std::string>& ports,
    const std::function<void(const std::string& port, const std::string& driver)>& trying) {
  std::vector<Probed> all(ports.size());
  std::vector<std::jthread> threads;
  for (std::size_t n = 0; n < ports.size(); ++n) {
    threads.emplace_back([&, n] {
      RealClock clock;
      all[n].port = ports[n];
      try {
        all[n].answer =
            probe_port(ports[n], clock, [&](const std::string& driver) { trying(ports[n], driver); });
      } catch (const std::exception& error) {
        all[n].failure = error.what();
      }
    });
  }
  threads.clear();  // Waits for them.
  return all;
}

std::vector<std::string> ports_to_ask(const std::vector<wire::PortInfo>& ports) {
  std::vector<std::string> asked;
  for (const wire::PortInfo& port : ports)
    if (port.permitted && port.holder.empty()) asked.push_back(port.path);
  return asked;
}

namespace {

/// How a bench file names the axes that were found.
std::string axes_in_words(const std::vector<std::string>& axes) {
  if (axes.empty()) return {};
  if (axes.size() == 1) return fmt::format("; axis = \"{}\" under [stage.x] or [stage.z]", axes[0]);
  const std::string two =
      fmt::format("; axis = \"{}\" under [stage.x] and axis = \"{}\" under [stage.z], or the other way round",
                  axes[0], axes[1]);
  if (axes.size() == 2) return two;
  return fmt::format("{}; the axes on this port are \"{}\"", two, fmt::join(axes, "\", \""));
}

}  // namespace

std::string in_words(const Probed& probed) {
  if (!probed.failure.empty()) return probed.failure;
  if (!probed.answer) return "no instrument that a driver recognises answered";
  if (probed.answer->driver.empty())
    return fmt::format("no driver recognises the instrument that answers \"{}\"", probed.answer->said);
  const std::string others = probed.answer->ports > 1
                                 ? fmt::format(", with {} more of its kind", probed.answer->ports - 1)
                                 : std::string();
  const ItemNames names{probed.answer->maker, probed.answer->model, probed.answer->serial_number};
  return fmt::format("{}: driver = \"{}\" under [{}]{}{}", in_words(names), probed.answer->driver,
                     probed.answer->role(), others, axes_in_words(probed.answer->axes));
}

nlohmann::ordered_json probed_json(const Probed& probed) {
  nlohmann::ordered_json object{{"port", probed.port}};
  if (!probed.failure.empty()) {
    object["failure"] = probed.failure;
  } else if (probed.answer && probed.answer->driver.empty()) {
    object["role"] = nullptr;
    object["said"] = probed.answer->said;
  } else if (probed.answer) {
    object["role"] = probed.answer->role();
    object["driver"] = probed.answer->driver;
    object["maker"] = probed.answer->maker;
    object["model"] = probed.answer->model;
    object["serial_number"] = probed.answer->serial_number;
    object["firmware"] = probed.answer->firmware;
    if (!probed.answer->axes.empty()) object["axes"] = probed.answer->axes;
  } else {
    object["role"] = nullptr;
  }
  return object;
}

nlohmann::ordered_json port_json(const wire::PortInfo& port) {
  return {{"path", port.path},
          {"by_id", port.by_id},
          {"usb", usb_name(port)},
          {"description", port.description},
          {"owner_group", port.owner_group},
          {"permitted", port.permitted},
          {"holder", port.holder}};
}

/// As a bench file names a port of USB; empty for any other.
std::string usb_name(const wire::PortInfo& port) {
  if (!port.usb_vendor || !port.usb_product) return {};
  return fmt::format("usb:{:04X}:{:04X}{}{}", *port.usb_vendor, *port.usb_product,
                     port.serial_number.empty() ? "" : ":", port.serial_number);
}

}  // namespace abcal
