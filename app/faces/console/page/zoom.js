// Zooms a plot: a part is chosen by dragging over it, or with the keyboard; a double click or 0 shows all again.
import {t} from '/language.js';

const NEAREST = 1e-3;  // narrowest part, relative to the whole

export const shade = {
  id: 'shade',
  afterDraw(chart) {
    if (!chart.chosen) return;
    const {top, height} = chart.chartArea, [from, to] = chart.chosen;
    chart.ctx.save();
    chart.ctx.fillStyle = 'rgb(128 128 128 / .3)';
    chart.ctx.fillRect(Math.min(from, to), top, Math.abs(to - from), height);
    chart.ctx.restore();
  },
};

export function offerZoom(chart) {
  const {canvas} = chart, axis = () => chart.options.scales.x;
  const made = {min: axis().min, max: axis().max, step: axis().ticks.stepSize};
  const whole = () => {
    const all = chart.data.datasets.flatMap(({data}) => data.map(({x}) => x));
    return {min: made.min ?? Math.min(...all), max: made.max ?? Math.max(...all)};
  };
  const show = (min, max) => {
    const all = whole(), least = NEAREST * (all.max - all.min);
    const some = (min > all.min || max < all.max) && max - min >= least;
    if (!some && max - min < least) return;
    axis().min = some ? Math.max(min, all.min) : made.min;
    axis().max = some ? Math.min(max, all.max) : made.max;
    axis().ticks.stepSize = some ? undefined : made.step;
    chart.update('none');
  };
  const all = () => show(-Infinity, Infinity);
  const KEYS = {
    '+': ({min, max}) => show(min + (max - min) / 4, max - (max - min) / 4),
    '-': ({min, max}) => show(min - (max - min) / 2, max + (max - min) / 2),
    ArrowLeft: ({min, max}) => move(min, max, -(max - min) / 8),
    ArrowRight: ({min, max}) => move(min, max, (max - min) / 8),
    0: all,
  };
  const move = (min, max, by) => {
    const ends = whole(), step = Math.min(Math.max(by, ends.min - min), ends.max - max);
    if (step !== 0) show(min + step, max + step);
  };

  canvas.tabIndex = 0;
  canvas.title = t('Drag, or press + and -, to zoom; arrows move; double click or 0 shows all.');
  canvas.addEventListener('keydown', (event) => {
    const does = KEYS[event.key === '=' ? '+' : event.key];
    if (!does || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    does(chart.scales.x);
  });
  canvas.addEventListener('dblclick', all);
  canvas.addEventListener('pointerdown', (event) => {
    if (event.button !== 0 || event.pointerType === 'touch') return;  // A finger scrolls.
    canvas.setPointerCapture(event.pointerId);
    chart.chosen = [event.offsetX, event.offsetX];
  });
  canvas.addEventListener('pointermove', (event) => {
    if (!chart.chosen) return;
    chart.chosen[1] = event.offsetX;
    chart.draw();
  });
  canvas.addEventListener('pointerup', () => {
    if (!chart.chosen) return;
    const [from, to] = [...chart.chosen].sort((a, b) => a - b), {x} = chart.scales;
    chart.chosen = null;
    if (to - from > 8) show(x.getValueForPixel(from), x.getValueForPixel(to));
    chart.draw();
  });
  canvas.addEventListener('pointercancel', () => { chart.chosen = null; });
}
