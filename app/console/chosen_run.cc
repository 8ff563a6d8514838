#include "app/console/chosen_run.h"

#include <utility>

#include "app/bench_file/instrument_ports.h"
#include "drivers/instrument/driver_catalogue.h"
#include "sim/emulated_serial_numbers.h"

namespace abcal::console {
namespace {

/// Whether the item is a simulated instrument that reports a serial number: it is then the chosen item.
bool is_simulated_item(const AccelerometerConfig& accelerometer) {
  return accelerometer.port == kSimulated &&
         !find_in(driver_catalogue().accelerometers, accelerometer.driver).traits.reads_volts &&
         !sim::emulated_serial_numbers(accelerometer.driver).empty();
}

void choose_item(ChosenRun& run, const ItemChoice& chosen) {
  BenchItemConfig& first = run.config.items.front();
  ItemConfig& item = first.item;
  const std::string model = std::exchange(item.model, chosen.model);
  item.maker = chosen.maker;
  const std::string before = std::exchange(item.serial_number, chosen.serial_number);
  if (std::string& required = first.accelerometer.serial_number; is_simulated_item(first.accelerometer))
    required = chosen.serial_number;
  else if (before != chosen.serial_number && !required.empty() && required != chosen.serial_number)
    run.warnings.push_back(
        Message("The bench file requires an accelerometer of serial number {serial}, which is another item: "
                "not required of this one.",
                std::exchange(required, "")));
  item.customer_number = chosen.customer_number;
  if (model == chosen.model) return;
  item.range = item.filter = item.firmware = item.supply = "";
  item.reference_surface = item.direction_marks = item.fasteners = item.cable = "";
  item.torque_newton_metre.reset();
  first.expected.nominal_sensitivity.reset();
  if (!model.empty())
    run.warnings.push_back(Message(
        "The bench file describes model {stated}, the item is {item}: its range, filter, firmware, supply, "
        "nominal sensitivity and how it is fastened are not stated. Check what is set on the instrument.",
        model, chosen.model.empty() ? Message("of no stated model") : Message("{model}", chosen.model)));
}

}  // namespace

ChosenRun choose_run(BenchConfig config, const RunChoice& choice) {
  ChosenRun run{std::move(config), {}};
  if (choice.item) choose_item(run, *choice.item);
  ProtocolConfig& protocol = run.config.protocol;
  if (choice.steps && *choice.steps != protocol.steps) {
    protocol.steps = *choice.steps;
    protocol.step = Angle::degrees(360.0 / protocol.steps);
  }
  if (choice.dwell_readings) protocol.dwell_readings = *choice.dwell_readings;
  if (!choice.estimator.empty()) protocol.estimator = choice.estimator;
  return run;
}

}  // namespace abcal::console
