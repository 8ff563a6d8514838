#include "drivers/iio/codec.h"

#include <fmt/format.h>
#include <libxml/parser.h>
#include <libxml/tree.h>

#include <algorithm>
#include <limits>
#include <memory>

#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal::iio {
namespace {

using wire::FrameCheck;
using wire::FrameVerdict;

constexpr std::size_t kLongestNumber = 11;        // "-2147483648"
constexpr std::int64_t kLongestText = 4'000'000;  // A description of some hundred devices.
constexpr unsigned kMostChannels = 4096;

/// A line with a number at the beginning of the bytes.
struct NumberLine {
  FrameVerdict verdict;
  std::int64_t value = 0;
};
NumberLine number_line(std::string_view bytes) {
  const std::size_t end = bytes.find('\n');
  const std::string_view text = bytes.substr(0, std::min(end, kLongestNumber + 1));
  const std::string_view digits = text.substr(text.starts_with('-') ? 1 : 0);
  const bool all_digits = digits.find_first_not_of("0123456789") == std::string_view::npos;
  if (!all_digits || text.size() > kLongestNumber) return {{FrameCheck::kInvalid, 0}};
  if (end == std::string_view::npos) return {{FrameCheck::kNeedMore, 0}};
  const auto value = pieces::number<std::int64_t>(text);
  if (!value) return {{FrameCheck::kInvalid, 0}};
  return {{FrameCheck::kComplete, end + 1}, *value};
}

bool contains(const std::vector<std::string>& all, std::string_view one) {
  return std::find(all.begin(), all.end(), one) != all.end();
}

// XML.

std::string property(const xmlNode* node, const char* name) {
  xmlChar* const value = xmlGetNoNsProp(node, reinterpret_cast<const xmlChar*>(name));
  if (value == nullptr) return {};
  std::string text = reinterpret_cast<const char*>(value);
  xmlFree(value);
  return text;
}

bool is_element(const xmlNode* node, std::string_view name) {
  return node->type == XML_ELEMENT_NODE && name == reinterpret_cast<const char*>(node->name);
}

std::optional<Channel> channel_of(const xmlNode* node) {
  Channel channel{property(node, "id"), property(node, "type") == "output"};
  if (channel.id.empty()) return std::nullopt;
  for (const xmlNode* child = node->children; child != nullptr; child = child->next) {
    if (is_element(child, "attribute")) channel.attributes.push_back(property(child, "name"));
    if (!is_element(child, "scan-element")) continue;
    channel.format = parse_format(property(child, "format"));
    const auto index = pieces::number<std::int64_t>(property(child, "index"));
    if (!index) return std::nullopt;
    if (*index >= 0 && *index <= kMostChannels) channel.index = static_cast<unsigned>(*index);
  }
  return channel;
}

std::optional<Device> device_of(const xmlNode* node) {
  Device device{property(node, "id"), property(node, "name")};
  if (device.id.empty()) return std::nullopt;
  for (const xmlNode* child = node->children; child != nullptr; child = child->next) {
    if (is_element(child, "attribute")) device.attributes.push_back(property(child, "name"));
    if (is_element(child, "debug-attribute")) device.debug_attributes.push_back(property(child, "name"));
    if (!is_element(child, "channel")) continue;
    auto channel = channel_of(child);
    if (!channel || device.channels.size() >= kMostChannels) return std::nullopt;
    device.channels.push_back(*std::move(channel));
  }
  return device;
}

}  // namespace

bool Channel::has(std::string_view attribute) const {
  return contains(attributes, attribute);
}
bool Device::has(std::string_view attribute) const {
  return contains(attributes, attribute);
}
bool Device::has_debug(std::string_view attribute) const {
  return contains(debug_attributes, attribute);
}
const Channel* Device::find(std::string_view channel) const {
  const auto found = std::find_if(channels.begin(), channels.end(),
                                  [&](const Channel& c) { return c.id == channel && !c.output; });
  return found == channels.end() ? nullptr : &*found;
}

std::optional<SampleFormat> parse_format(std::string_view text) {
  // "le:S64/64>>0"; a capital letter: all bits are defined.
  if (text.size() < 4 || text[2] != ':') return std::nullopt;
  const std::string_view order = text.substr(0, 2);
  const char sign = text[3];
  const std::size_t slash = text.find('/');
  const std::size_t shift = text.find(">>");
  if ((order != "le" && order != "be") || std::string_view("sSuU").find(sign) == std::string_view::npos ||
      slash == std::string_view::npos || shift == std::string_view::npos || shift < slash)
    return std::nullopt;
  const auto bits = pieces::number<unsigned>(text.substr(4, slash - 4));
  const auto length = pieces::number<unsigned>(text.substr(slash + 1, shift - slash - 1));
  const auto places = pieces::number<unsigned>(text.substr(shift + 2));
  if (!bits || !length || !places) return std::nullopt;
  if (*length != 8 && *length != 16 && *length != 32 && *length != 64) return std::nullopt;
  if (*bits == 0 || *bits > *length || *places > *length - *bits) return std::nullopt;
  return SampleFormat{order == "be", sign == 's' || sign == 'S', *bits, *length / 8, *places};
}

std::optional<Context> parse_context(std::string_view xml) {
  if (xml.size() > static_cast<std::size_t>(kLongestText)) return std::nullopt;
  // iiod declares its elements, and no entity.
  if (xml.find("<!ENTITY") != std::string_view::npos) return std::nullopt;
  const std::unique_ptr<xmlDoc, decltype(&xmlFreeDoc)> document(
      xmlReadMemory(xml.data(), static_cast<int>(xml.size()), nullptr, nullptr,
                    XML_PARSE_NONET | XML_PARSE_NOERROR | XML_PARSE_NOWARNING),
      &xmlFreeDoc);
  const xmlNode* const root = document ? xmlDocGetRootElement(document.get()) : nullptr;
  if (root == nullptr || !is_element(root, "context")) return std::nullopt;
  Context context;
  for (const xmlNode* child = root->children; child != nullptr; child = child->next) {
    if (is_element(child, "context-attribute"))
      context.attributes[property(child, "name")] = property(child, "value");
    if (!is_element(child, "device")) continue;
    auto device = device_of(child);
    if (!device) return std::nullopt;
    context.devices.push_back(*std::move(device));
  }
  return context;
}

// Replies.

FrameVerdict check_reply(ReplyKind kind, std::string_view bytes) {
  const auto [verdict, value] = number_line(bytes);
  if (verdict.check != FrameCheck::kComplete || kind == ReplyKind::kNumber || value < 0 ||
      (kind == ReplyKind::kName && value == 0))
    return verdict;
  if (value > kLongestText) return {FrameCheck::kInvalid, 0};
  const std::size_t end = verdict.length + static_cast<std::size_t>(value);
  if (bytes.size() <= end) return {FrameCheck::kNeedMore, 0};
  if (bytes[end] != '\n') return {FrameCheck::kInvalid, 0};
  return {FrameCheck::kComplete, end + 1};
}

std::int64_t number_of(std::string_view reply) {
  return number_line(reply).value;
}

std::string text_of(std::string_view reply) {
  constexpr std::string_view kBlanks(" \t\r\n\0", 5);
  const auto [verdict, value] = number_line(reply);
  if (value <= 0) return {};
  return std::string(pieces::trimmed(reply.substr(verdict.length, static_cast<std::size_t>(value)), kBlanks));
}

std::optional<VersionLine> find_version(std::string_view bytes) {
  // "0.24." and a release, of seven characters if the server is iiod.
  constexpr std::size_t kLongestRelease = 40;
  for (std::size_t end = bytes.find('\n'); end != std::string_view::npos; end = bytes.find('\n', end + 1)) {
    const std::size_t before = end == 0 ? std::string_view::npos : bytes.rfind('\n', end - 1);
    const std::string_view line = bytes.substr(before == std::string_view::npos ? 0 : before + 1,
                                               end - (before == std::string_view::npos ? 0 : before + 1));
    const std::size_t first = line.find('.');
    if (first == std::string_view::npos) continue;
    const std::size_t second = line.find('.', first + 1);
    if (second == std::string_view::npos || !pieces::number<std::uint16_t>(line.substr(0, first)) ||
        !pieces::number<std::uint16_t>(line.substr(first + 1, second - first - 1)))
      continue;
    const std::string_view release = line.substr(second + 1);
    if (release.empty() || release.size() > kLongestRelease) continue;
    if (std::all_of(release.begin(), release.end(), [](char c) { return c >= ' ' && c <= '~'; }))
      return VersionLine{std::string(line), end + 1};
  }
  return std::nullopt;
}

namespace {

/// Goes through the chunks of an answer; `each` is shown the bytes of every whole one.
template <class Each>
FrameVerdict walk_samples(std::string_view bytes, std::size_t wanted, std::string_view mask,
                          std::int64_t& error, Each each) {
  std::size_t at = 0;
  for (std::size_t got = 0; got < wanted;) {
    const auto [line, length] = number_line(bytes.substr(at));
    if (line.check != FrameCheck::kComplete) return line;
    at += line.length;
    if (length <= 0) {
      error = length;
      return {FrameCheck::kComplete, at};
    }
    const auto size = static_cast<std::uint64_t>(length);
    if (size > wanted - got) return {FrameCheck::kInvalid, 0};
    if (got == 0) {
      const std::string_view said = bytes.substr(at, mask.size() + 1);
      const std::string expected = std::string(mask) + "\n";
      if (!std::string_view(expected).starts_with(said)) return {FrameCheck::kInvalid, 0};
      if (said.size() < expected.size()) return {FrameCheck::kNeedMore, 0};
      at += expected.size();
    }
    if (bytes.size() - at < size) return {FrameCheck::kNeedMore, 0};
    each(bytes.substr(at, size));
    at += size;
    got += size;
  }
  return {FrameCheck::kComplete, at};
}

}  // namespace

FrameVerdict check_samples(std::string_view bytes, std::size_t wanted, std::string_view mask) {
  std::int64_t error = 0;
  return walk_samples(bytes, wanted, mask, error, [](std::string_view) {});
}

Samples samples_of(std::string_view reply, std::string_view mask) {
  // The reply is whole, so that it holds no more than was wanted.
  Samples samples;
  walk_samples(reply, reply.size(), mask, samples.error,
               [&](std::string_view chunk) { samples.bytes += chunk; });
  return samples;
}

// Scans.

std::optional<ScanLayout> lay_out(const Device& device) {
  constexpr std::size_t kWord = 32;
  std::vector<std::size_t> chosen;  // Places in the list of channels.
  const auto choose = [&](std::string_view id) {
    const Channel* const channel = device.find(id);
    const bool usable = channel != nullptr && channel->index && channel->format;
    if (usable) chosen.push_back(static_cast<std::size_t>(channel - device.channels.data()));
    return usable;
  };
  if (!choose("accel_x") || !choose("accel_y") || !choose("accel_z")) return std::nullopt;
  choose("timestamp");

  ScanLayout layout;
  const std::size_t words = (device.channels.size() + kWord - 1) / kWord;
  std::vector<std::uint32_t> mask(words);
  for (const std::size_t number : chosen) mask[number / kWord] |= std::uint32_t{1} << (number % kWord);
  for (std::size_t n = words; n > 0; --n) layout.mask += fmt::format("{:08x}", mask[n - 1]);

  // In the order of their indices, each at a multiple of its own size.
  std::vector<std::size_t> order{0, 1, 2};
  if (chosen.size() == 4) order.push_back(3);
  const auto channel = [&](std::size_t k) -> const Channel& { return device.channels[chosen[k]]; };
  std::sort(order.begin(), order.end(),
            [&](std::size_t a, std::size_t b) { return *channel(a).index < *channel(b).index; });
  for (const std::size_t k : order) {
    const SampleFormat& format = *channel(k).format;
    const Place place{format, (layout.size + format.bytes - 1) / format.bytes * format.bytes};
    layout.size = place.offset + format.bytes;
    if (k < 3)
      layout.axes[k] = place;
    else
      layout.timestamp = place;
  }
  for (std::size_t n = 1; n < order.size(); ++n)
    if (*channel(order[n - 1]).index == *channel(order[n]).index) return std::nullopt;
  return layout;
}

Raw value_at(std::string_view scan, const Place& place) {
  const SampleFormat& format = place.format;
  std::uint64_t word = 0;
  for (std::size_t n = 0; n < format.bytes; ++n) {
    const std::size_t at = format.big_endian ? n : format.bytes - 1 - n;
    word = word << 8U | static_cast<unsigned char>(scan[place.offset + at]);
  }
  const std::uint64_t all =
      format.bits == 64 ? std::numeric_limits<std::uint64_t>::max() : (std::uint64_t{1} << format.bits) - 1;
  word = word >> format.shift & all;
  if (!format.is_signed) return {static_cast<std::int64_t>(word), word == 0 || word == all};
  const std::uint64_t sign = std::uint64_t{1} << (format.bits - 1);
  const auto value = static_cast<std::int64_t>((word & sign) != 0 ? word | ~all : word);
  return {value, word == sign || word == sign - 1};
}

}  // namespace abcal::iio
