// The end of a run is its result: verdict, the nine values, what the calibration does to the readings, and what comes next.
import {byId, decimals, element} from '/text.js';
import {said} from '/said.js';
import {COVERED, nineValues} from '/answer.js';
import {resultItems} from '/items.js';
import {Chart, place} from '/plots.js';
import {downloads, fetchJson, verdict} from '/runs.js';
import {t} from '/language.js';

const TEXT = {
  title: t('Result of the run'), reading: t('Reading the result'), whole: t('The whole result'), certificate: t('Certificate'), next: t('Measure the next item'),
  figure: t('|a| − g at each angle'), none: t('No reading can be corrected by this result.'), asRead: t('as read'), corrected: t('corrected'),
  noAcceleration: t('The output is no acceleration: it has no |a| before the correction.'),
};
const UNIT = 'm/s²';

const heading = () => element('h3', {id: 'outcome-title'}, TEXT.title);
const finite = (values) => values.filter((value) => value !== null);
const largest = (values) => { const most = Math.max(...finite(values).map(Math.abs)); return `${most.toFixed(decimals(most))} ${UNIT}`; };

export class Outcome {
  // next: begins the next run.
  constructor(next) {
    this.next = element('button', {type: 'button', id: 'outcome-next'}, TEXT.next);
    this.next.addEventListener('click', next);
    this.name = '';
  }

  // name: of the run that has ended and whose result is shown; empty: none. seen: not while the bench does something else.
  show(name, {seen, may}) {
    byId('outcome').hidden = !name || !seen;
    this.next.disabled = !may;
    if (name === this.name) return;
    this.name = name;
    this.fill([heading(), element('p', {role: 'status'}, TEXT.reading)]);
    if (name) this.load(name);
  }

  fill(content) {
    this.chart?.destroy();
    this.chart = null;
    byId('outcome').replaceChildren(...content);
  }

  async load(name) {
    try {
      const data = await fetchJson(`/runs/${encodeURIComponent(name)}/result`);
      if (name === this.name) this.showResult(data);
    } catch (error) {
      if (name === this.name) this.fill([heading(), element('p', {role: 'alert', class: 'grade-problem'}, said(error.message || String(error), {capital: true}))]);
    }
  }

  showResult({run, item, results, norms, downloads: kinds}) {
    const [reported] = results, several = run.items.length > 1, path = `#runs/${encodeURIComponent(run.name)}`;
    const reports = downloads(kinds.filter((kind) => kind.name.startsWith('report.')), run, several ? item : 0);
    const shown = verdict(reported, run), isUsable = reported.verdict !== 'not_usable';
    shown.id = 'outcome-verdict';
    const values = isUsable ? nineValues(reported) : element('p', {}, t('Nothing may be read from the numbers of this run.'));
    values.id = 'outcome-values';
    this.fill([
      ...(several ? [resultItems(run, item)] : []),
      element('div', {class: 'bar', id: 'outcome-links'}, heading(), this.next, element('a', {class: 'button', href: path}, TEXT.whole),
        element('a', {class: 'button', href: `${path}/${item}/certificate`}, TEXT.certificate), reports),
      element('div', {class: 'pair'}, element('div', {}, shown, values, element('p', {class: 'small-print'}, COVERED)), this.figure(norms))]);
    if (this.holder) this.draw(norms);
  }

  figure(norms) {
    this.holder = norms && finite(norms.after).length ? place() : null;
    if (!this.holder) return element('p', {}, TEXT.none);
    const hasBefore = finite(norms.before).length > 0;
    return element('div', {id: 'outcome-figure'}, element('h4', {}, TEXT.figure), this.holder,
      element('p', {class: 'small-print'}, hasBefore ? t`Largest: ${largest(norms.before)} as read, ${largest(norms.after)} corrected by offsets, sensitivities and angles. What remains is what these cannot correct, and noise.`
        : [TEXT.noAcceleration, ' ', t`Largest after it: ${largest(norms.after)}.`].join('')));
  }

  draw({before, after}) {
    const xs = after.map((_, i) => i + 1);
    const series = (output, label) => ({output, label, points: true});
    this.chart = new Chart(this.holder, {name: t('|a| − g at each angle, as read and corrected'), x: {words: t('angle of the run, in order (1)'), whole: [0, xs.length + 1], say: String}, y: `|a| − g (${UNIT})`,
      series: [series('u', TEXT.asRead), series('v', TEXT.corrected)]});
    this.chart.unit = UNIT;
    this.chart.show(xs, [before, after], {levels: [{y: 0, words: '', dash: [8, 4]}]});
  }
}
