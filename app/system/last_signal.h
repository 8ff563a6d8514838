#pragma once

namespace abcal {

/// The last of the signals of watch_for_signals() (app/system/interrupt.h) that has come; 0: none.
int last_interrupt_signal();

}  // namespace abcal
