#include <fmt/format.h>

#include <boost/asio/ip/address.hpp>
#include <boost/asio/ip/host_name.hpp>
#include <filesystem>
#include <memory>
#include <stdexcept>
#include <string>

#include "app/bench/bench_config.h"
#include "app/bench/bench_records.h"
#include "app/commands/commands.h"
#include "app/console/server.h"
#include "app/session/register_records.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"

namespace abcal {
namespace {

/// The token, where one is needed or given. @return whether it was made here and must be shown.
bool choose_access(console::ServerOptions& server, const std::filesystem::path& token_file) {
  boost::system::error_code error;
  const auto address = boost::asio::ip::make_address(server.address, error);
  if (error)
    throw std::invalid_argument(fmt::format(
        "--listen {}: this is no address; required: e.g. 127.0.0.1, 0.0.0.0 or ::1", server.address));
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

}  // namespace

CLI::App* add_serve(CLI::App& parent, int& exit_code) {
  struct Options {
    console::ServerOptions server;
    console::Session::Options bench;
    std::filesystem::path token_file;
  };
  auto options = std::make_shared<Options>();
  options->bench.pace = 60.0;
  CLI::App* command = parent.add_subcommand("serve", "Watch and steer the bench in a browser");
  command->add_option("BENCH", options->bench.bench_file, "bench file (TOML)")->required();
  command->add_option("--runs", options->bench.runs, "folder of the run files (default: the bench file's)");
  command
      ->add_option("--listen", options->server.address,
                   "address to listen on; any other than the loopback requires a token")
      ->capture_default_str();
  command->add_option("--port", options->server.port, "port to listen on; 0: any free one")
      ->capture_default_str();
  command
      ->add_option("--pace", options->bench.pace,
                   "if all instruments are simulated: factor by which time runs faster")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--token-file", options->token_file,
                      "file with the token that every page must send (default: made if required)");
  command->add_option("--host", options->server.access.hosts,
                      "further name[:port] by which pages call the console, e.g. behind a proxy");
  command->callback([options, &exit_code] {
    read_bench(options->bench.bench_file,
               register_records());  // Its problems are reported at once, not to the first page.
    if (options->bench.runs.empty()) options->bench.runs = options->bench.bench_file.parent_path();
    if (options->bench.runs.empty()) options->bench.runs = ".";
    const bool made = choose_access(options->server, options->token_file);
    console::Server server(options->server, options->bench);
    const std::string& token = options->server.access.token;
    print_result("Console: http://{}:{}/{}\n", name_to_call(options->server.address), server.port(),
                 made ? "?token=" + token : "");
    print_result(
        "{}A stop by the console is no emergency stop: keep the stage's own switch within reach.\n"
        "Serving until interrupted (Ctrl-C).\n",
        token.empty() ? "Whoever has an account on this computer can use it.\n" : "");
    exit_code = server.serve(interrupt_token()) ? kExitInterrupted : kExitDone;
  });
  return command;
}

}  // namespace abcal
