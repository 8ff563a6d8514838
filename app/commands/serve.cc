#include <fmt/format.h>

#include <boost/asio/ip/address.hpp>
#include <boost/asio/ip/host_name.hpp>
#include <csignal>
#include <filesystem>
#include <memory>
#include <stdexcept>
#include <string>

#include "app/bench/bench_config.h"
#include "app/bench/bench_records.h"
#include "app/commands/bench.h"
#include "app/commands/commands.h"
#include "app/console/bench_service.h"
#include "app/console/server.h"
#include "app/session/register_records.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/last_signal.h"
#include "app/system/output.h"

namespace abcal {
namespace {

/// The token, where one is needed or given. @return whether it was made here and must be shown.
bool choose_access(console::ServerOptions& server, const std::filesystem::path& token_file) {
  boost::system::error_code error;
  const auto address = boost::asio::ip::make_address(server.address, error);
  if (error)
    throw std::invalid_argument(
        fmt::format("--listen {}: this is not an address; required: for example 127.0.0.1, 0.0.0.0 or ::1",
                    server.address));
  if (!address.is_loopback()) server.access.hosts.push_back(boost::asio::ip::host_name());
  if (!token_file.empty()) {
    server.access.token = console::read_token(token_file);
    return false;
  }
  if (address.is_loopback()) return false;
  server.access.token = console::make_token();
  return true;
}

/// The address as a person types it into a browser.
std::string name_to_call(const std::string& address) {
  const auto parsed = boost::asio::ip::make_address(address);
  if (parsed.is_unspecified()) return boost::asio::ip::host_name();
  return parsed.is_v6() ? "[" + address + "]" : address;
}

/// The folder of the runs: as given, else that of the bench file.
void choose_folder(console::Session::Options& bench) {
  if (bench.runs.empty()) bench.runs = bench.bench_file.parent_path();
  if (bench.runs.empty()) bench.runs = ".";
}

/// Options of a bench, the same for the console and for the process that holds it.
void add_bench_options(CLI::App& command, console::Session::Options& bench) {
  bench.pace = 60.0;
  command.add_option("BENCH", bench.bench_file, "bench file (TOML)")->required();
  command.add_option("--runs", bench.runs, "folder of the run files (default: the bench file's)");
  command
      .add_option("--pace", bench.pace, "if all instruments are simulated: factor by which time runs faster")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
}

/// Ctrl-C is a person who ends it all. A closed terminal or a service that is stopped is none: what is in
/// progress at the bench goes on.
bool leaves_bench() {
  return last_interrupt_signal() != SIGINT;
}

}  // namespace

CLI::App* add_bench(CLI::App& parent, int& exit_code) {
  struct Options {
    console::BenchService::Options service;
    bool stay = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand(
      "bench", "Hold a bench for consoles, in a process that outlives them (`abcal serve` starts it)");
  add_bench_options(*command, options->service.bench);
  command->add_option("--socket", options->service.socket,
                      "where consoles find it (default: .BENCH.bench in the folder of the runs)");
  command->add_flag("--stay", options->stay,
                    "stay when nothing is in progress and no console is there, as a service does");
  command->callback([options, &exit_code] {
    console::BenchService::Options& service = options->service;
    choose_folder(service.bench);
    if (service.socket.empty()) service.socket = console::default_bench_socket(service.bench);
    if (options->stay) service.linger = std::chrono::milliseconds(0);
    console::BenchService bench(service);
    exit_code = bench.serve(interrupt_token()) ? kExitInterrupted : kExitDone;
  });
  return command;
}

CLI::App* add_serve(CLI::App& parent, int& exit_code) {
  struct Options {
    console::ServerOptions server;
    console::Session::Options bench;
    std::filesystem::path token_file;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("serve", "Monitor and control the bench in a browser");
  add_bench_options(*command, options->bench);
  command
      ->add_option("--listen", options->server.address,
                   "address to listen on; any other than the loopback requires a token")
      ->capture_default_str();
  command->add_option("--port", options->server.port, "port to listen on; 0: any free one")
      ->capture_default_str();
  command->add_option("--bench-socket", options->server.bench_socket,
                      "where the process that holds the bench listens, if a service of its own starts it");
  command->add_option("--token-file", options->token_file,
                      "file with the token that every page must send (default: made if required)");
  command->add_option("--host", options->server.access.hosts,
                      "further name[:port] by which pages call the console, e.g. behind a proxy");
  command->callback([options, &exit_code] {
    read_bench(options->bench.bench_file,
               register_records());  // Its problems are reported at once, not to the first page.
    choose_folder(options->bench);
    const bool made = choose_access(options->server, options->token_file);
    console::Server server(options->server, options->bench);
    const std::string& token = options->server.access.token;
    print_result("Console: http://{}:{}/{}\n", name_to_call(options->server.address), server.port(),
                 made ? "?token=" + token : "");
    print_result(
        "{}A stop by the console is not an emergency stop: keep the stage's own switch within reach.\n"
        "Serving until interrupted (Ctrl-C).\n",
        token.empty() ? "Anyone with an account on this computer can use it.\n" : "");
    exit_code = server.serve(interrupt_token(), leaves_bench) ? kExitInterrupted : kExitDone;
  });
  return command;
}

}  // namespace abcal
