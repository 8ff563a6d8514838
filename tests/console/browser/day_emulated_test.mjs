// The day of day_test.mjs in real time (ABCAL_DAY).
import './day_test.mjs';
