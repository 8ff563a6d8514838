#pragma once

namespace abcal::v1 {

/// Version of the program and its commit: "1.2.0 (1a2b3c4)".
const char* version();

}  // namespace abcal::v1

// The library's names are in abcal::v1, the first part of its version (soname libabcal.so.1), and can be
// written as abcal::Record. Inside the library they coexist with the program's own names.
#ifndef ABCAL_BUILDING_LIBRARY
namespace abcal {
using namespace v1;
}
#endif
