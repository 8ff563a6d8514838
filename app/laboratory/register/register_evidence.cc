#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>

#include "app/laboratory/register/register.h"

namespace abcal::lab {
namespace {

constexpr const char* kRollback = "rollback";
constexpr const char* kFork = "fork";
constexpr const char* kRewriting = "rewriting";
constexpr const char* kForkOrRewriting = "fork or rewriting";
constexpr const char* kCopiedBack = "the register was copied back, or its last entries were removed";

std::string words_of(const AuditEntry& entry) {
  return fmt::format("\"{}\" of {} by {} at {}", entry.what, entry.subject, entry.who, entry.utc);
}

/// Whether two entries record the same act, though one of them may have been altered: an act that was
/// replaced has another time and other contents.
bool is_same_act(const AuditEntry& a, const AuditEntry& b) {
  return a.utc == b.utc || (a.who == b.who && a.what == b.what && a.subject == b.subject &&
                            a.before_json == b.before_json && a.after_json == b.after_json);
}

/// Whether the entry gave its number to a certificate.
bool gave_number_to(const AuditEntry& entry, const NamedCertificate& certificate) {
  const nlohmann::json after = nlohmann::json::parse(entry.after_json, nullptr, false);
  return entry.subject == "certificate/" + certificate.number && after.is_object() &&
         after.value("run_sha256", "") == certificate.run_sha256;
}

/// The first entry at which a register differs from its backup.
RegisterFinding differs_from_backup(const RegisterEvidence& evidence, const std::vector<AuditEntry>& entries,
                                    std::size_t first) {
  const AuditEntry &named = evidence.audit[first], &found = entries[first];
  const std::size_t last = std::min(evidence.audit.size(), entries.size()) - 1;
  const bool rewritten = is_same_act(evidence.audit[last], entries[last]);
  return {
      fmt::format("{}, entry {}", evidence.name, named.entry), false,
      fmt::format("{}: found {} with SHA-256 {}; required: {} with SHA-256 {}; {}",
                  rewritten ? kRewriting : kFork, words_of(found), found.chain, words_of(named), named.chain,
                  rewritten ? "the entry was changed, and the chain rebuilt from it on"
                            : fmt::format("the register was copied back to entry {} or before, and "
                                          "continued otherwise",
                                          first)),
      rewritten ? kRewriting : kFork};
}

RegisterFinding differs_from_head(const RegisterEvidence& evidence, const AuditEntry& found) {
  const char* kind = kForkOrRewriting;
  std::string why = "the register was copied back and continued otherwise, or rewritten";
  if (evidence.certificate && gave_number_to(found, *evidence.certificate)) {
    kind = kRewriting;
    why = "the entry, or one before it, was changed and the chain rebuilt from it on";
  } else if (evidence.certificate) {
    kind = kFork;
    why = fmt::format(
        "the entry that gave number {} to run {} is another one now: the register was copied back and "
        "continued otherwise",
        evidence.certificate->number, evidence.certificate->run_sha256);
  }
  return {fmt::format("{}, entry {}", evidence.name, found.entry), false,
          fmt::format("{}: found SHA-256 {} ({}); required: {}; {}", kind, found.chain, words_of(found),
                      evidence.head->sha256, why),
          kind};
}

RegisterFinding compare_certificate(const std::string& name, const NamedCertificate& certificate,
                                    const std::vector<CertificateRecord>& registered) {
  const std::string what = fmt::format("{}, number {}", name, certificate.number);
  const auto found = std::find_if(registered.begin(), registered.end(), [&](const CertificateRecord& one) {
    return one.number == certificate.number;
  });
  if (found == registered.end())
    return {what, false,
            fmt::format("{}: found no certificate of this number; required: one of run {}; {}, or this is "
                        "not its register",
                        kRollback, certificate.run_sha256, kCopiedBack),
            kRollback};
  if (found->run_sha256 != certificate.run_sha256)
    return {what, false,
            fmt::format("{}: found the number given to run {}; required: run {}; the number was given twice",
                        kFork, found->run_sha256, certificate.run_sha256),
            kFork};
  if (found->state == "reserved")
    return {what, false,
            fmt::format("{}: found a number that is not issued yet; required: issued; {}, or the program "
                        "ended while it issued: `abcal issue` then completes it",
                        kRollback, kCopiedBack),
            kRollback};
  if (found->xml_sha256 != certificate.xml_sha256)
    return {what, false,
            fmt::format("{}: found SHA-256 {} of the XML that was approved; required: {}, that of this file; "
                        "the register or the file was changed",
                        kRewriting, found->xml_sha256, certificate.xml_sha256),
            kRewriting};
  return {what, true,
          fmt::format("{}, approved by {}, its XML as approved", found->state, found->approved_by)};
}

}  // namespace

std::optional<RegisterFinding> Register::compare_audit_with(const RegisterEvidence& evidence) {
  if (!evidence.register_identity.empty() && evidence.register_identity != facts_.identity)
    return RegisterFinding{evidence.name, false,
                           fmt::format("it is of register {}; required: this one, {}",
                                       evidence.register_identity, facts_.identity),
                           "another register"};
  if (!evidence.head) return std::nullopt;
  const std::vector<AuditEntry> entries = audit();
  const auto named = static_cast<std::size_t>(evidence.head->entries);
  const auto [in_backup, in_register] =
      std::mismatch(evidence.audit.begin(), evidence.audit.end(), entries.begin(), entries.end(),
                    [](const AuditEntry& a, const AuditEntry& b) { return a.chain == b.chain; });
  if (in_backup != evidence.audit.end() && in_register != entries.end())
    return differs_from_backup(evidence, entries, static_cast<std::size_t>(in_register - entries.begin()));
  const std::string what = fmt::format("{}, entry {}", evidence.name, named);
  if (entries.size() < named)
    return RegisterFinding{what, false,
                           fmt::format("{}: found {} entries; required: at least {}; {}", kRollback,
                                       entries.size(), named, kCopiedBack),
                           kRollback};
  const AuditEntry& entry = entries[named - 1];
  if (!entry.chain.starts_with(evidence.head->sha256)) return differs_from_head(evidence, entry);
  return RegisterFinding{what, true, fmt::format("as it says; entries since: {}", entries.size() - named)};
}

std::vector<RegisterFinding> Register::compare_with(const RegisterEvidence& evidence) {
  std::vector<RegisterFinding> findings;
  if (auto of_audit = compare_audit_with(evidence)) findings.push_back(*std::move(of_audit));
  const bool of_another = !findings.empty() && findings.front().kind == "another register";
  if (evidence.certificate && !of_another)
    findings.push_back(compare_certificate(evidence.name, *evidence.certificate, certificates()));
  return findings;
}

}  // namespace abcal::lab
