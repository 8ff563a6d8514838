#include "app/laboratory/certificate/country_name.h"

#include <unicode/locid.h>
#include <unicode/unistr.h>

namespace abcal {

std::string country_name(const std::string& code, const std::string& language) {
  icu::UnicodeString name;
  icu::Locale("", code.c_str()).getDisplayCountry(icu::Locale(language.c_str()), name);
  std::string text;
  name.toUTF8String(text);
  return text == code ? std::string() : text;
}

}  // namespace abcal
