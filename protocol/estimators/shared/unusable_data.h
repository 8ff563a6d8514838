#pragma once

#include <stdexcept>
#include <string>
#include <utility>

#include "protocol/messages/message.h"

namespace abcal {

/// These data cannot be analysed: they contradict the assumptions of the analysis, or do not determine its
/// result. what() states the value found and the value required. An estimator refuses data with this
/// exception only; any other exception that leaves it is a fault of the program.
class UnusableData : public std::runtime_error {
 public:
  explicit UnusableData(Message message)
      : std::runtime_error(message.english()), message_(std::move(message)) {}
  explicit UnusableData(const std::string& text) : UnusableData(Message::bare(text)) {}
  const Message& message() const { return message_; }

 private:
  Message message_;
};

}  // namespace abcal
