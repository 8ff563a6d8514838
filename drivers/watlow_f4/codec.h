#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/wire/frame.h"

/// Modbus as Watlow's F4 and F4T speak it, RTU and TCP: bytes to requests and back, no port, no clock.
/// Source: docs/protocols/watlow_f4.md.
namespace abcal::watlow_f4 {

enum class Framing { kRtu, kTcp };

/// Checksum of RTU frames, sent low byte first.
std::uint16_t crc16(std::string_view bytes);

/// Requests: function code and data, without framing. @{
std::string read_registers(std::uint16_t first, std::uint16_t count);
std::string write_register(std::uint16_t address, std::uint16_t value);
std::string write_registers(std::uint16_t first, const std::vector<std::uint16_t>& values);
std::string loop_back(std::uint16_t token);
/// @}

/// Builds a frame; `transaction` is ignored for RTU.
std::string frame(Framing framing, int unit, std::uint16_t transaction, std::string_view pdu);

/// The first frame of a reply. kInvalid: no frame begins with the first byte.
wire::FrameVerdict check_reply(Framing framing, std::string_view bytes);

/// A reply: either registers, or the code of an exception.
struct Reply {
  int unit = 0;
  std::uint16_t transaction = 0;         ///< 0 for RTU.
  int function = 0;                      ///< Without the bit of an exception.
  int exception = 0;                     ///< 0: none.
  std::vector<std::uint16_t> registers;  ///< Registers of a read.
  std::string data;                      ///< For any other function: the bytes after the function code.
};

/// A whole frame. Nullopt if it is malformed.
std::optional<Reply> parse_reply(Framing framing, std::string_view frame);

/// Meaning of an exception code in words.
std::string_view exception_text(int code);

/// Two registers, the low word first. @{
float float_of(std::uint16_t low, std::uint16_t high);
std::vector<std::uint16_t> registers_of(float value);
/// @}

/// A signed number with this number of decimals; absent for values that stand for "no value" (-32000 and
/// below).
std::optional<double> decimal_of(std::uint16_t raw, int decimals);
/// @return nullopt if it does not fit
std::optional<std::uint16_t> raw_of(double value, int decimals);

/// One character per register, up to the first that does not hold one.
std::string text_of(const std::vector<std::uint16_t>& registers);

}  // namespace abcal::watlow_f4
