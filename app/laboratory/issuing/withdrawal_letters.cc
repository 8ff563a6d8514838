#include "app/laboratory/issuing/withdrawal_letters.h"

#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <stdexcept>
#include <tuple>

#include "app/laboratory/certificate/words.h"

namespace abcal {
namespace {

/// A name as a part of a file's name.
std::string for_file(const std::string& name) {
  std::string text;
  for (const char c : name) {
    const bool plain = (c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z');
    if (plain)
      text += c;
    else if (!text.empty() && text.back() != '-')
      text += '-';
  }
  constexpr std::size_t kLongest = 40;
  text.resize(std::min(text.size(), kLongest));
  while (!text.empty() && text.back() == '-') text.pop_back();
  return text.empty() ? "customer" : text;
}

std::string state_of(const Words& words, const lab::CertificateRecord& record) {
  if (record.state == "withdrawn") return words("withdrawn").text;
  return record.state == "replaced" ? words("amended").text : words("issued").text;
}

/// A sentence on which record was withdrawn, when and why.
Section withdrawn_section(const Words& words, const std::vector<lab::Withdrawal>& withdrawn) {
  static constexpr Term kKinds[]{"calibration", "certificate"};
  Section section{words("What was withdrawn").text, {}};
  for (const lab::Withdrawal& one : withdrawn) {
    FactList facts;
    facts.facts = {{words("Record").text, words(word_of(kKinds, one.kind)).text + " " + one.name},
                   {words("Withdrawn on").text, one.date()},
                   {words("Reason").text, one.reason}};
    section.blocks.emplace_back(std::move(facts));
  }
  return section;
}

Section certificate_section(const Words& words, const std::vector<lab::AffectedCertificate>& certificates,
                            bool itself) {
  Section section{words("Your certificates").text, {}};
  section.blocks.push_back(Paragraph{
      itself ? words("This certificate, which we issued to you, no longer holds. Please do not use it.").text
             : words("These certificates, which we issued to you, rest on it.").text});
  DocumentTable table;
  table.columns = {{words("Certificate").text},
                   {words("Item").text},
                   {words("Date of issue").text, CellKind::kUnit},
                   {words("State").text}};
  for (const lab::AffectedCertificate& one : certificates)
    table.rows.push_back(
        {one.record.number, one.record.item, one.record.issue_date, state_of(words, one.record)});
  section.blocks.emplace_back(std::move(table));
  return section;
}

Document letter_to(const lab::Addressee& to, const std::vector<lab::AffectedCertificate>& certificates,
                   const std::vector<lab::Withdrawal>& withdrawn,
                   const std::pair<std::string, std::string>& laboratory_and_date) {
  const auto languages = Words::languages();
  const bool is_known = std::find(languages.begin(), languages.end(), to.language) != languages.end();
  const Words words(is_known ? to.language : "en");
  const auto& [laboratory, date] = laboratory_and_date;
  Document document;
  document.language = words.language();
  document.page_words = words("page {page} of {pages}", Stated{"{}"}, Stated{"{}"}).text;
  document.title = words("Notice of withdrawal").text;
  document.subtitle = withdrawn.front().name;
  document.identification = laboratory + " · " + to.name;
  document.origin = words("draft of {date}", date).text;
  document.page_mark = words("DRAFT").text;
  document.cautions = {words("DRAFT of a letter. Nothing was sent.").text};
  SideBySide parties;
  parties.left.facts = {{words("Laboratory").text, laboratory}, {words("Date").text, date}};
  parties.right.facts = {{words("Customer").text, to.name}};
  if (!to.address.empty()) parties.right.facts.emplace_back(words("Address").text, to.address);
  if (!to.email.empty()) parties.right.facts.emplace_back(words("E-mail").text, to.email);
  document.sections.push_back({"", {parties}});
  document.sections.push_back(withdrawn_section(words, withdrawn));
  const bool itself = std::any_of(withdrawn.begin(), withdrawn.end(), [](const lab::Withdrawal& one) {
    return one.kind == lab::kCertificateKind;
  });
  document.sections.push_back(certificate_section(words, certificates, itself));
  document.sections.push_back(
      {words("To be completed by the laboratory").text,
       {BulletList{{words("Effect on the results of these certificates").text,
                    words("What the customer should do, and by when").text, words("Whom to ask").text}}}});
  return document;
}

}  // namespace

WithdrawalLetters withdrawal_letters(const lab::Affected& affected, const std::string& laboratory,
                                     const std::string& date) {
  if (affected.withdrawn.empty())
    throw std::invalid_argument(
        "nothing of this name was withdrawn; required: `abcal lab withdraw KIND NAME --reason TEXT` before "
        "letters about it");
  WithdrawalLetters all;
  std::map<std::pair<std::string, std::string>, std::vector<lab::AffectedCertificate>> of_customers;
  for (const lab::AffectedCertificate& one : affected.certificates) {
    if (one.addressee)
      of_customers[{one.addressee->name, one.addressee->address}].push_back(one);
    else
      all.without_customer.push_back(one.record.number);
  }
  for (const auto& [customer, certificates] : of_customers) {
    Letter letter;
    letter.customer = customer.first;
    letter.file_name = fmt::format("letter-{:02}-{}.html", all.letters.size() + 1, for_file(customer.first));
    letter.document =
        letter_to(*certificates.back().addressee, certificates, affected.withdrawn, {laboratory, date});
    all.letters.push_back(std::move(letter));
  }
  return all;
}

}  // namespace abcal
