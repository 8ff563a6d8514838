#pragma once

#include <string>
#include <string_view>
#include <type_traits>
#include <unordered_map>
#include <vector>

#include "drivers/text/message.h"

namespace abcal {

/// A text of a certificate, and in which language it is (ISO 639-1); empty: in none, a name or a number.
struct Wording {
  std::string text;
  std::string language;
};

/// The program's own sentences in the language of a certificate. The code has them in English; a further
/// language is one file, app/laboratory/certificate/languages/CODE.po, with all of them.
class Words {
 public:
  /// @throws std::invalid_argument  for a language without a file, listing the available ones
  explicit Words(std::string_view language = "en");

  const std::string& language() const { return language_; }

  /// A sentence of the program, a literal, with its values. A text that is not a literal does not compile.
  template <class... Values>
  Wording operator()(Sentence<std::type_identity_t<Values>...> sentence, const Values&... values) const {
    return (*this)(Message(sentence, values...));
  }
  /// A message; in no language if the language's file lacks a sentence of it.
  Wording operator()(const Message& message) const;
  /// A text of the laboratory, which writes in the language of its certificate.
  Wording as_given(std::string_view text) const { return {std::string(text), language_}; }

  /// Codes of the available languages: "en" and those with a file.
  static std::vector<std::string> languages();

 private:
  std::string language_;
  const std::unordered_map<std::string, std::string>* table_ = nullptr;  ///< Null: English.
};

/// Words that come as text, from files and tables of the program.
inline constexpr Term kQuantities[]{"angle",    "gravity", "voltage",      "temperature", "humidity",
                                    "pressure", "level",   "stage record", "other"},
    kRoles[]{"stage", "accelerometer"}, kDistributions[]{"normal", "rectangular", "triangular", "u-shaped"},
    kPlaces[]{"laboratory", "customer", "laboratoryBranch", "customerBranch"},
    kConformityWords[]{"pass", "conditionalPass", "conditionalFail", "fail"},
    kVerdicts[]{"usable", "doubtful", "not_usable"},
    kRunStates[]{"running", "interrupted", "complete", "abandoned"};

/// Sentences that a language's file lacks.
std::vector<std::string> missing_in_language(const std::string& language,
                                             const std::vector<std::string>& sentences);

}  // namespace abcal
