#include "sim/serial_line.h"

#include <algorithm>
#include <cmath>

namespace abcal::sim {
namespace {

constexpr double kBitsPerByte = 10.0;
// A UART samples in the middle of a bit: over ten bits it tolerates an error of half a bit.
constexpr double kBearableMismatch = 0.05;
constexpr double kRoundOff = 1e-6;  // Bytes: a time that is a whole number of bytes counts them all.
constexpr double kMostNoise = 8.0;  // Bytes of noise for each byte that is sent.

/// splitmix64 (Steele, Lea, Flood 2014).
std::uint64_t mixed(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15U;
  x = (x ^ (x >> 30U)) * 0xBF58476D1CE4E5B9U;
  x = (x ^ (x >> 27U)) * 0x94D049BB133111EBU;
  return x ^ (x >> 31U);
}

}  // namespace

Clock::Instant SerialLine::Piece::time_of(std::size_t count) const {
  return start + from_seconds(static_cast<double>(count) / bytes_per_s);
}

bool SerialLine::fits(unsigned sent, unsigned read) {
  return std::abs(static_cast<double>(read) / sent - 1.0) <= kBearableMismatch;
}

void SerialLine::send(std::string_view bytes, unsigned speed, std::optional<unsigned> read_at,
                      Clock::Instant at) {
  if (bytes.empty()) return;
  const double lasts_s = kBitsPerByte * static_cast<double>(bytes.size()) / speed;
  Piece piece{std::max(at, free_at_), static_cast<double>(bytes.size()) / lasts_s, std::string(bytes)};
  const double ratio = read_at ? static_cast<double>(*read_at) / speed : 1.0;
  if (!fits(speed, read_at.value_or(speed))) {
    const double count = std::ceil(static_cast<double>(bytes.size()) * std::min(ratio, kMostNoise));
    piece.bytes.assign(static_cast<std::size_t>(count), '\0');
    // The high bit: stop bits and data bits run into each other.
    for (char& c : piece.bytes) c = static_cast<char>(0x80U | (mixed(++noise_) & 0x7FU));
    piece.bytes_per_s = count / lasts_s;
  }
  free_at_ = piece.start + from_seconds(lasts_s);
  under_way_ += piece.bytes.size();
  pieces_.push_back(std::move(piece));
}

std::size_t SerialLine::room(unsigned speed, Clock::Instant at, Clock::Instant now) const {
  const double free_s = to_seconds(now - std::max(at, free_at_));
  return static_cast<std::size_t>(std::max(0.0, free_s) * speed / kBitsPerByte);
}

std::string SerialLine::arrived(Clock::Instant now) {
  std::string bytes;
  while (!pieces_.empty()) {
    Piece& piece = pieces_.front();
    std::size_t count = piece.bytes.size();
    if (piece.time_of(count) > now) {
      const double passed = std::floor(to_seconds(now - piece.start) * piece.bytes_per_s + kRoundOff);
      count = std::min(count, static_cast<std::size_t>(std::max(0.0, passed)));
    }
    if (count > piece.taken) {
      bytes.append(piece.bytes, piece.taken, count - piece.taken);
      under_way_ -= count - piece.taken;
      piece.taken = count;
    }
    if (piece.taken < piece.bytes.size()) break;
    pieces_.pop_front();
  }
  return bytes;
}

std::optional<Clock::Instant> SerialLine::next_due() const {
  if (pieces_.empty()) return std::nullopt;
  const Piece& piece = pieces_.front();
  return piece.time_of(std::min(piece.bytes.size(), piece.taken + kFifo));
}

void SerialLine::clear() {
  pieces_.clear();
  under_way_ = 0;
}

}  // namespace abcal::sim
