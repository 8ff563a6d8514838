#include "app/bench_file/item_identity.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>

#include "app/bench_file/instrument_ports.h"
#include "drivers/instrument/driver_catalogue.h"
#include "drivers/text/names.h"
#include "drivers/text/text.h"
#include "protocol/record/run_label.h"

namespace abcal {
namespace {

constexpr std::string_view kMaker = "maker", kModel = "model", kSerialNumber = "serial_number";

/// Runs of letters and digits in small letters. Bytes beyond ASCII belong to letters.
std::vector<std::string> plain_words(std::string_view text) {
  std::vector<std::string> words(1);
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte >= 0x80 || std::isalnum(byte) != 0) {
      words.back() += static_cast<char>(std::tolower(byte));
    } else if (!words.back().empty()) {
      words.emplace_back();
    }
  }
  if (words.back().empty()) words.pop_back();
  return words;
}

bool contains(const std::vector<std::string>& text, const std::vector<std::string>& part) {
  return !part.empty() && std::search(text.begin(), text.end(), part.begin(), part.end()) != text.end();
}

bool begins_with(const std::vector<std::string>& text, const std::vector<std::string>& part) {
  return !part.empty() && part.size() <= text.size() && std::equal(part.begin(), part.end(), text.begin());
}

IdentityPart part_of(std::string_view key, std::string_view words, const std::string& stated,
                     const std::string& reported) {
  return {std::string(key), std::string(words), std::string(pieces::trimmed(stated)),
          std::string(pieces::trimmed(reported))};
}

/// The names of the parts that are known in one way: "maker and model".
std::string names_of(const ItemIdentityParts& parts, KnownBy known_by) {
  std::vector<std::string> names;
  for (const IdentityPart& part : parts)
    if (part.known_by() == known_by) names.push_back(part.words);
  std::string text;
  for (std::size_t i = 0; i < names.size(); ++i)
    text += (i == 0 ? "" : i + 1 == names.size() ? " and " : ", ") + names[i];
  return text;
}

}  // namespace

const std::vector<ItemFact> kItemSettings{{"Range", "item.range"},
                                          {"Filter", "item.filter"},
                                          {"Firmware", "item.firmware"},
                                          {"Supply", "item.supply"}};
const std::vector<ItemFact> kItemMounting{{"Reference surface", "item.reference_surface"},
                                          {"Direction marks", "item.direction_marks"},
                                          {"Fasteners", "item.fasteners"},
                                          {"Tightening torque", "item.torque"},
                                          {"Cable", "item.cable"}};

constexpr auto kKnownBy = names<KnownBy>(
    {{KnownBy::kRead, "read"}, {KnownBy::kStated, "stated"}, {KnownBy::kNothing, "not known"}});

std::string_view to_string(KnownBy known_by) {
  return kKnownBy.of(known_by, "not known");
}

bool IdentityPart::agrees() const {
  if (stated.empty() || reported.empty() || stated == reported) return true;
  if (key == kSerialNumber) return false;
  const std::vector<std::string> by_file = plain_words(stated), found = plain_words(reported);
  if (key == kMaker) return contains(by_file, found) || contains(found, by_file);
  return begins_with(by_file, found) || begins_with(found, by_file);
}

KnownBy IdentityPart::known_by() const {
  if (!reported.empty()) return KnownBy::kRead;
  return stated.empty() ? KnownBy::kNothing : KnownBy::kStated;
}

ItemNames reported_by_item(const std::string& driver, const std::string& output_unit,
                           const ItemNames& instrument) {
  if (driver == kSimulated) return {};
  const DriverTraits traits = find_in(driver_catalogue().accelerometers, driver).traits;
  if (traits.reads_volts || output_unit.ends_with("V")) return {};
  ItemNames names = instrument;
  if (!traits.reports_maker) names.maker.clear();
  if (!traits.reports_model) names.model.clear();
  return names;
}

ItemIdentityParts identity_parts(const ItemNames& stated, const ItemNames& reported) {
  return {part_of(kMaker, "maker", stated.maker, reported.maker),
          part_of(kModel, "model", stated.model, reported.model),
          part_of(kSerialNumber, "serial number", stated.serial_number, reported.serial_number)};
}

ItemIdentityParts identity_parts(const RunHeader& header, const std::string& driver) {
  const auto label = [&](std::string_view key) {
    return label_of(header.labels, fmt::format("item.{}", key));
  };
  const ItemNames stated{label(kMaker), label(kModel), label(kSerialNumber)};
  const auto instrument =
      std::ranges::find(header.instruments, std::string_view("accelerometer"), &InstrumentIdentity::role);
  if (instrument == header.instruments.end()) return identity_parts(stated, ItemNames{});
  return identity_parts(stated,
                        reported_by_item(driver, header.response_unit,
                                         {instrument->maker, instrument->model, instrument->serial_number}));
}

std::string difference(const IdentityPart& part) {
  if (part.agrees()) return {};
  return fmt::format(
      "{} is \"{}\" as the instrument reports it; required: \"{}\", as [item] {} states it. Connect the item "
      "that the bench file names, or write {} = \"{}\" if the instrument that answers is the item",
      part.words, part.reported, part.stated, part.key, part.key, part.reported);
}

std::string in_words(const ItemNames& names) {
  return fmt::format("{} {}{}{}", names.maker, names.model,
                     names.serial_number.empty() ? "" : ", serial number ", names.serial_number);
}

std::string describe_sources(const ItemIdentityParts& parts) {
  const std::string read = names_of(parts, KnownBy::kRead), stated = names_of(parts, KnownBy::kStated);
  std::string text;
  if (!read.empty()) text = read + " read from the instrument";
  if (!stated.empty()) text += (text.empty() ? "" : "; ") + stated + " stated, not read";
  return text;
}

}  // namespace abcal
