// The state of comparisons of laboratories (abcal pilot): whose results are in, and, when all are, who agrees. No value of a result is
// shown here.
import {byId, element, scrollable, table, DASH} from '/text.js';
import {said} from '/said.js';
import {fetchJson} from '/runs.js';
import {timeElement} from '/time.js';
import {t} from '/language.js';

const HASH_DIGITS = 16;  // Shown of a SHA-256; its title has all.

const failed = (error) => element('p', {role: 'alert', class: 'grade-problem'}, said(error.message));

// Whether the link to this view is offered.
export async function offerComparisons() {
  byId('to-comparisons').hidden = await fetchJson('/comparisons').then((list) => list.length === 0, () => true);
}

export async function showComparisons() {
  const body = byId('comparisons-body');
  try {
    const list = await fetchJson('/comparisons');
    body.replaceChildren(...(list.length ? list.map(card) : [element('p', {}, t('No protocol of a comparison lies in the folder of the runs.'))]));
  } catch (error) {
    body.replaceChildren(failed(error));
  }
}

function card(comparison) {
  const {file, error, name} = comparison, own = element('section', {class: 'card block'}, element('h3', {}, name ?? file));
  if (error) {
    own.append(failed({message: error}));
    return own;
  }
  const {measurements, complete, not_agreed: notAgreed, correlation_bounds: bounds, changes} = comparison;
  const ready = measurements.every(({state}) => state === 'in' || state === 'withdrawn');
  const committed = measurements.filter(({state}) => state !== 'open').length;
  own.append(element('p', {}, t`Pilot: ${comparison.pilot}. ${committed} of ${measurements.length} results are in.`, ' ', ready ? '' : t('No value is shown before all are in.')));
  if (ready) own.append(outcomeOf(file));
  if (complete) own.append(element('p', {}, notAgreed.length ? t`Draft A is not agreed with by: ${notAgreed.join(', ')}.` : t('All participants agree with Draft A.')));
  own.append(scrollable('scroll-x stack', name, table(t('Measurements in the order of the schedule'), [t('Participant'), t('Planned'), t('Result'), 'SHA-256'],
    measurements.map((one) => [`${one.number}. ${one.participant}`, one.planned || DASH, stateOf(one), one.sha256 ? element('code', {title: one.sha256}, one.sha256.slice(0, HASH_DIGITS)) : DASH]))));
  for (const [heading, texts] of [[t('Bounds of correlation'), bounds], [t('Changes'), changes]])
    if (texts.length) own.append(element('h4', {}, heading), element('ul', {}, ...texts.map((text) => element('li', {}, said(text)))));
  return own;
}

function stateOf({state, planned, committed_utc: committed, withdrawn}) {
  const late = planned && planned < new Date().toISOString().slice(0, 10);
  const words = {open: late ? t('missing since the planned day') : t('open'), committed: t('registered, file missing'), in: t('registered and revealed'), withdrawn: t('withdrawn')}[state];
  return element('span', {class: state === 'open' && late ? 'grade-warning' : false}, words, ...(state === 'withdrawn' ? [': ', said(withdrawn)] : committed ? [', ', timeElement(committed, 'date')] : []));
}

// The verdict, which takes the console seconds, with the link to the report.
function outcomeOf(file) {
  const address = `/comparisons/${encodeURIComponent(file)}`, holder = element('div', {class: 'outcome-of'}, element('p', {role: 'status'}, t('The results are being analysed.')));
  fetchJson(`${address}/outcome`).then(({agree, verdict}) => holder.replaceChildren(
    element('p', {class: agree ? 'grade-good' : 'grade-problem'}, element('strong', {}, said(verdict))),
    element('p', {}, element('a', {href: `${address}/draft_a.html`, download: `${file.replace(/\.toml$/, '')}-draft-a.html`}, t('Draft A of the report (HTML)')))), (error) => holder.replaceChildren(failed(error)));
  return holder;
}
