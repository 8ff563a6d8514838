#pragma once

#include <cstddef>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>

namespace abcal::console {

/// The longest text of an item: a serial number has some tens of characters.
constexpr std::size_t kLongestItemText = 100;

/// The item that is to be calibrated, as a person chose or scanned it.
struct ItemChoice {
  std::string maker, model;
  std::string serial_number;    ///< Never empty.
  std::string customer_number;  ///< The owner's own; empty: not stated.
};

/// What a person chose for a run; what is absent is as the bench file says.
struct RunChoice {
  std::optional<ItemChoice> item;
  std::optional<int> steps;           ///< Angles of each experiment, over a whole turn.
  std::optional<int> dwell_readings;  ///< At each angle.
  std::string estimator;
  bool without_missing_items = false;  ///< Of several items those that are not there are left out.
  /// Of the bench file's bytes when the person looked at it; empty: whatever it says now.
  std::string bench_sha256;
  /// What tells one form from another: each starts one run at most; empty: any number.
  std::string form;
};

/// A choice that is not understood. what() says what was found and required.
/// Reads the members "item", "steps", "dwell_readings", "estimator", "without_missing_items", "bench_sha256",
/// "form" of an object; others are left to the caller.
/// @throws RequestError (request.h)
RunChoice parse_run_choice(const nlohmann::json& object);
/// The same of the fields of an address: "serial_number", "maker", "model", "customer_number" and the others
/// as above. @throws RequestError
RunChoice parse_run_choice(const std::map<std::string, std::string>& fields);

/// Refuses a text that is longer than `most` bytes, has control characters, or characters that turn the
/// direction of writing. @throws RequestError
void require_plain_text(const char* name, const std::string& text, std::size_t most);

nlohmann::ordered_json to_json(const RunChoice& choice);

}  // namespace abcal::console
