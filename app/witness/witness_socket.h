#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>

#include "app/system/descriptor.h"

namespace abcal {

// The channel of packets between a witness and the programs that ask it. Each packet is one JSON object. A
// question has the member "do": "who", "fetch", or the act of a WitnessRequest. Its answer has "ok", and
// "why" if that is false; "again" if the witness cannot sign now.

/// Longest packet, in bytes.
inline constexpr std::size_t kLongestWitnessPacket = 64 * 1024;

/// Listens at a path, which all users may connect to. A socket that is no longer served is replaced.
/// @throws std::runtime_error also if another process serves it
Descriptor listen_as_witness(const std::filesystem::path& path);

/// As receive_packet(). @throws std::invalid_argument for a longer packet than kLongestWitnessPacket
std::optional<std::string> receive_witness_packet(int socket);

}  // namespace abcal
