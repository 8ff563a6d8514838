#pragma once

#include <gtest/gtest.h>

#include <string>

#include "drivers/instrument/instrument_error.h"

namespace abcal::test {

/// The InstrumentError that `call` throws. Fails the test if it throws none.
template <class Call>
InstrumentError error_of(Call call) {
  try {
    call();
  } catch (const InstrumentError& error) {
    return error;
  }
  ADD_FAILURE() << "nothing was thrown";
  return {"", Fault::kImplausible, "nothing was thrown"};
}

/// The text of the InstrumentError that `call` throws. Fails the test unless its fault is `fault`.
template <class Call>
std::string error_of(Call call, Fault fault) {
  const InstrumentError error = error_of(call);
  EXPECT_EQ(error.fault(), fault) << error.what();
  return error.what();
}

}  // namespace abcal::test
