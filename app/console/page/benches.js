// The benches of this computer as tiles, which steer nothing, and links to the consoles of other computers.
import {byId, duration, element, DASH} from '/text.js';
import {said, term} from '/said.js';
import {fetched} from '/fetched.js';
import {rolesIn, t} from '/language.js';

const EACH_MS = 5000;  // Longer than a process without an activity stays for a console: asking keeps none alive.
const WORDS = {idle: t('Idle'), checking: t('Checking'), running: t('Measuring'), jogging: t('Moving'), analysing: t('Analysing')};

let soon = null;
export async function showBenches() {
  clearTimeout(soon);
  if (!/^#benches/.test(location.hash)) return;
  const body = byId('benches-body');
  try {
    const {benches, links} = await (await fetched('/benches')).json();
    body.replaceChildren(benches.length ? element('ul', {class: 'items'}, ...benches.map(tile)) : element('p', {}, t('No bench of this computer is held by a process now.')),
      ...(links.length ? [element('h3', {}, t('Consoles of other computers')), element('ul', {}, ...links.map((address) => element('li', {}, element('a', {href: address, rel: 'noreferrer'}, address))))] : []));
  } catch (error) {
    body.replaceChildren(element('p', {role: 'alert', class: 'grade-problem'}, said(error.message)));
  }
  soon = setTimeout(showBenches, EACH_MS);
}

// Whether the link to this view is offered.
export async function offerBenches() {
  const answer = await fetched('/benches').then((response) => (response.ok ? response.json() : null), () => null);
  byId('to-benches').hidden = !answer || answer.benches.length + answer.links.length === 0;
}

function tile({bench, folder, state, activity, phase, item, file, simulated, progress, fault, ended}) {
  const answers = state === 'answers', what = activity?.activity ?? 'idle', isHeld = what === 'running' && phase?.phase === 'held';
  const word = !answers ? (state === 'silent' ? t('Does not answer') : t('Not running')) : fault && what === 'idle' ? t('Faulted') : isHeld ? t('Held') : WORDS[what] ?? what;
  const grade = !answers || fault ? 'grade-problem' : isHeld ? 'grade-warning' : 'grade-good';
  const isOn = answers && what === 'running' && progress?.total;
  return element('li', {class: `bench-tile ${grade === 'grade-good' ? '' : 'left-out'}`}, element('h3', {}, bench, ' ', simulated ? element('span', {class: 'simulated'}, t`SIMULATED: ${rolesIn(simulated)}`) : ''),
    element('p', {class: grade}, element('strong', {}, word), fault && what === 'idle' ? element('span', {}, ': ', said(fault.words)) : ''),
    element('p', {}, t('Item'), ': ', item || DASH),
    ...(isOn ? [element('p', {}, t`${progress.measured} of ${progress.total}`, ', ', t('Time left'), ': ', Number.isFinite(progress.left_s) ? t`about ${duration(progress.left_s)}` : DASH),
      element('progress', {max: 1, value: progress.measured / progress.total, 'aria-label': t('Angles measured')})] : []),
    ...(ended && !isOn ? [element('p', {}, file, ': ', ended.complete ? term(ended.verdict) : t('interrupted'))] : []),
    element('p', {class: 'small-print'}, folder));
}
