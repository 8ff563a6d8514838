#pragma once

#include <string>
#include <vector>

#include "app/document/document.h"
#include "app/laboratory/register/records.h"

namespace abcal {

/// The draft of a letter to a customer.
struct Letter {
  std::string customer;
  std::string file_name;  ///< "letter-01-Customer-Ltd.html"
  Document document;
};

/// Letters about a withdrawal, one a customer, in the language of the customer's last certificate. They are
/// drafts, which is printed on every page: the program does not send them.
struct WithdrawalLetters {
  std::vector<Letter> letters;
  std::vector<std::string> without_customer;  ///< Numbers of certificates whose customer is not known.
};

/// @param affected  by what was withdrawn
/// @param date  of the letters, "2026-03-01"
/// @throws std::invalid_argument  if none of it was withdrawn
WithdrawalLetters withdrawal_letters(const lab::Affected& affected, const std::string& laboratory,
                                     const std::string& date);

}  // namespace abcal
