#pragma once

#include <stop_token>

namespace abcal {

/// Blocks SIGINT, SIGTERM and SIGHUP in this and all later threads and starts the one thread that waits for
/// them. Call once, first thing in main().
void watch_for_signals();

/// Stop is requested when one of these signals has come. Callbacks on it run in the watching thread, at once:
/// that is how a stage is halted while another thread waits for a reply.
std::stop_token interrupt_token();

}  // namespace abcal
