#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>
#include <stdexcept>
#include <stop_token>
#include <string>

#include "app/console/console_session.h"

namespace abcal::console {

/// Another process holds the bench already.
class BenchIsHeld : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Default socket of the process that holds a bench: in the run folder, named after the bench file.
std::filesystem::path default_bench_socket(const Session::Options& bench);
/// The name of the bench whose default socket has this name; nullopt if the file name is not a bench socket.
std::optional<std::string> bench_of_socket(const std::string& file);

/// Holds a bench for consoles, in a process of its own: the instruments, the measuring thread, and the state
/// that pages show. Consoles connect and disconnect over a Unix socket that only this user can reach; an
/// activity continues without any console. Each bench has at most one such process.
class BenchService {
 public:
  struct Options {
    Session::Options bench;
    std::filesystem::path socket;
    /// Ends when nothing is in progress and no console was connected for this time; zero: never by itself.
    std::chrono::milliseconds linger{3000};
  };

  /// Listens from here on.
  /// @throws BenchIsHeld, std::runtime_error
  explicit BenchService(Options options);
  ~BenchService();

  /// Serves until `stop`, until a console closes the bench, or until nobody needs it; the stage is halted
  /// then.
  /// @return whether an activity was stopped
  bool serve(const std::stop_token& stop);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace abcal::console
