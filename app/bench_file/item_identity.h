#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "drivers/text/message.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// A fact of an item: its name in words, and its label in a run.
struct ItemFact {
  Term words;
  std::string label;
};

/// Beginning of these labels.
inline constexpr std::string_view kItemLabel = "item.";
/// How the item was set up, and how it was mounted; in the order of a page.
extern const std::vector<ItemFact> kItemSettings, kItemMounting;

/// How a part of an item's identity is known.
enum class KnownBy {
  kNothing,
  kStated,  ///< The bench file states it; the instrument does not report it.
  kRead,    ///< The instrument reports it.
};

/// "read", "stated", "not known"
std::string_view to_string(KnownBy known_by);

/// The parts of an item's identity.
struct ItemNames {
  std::string maker, model, serial_number;
};

/// "Maker Model, serial number 7"; without a serial number "Maker Model".
std::string in_words(const ItemNames& names);

/// One part of an item's identity, as the bench file states it and as the instrument reports it.
struct IdentityPart {
  std::string key;       ///< "maker", "model", "serial_number", as in [item].
  std::string words;     ///< "maker", "model", "serial number"
  std::string stated;    ///< Empty: not stated.
  std::string reported;  ///< Empty: not reported.

  /// Whether nothing contradicts: a serial number equals the reported one. Of a maker and a model, letter
  /// case and punctuation do not count; the words of one maker are found in the other ("MicroStrain" in
  /// "MicroStrain by HBK"), and one model begins with the words of the other ("3DM-GV7" and "3DM-GV7-AR").
  bool agrees() const;
  KnownBy known_by() const;
  /// The stated text, or the reported one if none is stated.
  const std::string& text() const { return stated.empty() ? reported : stated; }
};

/// Maker, model and serial number, in this order.
using ItemIdentityParts = std::array<IdentityPart, 3>;

/// Identity that a driver's instrument reports of the item itself: nothing of it for a voltmeter, which is
/// not the item, and for the simulated accelerometer, which has no identity of its own.
/// @param driver  name in the bench file  @param output_unit  unit of the readings
ItemNames reported_by_item(const std::string& driver, const std::string& output_unit,
                           const ItemNames& instrument);

/// @param reported  as reported_by_item() gives it
ItemIdentityParts identity_parts(const ItemNames& stated, const ItemNames& reported);

/// As the header of a stored run has them.
/// @param header  read for this item, so that labels and accelerometer are those of the item
/// @param driver  of the item's accelerometer
ItemIdentityParts identity_parts(const RunHeader& header, const std::string& driver);

/// A sentence on what is reported, what is stated and what to do, for an item on the bench; empty if they
/// agree.
std::string difference(const IdentityPart& part);

/// "maker and model read from the instrument; serial number stated, not read", in this form; parts that are
/// not known are left out.
std::string describe_sources(const ItemIdentityParts& parts);

}  // namespace abcal
