// Fuzz target of the iio codec: replies of iiod, descriptions and samples, each confirmed by a slow reference
// that goes through them byte by byte.

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <string>
#include <string_view>

#include "drivers/iio/codec.h"

namespace {

using abcal::iio::ReplyKind;
using abcal::wire::FrameCheck;

void require(bool right) {
  if (!right) std::abort();
}

/// Reads on demand; `more` is set where the bytes end.
struct Reader {
  std::string_view bytes;
  std::size_t at = 0;
  bool more = false;
  bool wrong = false;

  std::optional<char> one() {
    if (at < bytes.size()) return bytes[at++];
    more = true;
    return std::nullopt;
  }
  /// A number of at most eleven characters, and the line's end.
  long long number() {
    std::string text;
    for (;;) {
      const auto c = one();
      if (!c) return 0;
      if (*c == '\n') break;
      const bool sign = *c == '-' && text.empty();
      if ((!sign && (*c < '0' || *c > '9')) || text.size() == 11) {
        wrong = true;
        return 0;
      }
      text += *c;
    }
    if (text.empty() || text == "-") {
      wrong = true;
      return 0;
    }
    return std::strtoll(text.c_str(), nullptr, 10);
  }
};

void examine_reply(ReplyKind kind, std::string_view bytes) {
  const auto verdict = abcal::iio::check_reply(kind, bytes);
  Reader reader{bytes};
  const long long number = reader.number();
  bool followed = kind != ReplyKind::kNumber && number >= 0 && !(kind == ReplyKind::kName && number == 0);
  if (!reader.wrong && !reader.more && followed && number > 4'000'000) reader.wrong = true;
  std::string text;
  for (long long n = 0; followed && !reader.wrong && !reader.more && n < number; ++n)
    if (const auto c = reader.one()) text += *c;
  if (followed && !reader.wrong && !reader.more) {
    const auto end = reader.one();
    if (end && *end != '\n') reader.wrong = true;
  }
  if (reader.wrong) return require(verdict.check == FrameCheck::kInvalid);
  if (reader.more) return require(verdict.check == FrameCheck::kNeedMore);
  require(verdict.check == FrameCheck::kComplete && verdict.length == reader.at);
  require(abcal::iio::number_of(bytes) == number);
  if (kind == ReplyKind::kNumber || number <= 0) return;
  const auto blank = [](char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\n' || c == '\0'; };
  while (!text.empty() && blank(text.back())) text.pop_back();
  while (!text.empty() && blank(text.front())) text.erase(0, 1);
  require(abcal::iio::text_of(bytes.substr(0, verdict.length)) == text);
}

void examine_samples(std::string_view bytes) {
  constexpr std::size_t kWanted = 24;
  const std::string mask = "00000047";
  const auto verdict = abcal::iio::check_samples(bytes, kWanted, mask);
  Reader reader{bytes};
  std::string samples;
  long long error = 0;
  for (bool first = true; samples.size() < kWanted; first = false) {
    const long long size = reader.number();
    if (reader.wrong || reader.more) break;
    if (size <= 0) {
      error = size;
      break;
    }
    if (static_cast<unsigned long long>(size) > kWanted - samples.size()) {
      reader.wrong = true;
      break;
    }
    for (std::size_t n = 0; first && n <= mask.size() && !reader.wrong && !reader.more; ++n) {
      const auto c = reader.one();
      if (c && *c != (n < mask.size() ? mask[n] : '\n')) reader.wrong = true;
    }
    std::string chunk;
    for (long long n = 0; n < size && !reader.wrong && !reader.more; ++n)
      if (const auto c = reader.one()) chunk += *c;
    if (reader.wrong || reader.more) break;
    samples += chunk;
  }
  if (reader.wrong) return require(verdict.check == FrameCheck::kInvalid);
  if (reader.more) return require(verdict.check == FrameCheck::kNeedMore);
  require(verdict.check == FrameCheck::kComplete && verdict.length == reader.at);
  const auto read = abcal::iio::samples_of(bytes.substr(0, verdict.length), mask);
  require(read.bytes == samples && read.error == error);
}

/// Bit by bit: bit `n` of the word that is stored there.
void examine_value(std::string_view bytes, std::string_view format_text) {
  const auto format = abcal::iio::parse_format(format_text);
  if (!format || bytes.size() < format->bytes) return;
  require(format->bits >= 1 && format->bits + format->shift <= 8 * format->bytes);
  const auto raw = abcal::iio::value_at(bytes, {*format, 0});
  const auto bit = [&](unsigned n) {
    const unsigned byte = format->big_endian ? format->bytes - 1 - n / 8 : n / 8;
    return static_cast<unsigned char>(bytes[byte]) >> (n % 8) & 1U;
  };
  bool all_ones = true, all_zeros = true;
  for (unsigned n = 0; n < format->bits; ++n) {
    const unsigned stored = bit(n + format->shift);
    require((static_cast<std::uint64_t>(raw.value) >> n & 1U) == stored);
    const bool sign = format->is_signed && n == format->bits - 1;
    ((stored != 0) == sign ? all_zeros : all_ones) = false;
  }
  const bool negative = format->is_signed && bit(format->bits - 1 + format->shift) != 0;
  for (unsigned n = format->bits; n < 64; ++n)
    require((static_cast<std::uint64_t>(raw.value) >> n & 1U) == (negative ? 1U : 0U));
  // At one end the sign is set and nothing else, at the other end all else.
  require(raw.at_end == (all_ones || all_zeros));
}

void examine_context(std::string_view bytes) {
  const auto context = abcal::iio::parse_context(bytes);
  if (!context) return;
  for (const auto& device : context->devices) {
    require(!device.id.empty());
    const auto layout = abcal::iio::lay_out(device);
    if (!layout) continue;
    require(layout->mask.size() == (device.channels.size() + 31) / 32 * 8);
    for (const auto& place : layout->axes)
      require(place.offset % place.format.bytes == 0 && place.offset + place.format.bytes <= layout->size);
    const std::string scan(layout->size, '\x5a');
    for (const auto& place : layout->axes) abcal::iio::value_at(scan, place);
    if (layout->timestamp) abcal::iio::value_at(scan, *layout->timestamp);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  for (const ReplyKind kind : {ReplyKind::kNumber, ReplyKind::kText, ReplyKind::kName})
    examine_reply(kind, bytes);
  examine_samples(bytes);
  const std::size_t line = std::min(bytes.find('\n'), bytes.size());
  examine_value(bytes.substr(std::min(line + 1, bytes.size())), bytes.substr(0, line));
  if (const auto version = abcal::iio::find_version(bytes)) {
    require(version->end <= size && version->end > version->text.size());
    require(bytes.substr(version->end - version->text.size() - 1, version->text.size()) == version->text);
  }
  if (bytes.find('<') != std::string_view::npos) examine_context(bytes);
  return 0;
}
