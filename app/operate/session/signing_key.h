#pragma once

#include <string>

namespace abcal {

/// The private key (PEM) with which this bench signs its runs, from the file that the environment variable
/// ABCAL_SIGNING_KEY names; empty: none is configured.
/// @throws std::invalid_argument if the file is no such key, or others can read it
std::string read_signing_key();

}  // namespace abcal
