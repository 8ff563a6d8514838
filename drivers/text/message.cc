#include "drivers/text/message.h"

#include <algorithm>

namespace abcal {
namespace {

using message_detail::next_place;
using message_detail::Place;

/// A sentence with each of its places replaced.
template <class Replacement>
std::string filled(std::string_view sentence, const Replacement& replacement) {
  std::string text;
  std::size_t at = 0;
  for (Place place = next_place(sentence, 0); place.begin != std::string_view::npos;
       place = next_place(sentence, place.end)) {
    text += sentence.substr(at, place.begin - at);
    text += replacement(place.name);
    at = place.end;
  }
  return text.append(sentence.substr(at));
}

/// Whether a sentence has a letter outside its places: others are the same in every language.
bool has_words(std::string_view sentence) {
  const std::string text = filled(sentence, [](std::string_view) { return std::string(); });
  return std::any_of(text.begin(), text.end(),
                     [](char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); });
}

/// Renders messages and their values.
struct Renderer {
  const Catalogue& catalogue;
  std::string_view decimal_mark = ".";
  bool complete = true;

  std::string operator()(const Stated& value) { return value.text; }
  std::string operator()(const Number& value) {
    std::string text;
    for (const char c : value.digits) c == '.' ? text += decimal_mark : text += c;
    return text;
  }
  std::string operator()(const Joined& value) {
    std::string text;
    for (const Message& message : value.messages) {
      if (&message != &value.messages.front()) text += value.separator;
      text += (*this)(message);
    }
    return text;
  }
  std::string operator()(const Message& message) {
    std::string_view sentence = message.id();
    if (sentence.empty() && !message.empty()) {
      complete = false;
      return std::get<Stated>(message.values().front().value).text;
    }
    const std::optional<std::string_view> translation = catalogue(sentence);
    if (translation)
      sentence = *translation;
    else
      complete = complete && !has_words(sentence);
    return filled(sentence, [&](std::string_view name) {
      const auto found = std::find_if(message.values().begin(), message.values().end(),
                                      [&](const NamedValue& value) { return value.name == name; });
      return found == message.values().end() ? fmt::format("{{{}}}", name) : std::visit(*this, found->value);
    });
  }
};

}  // namespace

namespace message_detail {

void a_sentence_needs_a_value_for_each_named_place() {}

}  // namespace message_detail

void Message::add(std::string_view english, std::vector<NamedValue> values) {
  id_ = filled(english, [](std::string_view name) { return fmt::format("{{{}}}", name); });
  values_ = std::move(values);
}

Message Message::bare(std::string text) {
  return stored({}, {}, std::move(text));
}

Message Message::stored(std::string id, std::vector<NamedValue> values, std::string text) {
  Message message;
  message.id_ = std::move(id);
  message.values_ = std::move(values);
  if (message.id_.empty()) {
    message.values_.clear();
    if (!text.empty()) message.values_.push_back({"text", Stated{std::move(text)}});
  }
  return message;
}

bool Message::empty() const {
  return id_.empty() && values_.empty();
}

std::string Message::english() const {
  const Catalogue same = [](std::string_view sentence) { return std::optional(sentence); };
  return Renderer{same}(*this);
}

Rendered Message::rendered(const Catalogue& catalogue) const {
  Renderer renderer{catalogue, catalogue(".").value_or(".")};
  std::string text = renderer(*this);
  return {std::move(text), renderer.complete};
}

Message in_sequence(std::vector<Message> messages, std::string separator) {
  if (messages.empty()) return {};
  if (messages.size() == 1) return messages.front();
  return {"{all}", Joined{std::move(messages), std::move(separator)}};
}

Message message_of(const std::exception& error) {
  const auto* told = dynamic_cast<const Told*>(&error);
  return told != nullptr ? told->message() : Message::bare(error.what());
}

Message word_of(std::span<const Term> vocabulary, std::string_view text) {
  for (const Term& term : vocabulary)
    if (term.english() == text) return term;
  return {"{text}", text};
}

bool contains(const Message& whole, const Message& part) {
  if (whole == part) return true;
  const auto in = [&](const Message& message) { return contains(message, part); };
  return std::ranges::any_of(whole.values(), [&](const NamedValue& named) {
    if (const auto* message = std::get_if<Message>(&named.value)) return in(*message);
    const auto* list = std::get_if<Joined>(&named.value);
    return list != nullptr && std::ranges::any_of(list->messages, in);
  });
}

}  // namespace abcal
