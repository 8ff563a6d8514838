#pragma once

#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <utility>

#include "app/system/channel.h"
#include "app/system/descriptor.h"
#include "app/witness/witness_log.h"
#include "app/witness/witness_service.h"
#include "app/witness/witness_socket.h"
#include "protocol/record/sha256.h"
#include "protocol/record/signature.h"
#include "tests/support/temporary_folder.h"

namespace abcal {

/// Link number k of a run; number 0 is its head.
inline std::string link_of(const std::string& run, std::int64_t k) {
  return sha256_of(run + std::to_string(k));
}

inline WitnessRequest begin_request(const std::string& run = "run-1", bool simulated = false) {
  WitnessRequest request;
  request.what = WitnessAct::kBegin;
  request.run = run;
  request.bench = "left";
  request.person = "A. B.";
  request.head = link_of(run, 0);
  request.simulated = simulated;
  return request;
}

inline WitnessRequest link_request(std::int64_t k, const std::string& run = "run-1") {
  WitnessRequest request;
  request.what = WitnessAct::kLink;
  request.run = run;
  request.k = k;
  request.previous = link_of(run, k - 1);
  request.now = link_of(run, k);
  return request;
}

inline WitnessRequest close_request(std::int64_t dwells, const std::string& run = "run-1") {
  WitnessRequest request;
  request.what = WitnessAct::kClose;
  request.run = run;
  request.k = dwells;
  request.now = link_of(run, dwells);
  request.events = sha256_of("events");
  return request;
}

inline WitnessRequest head_request(std::int64_t entries, const std::string& head = "",
                                   const std::string& register_identity = "register-1") {
  WitnessRequest request;
  request.what = WitnessAct::kHead;
  request.register_identity = register_identity;
  request.entries = entries;
  request.head = sha256_of(head.empty() ? "entry " + std::to_string(entries) : head);
  return request;
}

/// A folder with a key, and clocks that go on by one second with each line.
class WitnessTest : public testing::Test {
 protected:
  std::unique_ptr<WitnessLog> open_log() {
    return std::make_unique<WitnessLog>(file, key, [this] {
      now.utc += std::chrono::seconds(1);
      now.since_boot += std::chrono::seconds(1);
      return now;
    });
  }

  test::TemporaryFolder folder;
  std::filesystem::path socket = folder / "socket";
  std::filesystem::path file = folder / "witness.db";
  std::string key = make_private_key(), public_pem = public_key_of(key);
  WitnessMoment now{
      .utc = Clock::UtcTime(std::chrono::sys_days{std::chrono::year{2026} / 3 / 1} + std::chrono::hours(12)),
      .boot_id = "boot-1",
      .since_boot = std::chrono::seconds(100)};
};

/// A service in a thread of its own, for the lifetime of this object.
class ServedWitness {
 public:
  /// @param users  as in WitnessService::Options
  ServedWitness(std::unique_ptr<WitnessLog> log, const std::filesystem::path& socket,
                std::optional<std::set<std::uint32_t>> users = std::nullopt)
      : log_(std::move(log)) {
    std::array<int, 2> ends{};
    if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends.data()) != 0)
      throw std::runtime_error("no socket");
    owner_ = Descriptor(ends[0]);
    service_ = std::make_unique<WitnessService>(
        *log_,
        WitnessService::Options{.socket = socket, .owner = Descriptor(ends[1]), .users = std::move(users)});
    thread_ = std::thread([this] { service_->serve(); });
  }
  ServedWitness(const ServedWitness&) = delete;
  ServedWitness& operator=(const ServedWitness&) = delete;
  ~ServedWitness() {
    owner_.close();
    thread_.join();
  }
  const Descriptor& owner() const { return owner_; }

 private:
  std::unique_ptr<WitnessLog> log_;
  std::unique_ptr<WitnessService> service_;
  Descriptor owner_;
  std::thread thread_;
};

/// Waits for the next packet. @return null: the connection has ended, or there is none after a minute
inline nlohmann::json receive_answer(const Descriptor& socket) {
  pollfd waiting{.fd = socket.number(), .events = POLLIN, .revents = 0};
  if (::poll(&waiting, 1, 60'000) != 1) return nullptr;
  const auto packet = receive_witness_packet(socket.number());
  return packet ? nlohmann::json::parse(*packet) : nlohmann::json(nullptr);
}

/// Null: the connection has ended.
inline nlohmann::json ask_witness(const Descriptor& socket, const std::string& question) {
  if (!send_packet(socket.number(), question)) return nullptr;
  return receive_answer(socket);
}

inline constexpr const char* kWho = R"({"do":"who"})";

}  // namespace abcal
