#include "app/commands/port_listing.h"

#include <fmt/format.h>

#include <mutex>

#include "app/system/progress.h"
#include "app/system/real_clock.h"
#include "drivers/registry.h"
#include "protocol/record/run_interrupted.h"

namespace abcal {

std::vector<Probed> probe_with_bar(const std::vector<std::string>& ports, const std::stop_token& stop) {
  RealClock bar_clock;
  ProgressBar bar("Asking", bar_clock);
  std::mutex bar_mutex;
  std::size_t asked = 0;
  const auto drivers =
      static_cast<double>(stage_drivers().size() + accelerometer_drivers().size() + chamber_drivers().size());
  std::vector<Probed> all = probe_ports(ports, [&](const std::string& port, const std::string& driver) {
    if (stop.stop_requested())
      throw RunInterrupted(Message("{port}: not asked to the end: interrupted", port));
    const std::lock_guard lock(bar_mutex);
    bar.show(static_cast<double>(asked++), static_cast<double>(ports.size()) * drivers,
             port + " for " + driver);
  });
  bar.clear();
  return all;
}

std::string port_text(const wire::PortInfo& port) {
  std::string text = fmt::format("  {}  {}\n", port.path, port.description);
  if (const std::string id = usb_name(port); !id.empty()) text += fmt::format("    port = \"{}\"\n", id);
  if (!port.by_id.empty()) text += fmt::format("    {}\n", port.by_id);
  if (!port.permitted)
    text += fmt::format("    not permitted for this user: sudo usermod -aG {} $USER, then log in again\n",
                        port.owner_group.empty() ? "dialout" : port.owner_group);
  if (!port.holder.empty()) text += fmt::format("    in use by {}\n", port.holder);
  if (port.latency_timer_ms && *port.latency_timer_ms > 2)
    text += fmt::format(
        "    its adapter delays short replies by {} ms; `setserial {} low_latency` reduces this to 1 ms\n",
        *port.latency_timer_ms, port.path);
  return text;
}

}  // namespace abcal
