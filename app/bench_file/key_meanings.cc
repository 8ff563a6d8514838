#include <map>
#include <string>

#include "app/bench_file/key_reference.h"

namespace abcal {
namespace {

// A key that is added to bench_keys.cc needs a line here, and docs/bench_file.md is made again with
// `abcal plan --keys > docs/bench_file.md`. The unit is given where the name does not end with it.
// NOLINTNEXTLINE(readability-function-size): a table of texts.
const std::map<std::string, KeyMeaning>& key_meanings() {
  static const std::map<std::string, KeyMeaning> meanings{
      {"schema", {"Version of the format. `abcal.bench/1` is also read.", ""}},
      {"bench.name", {"Name of the bench, for the report.", ""}},
      {"bench.g_loc_mps2",
       {"Local gravity. Required unless `latitude_deg` and `height_m` are given. Or `{ from = \"RECORD\" }`: "
        "a "
        "calibration in the register, which then gives U, k and source, too.",
        "", true}},
      {"bench.g_loc_expanded_uncertainty_mps2", {"Expanded uncertainty U = k u of `g_loc_mps2`.", ""}},
      {"bench.g_loc_k", {"Coverage factor k of that uncertainty.", "1"}},
      {"bench.g_loc_source",
       {"Source of the value, for example a survey or the number of a certificate.", ""}},
      {"bench.latitude_deg",
       {"Geodetic latitude, south negative. If `g_loc_mps2` is absent, gravity is computed from latitude and "
        "height by a formula, with a warning.",
        ""}},
      {"bench.height_m", {"Height above sea level.", ""}},
      {"item.maker",
       {"Maker of the accelerometer under test. An instrument that reports another maker, model or serial "
        "number is refused ([the item](measurement.md#the-item)); what it reports is taken where nothing is "
        "stated.",
        ""}},
      {"item.model", {"Model, compared as the maker is.", ""}},
      {"item.serial_number",
       {"Serial number, as the instrument reports it. A number of the label that it does not report is a "
        "`customer_number`.",
        ""}},
      {"item.customer_number", {"The number that its owner gave it.", ""}},
      {"item.range", {"Measuring range as set, in words.", ""}},
      {"item.filter", {"Filter or bandwidth as set, in words.", ""}},
      {"item.firmware", {"Firmware version.", ""}},
      {"item.supply", {"Supply voltage, in words.", ""}},
      {"item.nominal_sensitivity",
       {"Expected output for 9.80665 m/s2. Absent: follows from the response unit if this is g or m/s2, "
        "otherwise not checked.",
        "R"}},
      {"item.sensitivity_tolerance",
       {"Largest relative difference from the nominal sensitivity. A larger one makes the result doubtful.",
        "1"}},
      {"item.mounting",
       {"Axes of the platter along which u, v and w point at the default orientation, each axis once, for "
        "example `-y x z`; or nine numbers, the rows of a rotation matrix: the directions of u, v and w.",
        ""}},
      {"item.reference_surface",
       {"Surface of the housing that lies on the platter, in words. This and the next four are printed on "
        "report and certificate.",
        ""}},
      {"item.direction_marks",
       {"Marks on the housing by which the directions of u, v and w are found, in words.", ""}},
      {"item.fasteners", {"What holds the item, in words, for example `4 screws M3 x 10`.", ""}},
      {"item.torque_newton_metre", {"Tightening torque of the fasteners.", "N m"}},
      {"item.cable", {"Cable and how it is led, in words.", ""}},
      {"operator.name", {"Name of the person who measures.", ""}},
      {"stage.driver",
       {"Driver of the controller. Empty if `[stage.x]` and `[stage.z]` each have a driver.", ""}},
      {"stage.port",
       {"Port: a path, `usb:VID:PID[:SERIAL]`, `tcp:HOST:PORT`, or `simulated`. Empty if each axis has its "
        "own port.",
        ""}},
      {"stage.baud", {"Baud rate of a serial port. Absent: the driver's usual one.", "Bd"}},
      {"stage.address", {"Address of the controller in a daisy chain.", ""}},
      {"stage.serial_number",
       {"If given, a controller with another serial number is refused. A stage that reports none is recorded "
        "with it, as stated by this file.",
        ""}},
      {"stage.level_file",
       {"File written by `abcal level`: axis zeros and tilt with their uncertainties. Empty: they are known "
        "only within `[stage_uncertainty]`.",
        ""}},
      {"stage.record",
       {"Stage record written by `abcal stage learn`: the joint estimator takes the stage from it, in place "
        "of the "
        "sizes in `[stage_uncertainty]`. The run keeps it. A record of another stage is refused.",
        ""}},
      {"stage.AXIS.axis", {"The controller's name for the axis.", ""}},
      {"stage.AXIS.sign",
       {"`1`, or `-1` if the controller counts against the right-hand rule. 0 is refused.", ""}},
      {"stage.AXIS.zero_deg", {"Controller angle at the default orientation.", ""}},
      {"stage.AXIS.travel_min_deg",
       {"Lower end of the travel, if narrower than the controller's, for example because of the cable.", ""}},
      {"stage.AXIS.travel_max_deg", {"Upper end of the travel.", ""}},
      {"stage.AXIS.speed_deg_per_s", {"Speed of the moves. Absent: as set in the controller.", ""}},
      {"stage.AXIS.driver",
       {"Driver of this axis if each axis has its own controller. Give it for both axes or for neither.",
        ""}},
      {"stage.AXIS.port", {"Port of this axis, with `driver`.", ""}},
      {"stage.unit",
       {"Unit of the axes, for a controller that does not report it. Empty: the controller must report it.",
        ""}},
      {"stage.AXIS.baud", {"Baud rate of this axis's port. Absent: the driver's usual one.", "Bd"}},
      {"stage.AXIS.address", {"Address of this axis's controller in a daisy chain.", ""}},
      {"accelerometer.driver", {"Driver of the accelerometer.", ""}},
      {"accelerometer.port", {"Port, as for `[stage]`. `scpi_single` takes three, separated by blanks.", ""}},
      {"accelerometer.baud", {"Baud rate of a serial port. Absent: the driver's usual one.", "Bd"}},
      {"accelerometer.rate_hz", {"Readings per second.", ""}},
      {"accelerometer.response_unit",
       {"Unit R of the output. Empty: as the instrument reports. Otherwise it must agree with the "
        "instrument.",
        ""}},
      {"accelerometer.full_scale",
       {"Largest output. Readings at this value are flagged as clipped. Absent: as the instrument reports.",
        "R"}},
      {"accelerometer.serial_number",
       {"If given, an instrument with another serial number is refused. One with an output in volts, or a "
        "voltmeter, that reports none is recorded with it, as stated by this file.",
        ""}},
      {"accelerometer.scale",
       {"Voltmeters and lines of text: output = (value - `bias`) / `scale`, for u, v, w. At least "
        "1e-12 in size.",
        "V/R or 1/R"}},
      {"accelerometer.bias", {"See `scale`.", "V or 1"}},
      {"accelerometer.channels", {"Voltmeters: the channels to which u, v, w are wired.", ""}},
      {"accelerometer.range_v", {"Voltmeters: fixed measuring range.", ""}},
      {"accelerometer.integration_plc", {"Voltmeters: integration time of one channel.", "mains periods"}},
      {"accelerometer.columns", {"Lines of text: the columns of u, v, w; the first column is 1.", ""}},
      {"accelerometer.separator",
       {"Lines of text: one character between columns; `\" \"` is any run of blanks and tabs.", ""}},
      {"accelerometer.comment", {"Lines of text: a line that begins with this is skipped. Empty: none.", ""}},
      {"accelerometer.names",
       {"Lines of text: names of u, v, w in front of their numbers, in place of columns, as \"ax ay az\". "
        "Empty: columns. Driver iio: name or id of the accelerometer, where there are several.",
        ""}},
      {"accelerometer.number_unit",
       {"Lines of text: what may follow a number at once, as \"g\" of `0.01g`.", ""}},
      {"accelerometer.decimal_mark", {"Lines of text: decimal mark of the numbers.", ""}},
      {"environment.temperature_degc", {"Temperature of the room, typed in.", ""}},
      {"environment.humidity_percent", {"Relative humidity, typed in.", ""}},
      {"environment.pressure_hpa", {"Air pressure, typed in.", ""}},
      {"environment.driver", {"Driver of a sensor that prints lines of text. Empty: no sensor.", ""}},
      {"environment.port", {"Port of the sensor; with `driver`.", ""}},
      {"environment.baud", {"Baud rate of the sensor. Absent: 9600.", "Bd"}},
      {"environment.temperature_column", {"Column of the temperature in degC; 0: absent.", ""}},
      {"environment.humidity_column", {"Column of the relative humidity in %; 0: absent.", ""}},
      {"environment.pressure_column", {"Column of the pressure in hPa; 0: absent.", ""}},
      {"environment.separator", {"As in `[accelerometer]`.", ""}},
      {"environment.comment", {"As in `[accelerometer]`.", ""}},
      {"protocol.steps",
       {"N, the number of angles of each experiment. (`steps` - 1) x `step_deg` must be less than 360.", ""}},
      {"protocol.step_deg", {"D, the nominal rotation step.", ""}},
      {"protocol.faces",
       {"2: half of the angles of each experiment are measured with the axis that stands turned by half a "
        "turn "
        "more, in a second face, so that errors of the stage act with the opposite sign "
        "([measurement](measurement.md#two-faces)). `steps` must then be even and at least 8. 1: as in the "
        "published protocol.",
        ""}},
      {"protocol.motion",
       {"`\"steps\"`: the stage stands at each angle, as in the published protocol. `\"constant_rate\"`: it "
        "turns "
        "through each circle at constant rates while readings stream; readings within one step about an "
        "angle "
        "count as its own ([constant rate](constant_rate.md)).",
        ""}},
      {"protocol.rate_deg_per_s",
       {"Constant rate: rates of the sweeps of a circle, up and down in turn; the list begins again if there "
        "are "
        "more sweeps.",
        "degree/s"}},
      {"protocol.sweeps", {"Constant rate: sweeps of each circle.", ""}},
      {"protocol.stops",
       {"Constant rate: dwells at rest in each circle, evenly spaced, which tie the results to rest.", ""}},
      {"protocol.acceleration_deg_per_s2",
       {"Constant rate: acceleration with which the controller starts and ends a sweep, at least. The travel "
        "must "
        "have room for it.",
        "degree/s^2"}},
      {"protocol.closing_angle",
       {"Measures the first angle of each experiment again, one turn on, to show drift.", ""}},
      {"protocol.check_poses",
       {"Measures two poses, with gravity along (1, 1, 1) and opposite to it, at the start, between the "
        "experiments and at the end. They reveal a late change of the gain or offset of any output. `false`: "
        "as in the published protocol.",
        ""}},
      {"protocol.approach_deg",
       {"Every angle is approached from below by at least this much, so that backlash has no effect. 0: from "
        "either side; backlash must then be within `zero_deg`.",
        ""}},
      {"protocol.position_window_deg", {"Largest distance of the encoder from the commanded angle.", ""}},
      {"protocol.window_polls",
       {"Number of consecutive polls that must find the axis stopped and inside the window.", ""}},
      {"protocol.poll_interval_s", {"Time between polls of a moving axis.", ""}},
      {"protocol.motion_timeout_s",
       {"Longest wait for a move, in addition to the time that it needs at its speed.", ""}},
      {"protocol.homing_timeout_s", {"Longest wait for homing.", ""}},
      {"protocol.settle_s",
       {"Time from the stop to the first reading used; `\"auto\"`: as long as the outputs need "
        "(measurement.md).",
        ""}},
      {"protocol.quiet_timeout_s",
       {"Longest further wait for quiet outputs. After this time the angle is measured and flagged.", ""}},
      {"protocol.dwell_readings", {"Number of readings averaged at one angle.", ""}},
      {"protocol.mains_hz",
       {"Mains frequency: the dwell lasts a whole number of mains periods. 0: not considered.", ""}},
      {"protocol.reading_timeout_s",
       {"If no reading arrives for this time, the accelerometer is considered to have failed.", ""}},
      {"protocol.warm_up_s", {"Waiting time with all instruments switched on, before the first angle.", ""}},
      {"protocol.replug_timeout_s", {"Longest wait for a vanished port to come back.", ""}},
      {"protocol.stability_s",
       {"Outputs and temperature must be stable for this time before the first angle. 0: not required.", ""}},
      {"protocol.stability_timeout_s", {"Longest wait for that stability.", ""}},
      {"tolerances.alignment_deg",
       {"Standard uncertainty of the directions of the axes: Zx, Zy, Xz ~ N(0, sin `alignment_deg`).", ""}},
      {"tolerances.step_deg", {"Standard uncertainty of each rotation-step error f_i(n).", ""}},
      {"tolerances.initial_turn_deg", {"Standard uncertainty of the initial -90 degree turns: d2, d3.", ""}},
      {"tolerances.zero_deg",
       {"Standard uncertainty of the mean step errors F_X, F_Z: the zeros of the axes.", ""}},
      {"tolerances.drift",
       {"Standard uncertainty of the drift of an output over the run, relative to its intrinsic sensitivity.",
        "1"}},
      {"chamber.driver", {"Driver of the thermal chamber. Empty: there is none.", ""}},
      {"chamber.port", {"Port, as for the stage; `simulated`.", ""}},
      {"chamber.baud", {"Speed of a serial port. Absent: the usual one of the driver.", "Bd"}},
      {"chamber.model", {"Controller or protocol, where the driver is not to ask.", ""}},
      {"chamber.address", {"Modbus unit or ASCII-2 address.", ""}},
      {"chamber.humidity", {"The second channel of the controller measures the relative humidity.", ""}},
      {"chamber.run_output", {"Event output that starts and stops the chamber.", ""}},
      {"chamber.pause_output",
       {"Event output or channel that pauses compressor or fan while it is on. 0: none.", ""}},
      {"chamber.door_input", {"Digital input that is on while the door is open. 0: none.", ""}},
      {"chamber.serial_number", {"If given, any other chamber is refused.", ""}},
      {"chamber.min_degc", {"Lowest set point. Absent: as the chamber's own hardware has it.", ""}},
      {"chamber.max_degc", {"Highest set point. Absent: as the chamber's own hardware has it.", ""}},
      {"chamber.dry_gas", {"Dry air or nitrogen is on, so that nothing can condense.", ""}},
      {"chamber.poll_s", {"Time between two looks at the chamber while a run measures.", ""}},
      {"temperature.set_points_degc", {"Set points of the series, from one end to the other.", "degC"}},
      {"temperature.reference_degc",
       {"Temperature at which the series begins and ends, and from which the polynomials count.", ""}},
      {"temperature.down", {"After the way up the same points are measured on the way down.", ""}},
      {"temperature.ramp_k_per_min",
       {"Rate between two points, where the chamber has a ramp. 0: as fast as it can.", "K/min"}},
      {"temperature.air_window_k", {"The soak counts while the air is so near to the set point.", "K"}},
      {"temperature.soak_min_s", {"Shortest soak.", ""}},
      {"temperature.soak_rate_k_per_min", {"The item's sensor must move slower than this.", "K/min"}},
      {"temperature.soak_span_s", {"Time over which that is looked at.", ""}},
      {"temperature.soak_max_s", {"Longest way to a point, ramp included; then the series ends.", ""}},
      {"temperature.item_min_degc", {"Lowest temperature that the item stands. Absent: not stated.", ""}},
      {"temperature.item_max_degc", {"Highest temperature that the item stands. Absent: not stated.", ""}},
      {"temperature.dew_point_margin_k", {"The air must be so much warmer than its dew point.", "K"}},
      {"temperature.pause", {"Compressor or fan pauses in dwells, where the chamber can.", ""}},
      {"temperature.end",
       {"What the chamber is left with: `hold` (its last set point), `ambient` (23 degC), `off` (23 degC "
        "first).",
        ""}},
      {"simulation.offset_per_degc2", {"Likewise, quadratic.", "R/degC^2"}},
      {"simulation.offset_per_degc3", {"Likewise, cubic.", "R/degC^3"}},
      {"simulation.sensitivity_per_degc",
       {"Relative change of the sensitivity with the temperature.", "1/degC"}},
      {"simulation.sensitivity_per_degc2", {"Likewise, quadratic.", "1/degC^2"}},
      {"simulation.sensitivity_per_degc3", {"Likewise, cubic.", "1/degC^3"}},
      {"simulation.offset_thermal_hysteresis",
       {"Half the loop of the offset: added where the item came from below, subtracted where from above.",
        "R"}},
      {"simulation.sensitivity_thermal_hysteresis", {"Likewise of the sensitivity, relative.", "1"}},
      {"simulation.chamber.air_lag_s", {"Time constant of the air behind the set point.", ""}},
      {"simulation.chamber.item_lag_s", {"Time constant of the item behind the air.", ""}},
      {"simulation.chamber.self_heating_degc", {"The item is in the end so much warmer than the air.", ""}},
      {"simulation.chamber.dew_point_degc", {"Dew point of the air in the chamber.", ""}},
      {"simulation.chamber.hysteresis_width_degc",
       {"The loop of the thermal hysteresis closes within this change of temperature.", ""}},
      {"emulator.chamber_model",
       {"Model of the simulated F4: `F4S` has one loop, `F4D` a second set point (register 319). Empty: F4S.",
        ""}},
      {"emulator.chamber_in_fahrenheit", {"The simulated chamber has the unit degF, as an F4T is sold.", ""}},
      {"limits.max_lost_fraction",
       {"The run ends if more than this fraction of the readings at one angle is lost.", "1"}},
      {"limits.temperature_min_degc", {"Lowest temperature of the accelerometer. Absent: no limit.", ""}},
      {"limits.temperature_max_degc", {"Highest temperature of the accelerometer. Absent: no limit.", ""}},
      {"limits.max_replugs", {"Number of times that a port may vanish and return in one run.", ""}},
      {"limits.temperature_change_degc",
       {"Largest change of temperature from the first angle. Absent: follows from `[item_uncertainty] "
        "drift`.",
        ""}},
      {"limits.temperature_wait_s",
       {"Longest wait for the temperature to return within its limits. 0: the angle is only flagged.", ""}},
      {"limits.spread_factor",
       {"Spread above this multiple of the median spread is treated as vibration.", "1"}},
      {"limits.repeats", {"Number of times that a disturbed angle is measured again.", ""}},
      {"limits.norm_fraction",
       {"Largest relative difference between the norm of the readings at one angle and local gravity. The "
        "norm includes the offsets.",
        "1"}},
      {"limits.stability",
       {"Before the first angle: largest change of the outputs, relative to their norm. Absent: "
        "`[item_uncertainty] drift`.",
        "1"}},
      {"limits.stability_degc",
       {"Before the first angle: largest change of temperature. Absent: follows from `[item_uncertainty] "
        "drift`.",
        ""}},
      {"limits.mounting_deg",
       {"Largest angle between the direction of an output and the one that `[item] mounting` names.", ""}},
      {"limits.slip_deg",
       {"Largest lasting turn of the accelerometer or of an axis. Absent: follows from "
        "`[stage_uncertainty]`.",
        ""}},
      {"limits.angle_deg",
       {"Largest error of one angle. Absent: follows from `[stage_uncertainty] step_deg`.", ""}},
      {"limits.drift",
       {"Largest change of an output, gradual over the run or sudden, relative to its sensitivity. Absent: "
        "follows from `[item_uncertainty] drift`.",
        "1"}},
      {"simulation.seed", {"Seed of all random numbers of the simulated bench.", ""}},
      {"simulation.draw",
       {"`stated`: every effect that `[stage_uncertainty]` and `[item_uncertainty]` state, or leave to a "
        "default, is drawn from its distribution by the seed; a key that is given fixes its effect. Drifts "
        "are "
        "drawn over the time of the planned run, where all ports are simulated and no series over "
        "temperature "
        "is planned. Empty: what is not given is zero.",
        ""}},
      {"simulation.sensitivity_matrix",
       {"Sensitivity matrix: rows u, v, w; columns x, y, z of the platter, before the platter tilts with Z.",
        "R/g_loc"}},
      {"simulation.offset", {"Offset O.", "R"}},
      {"simulation.k2",
       {"Non-linearity of second order: adds k2 (l - O)^2, where l is the linear response.", "1/R"}},
      {"simulation.k3", {"Non-linearity of third order: adds k3 (l - O)^3.", "1/R^2"}},
      {"simulation.drift_per_hour", {"Drift, zero at the start.", "R/h"}},
      {"simulation.offset_per_degc", {"Change of the offset with the temperature.", "R/degC"}},
      {"simulation.noise", {"Standard deviation of one reading; white.", "R"}},
      {"simulation.quantisation", {"Smallest step of the output; 0: none.", "R"}},
      {"simulation.full_scale", {"Output at which the accelerometer clips. Absent: never.", "R"}},
      {"simulation.ring_down_amplitude",
       {"Amplitude of the vibration after a move, per unit of its speed.", "R/(degree/s)"}},
      {"simulation.ring_down_frequency_hz", {"Frequency of that vibration.", ""}},
      {"simulation.ring_down_decay_s", {"Time constant of its decay.", ""}},
      {"simulation.temperature_degc", {"Temperature of the accelerometer at the start.", ""}},
      {"simulation.temperature_per_hour", {"Rate of change of that temperature.", "degC/h"}},
      {"simulation.noise_seeded_by_angle",
       {"The noise restarts at each pose, so that a resumed run repeats it bit for bit.", ""}},
      {"simulation.zx", {"Zx, horizontal component of axis Z at rest.", "1"}},
      {"simulation.zy", {"Zy, the other horizontal component of axis Z at rest.", "1"}},
      {"simulation.xz", {"Xz, vertical component of axis X.", "1"}},
      {"simulation.zx_per_degc",
       {"Change of Zx with the item's temperature: a stage that turns warm with it. From `temperature_degc` "
        "on.",
        "1/degC"}},
      {"simulation.AXIS.mean_step_error_deg", {"F_X or F_Z, at every angle except 0 and -90 degrees.", ""}},
      {"simulation.AXIS.initial_turn_error_deg", {"Error at -90 degrees: d3 for X, d2 for Z.", ""}},
      {"simulation.AXIS.step_error_deg",
       {"Standard deviation of the error of a pose, drawn once for each pose of both axes.", ""}},
      {"simulation.AXIS.backlash_deg", {"Lag of the axis after a move in the negative direction.", ""}},
      {"simulation.AXIS.travel_min_deg", {"Lower end of the travel.", ""}},
      {"simulation.AXIS.travel_max_deg", {"Upper end of the travel.", ""}},
      {"simulation.AXIS.speed_deg_per_s", {"Speed until the driver sets another.", ""}},
      {"simulation.AXIS.acceleration_deg_per_s2", {"Acceleration.", ""}},
      {"simulation.AXIS.encoder_resolution_deg", {"Smallest step of the encoder.", ""}},
      {"simulation.AXIS.rate_ripple",
       {"Standard deviation of sine and cosine of each of six harmonics of the rate while the axis turns; "
        "the "
        "encoder sees them.",
        "1"}},
      {"simulation.low_pass_hz", {"Corner of a low-pass behind all bends of the outputs; 0: none.", ""}},
      {"simulation.low_pass_order", {"1, or 2: two such filters, one behind the other.", ""}},
      {"simulation.group_delay_s", {"Further delay of all outputs.", ""}},
      {"simulation.time_stamp_jitter_s", {"Readings arrive late by this times |normal|.", ""}},
      {"simulation.rate_offset",
       {"Offset at 60 degrees/s about either axis; proportional to the rate.", "R"}},
      {"simulation.position_u_mm",
       {"Position of the element of u on the platter: x and y from the Z axis, z from the X axis.", "mm"}},
      {"simulation.position_v_mm", {"Likewise of v.", "mm"}},
      {"simulation.position_w_mm", {"Likewise of w.", "mm"}},
      {"simulation.axes_distance_mm", {"From the X axis to the Z axis, along y where Z is at 0.", "mm"}},
      {"simulation.encoder_latency_s",
       {"While an axis turns, its encoder says where it was this long ago,", ""}},
      {"simulation.encoder_jitter_s", {"and further by this times |normal|.", ""}},
      {"simulation.AXIS.harmonics.order", {"Order m of the harmonic of the axis's error map.", ""}},
      {"simulation.AXIS.harmonics.sin_deg", {"Coefficient of sin(m angle).", ""}},
      {"simulation.AXIS.harmonics.cos_deg", {"Coefficient of cos(m angle) - 1.", ""}},
      {"simulation.k4",
       {"Non-linearity of fourth order: adds k4 (l - O)^4, where l is the linear response.", "1/R^3"}},
      {"simulation.k5", {"Non-linearity of fifth order: adds k5 (l - O)^5.", "1/R^4"}},
      {"simulation.asymmetry",
       {"Adds asymmetry \\|l - O\\|: the sensitivity differs for the two signs.", "1"}},
      {"simulation.cross_ab",
       {"Cross term: adds cross_ab S y_a y_b, where y = (l - O) / S and S is the intrinsic sensitivity. a is "
        "the output itself, b and c are the next two in the order u, v, w, u.",
        "1"}},
      {"simulation.cross_ac", {"Likewise with y_a y_c.", "1"}},
      {"simulation.cross_bc", {"Likewise with y_b y_c.", "1"}},
      {"simulation.cross_bb", {"Likewise with y_b^2.", "1"}},
      {"simulation.cross_cc", {"Likewise with y_c^2.", "1"}},
      {"simulation.hysteresis",
       {"Hysteresis: adds this value times the sign of the output's change in the last motion.", "R"}},
      {"simulation.hysteresis_width",
       {"Above 0: the hysteresis follows the output along its whole way, as play does, and turns round "
        "gradually "
        "while the output changes by this much. 0: its sign is that of the last motion.",
        "R"}},
      {"simulation.drift_1",
       {"Drift: this value times half the Legendre polynomial of order 1 of the time within the span, from "
        "-1 to 1.",
        "R"}},
      {"simulation.drift_2", {"Likewise, order 2.", "R"}},
      {"simulation.drift_3", {"Likewise, order 3.", "R"}},
      {"simulation.exponential_drift", {"Exponentially decaying drift: its value at the start.", "R"}},
      {"simulation.exponential_drift_s", {"Time constant of the exponential drift.", "s"}},
      {"simulation.sinusoidal_drift", {"Amplitude of a sinusoidal drift.", "R"}},
      {"simulation.sinusoidal_drift_period_s", {"Period of the sinusoidal drift.", "s"}},
      {"simulation.sinusoidal_drift_phase_deg", {"Phase of the sinusoidal drift at the start.", "degree"}},
      {"simulation.sensitivity_drift",
       {"Relative change of the sensitivity over the span, zero at its middle.", "1"}},
      {"simulation.gain_step", {"Sudden relative change of the sensitivity at `gain_step_at_s`.", "1"}},
      {"simulation.gain_step_at_s", {"Time of the gain step, from the start of the simulated world.", "s"}},
      {"simulation.random_walk",
       {"Random walk of the offset: standard deviation at the end of the span.", "R"}},
      {"simulation.flicker_noise",
       {"Standard deviation of noise with a 1/frequency spectrum, from 1/4 to 256 cycles per span.", "R"}},
      {"simulation.correlated_noise", {"Standard deviation of noise with an exponential correlation.", "R"}},
      {"simulation.correlated_noise_s", {"Correlation time of that noise.", "s"}},
      {"simulation.mount_creep_urad",
       {"Creep of the mount: it turns about x, y, z by these angles times 1 - exp(-time / `mount_creep_s`).",
        "urad"}},
      {"simulation.mount_creep_s", {"Time constant of the mount creep.", "s"}},
      {"simulation.span_s",
       {"The span: time, from the start of the simulated world, to which the effects \"over the span\" "
        "refer.",
        "s"}},
      {"simulation.run",
       {"Number of the run on this stage. The noise, and all that the stage does not repeat, follow from "
        "`seed` "
        "and this number, all else from `seed` alone.",
        ""}},
      {"simulation.age_months", {"Age of the stage, for `growth_deg`.", "month"}},
      {"simulation.knock_from_run", {"First `run` after a knock, for `knock_deg`; 0: none.", ""}},
      {"simulation.floor_repeatability_urad",
       {"Standard deviation of the tilt of the base about x and about y, drawn once for each `run`.",
        "urad"}},
      {"simulation.floor_tilt_x_urad",
       {"Tilt of the base about x over the span, zero at its middle.", "urad"}},
      {"simulation.floor_tilt_y_urad", {"Likewise about y.", "urad"}},
      {"simulation.sag_urad",
       {"Bending under the load: the platform turns by the cross product of the upward direction and these "
        "angles, in its own coordinates.",
        "urad"}},
      {"simulation.AXIS.fine_map_deg",
       {"Standard deviation of an error drawn once for each angle of the axis, wherever the other one is.",
        ""}},
      {"simulation.AXIS.step_repeatability_deg",
       {"Standard deviation of the part of the error that is drawn for each pose and `run`, except where the "
        "axis is at 0 degrees.",
        ""}},
      {"simulation.AXIS.homing_repeatability_deg",
       {"Standard deviation of the zero of the axis, drawn once for each `run`.", ""}},
      {"simulation.AXIS.growth_deg",
       {"Standard deviation of the change of each value of the fine map in one month; it grows with the root "
        "of "
        "`age_months`.",
        ""}},
      {"simulation.AXIS.knock_deg",
       {"Standard deviation of the change of each value of the fine map by a knock (`knock_from_run`).", ""}},
      {"simulation.AXIS.smooth_error_deg",
       {"Standard deviation of each coefficient of smooth step errors of orders 1 to 6, drawn from the seed.",
        "degree"}},
      {"simulation.AXIS.wobble_urad",
       {"Standard deviation of each coefficient of the wobble of orders 1 to 3, drawn from the seed.",
        "urad"}},
      {"simulation.AXIS.wobble.order", {"Order m of a harmonic of the wobble.", ""}},
      {"simulation.AXIS.wobble.cos_1_urad",
       {"Coefficient of cos(m angle) about direction 1, perpendicular to the axis: horizontal for X, nearest "
        "to x for Z.",
        "urad"}},
      {"simulation.AXIS.wobble.sin_1_urad", {"Coefficient of sin(m angle) about direction 1.", "urad"}},
      {"simulation.AXIS.wobble.cos_2_urad",
       {"Coefficient of cos(m angle) about direction 2, the cross product of the axis and direction 1.",
        "urad"}},
      {"simulation.AXIS.wobble.sin_2_urad", {"Coefficient of sin(m angle) about direction 2.", "urad"}},
      {"protocol.estimator",
       {"Estimator that gives the result of the run; recorded before the first angle.", ""}},
      {"simulation.link.latency_s", {"Delay of everything that the instrument sends.", ""}},
      {"simulation.link.jitter_s", {"Largest additional random delay; the order of bytes is kept.", ""}},
      {"notify.webhook",
       {"Address that gets each message as JSON by HTTP POST ([messages](measurement.md#messages)). "
        "`env:NAME`: "
        "the address stands in that environment variable, since a secret does not belong into a run file.",
        ""}},
      {"notify.mail_to", {"Mail address that gets each message.", ""}},
      {"notify.mail_from", {"Mail address of the sender; required with `mail_to`.", ""}},
      {"notify.mail_server",
       {"Server that takes the mail: `smtp://HOST[:PORT]` or `smtps://HOST[:PORT]`. User and password: "
        "environment variables `ABCAL_MAIL_USER` and `ABCAL_MAIL_PASSWORD`.",
        ""}},
      {"emulator.line",
       {"Behaviour of the pseudo-terminals of `abcal emulate`. `real`: as a serial line at the speed of the "
        "device, with noise at another speed. `ideal`: bytes arrive at once, at any speed.",
        ""}},
      {"emulator.stage_model",
       {"Model of the simulated controller ([emulate](emulate.md#models)). Empty: the default model.", ""}},
      {"emulator.accelerometer_model",
       {"Model of the simulated accelerometer or voltmeter ([emulate](emulate.md#models)). Empty: the "
        "default model.",
        ""}},
      {"emulator.at_power_on",
       {"Whether the simulated accelerometer outputs readings as soon as it is switched on: `streaming` or "
        "`silent` (`microstrain_mip`, `vectornav`, `witmotion`). Empty: as its maker ships it.",
        ""}},
      {"emulator.serial_port",
       {"Serial port of the simulated `vectornav` that is wired. Outputs that a program sets on the other "
        "port "
        "are reported.",
        ""}},
      {"fault.kind", {"Kind of fault; [emulate](emulate.md#faults) describes each.", ""}},
      {"fault.instrument",
       {"Faults of the wire: the instrument. Use `stage-x`, `accelerometer-u` and so on if each has its own "
        "port. Of several items: `item-3`, also for faults of the accelerometer itself.",
        ""}},
      {"fault.axis", {"Faults of an axis: the axis.", ""}},
      {"fault.at_s", {"Start, from the start of the simulated world.", ""}},
      {"fault.for_s", {"Duration. Absent: until the end.", ""}},
      {"fault.at_write",
       {"Faults of the wire: number of the first command affected. Absent: `at_s` applies.", ""}},
      {"fault.for_writes", {"Faults of the wire: number of commands affected.", ""}},
      {"fault.value", {"`clipped-output`: full scale in R. Faults of an axis: degrees.", ""}},
      {"fault.output", {"`stuck-output`: the output. Empty: all three.", ""}},
      {"fault.text", {"`replaced-reply`: the text of the reply.", ""}},
      {"fault.delay_s", {"`late-reply`: the delay.", ""}},
      {"change.at_s", {"Start, from the start of the simulated world.", ""}},
      {"change.item", {"Of several items: which one, counted from 1.", ""}},
  };
  return meanings;
}

const std::map<std::string, std::string>& section_texts() {
  static const std::map<std::string, std::string> texts{
      {"bench",
       "Local gravity. `abcal gravity` computes it by a formula if there is no survey "
       "([theory](theory/gravity.md)). A sensitivity per m/s2 needs a survey; angles, offsets and "
       "sensitivities per g_loc do not."},
      {"item",
       "The accelerometer under test. The texts appear in report and certificate. The result is compared "
       "with the last three keys ([checks](measurement.md#in-the-analysis))."},
      {"[[item]]",
       "Several items on one stage: one `[[item]]` for each, up to 32, in place of `[item]` and "
       "`[accelerometer]` ([several items](several_items.md)). The sections below it follow each "
       "`[[item]]`."},
      {"stage",
       "Cables and settings of each controller: [drivers](drivers). Two controllers: "
       "[split_stage](drivers/split_stage.md)."},
      {"stage.x", "The outer axis, horizontal at rest."},
      {"accelerometer",
       "The keys from `scale` to `comment` apply only to voltmeters "
       "([scpi_voltmeter](drivers/scpi_voltmeter.md)) and to boards that print lines of text "
       "([text_line](drivers/text_line.md))."},
      {"environment",
       "Conditions of the room: typed in, or read from a sensor at the start and at the end of the run "
       "([text_line](drivers/text_line.md#environment))."},
      {"protocol", "How the three rotation experiments are measured ([measurement](measurement.md))."},
      {"tolerances",
       "Section of the older schema `abcal.bench/1`, read with a warning. Use `[stage_uncertainty]` and "
       "`[item_uncertainty]` instead."},
      {"stage_uncertainty",
       "Sizes of the effects of the stage, as **standard uncertainties** from the maker's data, a "
       "certificate, or `abcal level`. The defaults of alignment, steps, turns and zeros are those of the "
       "paper's stage. 0 leaves an effect out. [Effects](effects.md) describes each effect and how to find "
       "its size."},
      {"item_uncertainty",
       "Sizes of the effects of the accelerometer, as standard uncertainties relative to its sensitivity "
       "([effects](effects.md))."},
      {"limits", "Limits of the checks ([checks and verdict](measurement.md#checks-and-verdict))."},
      {"simulation", "Properties of the simulated or emulated bench (the truth). A run never sees them."},
      {"simulation.x", "The simulated outer axis: actual angle = commanded angle + error(commanded angle)."},
      {"simulation.x.harmonics", "Systematic part of the error map of the axis; may be repeated."},
      {"simulation.x.wobble",
       "Harmonics of the wobble of the axis; may be repeated ([effects](effects.md))."},
      {"chamber",
       "The thermal chamber around the stage; looked at while a run measures "
       "([temperature](temperature.md))."},
      {"temperature", "The series of `abcal temperature` ([temperature](temperature.md))."},
      {"simulation.chamber", "The simulated chamber and the item in it."},
      {"simulation.link", "Timing of the simulated links."},
      {"notify", "Who is told of faults and of the end of a run ([messages](measurement.md#messages))."},
      {"emulator", "Models and lines of simulated and emulated instruments ([emulate](emulate.md))."},
      {"fault", "A fault that the simulation injects; may be repeated ([emulate](emulate.md#faults))."},
      {"change",
       "From `at_s` on the accelerometer and the room have these properties. May be repeated, in order of "
       "time. Properties that are not given do not change. Further keys: those of `[simulation]` that "
       "concern the accelerometer and the room."},
  };
  return texts;
}

}  // namespace

KeyMeaning bench_key_meaning(const std::string& path) {
  const auto found = key_meanings().find(path);
  return found == key_meanings().end() ? KeyMeaning{} : found->second;
}

std::string bench_section_text(const std::string& section) {
  const auto found = section_texts().find(section);
  return found == section_texts().end() ? std::string() : found->second;
}

}  // namespace abcal
