// Chart.js (a global of chart.js) dressed for this page: colours of the style sheet, also after light and dark change.
const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const made = new Set();

export const OUTPUTS = ['u', 'v', 'w'];
export const colour = (output) => style(`--${output}`);
export const POINTS = ['circle', 'triangle', 'rect'];  // Not by colour alone.
const DASHES = [[], [6, 3], [2, 2]];

function dress(chart) {
  const text = style('--dim'), line = style('--line');
  for (const axis of Object.values(chart.options.scales)) {
    axis.ticks = {...axis.ticks, color: text};
    axis.grid = {...axis.grid, color: line};
    if (axis.title) axis.title.color = text;
  }
  chart.options.plugins.legend.labels.color = text;
  for (const set of chart.data.datasets) {
    if (set.output === undefined) continue;
    set.borderColor = set.pointBackgroundColor = colour(set.output);
    if (set.type === 'bar' || chart.config.type === 'bar') set.backgroundColor = colour(set.output);
  }
}

// A plot on a canvas. Axis titles carry the units.
export function plot(canvas, {type = 'line', x, y, datasets, legend = true, xRange = {}, yRange = {}, tooltip}) {
  const chart = new Chart(canvas, {
    type,
    data: {datasets},
    options: {
      animation: false, responsive: true, maintainAspectRatio: false, parsing: false, normalized: true,
      interaction: {mode: 'nearest', intersect: false},
      scales: {
        x: {type: 'linear', title: {display: true, text: x}, ...xRange},
        y: {title: {display: true, text: y}, ...yRange},
      },
      plugins: {
        legend: {display: legend, labels: {usePointStyle: true, boxHeight: 7, filter: (item) => !item.text.startsWith('_')}},
        tooltip: tooltip ? {callbacks: tooltip} : {},
      },
    },
  });
  dress(chart);
  chart.update('none');
  made.add(chart);
  return chart;
}

export function discard(chart) {
  made.delete(chart);
  chart.destroy();
}

// A line through points, or points alone.
export function series(output, label, {line = true, points = false} = {}) {
  const i = Math.max(0, OUTPUTS.indexOf(output));
  return {label, output, data: [], borderWidth: line ? 1.8 : 0, showLine: line, borderDash: DASHES[i],
    pointRadius: points ? 3 : 0, pointStyle: POINTS[i], pointHitRadius: 8};
}

matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
  for (const chart of made) {
    dress(chart);
    chart.update('none');
  }
});

// Groups of bars, one colour an output.
export function bars(canvas, {x = '', y, labels, sets}) {
  const chart = new Chart(canvas, {
    type: 'bar',
    data: {labels, datasets: sets.map((set) => ({label: set.output, output: set.output, data: set.values}))},
    options: {
      animation: false, responsive: true, maintainAspectRatio: false,
      scales: {x: {title: {display: x !== '', text: x}}, y: {title: {display: true, text: y}}},
      plugins: {legend: {labels: {usePointStyle: true, boxHeight: 7}}},
    },
  });
  dress(chart);
  chart.update('none');
  made.add(chart);
  return chart;
}

// Values with a band of two standard uncertainties, and the limits of a control chart where there are any.
export function band(canvas, {x, y, points, output, limits = null, marks = false}) {
  const edge = (sign) => points.map((p) => ({x: p.x, y: p.y + sign * 2 * (p.u ?? 0)}));
  const level = (name, value, dash) => ({...series('u', name), output: undefined, borderColor: 'gray', borderDash: dash, pointRadius: 0,
    data: points.length ? [{x: points[0].x, y: value}, {x: points.at(-1).x, y: value}] : []});
  const datasets = [
    {...series(output, 'value', {points: marks}), borderDash: [], data: points.map(({x: at, y: value}) => ({x: at, y: value}))},
    {...series(output, '2 std. uncertainties', {}), borderWidth: 1, borderDash: [2, 3], data: edge(+1)},
    {...series(output, '_lower', {}), borderWidth: 1, borderDash: [2, 3], data: edge(-1)},
  ];
  if (limits) datasets.push(level('centre', limits.centre, []), level('limits', limits.upper, [8, 4]), level('_limit', limits.lower, [8, 4]));
  return plot(canvas, {x, y, datasets, xRange: {ticks: {precision: 0}}});
}
