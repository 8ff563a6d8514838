#pragma once

namespace abcal {

/// The last of the signals of watch_for_signals() (app/ground/system/interrupt.h) that has come and has to be
/// followed by an orderly end; 0: none. To ask undertakes nothing.
int last_interrupt_signal();

}  // namespace abcal
