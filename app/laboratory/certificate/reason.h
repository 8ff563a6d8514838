#pragma once

#include <vector>

#include "drivers/text/message.h"
#include "protocol/plan/run_config.h"

namespace abcal {

/// Why a certificate is refused or its results are not called traceable, in messages: a draft states it in
/// the language of the certificate.
struct Reason {
  Message run;   ///< "as-found run"; empty: it concerns no run.
  Message part;  ///< "local gravity"; empty: the whole run.
  Message found, required;

  /// "run, local gravity: found no source; required: [bench] g_loc_source"
  Message message() const;
  Problem problem() const;

  friend bool operator==(const Reason&, const Reason&) = default;
};

std::vector<Problem> problems_of(const std::vector<Reason>& reasons);

/// A text of a person in quotes; "nothing" for an empty one.
Message quoted(const std::string& text);

}  // namespace abcal
