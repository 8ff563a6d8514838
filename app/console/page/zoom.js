// Zooms a chart: a part is chosen by dragging over it, with the wheel, two fingers, or the keyboard; a double click or 0 shows all.
import {resetWords} from '/plots.js';

const NEAREST = 1e-3;  // narrowest part, relative to the whole

export function offerZoom(chart) {
  const {holder} = chart;
  const show = (min, max) => {
    const [first, last] = chart.ends, least = NEAREST * (last - first);
    if (max - min < least) return;
    if (min <= first && max >= last) chart.zoom(null);
    else chart.zoom(Math.max(min, first), Math.min(max, last));
  };
  const move = (by) => {
    const [first, last] = chart.ends, [min, max] = chart.shownX, step = Math.min(Math.max(by * (max - min), first - min), last - max);
    if (step !== 0) show(min + step, max + step);
  };
  // factor: below 1 shows less. at: the place, 0 to 1, that stays.
  const scale = (factor, at = 0.5) => {
    const [min, max] = chart.shownX, room = (max - min) * (factor - 1);
    show(min - room * at, max + room * (1 - at));
  };
  const scaleY = (factor) => {
    const [low, high] = chart.shownY, room = (high - low) * (factor - 1) / 2;
    chart.zoomY(low - room, high + room);
  };
  const KEYS = {'+': () => scale(0.5), '-': () => scale(2), ArrowLeft: () => move(-1 / 8), ArrowRight: () => move(1 / 8), PageUp: () => scaleY(0.5), PageDown: () => scaleY(2), 0: () => chart.all()};

  holder.tabIndex = 0;
  holder.title = resetWords();
  holder.addEventListener('keydown', (event) => {
    const does = KEYS[event.key === '=' ? '+' : event.key];
    if (!does || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    does();
  });
  const placeOf = ({clientX}) => { const {left, width} = chart.plot.over.getBoundingClientRect(); return Math.min(1, Math.max(0, (clientX - left) / width)); };
  // Without the focus the wheel scrolls the page; a pinch on a touch pad is reported as a wheel with Ctrl.
  holder.addEventListener('wheel', (event) => {
    if (!event.ctrlKey && document.activeElement !== holder) return;
    event.preventDefault();
    const factor = Math.exp(Math.max(-1, Math.min(1, event.deltaY / 300)));
    if (event.shiftKey) scaleY(factor); else scale(factor, placeOf(event));
  }, {passive: false});
  holder.addEventListener('pointerdown', () => holder.focus({preventScroll: true}));
  // Two fingers: the distance between them.
  let apart = null;
  const distance = ([a, b]) => Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
  holder.addEventListener('touchmove', (event) => {
    if (event.touches.length !== 2) return;
    event.preventDefault();
    const now = distance(event.touches);
    if (apart) scale(apart / now, placeOf({clientX: (event.touches[0].clientX + event.touches[1].clientX) / 2}));
    apart = now;
  }, {passive: false});
  holder.addEventListener('touchend', () => { apart = null; });
}
