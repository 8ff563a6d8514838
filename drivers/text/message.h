#pragma once

#include <fmt/format.h>

#include <exception>
#include <functional>
#include <iosfwd>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

namespace abcal {

/// A text that is the same in every language: a name, a symbol, whatever a person wrote. No catalogue accepts
/// it.
struct Stated {
  std::string text;
};

/// A number, by its digits with a decimal point; each language has its own decimal mark.
struct Number {
  std::string digits;
};

namespace message_detail {

/// Calling it in a constant expression is the compiler's error message.
void a_sentence_needs_a_value_for_each_named_place();

/// The next place "{name}" or "{name:.3g}" of a sentence.
struct Place {
  std::size_t begin = std::string_view::npos, end = 0;  ///< npos: there is no further place.
  std::string_view name, spec;
};

constexpr Place next_place(std::string_view english, std::size_t from) {
  Place place;
  place.begin = english.find('{', from);
  if (place.begin == std::string_view::npos) return place;
  const std::size_t close = english.find('}', place.begin);
  if (close == std::string_view::npos) a_sentence_needs_a_value_for_each_named_place();
  place.end = close + 1;
  place.name = english.substr(place.begin + 1, close - place.begin - 1);
  if (const std::size_t colon = place.name.find(':'); colon != std::string_view::npos) {
    place.spec = place.name.substr(colon + 1);
    place.name = place.name.substr(0, colon);
  }
  return place;
}

/// The number of places of a sentence, each of which has a name of its own.
constexpr std::size_t places_of(std::string_view english) {
  std::size_t count = 0;
  for (Place place = next_place(english, 0); place.begin != std::string_view::npos;
       place = next_place(english, place.end), ++count) {
    if (place.name.empty()) a_sentence_needs_a_value_for_each_named_place();
    for (const char c : place.name)
      if (!((c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_'))
        a_sentence_needs_a_value_for_each_named_place();
    for (Place before = next_place(english, 0); before.begin < place.begin;
         before = next_place(english, before.end))
      if (before.name == place.name) a_sentence_needs_a_value_for_each_named_place();
  }
  return count;
}

}  // namespace message_detail

/// A sentence or word of the program, in English, with a named place for each value: "{found} of {all}", or
/// "{found:.3g}" with the format of a number. It is made only from a literal. It does not compile with
/// another number of values, or with a place that has no name or that of another place.
template <class... Values>
class Sentence {
 public:
  template <std::size_t kSize>
  // NOLINTNEXTLINE(google-explicit-constructor): a literal is a sentence.
  consteval Sentence(const char (&english)[kSize]) : english_(english, kSize - 1) {
    if (message_detail::places_of(english_) != sizeof...(Values))
      message_detail::a_sentence_needs_a_value_for_each_named_place();
  }
  constexpr std::string_view english() const { return english_; }
  constexpr bool empty() const { return english_.empty(); }
  // NOLINTNEXTLINE(google-explicit-constructor): English is what the code and its logs are written in.
  constexpr operator std::string_view() const { return english_; }
  friend constexpr bool operator==(const Sentence& a, std::string_view english) {
    return a.english_ == english;
  }

 private:
  std::string_view english_;
};

/// A word or sentence of the program without values.
using Term = Sentence<>;

/// Translations by their English sentences; absent: the catalogue does not have the sentence. The entry "."
/// is the decimal mark.
using Catalogue = std::function<std::optional<std::string_view>(std::string_view english)>;

/// A message in a language.
struct Rendered {
  std::string text;
  bool complete = true;  ///< The catalogue has every sentence of it.
};

struct NamedValue;

/// A sentence of the program with its values. What it says is known without looking into a text: by its `id`,
/// which is the English sentence with named places, and by its values.
class Message {
 public:
  /// No message: an empty text.
  Message() = default;
  /// Values are numbers, messages, lists of them (Joined); all others are the same in every language.
  template <class... Values>
  // NOLINTNEXTLINE(google-explicit-constructor): a term is a message.
  Message(Sentence<std::type_identity_t<Values>...> sentence, const Values&... values);

  /// A text of which no sentence is known: a file of an earlier version, the message of an exception. It is
  /// rendered unchanged, and is in no language.
  static Message bare(std::string text);
  /// A message that was stored, with its values; bare if it has no id.
  static Message stored(std::string id, std::vector<NamedValue> values, std::string text);

  /// The English sentence with its places, without formats of numbers; empty: bare, or no message.
  const std::string& id() const { return id_; }
  const std::vector<NamedValue>& values() const { return values_; }
  bool empty() const;

  std::string english() const;
  Rendered rendered(const Catalogue& catalogue) const;
  // NOLINTNEXTLINE(google-explicit-constructor): English is what the code and its logs are written in.
  operator std::string() const { return english(); }

  friend bool operator==(const Message& a, const Message& b) {
    return a.id_ == b.id_ && a.english() == b.english();
  }
  friend bool operator==(const Message& a, std::string_view english) { return a.english() == english; }
  friend std::string operator+(const std::string& text, const Message& more) { return text + more.english(); }
  template <class Traits>
  friend std::basic_ostream<char, Traits>& operator<<(std::basic_ostream<char, Traits>& stream,
                                                      const Message& message) {
    return stream << message.english();
  }

 private:
  void add(std::string_view english, std::vector<NamedValue> values);

  std::string id_;
  std::vector<NamedValue> values_;
};

/// Messages one after the other, as one value.
struct Joined {
  std::vector<Message> messages;
  std::string separator = "; ";
};

/// A value of a message.
struct NamedValue {
  std::string name;
  std::variant<Stated, Number, Message, Joined> value;
};

/// An exception that knows its message, beside its what() in English.
class Told {
 public:
  virtual ~Told() = default;
  virtual Message message() const = 0;
};

/// An exception of a kind that is told by a message: throw Telling<std::runtime_error>(Message("..."));
template <class Base>
class Telling : public Base, public Told {
 public:
  explicit Telling(Message message) : Base(message.english()), message_(std::move(message)) {}
  Message message() const override { return message_; }

 private:
  Message message_;
};

/// The message of an exception: bare if it is not Told.
Message message_of(const std::exception& error);

/// Messages one after the other, as one message; that of a single one is itself.
Message in_sequence(std::vector<Message> messages, std::string separator = "; ");

/// A word that comes as text, e.g. from a file: one of the vocabulary is a message; any other text is the
/// same in every language.
Message word_of(std::span<const Term> vocabulary, std::string_view text);

/// Whether a message is another one or has it among its values.
bool contains(const Message& whole, const Message& part);

namespace message_detail {

template <class Value>
NamedValue value_of(const Value& value, const Place& place) {
  NamedValue named{std::string(place.name), {}};
  if constexpr (std::is_same_v<Value, Message> || std::is_same_v<Value, Joined> ||
                std::is_same_v<Value, Number> || std::is_same_v<Value, Stated>)
    named.value = value;
  else if constexpr (std::is_same_v<Value, std::vector<Message>>)
    named.value = Joined{value};
  else if constexpr (std::is_same_v<Value, Term>)
    named.value = Message(value);
  else if constexpr (std::is_same_v<Value, char>)
    named.value = Stated{std::string(1, value)};
  else if constexpr (std::is_arithmetic_v<Value>)
    named.value = Number{fmt::format(fmt::runtime(fmt::format("{{:{}}}", place.spec)), value)};
  else
    named.value = Stated{std::string(std::string_view(value))};
  return named;
}

}  // namespace message_detail

template <class... Values>
Message::Message(Sentence<std::type_identity_t<Values>...> sentence, const Values&... values) {
  std::vector<NamedValue> named;
  std::size_t at = 0;
  [[maybe_unused]] const auto add_next = [&](const auto& value) {
    const message_detail::Place place = message_detail::next_place(sentence.english(), at);
    named.push_back(message_detail::value_of(value, place));
    at = place.end;
  };
  (add_next(values), ...);
  add(sentence.english(), std::move(named));
}

}  // namespace abcal

template <>
struct fmt::formatter<abcal::Message> : fmt::formatter<std::string_view> {
  template <class Context>
  auto format(const abcal::Message& message, Context& context) const {
    return fmt::formatter<std::string_view>::format(message.english(), context);
  }
};
template <>
struct fmt::formatter<abcal::Term> : fmt::formatter<std::string_view> {
  template <class Context>
  auto format(const abcal::Term& term, Context& context) const {
    return fmt::formatter<std::string_view>::format(term.english(), context);
  }
};
