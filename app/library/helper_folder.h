#pragma once

namespace abcal::v1 {

/// The program finds its helper programs and data beside itself; a library in another program finds them
/// beside itself, or in libexec and share of the prefix in which it is installed. Done once.
[[gnu::visibility("hidden")]] void find_helpers();

}  // namespace abcal::v1
