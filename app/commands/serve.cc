#include <fmt/format.h>

#include <boost/asio/ip/address.hpp>
#include <boost/asio/ip/host_name.hpp>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/bench_records.h"
#include "app/commands/bench.h"
#include "app/commands/commands.h"
#include "app/console/bench_service.h"
#include "app/console/forwarded.h"
#include "app/console/server.h"
#include "app/console/tls.h"
#include "app/laboratory/certificate/laboratory_file.h"
#include "app/laboratory/register/login.h"
#include "app/laboratory/register/login_file.h"
#include "app/laboratory/register/register_lookup.h"
#include "app/system/exit_code.h"
#include "app/system/interrupt.h"
#include "app/system/last_signal.h"
#include "app/system/output.h"
#include "app/system/real_clock.h"

namespace abcal {
namespace {

/// Options of `abcal serve`.
struct ServeOptions {
  console::ServerOptions server;
  console::Session::Options bench;
  std::filesystem::path token_file, tls_certificate, tls_key;
  bool tls = false;
};

std::string known_address(const std::string& option, const std::string& text) {
  if (auto address = console::plain_address(text)) return *std::move(address);
  throw std::invalid_argument(fmt::format(
      "{} {}: this is not an address; required: for example 127.0.0.1, 0.0.0.0 or ::1", option, text));
}

/// Sets the access rules of the console. @return whether a token was made here and must be shown.
bool choose_access(ServeOptions& options) {
  console::ServerOptions& server = options.server;
  const bool loopback =
      boost::asio::ip::make_address(known_address("--listen", server.address)).is_loopback();
  for (std::string& proxy : server.trusted_proxies) proxy = known_address("--trusted-proxy", proxy);
  server.register_location = lab::register_location({});
  // Its problems are reported at once, not to the first person.
  if (!server.register_location.empty())
    (void)lab::Register::open(server.register_location, RealClock().utc_now());
  const bool proxied = !server.access.hosts.empty() || !server.trusted_proxies.empty();
  if (!loopback) server.access.hosts.push_back(boost::asio::ip::host_name());
  if (!options.token_file.empty()) {
    server.access.token = console::read_token(options.token_file);
    return false;
  }
  if (!server.register_location.empty() || (loopback && !proxied)) return false;
  server.access.token = console::make_token();
  return true;
}

/// Sets the TLS certificate, which every address except the loopback requires.
void choose_tls(ServeOptions& options) {
  console::ServerOptions& server = options.server;
  if (options.tls_certificate.empty() != options.tls_key.empty())
    throw std::invalid_argument(fmt::format("{} is given without {}; required: both, or neither",
                                            options.tls_key.empty() ? "--tls-certificate" : "--tls-key",
                                            options.tls_key.empty() ? "--tls-key" : "--tls-certificate"));
  if (!options.tls_certificate.empty()) {
    server.tls = console::read_tls_identity(options.tls_certificate, options.tls_key);
    return;
  }
  const auto address = boost::asio::ip::make_address(server.address);
  if (address.is_loopback() && !options.tls) return;
  std::vector<std::string> names{"localhost", "127.0.0.1", "::1", boost::asio::ip::host_name()};
  if (!address.is_unspecified() && !address.is_loopback()) names.push_back(address.to_string());
  for (const std::string& host : server.access.hosts) names.push_back(host.substr(0, host.find(':')));
  const char* of_service = std::getenv("STATE_DIRECTORY");  // Set by systemd.
  const std::filesystem::path folder =
      of_service != nullptr && *of_service == '/' ? std::filesystem::path(of_service) : lab::state_folder();
  server.tls = console::own_tls_identity(folder, names, RealClock().utc_now());
}

/// A sentence that names the persons with access to the console.
std::string who_may(const console::ServerOptions& server) {
  const bool token = !server.access.token.empty();
  if (!server.register_location.empty())
    return fmt::format(
        "Persons of the register log in: whoever may measure steers, the others watch and may press "
        "Stop.{}\n",
        token ? " So may whoever has the token." : "");
  const char* unverified = "Nobody's name is verified without a register (ABCAL_REGISTER).";
  if (token) return fmt::format("Whoever has the token can use it. {}\n", unverified);
  return fmt::format("Anyone with an account on this computer can use it. {}\n", unverified);
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

/// Ctrl-C is a person's request to end everything. After a closed terminal or a stopped service, activity at
/// the bench continues.
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
    const std::stop_token stop = interrupt_token();
    console::BenchService bench(service);
    exit_code = bench.serve(stop) ? kExitInterrupted : kExitDone;
  });
  return command;
}

CLI::App* add_serve(CLI::App& parent, int& exit_code) {
  auto options = std::make_shared<ServeOptions>();
  CLI::App* command = parent.add_subcommand("serve", "Monitor and control the bench in a browser");
  add_bench_options(*command, options->bench);
  command
      ->add_option("--listen", options->server.address,
                   "address to listen on; any other than the loopback has TLS, and a register or a token")
      ->capture_default_str();
  command->add_option("--port", options->server.port, "port to listen on; 0: any free one")
      ->capture_default_str();
  command->add_option("--bench-socket", options->server.bench_socket,
                      "where the process that holds the bench listens, if a service of its own starts it");
  command->add_option("--laboratory", options->server.laboratory_file,
                      "laboratory file of the certificates that are approved on the page; needs a register");
  command->add_option("--token-file", options->token_file,
                      "file with the token that every page must send (default: made if required)");
  command->add_option("--host", options->server.access.hosts,
                      "further name[:port] by which pages call the console, e.g. behind a proxy");
  command->add_option("--trusted-proxy", options->server.trusted_proxies,
                      "address of a proxy whose Forwarded or X-Forwarded-For is true; repeatable");
  command
      ->add_option("--tiles", options->server.tile_folders,
                   "folder of runs whose benches are shown as tiles on the page; repeatable")
      ->check(CLI::ExistingDirectory);
  command
      ->add_option("--tile-link", options->server.tile_links,
                   "address (https://...) of a console of another computer, linked beside the tiles")
      ->check([](const std::string& address) {
        const bool is_web = address.starts_with("https://") || address.starts_with("http://");
        return is_web ? std::string() : "an address begins with https:// or http://, found: " + address;
      });
  command->add_option("--tls-certificate", options->tls_certificate,
                      "certificate of the console, with those up to its authority (PEM)");
  command->add_option("--tls-key", options->tls_key, "its private key (PEM), readable by its owner only");
  command->add_flag("--tls", options->tls,
                    "TLS on the loopback too, with a self-signed certificate unless one is given");
  command->callback([options, &exit_code] {
    read_bench(options->bench.bench_file,
               register_records());  // Its problems are reported at once, not to the first page.
    choose_folder(options->bench);
    if (!options->server.laboratory_file.empty()) (void)read_laboratory_file(options->server.laboratory_file);
    const bool made = choose_access(*options);
    choose_tls(*options);
    const std::stop_token stop = interrupt_token();
    console::Server server(options->server, options->bench);
    const auto& tls = options->server.tls;
    print_result("Console: {}://{}:{}/{}\n", tls ? "https" : "http", name_to_call(options->server.address),
                 server.port(), made ? "#token=" + options->server.access.token : "");
    if (tls)
      print_result("{} certificate, SHA-256 {}\n", tls->self_signed ? "Self-signed" : "Its",
                   console::tls_fingerprint(*tls));
    print_result(
        "{}A stop by the console is not an emergency stop: keep the stage's own switch within reach.\n"
        "Serving until interrupted (Ctrl-C).\n",
        who_may(options->server));
    exit_code = server.serve(stop, leaves_bench) ? kExitInterrupted : kExitDone;
  });
  return command;
}

}  // namespace abcal
