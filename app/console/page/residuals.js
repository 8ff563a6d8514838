// The angles of a run: residuals with bars of ±2 u, by angle and by time, and the way from a flagged angle to its single readings.
import {element, number, scrollable, signed, small, table, DASH} from '/text.js';
import {said, term} from '/said.js';
import {fetched} from '/fetched.js';
import {PagedTable} from '/pages.js';
import {Replay} from '/replay.js';
import {t} from '/language.js';
import {Chart, OUTPUTS, outputSeries, place, quarters, withDigits} from '/plots.js';

const TEXT = {
  title: t('Residuals: reading minus fit, with ±2 u'), against: t('Against'), angle: t('angle'), time: t('time'), flagged: t('Readings of the flagged angles'), noFlag: t('No angle is flagged.'), readings: t('Readings'),
  band: t('Grey band: ±2 u of a mean, of the output with the largest u. What is outside is more than noise: the stage or the accelerometer. A red ring marks a flagged angle. A click on a point shows its readings.'),
  all: t('All angles as a table'), whole: t('All readings of the run'), temperature: t('temperature (°C)'), minutes: t('time since the run began (min)'), none: t('none'),
  asTable: t('As a table'), close: t('Close'),
  noFit: t('There are no residuals: the published protocol does not evaluate these angles, for example those of a run at constant rates. Their readings are below.'),
};
export const TURNS = [t('1: X turns'), t('2: X turns, Z at −90°'), t('3: Z turns, X at −90°')];

// The angle at which the item sees the same gravity in face 1.
export function plottedAngle({experiment, face, alpha_deg: alpha}) {
  if (face !== 2) return alpha;
  const angle = experiment === 3 ? alpha + 180 : -alpha;
  return angle - 360 * Math.floor(angle / 360);
}

// "−12.3e−6 g" and below it "z −1.2": a residual under the pointer.
export const residualWords = (value, u, unit) => `${withDigits(value, u, unit)}\nz ${u > 0 ? signed(value / u, 1) : DASH}`;

// Residuals, an entry each angle: {experiment, x, time_s, residual[3], u[3], flagged}; drawn as points by `x`.
export function showResiduals(chart, entries, {unit, at}) {
  const sorted = [...entries].filter((e) => Number.isFinite(at(e))).sort((a, b) => at(a) - at(b)), xs = sorted.map(at);
  chart.entries = sorted;
  chart.unit = unit;
  const known = sorted.filter(({u}) => u);
  chart.show(xs, OUTPUTS.map((_, j) => sorted.map((e) => e.residual?.[j] ?? null)),
    {bars: OUTPUTS.map((_, j) => sorted.map((e) => e.u?.[j] ?? 0)), band: {x: known.map(at), u: known.map(({u}) => Math.max(...u))},
      rings: sorted.flatMap((e, i) => (e.flagged ? [i] : [])), y: t`residual (${unit})`, marks: chart.marks});
}

export const residualChart = (holder, {name, x, sync, picked = null}) => {
  const chart = new Chart(holder, {name, x, y: t('residual'), series: outputSeries(), sync, say: (value, k, i) => residualWords(value, chart.entries[i]?.u?.[k], chart.unit),
    picked: picked && ((i) => picked(chart.entries[i]))});
  return chart;
};

async function json(path) {
  const response = await fetched(path);
  if (!response.ok) throw new Error((await response.text()).trim());
  return response.json();
}

// angles: as /runs/NAME/angles; fits: of the published protocol.
function entriesOf(angles, fits) {
  const fitOf = new Map(fits.map((fit) => [`${fit.experiment} ${fit.accelerometer}`, fit]));
  return angles.position.map((position, i) => {
    const entry = {position, experiment: angles.experiment[i], face: angles.face[i], alpha_deg: angles.alpha_deg[i], closing: angles.closing[i], time_s: angles.time_s[i], readings: angles.readings[i],
      temperature: angles.temperature_degc[i], x_deg: angles.encoder_x_deg[i], z_deg: angles.encoder_z_deg[i], rate: angles.rate_deg_per_s[i], flags: angles.flag_words.filter((_, bit) => angles.flags[i] & (1 << bit)).map(term),
      mean: angles.mean.map((column) => column[i]), u: angles.u_mean[0][i] === null ? null : angles.u_mean.map((column) => column[i]), residual: null};
    entry.x = plottedAngle(entry);
    entry.flagged = entry.flags.length > 0;
    const own = OUTPUTS.map((name) => fitOf.get(`${entry.experiment} ${name}`));
    if (own.every(Boolean)) {
      const a = entry.x * Math.PI / 180;
      entry.residual = own.map((fit, j) => (entry.mean[j] === null ? null : entry.mean[j] - (fit.constant.value + fit.sine.value * Math.sin(a) + fit.cosine.value * Math.cos(a))));
    }
    return entry;
  });
}

export const nameOf = (e) => (e.experiment ? t`experiment ${e.experiment}, ${number(e.alpha_deg, 2)}°` + (e.face === 2 ? t(', face 2') : '') + (e.closing ? t(' (closing)') : '') : t('check pose'));

// path: of the run or of one of its items. fits: of the published protocol; events: of the run; charts: where the charts are kept
// until another view is shown.
export class Residuals {
  constructor(path, {fits, unit, events, charts}) {
    Object.assign(this, {path, fits, unit, events, charts, by: 'angle', until: Infinity});
    this.holder = element('div', {class: 'plots', id: 'residuals'});
    this.flagged = element('div', {id: 'flagged-angles'});
    this.single = element('section', {id: 'angle-readings', 'aria-live': 'polite', tabindex: -1});
    this.choice = element('select', {id: 'residuals-against'}, element('option', {value: 'angle'}, TEXT.angle), element('option', {value: 'time'}, TEXT.time));
    this.choice.addEventListener('change', () => { this.by = this.choice.value; this.draw(); });
    this.rows = scrollable('scroll', TEXT.all, '');
    this.whole = element('details', {id: 'all-readings'}, element('summary', {}, TEXT.whole), element('div', {}));
    this.whole.addEventListener('toggle', () => { if (this.whole.open && !this.whole.dataset.drawn) this.drawWhole(); });
    this.element = element('section', {class: 'card block'}, element('h3', {}, TEXT.title),
      element('div', {class: 'bar no-print'}, element('label', {for: 'residuals-against'}, TEXT.against), this.choice), this.flagged, this.holder,
      element('p', {class: 'small-print'}, TEXT.band), this.single, element('details', {}, element('summary', {}, TEXT.all), this.rows), this.whole);
  }

  async load({toFlags = false} = {}) {
    try {
      this.angles = await json(`${this.path}/angles`);
    } catch (error) {
      return this.holder.replaceChildren(element('p', {role: 'alert', class: 'grade-problem'}, said(error.message)));
    }
    this.entries = entriesOf(this.angles, this.fits);
    this.draw();
    this.listFlagged();
    if (this.entries.some((e) => Number.isFinite(e.time_s))) this.element.insertBefore(new Replay(this).element, this.holder);
    const cells = (e) => [nameOf(e), Number.isFinite(e.rate) ? number(e.rate, 2).replace('-', '−') : DASH, Number.isFinite(e.time_s) ? number(e.time_s / 60, 2) : DASH,
      ...OUTPUTS.flatMap((_, j) => [e.residual?.[j] === null || !e.residual ? DASH : withDigits(e.residual[j], e.u?.[j]), e.residual && e.u ? signed(e.residual[j] / e.u[j], 1) : DASH]),
      e.u ? small(Math.max(...e.u)) : DASH, number(e.temperature, 2), e.flags.length ? e.flags.join(', ') : TEXT.none];
    new PagedTable(this.rows, {caption: () => t`Residuals in ${this.unit}, and z: residual over standard uncertainty (1)`,
      head: () => [t('Angle'), t('Rate (degrees/s)'), t('Time (min)'), ...OUTPUTS.flatMap((name) => [`${name} (${this.unit})`, `z ${name} (1)`]), t`Largest std. uncertainty (${this.unit})`, t('Temperature (°C)'), t('Flags')],
      rows: (from, to) => this.entries.slice(from, to).map(cells)}).show(this.entries.length);
    if (toFlags) this.flagged.querySelector('button, p')?.focus();
  }

  discardCharts() {
    for (const {chart} of this.holder.querySelectorAll('.plot')) {
      this.charts.splice(this.charts.indexOf(chart), 1);
      chart.destroy();
    }
    this.holder.replaceChildren();
  }

  draw() {
    this.discardCharts();
    this.shown = [];  // Charts, each with its entries and their place along x.
    if (!this.entries.some((e) => e.residual)) return this.holder.replaceChildren(element('p', {}, TEXT.noFit));
    const one = (title, name, x, entries, at, sync, kind = '') => {
      const holder = place(kind);
      this.holder.append(element('div', {class: kind === 'wide' ? 'across' : false}, element('h4', {}, title), holder));
      const chart = residualChart(holder, {name, x, sync, picked: (entry) => this.showReadings(entry)});
      this.charts.push(chart);
      this.shown.push([chart, entries, at]);
    };
    const seen = (experiment) => this.entries.filter((e) => e.residual && !e.closing && (experiment === null || e.experiment === experiment));
    if (this.by === 'angle') {
      for (const n of [1, 2, 3])
        one(t`Experiment ${TURNS[n - 1]}`, t`Residuals of experiment ${n}; the table below has the numbers`, {words: t('angle (degrees)'), whole: [0, 360], splits: quarters}, seen(n), ({x}) => x, 'residuals by angle');
    } else {
      const x = {words: TEXT.minutes, whole: [0, Math.max(1e-3, ...this.entries.map(({time_s: s}) => (Number.isFinite(s) ? s / 60 : 0)))]};
      one(TEXT.title, t('Residuals against time; the table below has the numbers'), x, seen(null), ({time_s: s}) => s / 60, 'residuals by time', 'wide');
      this.drawTemperature(x);
      this.markEvents();
    }
    this.refresh();
  }

  // Shows the angles up to a moment of the run, in seconds since it began; Infinity: all.
  showUntil(time_s) {
    this.until = time_s;
    this.refresh();
  }
  refresh() {
    for (const [chart, entries, at] of this.shown) showResiduals(chart, this.until === Infinity ? entries : entries.filter((e) => e.time_s <= this.until), {unit: this.unit, at});
  }

  // Dashed lines where something happened, e.g. a note or a port that returned; their words are in the table of the events.
  markEvents() {
    const begun = Date.parse(this.angles.begun_utc);
    if (!Number.isFinite(begun)) return;  // Simulated time.
    const marks = this.events.filter(({kind}) => !['started', 'complete', 'operator stated', 'operator logged in'].includes(kind)).map(({utc}) => ({x: (Date.parse(utc) - begun) / 60_000}));
    for (const {chart} of this.holder.querySelectorAll('.plot')) {
      chart.marks = marks;
      chart.paint();
    }
  }

  drawTemperature(x) {
    const known = this.entries.filter((e) => Number.isFinite(e.temperature) && Number.isFinite(e.time_s)).sort((a, b) => a.time_s - b.time_s);
    if (!known.length) return;
    const holder = place('wide small');
    this.holder.append(element('div', {class: 'across'}, element('h4', {}, TEXT.temperature), holder));
    const chart = new Chart(holder, {name: t('Temperature against time; the table below has the numbers'), x, y: TEXT.temperature, sync: 'residuals by time',
      series: [{output: 'u', label: t('temperature'), points: true, line: true}], say: (value) => number(value, 2, '°C')});
    this.charts.push(chart);
    chart.show(known.map(({time_s: s}) => s / 60), [known.map(({temperature}) => temperature)]);
  }

  listFlagged() {
    const flagged = this.entries.filter((e) => e.flagged);
    if (!flagged.length) return this.flagged.replaceChildren(element('p', {tabindex: -1}, TEXT.noFlag));
    this.flagged.replaceChildren(element('h4', {}, TEXT.flagged));
    const button = (e) => {
      const made = element('button', {type: 'button', class: 'flagged-angle'}, nameOf(e), ': ', e.flags.join(', '));
      made.addEventListener('click', () => this.showReadings(e));
      return made;
    };
    const MOST = 12;
    this.flagged.append(element('div', {class: 'bar'}, ...flagged.slice(0, MOST).map(button)));
    if (flagged.length > MOST) {
      const rest = element('details', {}, element('summary', {}, t`${flagged.length - MOST} more`), element('div', {class: 'bar'}, ...flagged.slice(MOST).map(button)));
      this.flagged.append(rest);
    }
  }

  async showReadings(entry) {
    let data;
    try {
      data = await json(`${this.path}/readings?position=${entry.position}&columns=${Math.round(this.holder.clientWidth || 600)}`);
    } catch (error) {
      return this.single.replaceChildren(element('p', {role: 'alert', class: 'grade-problem'}, said(error.message)));
    }
    this.single.querySelector('.plot')?.chart?.destroy();
    const holder = place('wide'), close = element('button', {type: 'button'}, TEXT.close);
    close.addEventListener('click', () => { holder.chart.destroy(); this.single.replaceChildren(); });
    const rows = scrollable('scroll', TEXT.readings, '');
    this.single.replaceChildren(element('h4', {}, t`Readings: ${nameOf(entry)}`), element('p', {}, t`${data.readings} readings; flags: `, entry.flags.length ? entry.flags.join(', ') : TEXT.none, '. ', close), holder,
      element('details', {}, element('summary', {}, TEXT.asTable), rows));
    const from = data.time_s[0] ?? 0;
    drawThinned(holder, t`Readings of ${nameOf(entry)}; the table below has the numbers`, t('time since the first of them (s)'), data, data.time_s.map((s) => s - from), entry.mean);
    this.charts.push(holder.chart);
    tableOfReadings(rows, data, data.time_s.map((s) => s - from));
    this.single.focus({preventScroll: true});
    this.single.scrollIntoView({block: 'nearest'});
  }

  async drawWhole() {
    const [, inside] = this.whole.children, holder = place('wide'), rows = scrollable('scroll', TEXT.whole, '');
    try {
      const data = await json(`${this.path}/readings?columns=${Math.round(this.holder.clientWidth || 600)}`);
      this.whole.dataset.drawn = 'yes';
      inside.replaceChildren(element('p', {}, data.thinned ? t`${data.readings} readings; drawn: lowest and highest of ${data.time_s.length} parts.` : t`${data.readings} readings.`), holder,
        element('details', {}, element('summary', {}, TEXT.asTable), rows));
      const minutes = data.time_s.map((s) => s / 60);
      drawThinned(holder, t('All readings of the run; the table below has the numbers'), TEXT.minutes, data, minutes, [0, 0, 0]);
      this.charts.push(holder.chart);
      tableOfReadings(rows, data, data.time_s);
    } catch (error) {
      inside.replaceChildren(element('p', {role: 'alert', class: 'grade-problem'}, said(error.message)));
    }
  }
}

// Readings less `means`; of thinned ones the lowest and the highest.
function drawThinned(holder, name, words, data, xs, means) {
  const isMean = means.some((mean) => mean), y = isMean ? t`reading minus mean (${data.unit})` : t`output (${data.unit})`;
  const less = (columns) => columns.map((column, j) => column.map((value) => (value === null ? null : value - (means[j] ?? 0))));
  const chart = new Chart(holder, {name, x: {words}, y, series: [...outputSeries({line: data.thinned, points: !data.thinned}), ...(data.thinned ? OUTPUTS.map((output) => ({output, label: '', line: true})) : [])],
    say: (value, k, i) => (data.thinned && k < 3 ? t`${withDigits(chart.values[k + 1][i], 0)} to ${withDigits(chart.values[k + 4][i], 0, data.unit)}` : withDigits(value, 0, data.unit))});
  chart.show(xs, [...less(data.lowest), ...(data.thinned ? less(data.highest) : [])]);
}

function tableOfReadings(holder, data, xs) {
  const cells = (i) => [number(xs[i], 3), ...OUTPUTS.flatMap((_, j) => (data.thinned ? [signed(data.lowest[j][i], 6), signed(data.highest[j][i], 6)] : [signed(data.lowest[j][i], 6)]))];
  new PagedTable(holder, {caption: () => (data.thinned ? t('Lowest and highest reading of each part') : TEXT.readings),
    head: () => [t('Time (s)'), ...OUTPUTS.flatMap((name) => (data.thinned ? [t`${name} lowest (${data.unit})`, t`${name} highest (${data.unit})`] : [`${name} (${data.unit})`]))],
    rows: (from, to) => Array.from({length: to - from}, (_, i) => cells(from + i))}).show(xs.length);
}
