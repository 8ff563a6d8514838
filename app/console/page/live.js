// The live view: shows the data of the messages, and nothing that the server has not stated.
import {byId, degrees, duration, element, number, signed, small, table, DASH} from '/text.js';
import {said, term, translated} from '/said.js';
import {drawGimbal} from '/gimbal.js';
import {liveItem} from '/items.js';
import {Chart, OUTPUTS, outputSeries, place, quarters} from '/plots.js';
import {plottedAngle, residualChart, showResiduals, TURNS} from '/residuals.js';
import {PagedTable} from '/pages.js';
import {limitWords, phaseWords} from '/state.js';
import {operatorIn, rolesIn, t} from '/language.js';
import {Strip} from '/strip.js';
import {timeElement} from '/time.js';

const REDRAWN_AFTER_MS = 100;
const LINES = 200;  // Most lines of the log.
const BY_TIME = 3;  // In place of the index of an experiment: all residuals against time.

// Numbers that are not finite arrive as texts.
const finite = (value) => (Number.isFinite(value) ? value : null);
// The readings of each item at an angle; with a single item, the dwell.
const readingsOf = ({dwell, items}) => (items.length ? items : [{k: 1, ...dwell}]);
// How a run ended, with the verdict or the cause in words.
const endOf = (event) => event && {...event, words: event.outcome.words};

export class LiveView {
  constructor() {
    this.run = null;
    this.items = [];  // Empty: a single item.
    this.dwells = new Map();
    this.fits = [null, null, null];
    this.charts = [];
    this.stageSeen = {x: {}, z: {}};
    this.newLines = [];  // Lines of the log that are not shown yet.
    this.untold = new Set();  // Parts of the page whose text has changed; `told`: when text was shown last.
    this.told = -Infinity;
    this.dirty = new Set(['strip']);
    this.strip = new Strip(() => this.dirty.add('strip'));
    this.makeResponses();
    this.makeTable();
    drawGimbal(0, 0);  // Until an angle is known; the table then shows dashes.
    // Drawn when the browser is ready, however fast messages arrive.
    this.drawn = new Map();
    const frame = (now) => { this.draw(now); requestAnimationFrame(frame); };
    requestAnimationFrame(frame);
    setInterval(() => this.countDown(), 1000);
  }

  makeResponses() {
    byId('responses').replaceChildren();
    this.charts = TURNS.map((words, i) => {
      const response = place('thumbnail'), residual = place(), turn = {words: t('angle (degrees)'), whole: [0, 360], splits: quarters}, sync = 'live by angle';
      const pick = element('button', {type: 'button', class: 'pick'}, t`Experiment ${words}`);
      pick.addEventListener('click', () => this.pick(i));
      byId('responses').append(element('div', {}, element('h4', {}, pick), response));
      byId('residuals-by-time').before(residual);
      return {
        pick,
        response: new Chart(response, {name: t`Response of experiment ${i + 1} against angle; the table below has the numbers`, x: turn, y: t('output'), sync,
          series: [...outputSeries(), ...OUTPUTS.map((output) => ({output, label: '', line: true}))]}),
        residual: residualChart(residual, {name: t`Residuals of experiment ${i + 1}; the table below has the numbers`, x: turn, sync}),
      };
    });
    this.byTime = residualChart(byId('residuals-by-time'), {name: t('Residuals against time; the table below has the numbers'), x: {words: t('time since the run began (min)')}});
    byId('against-time').addEventListener('click', () => this.pick(this.picked === BY_TIME ? null : BY_TIME));
    this.pick(null);
  }

  // The main picture shows the residuals of the experiment that runs, or what a person has picked: the index of an experiment, or BY_TIME.
  pick(picked) {
    this.picked = picked;
    this.showMain();
  }

  showMain() {
    const now = this.run?.plan[this.phase?.position]?.experiment || this.lastDwell?.experiment || 1, shown = this.picked ?? now - 1;
    if (shown === this.shownMain) return;
    this.shownMain = shown;
    byId('shown-residuals').textContent = shown === BY_TIME ? t('Residuals against time') : t`Residuals of experiment ${TURNS[shown]}`;
    byId('against-time').setAttribute('aria-pressed', shown === BY_TIME);
    byId('residuals-by-time').hidden = shown !== BY_TIME;
    this.charts.forEach(({residual, pick}, i) => {
      residual.holder.hidden = i !== shown;
      pick.setAttribute('aria-pressed', i === shown);
    });
  }

  snapshot(message) {
    this.about = message.about;
    this.run = message.run;
    this.dwells.clear();
    this.fits = [null, null, null];
    this.lastDwell = null;
    this.picked = null;
    this.items = (this.run?.items ?? []).map(({missing, ...item}) => ({...item, dropped: missing, mean: null, flags: '', temperature_degc: null}));
    this.knowProgress(this.run?.progress);
    if (this.run) {
      for (const done of this.run.measured) this.knowDwell(done);
      for (const fit of this.run.fits) this.fits[fit.experiment - 1] = fit.outputs;
      byId('run-file').textContent = this.run.file || DASH;
      this.showItem(this.items.map(({name}) => name).join(', ') || this.run.item);
      byId('operator').textContent = operatorIn(this.run.operator) || DASH;
      byId('simulated').textContent = this.run.simulated ? t('SIMULATED') : '';
      byId('simulated').title = this.run.simulated ? t`Simulated: ${rolesIn(this.run.simulated)}` : '';
      byId('time').textContent = this.run.simulated_time ? t`simulated, ${this.about.pace} times as fast` : t('real');
    } else {  // The process that holds the bench has started again.
      for (const id of ['run-file', 'operator', 'time']) byId(id).textContent = DASH;
      this.showItem(this.loaded);
      byId('simulated').textContent = '';
    }
    this.strip.begin(message.strip, message.activity.activity === 'checking' ? [] : this.items);
    this.stageSeen = {...message.stage};
    byId('log-lines').replaceChildren();
    this.newLines = [...message.log];
    if (message.checks) this.checks(message.checks);
    else byId('checks').replaceChildren(element('p', {}, t('Not checked yet.')));
    this.activity = message.activity;
    this.phase = message.phase;
    this.fault = message.fault;
    this.ended = endOf(this.run?.ended ?? null);
    this.interrupted = message.interrupted;
    byId('guard').replaceChildren(said(message.guard ?? ''));
    this.words();
    this.drawProgress();
    for (const part of ['strip', 'table', 'items']) this.dirty.add(part);
    this.untold.add('stage').add('log');
    this.responsesChange();
  }

  // The item that the next run would measure; shown while no run is.
  setLoaded(words) {
    this.loaded = words;
    if (!this.run) this.showItem(words);
  }

  showItem(words) {
    byId('item').textContent = words || DASH;
    byId('item').title = words || '';  // Several do not fit into the bar.
  }

  responsesChange() {
    for (const n of [1, 2, 3]) this.dirty.add(`response ${n}`).add(`residual ${n}`);
    this.dirty.add('time');
  }

  receive(message) {
    if (message.line) this.knowLine(message.line);
    switch (message.type) {
      case 'snapshot': this.snapshot(message); break;
      case 'activity':
        if (message.activity === 'checking') this.strip.begin([], []);  // The readings start again, and their time starts at zero.
        if (message.activity !== 'idle') this.fault = null;
        if (message.activity === 'idle') this.phase = null;
        this.activity = message;
        this.words();
        break;
      case 'phase': this.phase = message; this.untold.add('words'); break;
      case 'stage': this.stageSeen[message.axis] = message; this.untold.add('stage'); break;
      case 'fault': this.fault = message; break;
      case 'notice':
        if (message.kind === 'guard') byId('guard').replaceChildren(said(message.text));
        if (message.kind === 'item dropped') {
          for (const item of this.items) if (item.k === message.item) item.dropped = message.text;
          this.itemsChange();
        }
        break;
      case 'strip':
        this.strip.receive(message.group);
        this.dirty.add('strip');
        break;
      case 'dwell_done': {
        const before = this.responding;
        if (!this.dwells.has(message.position))  // An angle that is measured again counts once.
          for (const {k} of readingsOf(message)) for (const item of this.items) if (item.k === k) ++item.measured;
        this.knowDwell(message);
        if (this.responding !== before) this.responsesChange();
        this.knowProgress(message.progress);
        this.untold.add('words');
        this.dirty.add('table');
        this.itemsChange();
        if (message.fit.experiment > 0) {  // A check pose belongs to no experiment.
          this.fits[message.fit.experiment - 1] = message.fit.outputs;
          this.dirty.add(`response ${message.fit.experiment}`).add(`residual ${message.fit.experiment}`).add('time');
        }
        break;
      }
      case 'checks': this.checks(message.findings); break;
      case 'acknowledged': this.interrupted = message.interrupted; this.words(); break;
      case 'finished': this.ended = endOf(message); this.interrupted = message.interrupted; this.words(); break;
    }
    this.tell();
  }

  // Shows words, log and angles once per REDRAWN_AFTER_MS. By a timer, as a page in the background gets no animation frames.
  tell() {
    if (!this.untold.size) return;
    const wait = this.told + REDRAWN_AFTER_MS - performance.now();
    if (wait > 0) {
      this.telling ??= setTimeout(() => { this.telling = null; this.tell(); }, wait);
      return;
    }
    const parts = this.untold;
    this.untold = new Set();
    this.told = performance.now();
    if (parts.has('stage')) this.drawStage();
    if (parts.has('log')) this.drawLog();
    if (parts.has('words')) { this.words(); this.drawProgress(); }
  }

  // Stores a measured angle: the dwell of its first item, and the last mean of each item.
  knowDwell(done) {
    const {position, dwell} = done, readings = readingsOf(done);
    const words = (flags) => this.about.flags.filter((_, bit) => flags & (1 << bit)).map(term).join(', ');
    this.lastDwell = {...dwell, position, item: readings[0].k, mean: dwell.mean.map(finite), u_mean: dwell.u_mean?.map(finite), flags: words(dwell.flags)};
    this.dwells.set(position, this.lastDwell);
    for (const {k, mean, flags, temperature_degc} of readings)
      for (const item of this.items) if (item.k === k) Object.assign(item, {mean: mean.map(finite), flags: words(flags), temperature_degc});
  }

  itemsChange() {
    this.strip.items = this.items;
    this.dirty.add('items').add('strip');
  }

  // Sets whether messages of the server arrive. Without contact the remaining time does not count down.
  setContact(contact) {
    if (this.contact === contact) return;
    this.countDown();  // With the last known data; a run may have ended a moment ago.
    this.contact = contact;
    this.leftSince = performance.now();
    if (contact) this.countDown();
    else if (byId('left').textContent !== DASH) byId('left').textContent = t`${byId('left').textContent}, last known`;
  }

  words() {
    this.showMain();
    const what = this.activity ? this.activity.activity : 'idle';
    const planned = this.run && this.phase ? this.run.plan[this.phase.position] : null;
    const held = this.phase && this.phase.phase === 'held';
    byId('angle').textContent = planned && what === 'running'
      ? `${held ? t('next: ') : ''}${planned.check ? t`check pose ${planned.n}`
        : planned.face === 2 ? t`experiment ${planned.experiment}, face 2, ${number(planned.alpha_deg, 1)}°`
          : t`experiment ${planned.experiment}, ${number(planned.alpha_deg, 1)}°`}${planned.closing ? t(' (closing angle)') : ''}` : DASH;
    const brief = what === 'running' ? phaseWords(this.phase) : '';
    if (byId('phase').textContent !== brief) byId('phase').textContent = brief;
    byId('limit').textContent = (what === 'running' && limitWords(this.phase)) || DASH;
    this.settling();
    this.offerInterrupted();
  }

  // Shows a run that a person may resume.
  offerInterrupted() {
    const run = this.interrupted;
    byId('interrupted').hidden = !run || this.activity.activity !== 'idle';
    if (!run) return;
    byId('acknowledge').hidden = Boolean(run.acknowledged_by);
    byId('acknowledged').replaceChildren(...(run.acknowledged_by ? [t('Acknowledged by '), run.acknowledged_by, ', ', timeElement(run.acknowledged_utc, 'clock')] : [t('Nobody has acknowledged it yet.')]));
    const at = run.angle ? t` at ${translated(run.angle) ?? run.angle}` : '';
    byId('interrupted-words').replaceChildren(t`${run.file} was interrupted${at}: ${run.measured} of ${run.planned} angles are measured. `,
      ...(run.words ? [said(run.words, {capital: true}), run.words.endsWith('.') ? ' ' : '. '] : []), t('Nothing moves until a person resumes it.'));
  }

  // Shows whether stage and outputs are at rest, and how long settling took at the last measured angle.
  settling() {
    const now = {moving: t('the stage moves'), settling: t('waiting until the outputs are quiet'), reading: t('still'), held: t('still')}[this.phase?.phase];
    const took = this.lastDwell && Number.isFinite(this.lastDwell.settle_time_s) ? t`last angle: ${number(this.lastDwell.settle_time_s, 1, 's')}` : '';
    const on = this.activity && this.activity.activity === 'running';
    byId('settling').textContent = [on ? now : '', took].filter(Boolean).join('; ') || DASH;
  }

  knowProgress(progress) {
    this.progress = progress;
    this.left = progress?.left_s;
    this.leftSince = performance.now();
  }

  drawProgress() {
    const {progress} = this;
    byId('measured').textContent = progress ? t`${progress.measured} of ${progress.total}` : DASH;
    byId('progress').value = progress?.total ? progress.measured / progress.total : 0;
    this.countDown();
  }

  countDown() {
    if (this.contact === false) return;  // It is unknown whether the run continues.
    const elapsed = (performance.now() - this.leftSince) / 1000;
    this.leftSince = performance.now();
    const phase = this.phase?.phase ?? '', port = phase === 'waiting for a port to come back';
    if (this.activity?.activity !== 'running' || this.left === undefined || this.left === null || !this.progress.total) {
      byId('left').textContent = DASH;
    } else if (phase === 'held' || port) {
      byId('left').textContent = port ? t`${duration(Math.max(0, this.left))} (waiting for a port)` : this.left > 0 ? t`${duration(this.left)} (held)` : DASH;
    } else {
      this.left -= elapsed;
      byId('left').textContent = this.left < 0 && this.progress.measured < this.progress.total ? t('longer than predicted') : t`about ${duration(Math.max(0, this.left))}`;
    }
  }

  drawStage() {
    const {x, z} = this.stageSeen;
    for (const [axis, seen] of [['x', x], ['z', z]]) {
      byId(`${axis}-encoder`).textContent = degrees(seen.encoder_deg, 4);
      byId(`${axis}-target`).textContent = degrees(seen.target_deg, 4);
    }
    drawGimbal(x.encoder_deg ?? 0, z.encoder_deg ?? 0, Number.isFinite(x.target_deg) && Number.isFinite(z.target_deg) ? {x: x.target_deg, z: z.target_deg} : null);
    byId('gimbal-title').textContent = t`The gimbal: X at ${byId('x-encoder').textContent}, Z at ${byId('z-encoder').textContent}`;
  }

  knowLine(line) {
    this.newLines.push(line);
    if (this.newLines.length > LINES) this.newLines.shift();
    this.untold.add('log');
  }

  drawLog() {
    const log = byId('log'), lines = byId('log-lines');
    const atEnd = log.scrollHeight - log.scrollTop - log.clientHeight < 30;
    lines.append(...this.newLines.map((line) => element('li', {class: `grade-${line.grade}`},
      timeElement(line.utc, 'clock'),
      ...(line.grade === 'info' ? [] : [`${t(line.grade)}: `]), said(line.text))));
    this.newLines = [];
    while (lines.children.length > LINES) lines.firstChild.remove();
    if (atEnd) log.scrollTop = log.scrollHeight;
  }

  checks(findings) {
    byId('checks').replaceChildren(table(t('Checks of the bench and their findings'), [t('Check'), t('Grade'), t('Found'), t('Advice')],
      findings.map((f) => [said(f.what), element('span', {class: `grade-${f.grade.replace(' ', '-')}`}, t(f.grade)), said(f.found), f.advice ? said(f.advice) : ''])));
  }

  // Draws one part per frame, each at most ten times a second, so that the page stays usable however fast messages arrive.
  draw(now) {
    const part = [...this.dirty].find((name) => now - (this.drawn.get(name) ?? -Infinity) >= REDRAWN_AFTER_MS);
    if (part === undefined) return;
    this.dirty.delete(part);
    this.drawn.set(part, now);
    if (part === 'strip') this.strip.draw();
    const [plotted, experiment] = part.split(' ');
    if (experiment) this.drawExperiment(plotted, Number(experiment) - 1);
    if (part === 'time') this.drawByTime();
    if (part === 'table') this.drawTable();
    if (part === 'items') this.drawItems();
  }

  // The item whose responses are shown: the first one in the last dwell, which changes if an item is left out.
  get responding() { return this.lastDwell?.item ?? this.items.find(({dropped}) => !dropped)?.k ?? 1; }
  get unit() { return this.items.find(({k}) => k === this.responding)?.unit ?? this.run?.unit ?? ''; }
  ofResponding() { return [...this.dwells.values()].filter(({item}) => item === this.responding); }

  drawItems() {
    byId('items-card').hidden = !this.items.length;
    byId('response-of').textContent = this.items.length ? `: ${t`Item ${this.responding}`}` : '';
    byId('items').replaceChildren(...this.items.map((item) => liveItem(item, this.progress?.total ?? 0)));
  }

  fitted(fit, alphaDeg) {
    const a = alphaDeg * Math.PI / 180;
    return fit.constant + fit.sine * Math.sin(a) + fit.cosine * Math.cos(a);
  }

  // The angles of experiment i (null: of all) with their residuals.
  entries(i) {
    return this.ofResponding().filter((d) => d.experiment > 0 && (i === null || d.experiment === i + 1)).map((d) => {
      const x = plottedAngle(d), fits = this.fits[d.experiment - 1];
      return {x, mean: d.mean, u: d.u_mean ?? null, time_s: d.time_s, flagged: Boolean(d.flags), residual: fits ? fits.map((fit, j) => (fit && d.mean[j] !== null ? d.mean[j] - this.fitted(fit, x) : null)) : null};
    });
  }

  // The response of experiment i, or its residual.
  drawExperiment(plotted, i) {
    const chart = this.charts[i][plotted], dwells = this.entries(i).sort((a, b) => a.x - b.x);
    if (plotted === 'residual') return showResiduals(chart, dwells, {unit: this.unit, at: ({x}) => x});
    const fits = dwells.length ? this.fits[i] : null, byX = new Map();
    for (let x = 0; fits && x <= 360; x += 5) byX.set(x, null);
    // Angles at one place, e.g. of both faces, are drawn next to each other.
    const xs = [...[...byX.keys()].map((x) => ({x, dwell: null})), ...dwells.map((dwell) => ({x: dwell.x, dwell}))].sort((a, b) => a.x - b.x);
    chart.unit = this.unit;
    chart.show(xs.map(({x}) => x), [...OUTPUTS.map((_, j) => xs.map(({dwell}) => dwell?.mean[j] ?? null)), ...OUTPUTS.map((_, j) => xs.map(({x}) => (fits?.[j] ? this.fitted(fits[j], x) : null)))],
      {bars: OUTPUTS.map((_, j) => xs.map(({dwell}) => dwell?.u?.[j] ?? 0)), rings: xs.flatMap(({dwell}, k) => (dwell?.flagged ? [k] : [])), y: t`output (${this.unit})`});
  }

  drawByTime() {
    showResiduals(this.byTime, this.entries(null), {unit: this.unit, at: ({time_s: s}) => (Number.isFinite(s) ? s / 60 : NaN)});
  }

  // The number of flagged angles leads to them, and from there to their readings.
  showFlagged(count) {
    const words = this.run ? String(count) : DASH, name = this.run?.file.split('/').at(-1);
    if (byId('flagged').textContent === words) return;
    byId('flagged').replaceChildren(count && name ? element('a', {href: `#runs/${encodeURIComponent(name)}/${this.responding}/flags`}, words) : words);
  }

  makeTable() {
    const cells = (d) => [d.experiment ? `${d.experiment}${d.face === 2 ? t(', face 2') : ''}${d.closing ? t(' (closing)') : ''}` : t`check pose ${d.n}`,
      d.experiment ? number(d.alpha_deg, 2) : DASH,
      ...d.mean.map((value) => signed(value, 6)), d.u_mean ? small(Math.max(...d.u_mean)) : DASH,
      number(d.temperature_degc, 2), d.flags || t('none')];
    this.table = new PagedTable(byId('dwell-table'), {
      follow: true,
      caption: () => t`Means of the outputs and their standard uncertainty in ${this.unit}`,
      head: () => [t('Experiment'), t('Angle (degrees)'), `u (${this.unit})`, `v (${this.unit})`, `w (${this.unit})`, t`Largest std. uncertainty (${this.unit})`, t('Temperature (°C)'), t('Flags')],
      rows: (from, to) => this.ofResponding().sort((a, b) => a.position - b.position).slice(from, to).map(cells),
    });
    const folded = byId('dwell-table').closest('details');
    folded.addEventListener('toggle', () => this.dirty.add('table'));
    this.tableIsSeen = () => folded.open;
  }

  drawTable() {
    const flagged = [...this.dwells.values()].filter((d) => d.flags);
    const flags = [...new Set(flagged.flatMap((d) => d.flags.split(', ')))].join(', ');
    this.showFlagged(flagged.length);
    byId('flagged').classList.toggle('some', flagged.length > 0);
    byId('flags').textContent = flags || (this.run ? t('none') : DASH);
    if (this.tableIsSeen()) this.table.show(this.ofResponding().length);
  }
}
