#pragma once

#include <string>

namespace abcal {

/// A statement of a witness (docs/witness.md): one line of its log and its signature. The line is evidence by
/// itself: it can be checked with the public key of the witness, without its log.
struct WitnessedLine {
  std::string line;       ///< One JSON object without a line break.
  std::string signature;  ///< 64 bytes: Ed25519 over the bytes of `line`.

  bool operator==(const WitnessedLine&) const = default;
};

}  // namespace abcal
