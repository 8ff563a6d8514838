#include "drivers/watlow_f4/codec.h"

#include <bit>
#include <cmath>

#include "drivers/text/names.h"

namespace abcal::watlow_f4 {
namespace {

constexpr unsigned kException = 0x80;
constexpr std::size_t kTcpHeader = 7;
constexpr std::size_t kLongestPdu = 253;
constexpr int kNoValue = -32000;

unsigned u8(std::string_view bytes, std::size_t at) {
  return static_cast<unsigned char>(bytes[at]);
}
std::uint16_t u16(std::string_view bytes, std::size_t at) {
  return static_cast<std::uint16_t>(u8(bytes, at) * 256U + u8(bytes, at + 1));
}
void put(std::string& to, unsigned value) {
  to.push_back(static_cast<char>(value / 256U));
  to.push_back(static_cast<char>(value % 256U));
}
bool reads(unsigned function) {
  return function == 3 || function == 4;
}
bool is_known(unsigned function) {
  return reads(function) || function == 6 || function == 8 || function == 16;
}

/// Bytes of function code and data; 0: not known yet; absent: no reply to a function that the driver uses.
std::optional<std::size_t> pdu_length(std::string_view pdu) {
  if (pdu.empty()) return 0;
  const unsigned function = u8(pdu, 0);
  if ((function & kException) != 0U)
    return is_known(function & ~kException) ? std::optional<std::size_t>(2) : std::nullopt;
  if (!is_known(function)) return std::nullopt;
  if (!reads(function)) return 5;
  if (pdu.size() < 2) return 0;
  const unsigned count = u8(pdu, 1);
  if (count == 0 || count % 2 != 0 || count + 2U > kLongestPdu) return std::nullopt;
  return count + 2;
}

wire::FrameVerdict check_rtu(std::string_view bytes) {
  constexpr wire::FrameVerdict kMore{wire::FrameCheck::kNeedMore, 0};
  if (bytes.size() < 2) return kMore;
  const auto length = pdu_length(bytes.substr(1));
  if (!length) return {};
  if (*length == 0 || bytes.size() < *length + 3) return kMore;
  const unsigned sent = u8(bytes, *length + 1) + 256U * u8(bytes, *length + 2);
  if (sent != crc16(bytes.substr(0, *length + 1))) return {};
  return {wire::FrameCheck::kComplete, *length + 3};
}

wire::FrameVerdict check_tcp(std::string_view bytes) {
  constexpr wire::FrameVerdict kMore{wire::FrameCheck::kNeedMore, 0};
  if (bytes.size() >= 3 && bytes[2] != 0) return {};
  if (bytes.size() >= 4 && bytes[3] != 0) return {};
  if (bytes.size() < kTcpHeader) return kMore;
  const std::size_t told = u16(bytes, 4);
  if (told < 3 || told > kLongestPdu + 1) return {};
  const auto length = pdu_length(bytes.substr(kTcpHeader));
  if (!length) return {};
  if (*length == 0) return kMore;
  if (*length + 1 != told) return {};
  if (bytes.size() < kTcpHeader + *length) return kMore;
  return {wire::FrameCheck::kComplete, kTcpHeader + *length};
}

}  // namespace

std::uint16_t crc16(std::string_view bytes) {
  unsigned crc = 0xFFFF;
  for (const char each : bytes) {
    crc ^= static_cast<unsigned char>(each);
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1U) != 0U ? (crc >> 1U) ^ 0xA001U : crc >> 1U;
  }
  return static_cast<std::uint16_t>(crc);
}

std::string read_registers(std::uint16_t first, std::uint16_t count) {
  std::string pdu("\x03");
  put(pdu, first);
  put(pdu, count);
  return pdu;
}

std::string write_register(std::uint16_t address, std::uint16_t value) {
  std::string pdu("\x06");
  put(pdu, address);
  put(pdu, value);
  return pdu;
}

std::string write_registers(std::uint16_t first, const std::vector<std::uint16_t>& values) {
  std::string pdu("\x10");
  put(pdu, first);
  put(pdu, static_cast<unsigned>(values.size()));
  pdu.push_back(static_cast<char>(2 * values.size()));
  for (const std::uint16_t value : values) put(pdu, value);
  return pdu;
}

std::string loop_back(std::uint16_t token) {
  std::string pdu("\x08");
  put(pdu, 0);
  put(pdu, token);
  return pdu;
}

std::string frame(Framing framing, int unit, std::uint16_t transaction, std::string_view pdu) {
  std::string bytes;
  if (framing == Framing::kTcp) {
    put(bytes, transaction);
    put(bytes, 0);
    put(bytes, static_cast<unsigned>(pdu.size()) + 1);
  }
  bytes.push_back(static_cast<char>(unit));
  bytes += pdu;
  if (framing == Framing::kRtu) {
    const unsigned crc = crc16(bytes);
    bytes.push_back(static_cast<char>(crc % 256U));
    bytes.push_back(static_cast<char>(crc / 256U));
  }
  return bytes;
}

wire::FrameVerdict check_reply(Framing framing, std::string_view bytes) {
  return framing == Framing::kRtu ? check_rtu(bytes) : check_tcp(bytes);
}

std::optional<Reply> parse_reply(Framing framing, std::string_view frame) {
  const wire::FrameVerdict verdict = check_reply(framing, frame);
  if (verdict.check != wire::FrameCheck::kComplete || verdict.length != frame.size()) return std::nullopt;
  const std::size_t at = framing == Framing::kRtu ? 0 : kTcpHeader - 1;
  Reply reply;
  reply.unit = static_cast<int>(u8(frame, at));
  if (framing == Framing::kTcp) reply.transaction = u16(frame, 0);
  const std::string_view pdu = frame.substr(at + 1, *pdu_length(frame.substr(at + 1)));
  reply.function = static_cast<int>(u8(pdu, 0) & ~kException);
  if ((u8(pdu, 0) & kException) != 0U) {
    reply.exception = static_cast<int>(u8(pdu, 1));
    return reply.exception == 0 ? std::nullopt : std::optional(reply);
  }
  if (reads(u8(pdu, 0))) {
    for (std::size_t n = 2; n < pdu.size(); n += 2) reply.registers.push_back(u16(pdu, n));
  } else {
    reply.data = pdu.substr(1);
  }
  return reply;
}

constexpr auto kExceptions = names<int>({{1, "it does not know the command"},
                                         {2, "it has no such register, or it cannot be written"},
                                         {3, "the value is outside its range"},
                                         {4, "the device failed, or the part is absent"}});

std::string_view exception_text(int code) {
  return kExceptions.of(code, "an exception that is not described");
}

float float_of(std::uint16_t low, std::uint16_t high) {
  return std::bit_cast<float>(static_cast<std::uint32_t>(high) * 65536U + low);
}

std::vector<std::uint16_t> registers_of(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  return {static_cast<std::uint16_t>(bits % 65536U), static_cast<std::uint16_t>(bits / 65536U)};
}

std::optional<double> decimal_of(std::uint16_t raw, int decimals) {
  const int value = std::bit_cast<std::int16_t>(raw);
  if (value <= kNoValue) return std::nullopt;
  return value * std::pow(10.0, -decimals);
}

std::optional<std::uint16_t> raw_of(double value, int decimals) {
  const double scaled = std::round(value * std::pow(10.0, decimals));
  if (!(scaled > kNoValue && scaled <= 32767.0)) return std::nullopt;
  return std::bit_cast<std::uint16_t>(static_cast<std::int16_t>(scaled));
}

std::string text_of(const std::vector<std::uint16_t>& registers) {
  std::string text;
  for (const std::uint16_t each : registers) {
    if (each < ' ' || each > '~') break;
    text.push_back(static_cast<char>(each));
  }
  while (text.ends_with(' ')) text.pop_back();
  return text;
}

}  // namespace abcal::watlow_f4
