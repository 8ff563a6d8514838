// Charts of values over a long axis: points with bars of ±2 u, lines, a band, marks. A chart is drawn by uPlot; this module adds what
// a metrologist asks of it: the digits that the uncertainty allows, residual and z under the pointer, and zoom in x and y.
import uPlot from '/uplot.js';
import {decimals, element, signed, DASH} from '/text.js';
import {t} from '/language.js';
import {offerZoom} from '/zoom.js';

const palette = {};
const made = new Set();

export const OUTPUTS = ['u', 'v', 'w'];
const GLYPHS = ['●', '▲', '■'];  // Outputs do not differ by colour alone,
const DASHES = [[], [6, 3], [2, 2]];  // nor do their lines.
const LEFT = 64;  // px for the numbers of the y axis, in all charts, so that charts below each other are aligned.

function readPalette() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ['dim', 'line', 'bad', 'text', 'band', ...OUTPUTS]) palette[name] = style.getPropertyValue(`--${name}`).trim();
}
readPalette();
// Draws all charts again, with the present colours of the style sheet.
export function repaint() {
  readPalette();
  for (const chart of made) chart.paint();
}
for (const query of ['(prefers-color-scheme: dark)', '(forced-colors: active)']) matchMedia(query).addEventListener('change', repaint);
const colourOf = (output) => palette[output] ?? palette.dim;

// "+12.3e−6": the digits that u allows; below 1e-3 as a multiple of a power of 1000.
export function withDigits(value, u, unit = '') {
  if (!Number.isFinite(value)) return DASH;
  const size = Math.max(Math.abs(value), Number.isFinite(u) ? u : 0), uncertain = Number.isFinite(u) && u > 0 ? u : Math.abs(value) * 1e-3;
  const power = size > 0 && size < 1e-3 ? 3 * Math.floor(Math.log10(size) / 3) : 0;
  return `${signed(value / 10 ** power, Math.min(decimals(uncertain / 10 ** power), 9))}${power ? `e−${-power}` : ''}${unit && ` ${unit}`}`;
}

// Numbers of an axis: "4.0e−5" where all are small.
function tickWords(splits) {
  const largest = Math.max(...splits.map(Math.abs)), step = splits.length > 1 ? Math.abs(splits[1] - splits[0]) : largest;
  let fixed = 0;
  while (fixed < 9 && Math.abs(Math.round(step * 10 ** fixed) - step * 10 ** fixed) > 1e-6 * step * 10 ** fixed) ++fixed;  // 2.5 has one decimal.
  return splits.map((value) => (largest >= 1e-3 ? value.toFixed(fixed) : value === 0 ? '0' : value.toExponential(1)).replaceAll('-', '−'));
}

const axis = (words, more) => ({label: words, labelSize: 20, labelGap: 0, font: '12px system-ui, sans-serif', labelFont: '12px system-ui, sans-serif',
  stroke: () => palette.dim, labelStroke: () => palette.dim, grid: {stroke: () => palette.line, width: 1}, ticks: {stroke: () => palette.line, width: 1, size: 4}, gap: 3, ...more});

const SHAPES = [
  (brush, x, y, r) => brush.arc(x, y, r, 0, 2 * Math.PI),
  (brush, x, y, r) => { brush.moveTo(x, y - 1.2 * r); brush.lineTo(x + 1.1 * r, y + 0.9 * r); brush.lineTo(x - 1.1 * r, y + 0.9 * r); brush.closePath(); },
  (brush, x, y, r) => brush.rect(x - 0.9 * r, y - 0.9 * r, 1.8 * r, 1.8 * r),
];

// A chart in `holder`. series: [{output, label, points, line}]; x: {words, whole: [from, to], splits}; y: the words of its axis.
// say(value, k, i): the words of value i of series k, under the pointer; sync: charts of one name share the crosshair;
// picked(i): a point was clicked.
export class Chart {
  constructor(holder, {name, x, y, series, say = null, sync = null, picked = null, legend = true}) {
    Object.assign(this, {holder, series, x, whole: x.whole ?? null, unit: '', yZoom: null, xZoom: null, say, picked});
    this.bars = null;     // u of each point, by series.
    this.band = null;     // {x, u}: drawn from −2 u to +2 u.
    this.levels = [];     // {y, words, dash}: horizontal lines.
    this.marks = [];      // {x, words}: vertical lines.
    this.rings = new Set();  // Points with a ring.
    holder.classList.add('plot');
    holder.setAttribute('role', 'img');
    holder.setAttribute('aria-label', name);
    holder.chart = this;
    holder.dataset.empty = t('Nothing measured yet');
    holder.classList.add('empty');
    this.values = [[], ...series.map(() => [])];
    this.xSplits = x.splits;
    this.plot = new uPlot({
      ...this.room(),
      legend: {show: legend, markers: {width: 0}},
      cursor: {points: {size: 9}, hover: {skip: [null]}, drag: {x: true, y: true, uni: 25, dist: 8}, focus: {prox: 30},
        bind: {dblclick: () => () => { this.all(); return null; }}, ...(sync && {sync: {key: sync, scales: ['x', null], setSeries: false}})},
      focus: {alpha: 1},
      scales: {
        x: {time: false, auto: () => this.xZoom === null, range: (_, min, max) => this.xZoom ?? this.whole ?? (min === null ? [0, 1] : min === max ? [min - 1, max + 1] : [min, max])},
        y: {range: (_, min, max) => this.yZoom ?? this.yRange(min, max)},
      },
      axes: [axis(x.words, {size: 24, splits: (plot, i, min, max, step) => this.xSplits?.(min, max) ?? defaultSplits(min, max, step), values: x.values ?? ((_, splits) => tickWords(splits))}),
        axis(y, {size: LEFT, values: (_, splits) => tickWords(splits), label: y})],
      series: [{label: t('at'), value: (_, value) => this.xWords(value)}, ...series.map((one, k) => {
        const at = Math.max(0, OUTPUTS.indexOf(one.output));
        return {label: one.label === '' ? '\u00a0' : `${one.points ? `${GLYPHS[at]} ` : ''}${one.label}`, stroke: () => (one.line ? colourOf(one.output) : 'transparent'), width: one.line ? 1.6 : 0, dash: one.dash ?? DASHES[at],
          spanGaps: true, points: {show: false}, value: (_, value, __, i) => (i === null || i === undefined ? DASH : this.words(value, k, i))};
      })],
      hooks: {drawClear: [() => this.drawUnder()], draw: [() => this.drawOver()],
        setSelect: [(plot) => this.select(plot.select)]},
    }, this.values, holder);
    // A legend entry without a name belongs to a line of another entry.
    holder.querySelectorAll('.u-series').forEach((row, k) => { if (k > 0 && series[k - 1].label === '') row.hidden = true; });
    this.plot.over.addEventListener('click', () => { const i = this.plot.cursor.idx; if (picked && Number.isInteger(i)) picked(i); });
    this.sized = new ResizeObserver(() => { const room = this.room(); if (room.width !== this.plot.width || room.height !== this.plot.height) this.plot.setSize(room); });
    this.sized.observe(holder);
    offerZoom(this);
    made.add(this);
  }

  // The legend is outside the size that uPlot is given.
  room() {
    const legend = this.holder.querySelector('.u-legend')?.offsetHeight ?? 26;
    return {width: Math.max(120, this.holder.clientWidth), height: Math.max(80, this.holder.clientHeight - legend)};
  }

  xWords(value) { return Number.isFinite(value) ? this.x.say?.(value) ?? signed(value, 2).replace('+', '') : DASH; }
  words(value, k, i) {
    if (value === null || value === undefined) return DASH;
    return this.say ? this.say(value, k, i) : withDigits(value, this.bars?.[k]?.[i], this.unit);
  }

  // Bars, band and levels are inside the picture as well as the points.
  yRange(min, max) {
    let [low, high] = min === null || min === undefined ? [Infinity, -Infinity] : [min, max];
    const take = (value) => { if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); } };
    this.bars?.forEach((us, k) => us?.forEach((u, i) => { const y = this.values[k + 1][i]; if (y !== null) { take(y - 2 * u); take(y + 2 * u); } }));
    this.band?.u.forEach((u) => { take(2 * u); take(-2 * u); });
    for (const {y} of this.levels) take(y);
    if (!(low <= high)) return [0, 1];
    const room = (high - low || Math.abs(high) || 1) * 0.06;
    return [low - room, high + room];
  }

  // Shows other values: xs, and of each series the values, null where there is none.
  show(xs, values, {bars = null, band = null, rings = [], marks = this.marks, levels = this.levels, y = null} = {}) {
    Object.assign(this, {bars, band, rings: new Set(rings), marks, levels});
    this.values = [xs, ...values];
    this.holder.classList.toggle('empty', !values.some((column) => column.some((value) => value !== null)));  // Axes without data say nothing.
    if (y !== null && this.plot.axes[1].label !== y) this.plot.axes[1].label = y;
    this.plot.setData(this.values);
  }

  paint() {
    this.plot.redraw(false, true);
  }

  drawUnder() {
    const {plot} = this, brush = plot.ctx, {left, top, width, height} = plot.bbox, ratio = devicePixelRatio;
    brush.save();
    brush.beginPath();
    brush.rect(left, top, width, height);
    brush.clip();
    if (this.band?.x.length) {
      const {x, u} = this.band, edge = (sign) => x.map((at, i) => [plot.valToPos(at, 'x', true), plot.valToPos(sign * 2 * u[i], 'y', true)]);
      brush.fillStyle = palette.band;
      brush.beginPath();
      for (const [px, py] of [...edge(1), ...edge(-1).reverse()]) brush.lineTo(px, py);
      brush.fill();
    }
    brush.font = `${12 * ratio}px system-ui, sans-serif`;
    brush.strokeStyle = brush.fillStyle = palette.dim;
    brush.lineWidth = ratio;
    for (const {y, words, dash} of this.levels) {
      const py = plot.valToPos(y, 'y', true);
      brush.setLineDash(dash.map((d) => d * ratio));
      brush.beginPath();
      brush.moveTo(left, py);
      brush.lineTo(left + width, py);
      brush.stroke();
      brush.fillText(words, left + 4 * ratio, py - 3 * ratio);
    }
    brush.setLineDash([2 * ratio, 3 * ratio]);
    for (const {x} of this.marks) {
      const px = plot.valToPos(x, 'x', true);
      brush.beginPath();
      brush.moveTo(px, top);
      brush.lineTo(px, top + height);
      brush.stroke();
    }
    brush.restore();
  }

  drawOver() {
    const {plot, values} = this, brush = plot.ctx, ratio = devicePixelRatio, xs = values[0], {left, top, width, height} = plot.bbox;
    const {min, max} = plot.scales.x;
    brush.save();
    brush.beginPath();
    brush.rect(left - 4 * ratio, top - 4 * ratio, width + 8 * ratio, height + 8 * ratio);
    brush.clip();
    const few = xs.length <= 40;
    this.series.forEach((one, k) => {
      if (!one.points) return;
      const shape = SHAPES[Math.max(0, OUTPUTS.indexOf(one.output))], ys = values[k + 1], radius = (few ? 3.2 : 2) * ratio;
      brush.fillStyle = brush.strokeStyle = colourOf(one.output);
      brush.lineWidth = ratio;
      const marks = new Path2D(), bars = new Path2D();
      for (let i = 0; i < xs.length; ++i) {
        const y = ys[i];
        if (y === null || y === undefined || xs[i] < min || xs[i] > max) continue;
        const px = plot.valToPos(xs[i], 'x', true), py = plot.valToPos(y, 'y', true), u = this.bars?.[k]?.[i];
        marks.moveTo(px + radius, py);
        shape(marks, px, py, radius);
        if (u > 0) {
          bars.moveTo(px, plot.valToPos(y - 2 * u, 'y', true));
          bars.lineTo(px, plot.valToPos(y + 2 * u, 'y', true));
        }
        if (this.rings.has(i)) {
          brush.save();
          brush.strokeStyle = palette.bad;
          brush.lineWidth = 2 * ratio;
          brush.beginPath();
          brush.arc(px, py, 7 * ratio, 0, 2 * Math.PI);
          brush.stroke();
          brush.restore();
        }
      }
      brush.stroke(bars);
      brush.fill(marks);
    });
    brush.restore();
  }

  // Zoom. from, to: of the x axis; null: all.
  zoom(from, to) {
    this.xZoom = from === null ? null : [from, to];
    if (this.xZoom) this.plot.setScale('x', {min: from, max: to}); else this.plot.setData(this.values);
  }
  zoomY(low, high) {
    this.yZoom = low === null ? null : [low, high];
    this.plot.setData(this.values);
  }
  all() {
    this.xZoom = this.yZoom = null;
    this.plot.setData(this.values);
  }
  select({left, top, width, height}) {
    if (width < 8 && height < 8) return;
    const value = (px, key) => this.plot.posToVal(px, key);
    // A selection over the whole height or width does not choose in that direction.
    const wide = width < this.plot.over.clientWidth - 1, high = height < this.plot.over.clientHeight - 1;
    if (high) this.yZoom = [value(top + height, 'y'), value(top, 'y')];
    if (wide) this.zoom(value(left, 'x'), value(left + width, 'x')); else this.plot.setData(this.values);
    this.plot.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
  }
  get shownX() { const {min, max} = this.plot.scales.x; return [min, max]; }
  get shownY() { const {min, max} = this.plot.scales.y; return [min, max]; }
  get ends() { const xs = this.values[0]; return this.whole ?? [xs[0] ?? 0, xs.at(-1) ?? 1]; }

  destroy() {
    made.delete(this);
    this.sized.disconnect();
    this.plot.destroy();
  }
}

function defaultSplits(min, max, step) {
  const splits = [];
  for (let at = Math.ceil(min / step - 1e-9) * step; at <= max + step * 1e-9; at += step) splits.push(at);
  return splits;
}
// Whole quarters of a turn where they fit.
export const quarters = (min, max) => (max - min >= 180 ? defaultSplits(min, max, 90) : null);

// A place for a chart with its name for those who do not see it.
export const place = (kind = '') => element('div', {class: `plot${kind && ` ${kind}`}`});

// Points of the three outputs: their series.
export const outputSeries = (more = {}) => OUTPUTS.map((output) => ({output, label: output, points: true, ...more}));

// Groups of a few named places, e.g. closures: values with bars of ±2 u over the names.
export function overNames(holder, {name, x, y, names, values, us = null, unit = '', levels = [{y: 0, words: '', dash: []}]}) {
  const chart = new Chart(holder, {name, y, series: outputSeries(), x: {words: x, whole: [-0.6, names.length - 0.4], splits: (min, max) => names.map((_, i) => i).filter((i) => i >= min && i <= max),
    values: (_, splits) => splits.map((i) => names[i] ?? ''), say: (at) => names[Math.round(at)] ?? ''}});
  chart.unit = unit;
  // The three outputs of a name are drawn next to each other.
  const xs = [], columns = OUTPUTS.map(() => []), bars = OUTPUTS.map(() => []);
  names.forEach((_, i) => OUTPUTS.forEach((__, j) => {
    xs.push(i + 0.16 * (j - 1));
    OUTPUTS.forEach((___, k) => { columns[k].push(k === j ? values[j][i] : null); bars[k].push(k === j ? us?.[j]?.[i] ?? 0 : 0); });
  }));
  chart.levels = levels;
  chart.show(xs, columns, {bars});
  return chart;
}

export const resetWords = () => t('Drag, or press + and -, to zoom; arrows move; PageUp and PageDown zoom the values; with the focus the wheel zooms; double click or 0 shows all.');
