#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>

#include "app/system/descriptor.h"

namespace abcal {

// The socket between a witness and the programs that ask it. It keeps the bounds of packets (SOCK_SEQPACKET);
// each packet is one JSON object. A question has the member "do": "who", "fetch", or the act of a
// WitnessRequest. Its answer has "ok", and "why" if that is false; "again" if the witness cannot sign now.

/// Longest packet, in bytes.
inline constexpr std::size_t kLongestWitnessPacket = 64 * 1024;

/// Listens at a path, which all users may connect to. A socket that is no longer served is replaced.
/// @throws std::runtime_error also if another process serves it
Descriptor listen_as_witness(const std::filesystem::path& path);

/// Connects without waiting. @throws std::runtime_error
Descriptor connect_to_witness(const std::filesystem::path& path);

/// Never waits. @return false: the other end is gone, or its queue is full
bool send_witness_packet(int socket, const std::string& packet);

/// Takes a packet that has arrived; never waits. @return nullopt if there is none, or if the connection has
/// ended
/// @throws std::invalid_argument for a longer packet than kLongestWitnessPacket
std::optional<std::string> receive_witness_packet(int socket);

/// User ID of the process at the other end (SO_PEERCRED).
unsigned peer_user(int socket);

}  // namespace abcal
