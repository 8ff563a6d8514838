#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace abcal::console {

/// Where an HTTP request goes: its target, taken apart. Reading it is separate from answering it.
struct Target {
  std::string path;                ///< As it was sent, before "?": "/runs/a%20b.run/result".
  std::vector<std::string> words;  ///< Its parts, decoded: "runs", "a b.run", "result". Any bytes, "/" too.
};

/// A target in absolute form ("http://bench7:8080/runs", RFC 9112, section 3.2.2) in origin form ("/runs"),
/// if its authority equals the header Host but for case. Any other target is returned unchanged.
std::string in_origin_form(std::string_view target, std::string_view host);

/// Reads a target in origin form (RFC 9112, section 3.2.1).
/// @return nullopt if it is not one
std::optional<Target> parse_target(std::string_view text);

/// Reads the fields of a form (application/x-www-form-urlencoded), decoded. The first of two with one name
/// counts. @return nullopt if it is not a form
std::optional<std::map<std::string, std::string>> parse_form(std::string_view body);
/// A field of such a form; empty: absent.
std::string field_of(const std::map<std::string, std::string>& form, const std::string& name);

}  // namespace abcal::console
