// Plays a finished run: its angles appear in the charts as they were measured, and the stage turns with them. Flagged angles are marks on
// the time line. While it plays, REPLAY is shown above it, since it does not show the present state of the bench.
import {byId, duration, element} from '/text.js';
import {drawGimbal} from '/gimbal.js';
import {t} from '/language.js';
import {nameOf} from '/residuals.js';

const TEXT = {play: t('Replay'), pause: t('Pause'), end: t('Show all'), speed: t('Times as fast'), at: t('Time of the run'), badge: t('REPLAY')};
const SPEEDS = [1, 10, 100, 1000];
const EACH_MS = 100;

export class Replay {
  // residuals: whose charts show the run.
  constructor(residuals) {
    this.residuals = residuals;
    this.entries = residuals.entries.filter((e) => Number.isFinite(e.time_s)).sort((a, b) => a.time_s - b.time_s);
    const first = this.entries[0].time_s, last = this.entries.at(-1).time_s;
    const button = (id, words, act) => { const made = element('button', {type: 'button', id}, words); made.addEventListener('click', act); return made; };
    this.play = button('replay-play', TEXT.play, () => this.toggle());
    this.end = button('replay-end', TEXT.end, () => this.stop());
    this.speed = element('select', {id: 'replay-speed'}, ...SPEEDS.map((n) => element('option', {value: n, selected: n === 100}, String(n))));
    const marks = [...new Set(this.entries.filter((e) => e.flagged).map((e) => e.time_s))];
    this.line = element('input', {type: 'range', id: 'replay-at', min: first, max: last, step: 'any', list: 'replay-flags', 'aria-label': TEXT.at});
    this.line.value = last;
    this.line.addEventListener('input', () => this.go(Number(this.line.value)));
    this.badge = element('strong', {class: 'replay-badge', hidden: true}, TEXT.badge);
    this.where = element('span', {id: 'replay-where'});
    // A picture of its own: the one of the live view shows the stage as it is now.
    this.stage = byId('gimbal').cloneNode(true);
    this.stage.removeAttribute('id');
    this.stage.removeAttribute('aria-labelledby');
    this.stage.setAttribute('aria-hidden', 'true');
    this.stage.setAttribute('hidden', '');
    this.stage.classList.add('gimbal');
    for (const part of this.stage.querySelectorAll('[id]')) part.removeAttribute('id');
    this.element = element('div', {id: 'replay', class: 'no-print'}, element('div', {class: 'bar'}, this.badge, this.play, this.end,
      element('label', {for: 'replay-speed'}, TEXT.speed), this.speed, this.where), this.line, element('datalist', {id: 'replay-flags'}, ...marks.map((value) => element('option', {value}))), this.stage);
    this.end.hidden = true;
  }

  toggle() {
    if (this.timer) return this.pause();
    if (Number(this.line.value) >= Number(this.line.max)) this.line.value = this.line.min;
    let before = performance.now();
    this.play.textContent = TEXT.pause;
    this.timer = setInterval(() => {
      if (!this.element.isConnected) return this.pause();  // Another view is shown.
      const now = performance.now(), at = Number(this.line.value) + (now - before) / 1000 * Number(this.speed.value);
      before = now;
      this.line.value = at;
      this.go(Math.min(at, Number(this.line.max)));
      if (at >= Number(this.line.max)) this.pause();
    }, EACH_MS);
  }

  pause() {
    clearInterval(this.timer);
    this.timer = null;
    this.play.textContent = TEXT.play;
  }

  stop() {
    this.pause();
    this.line.value = this.line.max;
    this.residuals.showUntil(Infinity);
    this.mark(false);
    this.where.textContent = '';
  }

  mark(isReplaying) {
    this.badge.hidden = this.end.hidden = !isReplaying;
    this.stage.toggleAttribute('hidden', !isReplaying);
    this.residuals.element.classList.toggle('replaying', isReplaying);
  }

  go(time_s) {
    this.mark(true);
    const passed = this.entries.filter((e) => e.time_s <= time_s), now = passed.at(-1) ?? this.entries[0];
    this.residuals.showUntil(time_s);
    drawGimbal(now.x_deg ?? 0, now.z_deg ?? 0, null, this.stage);
    const flagged = passed.filter((e) => e.flagged).length;
    this.where.textContent = t`${duration(time_s)}: ${nameOf(now)}; ${passed.length} of ${this.entries.length} angles, ${flagged} flagged`;
  }
}
