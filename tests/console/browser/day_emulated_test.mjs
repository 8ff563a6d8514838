// The same day in real time: see ABCAL_DAY there.
import './day_test.mjs';
