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

/// A person's choices for a run. Where absent, the values of the bench file apply.
struct RunChoice {
  std::optional<ItemChoice> item;
  std::optional<int> steps;           ///< Angles of each experiment, over a whole turn.
  std::optional<int> dwell_readings;  ///< Readings at each angle.
  std::string estimator;
  bool without_missing_items = false;  ///< Missing ones of several items are left out.
  /// SHA-256 of the bench file when the person saw it; empty: any content is accepted.
  std::string bench_sha256;
  /// Identifies the form, which starts one run at most; empty: not limited.
  std::string form;
};

/// Reads the members "item", "steps", "dwell_readings", "estimator", "without_missing_items", "bench_sha256",
/// "form" of an object; others are left to the caller.
/// @throws RequestError (request.h) that states what was found and what is required
RunChoice parse_run_choice(const nlohmann::json& object);
/// Reads a choice from the fields of a URL query: "serial_number", "maker", "model", "customer_number" and
/// the others as above. @throws RequestError
RunChoice parse_run_choice(const std::map<std::string, std::string>& fields);

/// Refuses a text that is longer than `most` bytes, or has control characters or characters that change the
/// direction of writing. @throws RequestError
void require_plain_text(const char* name, const std::string& text, std::size_t most);

nlohmann::ordered_json to_json(const RunChoice& choice);

}  // namespace abcal::console
