import {t} from '/language.js';
import {offerZoom, shade} from '/zoom.js';

// Chart.js (a global of chart.js) with the colours of the style sheet, also after a change between light and dark.
const palette = {};
const made = new Set();

export const OUTPUTS = ['u', 'v', 'w'];
const POINTS = ['circle', 'triangle', 'rect'];  // Outputs do not differ by colour alone.
const DASHES = [[], [6, 3], [2, 2]];

function readPalette() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ['dim', 'line', 'bad', ...OUTPUTS]) palette[name] = style.getPropertyValue(`--${name}`).trim();
}
readPalette();
// Draws all plots again, with the present colours of the style sheet.
export function repaint() {
  readPalette();
  for (const chart of made) {
    for (const set of chart.data.datasets) {
      for (const [name, colour] of Object.entries(coloursOf(set.output))) if (typeof set[name] !== 'function') set[name] = colour;
    }
    chart.update();  // Without animation; the mode 'none' would leave the markers as they are.
  }
}
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', repaint);

// Functions, which Chart.js calls at each update.
const dim = () => palette.dim;
const line = () => palette.line;
// The colours of a dataset are values, as functions would be called for each point.
function coloursOf(output) {
  const colour = palette[output] ?? palette.dim;
  return {borderColor: colour, backgroundColor: colour, pointBackgroundColor: colour, pointBorderColor: colour};
}

function axis(words, more = {}) {
  return {...more, title: {display: words !== '', text: words, color: dim}, ticks: {...more.ticks, format: {useGrouping: false}, color: dim}, grid: {color: line}};
}

// Y axes of equal width in plots below each other, so that their angles are aligned.
const LEFT = 78;  // least width in px
const aligned = (group) => ({afterFit: (scale) => { scale.width = group.width = Math.max(LEFT, group.width ?? 0, scale.width); }});

// The sample of a line in the legend: its dashes and its marker. Drawn once, as the legend asks for it at each update.
const drawnSamples = new Map();
function sample(item, dash) {
  const key = `${dash} ${item.pointStyle} ${item.strokeStyle}`;
  if (!drawnSamples.has(key)) drawnSamples.set(key, drawSample(item, dash));
  return drawnSamples.get(key);
}
function drawSample(item, dash) {
  const picture = document.createElement('canvas'), brush = picture.getContext('2d');
  [picture.width, picture.height] = [34, 10];
  brush.strokeStyle = brush.fillStyle = item.strokeStyle;
  brush.lineWidth = 1.8;
  brush.setLineDash(dash);
  brush.beginPath();
  brush.moveTo(0, 5);
  brush.lineTo(34, 5);
  brush.stroke();
  brush.setLineDash([]);
  if (item.pointStyle !== 'line') Chart.helpers.drawPoint(brush, {pointStyle: item.pointStyle, radius: 3.5, borderWidth: 1}, 17, 5);
  return picture;
}
const samples = (chart) => Chart.defaults.plugins.legend.labels.generateLabels(chart)
  .map((item) => ({...item, pointStyle: sample(item, chart.data.datasets[item.datasetIndex].borderDash)}));

// "4.0e−5" where Chart.js would write 4.000000E-5.
function tick(value, index, ticks) {
  const largest = Math.max(...ticks.map((t) => Math.abs(t.value)));
  if (value === 0 || largest >= 1e-3) return Chart.Ticks.formatters.numeric.call(this, value, index, ticks);
  return value.toExponential(1).replaceAll('-', '−');
}

function draw(canvas, type, data, {x, y, legend = true, xRange = {}, group = null}) {
  const chart = new Chart(canvas, {
    type,
    data,
    plugins: [shade],
    options: {
      animation: false, responsive: true, maintainAspectRatio: false,
      ...(type === 'line' && {parsing: false}),  // Points come as {x, y}, in numbers.
      interaction: {mode: 'nearest', intersect: false},
      scales: {x: axis(x, xRange), y: axis(y, {...(group ? aligned(group) : {}), ticks: {callback: tick}})},
      plugins: {legend: {display: legend, labels: {color: dim, usePointStyle: true, ...(type === 'line' && {generateLabels: samples, pointStyleWidth: 34}), boxHeight: 7, filter: (item) => !item.text.startsWith('_')}}},
    },
  });
  made.add(chart);
  if (type === 'line') offerZoom(chart);
  return chart;
}

export function discard(chart) {
  made.delete(chart);
  chart.destroy();
}

// A plot of points and lines over numbers. Axis titles carry the units; the legend omits names that begin with "_".
export function plot(canvas, {datasets, xRange = {}, ...words}) {
  return draw(canvas, 'line', {datasets}, {...words, xRange: {type: 'linear', ...xRange}});
}

// Smaller if there are many points.
export const pointRadius = (points) => (points.length > 40 ? 1.8 : 3);

// A line through points, or points alone.
export function series(output, label, {line: joined = true, points = false} = {}) {
  const i = Math.max(0, OUTPUTS.indexOf(output));
  return {label, output, data: [], ...coloursOf(output),
    borderWidth: joined ? 1.8 : 0, showLine: joined, borderDash: DASHES[i], pointRadius: points ? 3 : 0, pointStyle: points ? POINTS[i] : 'line', pointHitRadius: 8};
}

// Groups of bars, one colour an output.
export function bars(canvas, {x = '', y, labels, sets}) {
  const datasets = sets.map((set) => ({label: set.output, output: set.output, data: set.values, ...coloursOf(set.output), pointStyle: POINTS[OUTPUTS.indexOf(set.output)]}));
  return draw(canvas, 'bar', {labels, datasets}, {x, y, xRange: {type: 'category'}});
}

// Values with a band of two standard uncertainties, and the limits of a control chart where there are any.
// The text `words` of a point is shown below it instead of its number.
export function band(canvas, {x, y, points, output, limits = null, marks = false}) {
  const edge = (sign) => points.map((p) => ({x: p.x, y: p.y + sign * 2 * (p.u ?? 0)}));
  const level = (name, value, dash) => ({...series('', name), borderWidth: 1.2, borderDash: dash,
    data: points.length ? [{x: points[0].x, y: value}, {x: points.at(-1).x, y: value}] : []});
  const thin = {borderWidth: 1, borderDash: [2, 3]};
  const outside = ({raw}) => limits && raw && (raw.y < limits.lower || raw.y > limits.upper);
  const striking = marks ? {pointRadius: (point) => (outside(point) ? 7 : 4), pointStyle: (point) => (outside(point) ? 'rectRot' : 'circle'),
    pointBackgroundColor: (point) => (outside(point) ? palette.bad : palette[output])} : {};
  const datasets = [
    {...series(output, t('value'), {points: marks}), ...striking, borderDash: [], data: points.map((p) => ({x: p.x, y: p.y}))},
    {...series(output, t('2 std. uncertainties')), ...thin, data: edge(+1)},
    {...series(output, '_lower'), ...thin, data: edge(-1)},
  ];
  if (limits) datasets.push(level(t('centre'), limits.centre, []), level(t('limits'), limits.upper, [8, 4]), level('_limit', limits.lower, [8, 4]));
  return plot(canvas, {x, y, datasets, xRange: {
    min: points[0]?.x, max: points.at(-1)?.x, offset: marks,
    ticks: {precision: 0, maxRotation: 0, autoSkipPadding: 10, ...(marks && {stepSize: 1, callback: (n) => points.find((p) => p.x === n)?.words ?? ''})}}});
}
