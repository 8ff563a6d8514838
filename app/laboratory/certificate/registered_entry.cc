#include "app/laboratory/certificate/registered_entry.h"

#include <fmt/format.h>

#include <regex>
#include <stdexcept>

namespace abcal {

std::string reference_of(const RegisteredEntry& registered) {
  return fmt::format("register {}, entry {}, SHA-256 {}", registered.register_identity, registered.entry,
                     registered.sha256);
}

std::optional<RegisteredEntry> registered_entry_of(const XmlQuery& certificate) {
  constexpr const char* kStatement =
      "dcc:administrativeData/dcc:statements/dcc:statement[@refType='abc_register']";
  if (!certificate.any(kStatement)) return std::nullopt;
  const std::string reference = certificate.text(std::string(kStatement) + "/dcc:reference");
  static const std::regex kForm("register ([0-9a-f]+), entry ([1-9][0-9]{0,17}), SHA-256 ([0-9a-f]{64})");
  std::smatch parts;
  if (!std::regex_match(reference, parts, kForm))
    throw std::invalid_argument(fmt::format(
        "the certificate's statement abc_register is \"{}\"; required: register IDENTITY, entry NUMBER, "
        "SHA-256 and 64 hexadecimal digits",
        reference));
  return RegisteredEntry{parts[1], std::stoll(parts[2]), parts[3]};
}

}  // namespace abcal
