#pragma once

namespace abcal {

/// The last signal of watch_for_signals() (app/system/interrupt.h) that requires an orderly end; 0:
/// none. A call does not undertake to end orderly.
int last_interrupt_signal();
/// The number of such signals so far.
int interrupt_signals();

}  // namespace abcal
