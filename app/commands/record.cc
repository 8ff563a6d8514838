#include <fmt/format.h>

#include <memory>

#include "app/commands/commands.h"
#include "app/measure/emulator/listening_port.h"
#include "app/measure/emulator/relay.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/real_clock.h"
#include "drivers/wire/open_stream.h"
#include "protocol/record/run_file.h"
#include "sim/emulator.h"

namespace abcal {
namespace {

struct RecordCommand {
  std::string port;
  std::string serve;
  std::string output;
  unsigned baud = 115200;
};

void record(const RecordCommand& command) {
  RealClock clock;
  auto instrument = wire::open_stream(command.port, {.path = {}, .baud = command.baud}, clock);
  const std::stop_token stop = interrupt_token();
  WireLogWriter log(command.output, command.port, format_utc(clock.utc_now()));
  const auto relay = std::make_shared<Relay>(std::move(instrument), log, clock.now());
  sim::Endpoint endpoint{relay, sim::PtyLink{command.serve}};
  if (command.serve.starts_with("tcp:")) endpoint.where = listening_port(command.serve);
  sim::Emulator emulator({std::move(endpoint)}, clock);
  print_result("{} is served on {}; every byte goes to {}\n", command.port, emulator.addresses().front(),
               command.output);
  print_result("Serving until interrupted (Ctrl-C).\n");
  emulator.run(stop);
  print_log("{} rows in {}\n", log.rows(), command.output);
}

}  // namespace

CLI::App* add_record(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<RecordCommand>();
  CLI::App* command = parent.add_subcommand(
      "record", "Sit between any host program and an instrument, and keep every byte of both with its time");
  command->add_option("--port", options->port, "port of the instrument, as in a bench file")->required();
  command
      ->add_option("--serve", options->serve,
                   "where the host program finds it: a link to a pseudo-terminal that is made, or tcp:PORT")
      ->required();
  command->add_option("--baud", options->baud, "speed of a serial port, in Bd")
      ->check(CLI::Range(300, 10'000'000));
  command->add_option("-o,--output", options->output, "file to create (docs/emulate.md)")->required();
  command->callback([options, &exit_code] {
    record(*options);
    exit_code = kExitDone;
  });
  return command;
}

}  // namespace abcal
