#pragma once

#include <nlohmann/json_fwd.hpp>
#include <vector>

#include "drivers/text/message.h"

namespace abcal {

/// {"text": in English, "id": the sentence with named places, "values": {name: value}}. A value is one of
///   - a text that is the same in every language,
///   - {"number": digits},
///   - a message,
///   - {"messages": [...], "separator": text}.
/// A message of which only the text is known has no "id" and no "values".
nlohmann::ordered_json message_json(const Message& message);

/// The message of a JSON of message_json(). @throws nlohmann::json::exception if it is none
Message message_from_json(const nlohmann::ordered_json& json);

/// The different messages with an id, in their order; none is there twice.
nlohmann::ordered_json messages_json(const std::vector<Message>& messages);

}  // namespace abcal
