import {duration, small} from '/text.js';
import {t} from '/language.js';
import {term} from '/said.js';
import {areAtRest, bannerState, plainState} from '/stop.js';

// The state of the banner with all its details (plainState() in stop.js has none): a pure function of the messages of the server.
// Phases that last are states of the banner. The others follow each other within seconds: they are the one state "Measuring", so
// that the banner is steady, and only the small text of `phaseWords` changes.
const PHASES = {
  homing: [t('Homing'), 'homing', t('The axes are homed')],
  'warming up': [t('Warming up'), 'settling', t('Warming up')],
  held: [t('Held'), 'held', t('Held; the stage stands still')],
  'waiting for a port to come back': [t('Waiting for a port'), 'port', t('A port has vanished; waiting for it to come back')],
  'waiting for the temperature': [t('Waiting'), 'settling', t('Waiting for the temperature to be stable')],
};
const KINDS = {held: 'held', 'waiting for a port to come back': 'fault'};
const BRIEF = {moving: t('the stage moves'), settling: t('settling'), reading: t('reading'), parking: t('the stage goes to zero')};

// The brief phases in words, for a place that nobody has to read; empty for the others.
export const phaseWords = (phase) => BRIEF[phase?.phase] ?? '';

// How long a phase may last; empty: no limit. In simulated time that differs from the real time that a person sees pass.
export function limitWords(phase) {
  if (!Number.isFinite(phase?.limit_s)) return '';
  const time = phase.limit_s < 1 ? small(phase.limit_s, 's') : duration(phase.limit_s);
  return phase.limit_simulated ? t`${time} of simulated time ${t(phase.limit_words)}` : `${time} ${t(phase.limit_words)}`;
}

// The first action when an instrument fails, by the fault that its driver reports.
const ADVICE = {
  refused: t('Read what the instrument answered, and correct it there or in the bench file.'),
  'no reply': t('Check power and cable of the instrument; then check the bench.'),
  'bad frame': t('Check the cable and the speed of the line; then check the bench.'),
  'link lost': t('Plug the instrument in again; then resume the run.'),
  'cannot open': t('Plug the instrument in, or end the program that holds its port.'),
  'wrong instrument': t('Connect the instrument that the bench file names.'),
  'not ready': t('Switch the instrument on and check the bench.'),
  'out of travel': t('Correct the plan or the travel in the bench file.'),
  stalled: t('Look whether the stage is free to turn; then check the bench.'),
  'implausible readings': t('Look at the accelerometer and its cable; then check the bench.'),
};

// view: {known, activity, phase, run, ended, fault, bench, axes}, each as the messages have them; known: whether any message has
// arrived.
export function stateOf(view) {
  const {known, activity, phase, ended, fault, bench, axes} = view, plain = plainState(view);
  if (!known || bench.state !== 'on') return plain;
  if (activity.activity === 'running' && !activity.stop_asked) return runningState(activity, phase);
  if (activity.activity !== 'idle' || !areAtRest(axes)) return plain;
  if (fault) {
    const interrupted = ended && !ended.complete ? t('The run is interrupted and can be resumed: ') : '';
    return {...plain, sentence: interrupted, todo: ADVICE[fault.fault] ?? t('Look at the log; then check the bench.')};
  }
  if (ended && ended.complete && !ended.words) return bannerState(t('Finished'), 'done', 'done', t('The levelling is complete. Its result is on the view Bench.'));
  if (ended && ended.complete) {
    // A result that cannot be certified never looks like one that can.
    const [kind, icon] = ended.verdict === 'usable' ? ['done', 'done'] : ended.verdict === 'doubtful' ? ['held', 'fault'] : ['fault', 'fault'];
    return bannerState(t('Finished'), kind, icon, t('The run is complete. Result: ') + term(ended.verdict.replace('_', ' ')));  // The reasons are with the result.
  }
  if (ended) return bannerState(t('Interrupted'), 'held', 'stop', t('The run is interrupted and can be resumed: '), {english: ended.words, todo: t('Resume it when the stage is clear.')});
  return plain;
}

function runningState(activity, phase) {
  if (!phase) return bannerState(t('Starting'), 'busy', 'homing', t('The run begins'));
  const asked = activity.hold_asked && phase.phase !== 'held' ? t('; it holds after this angle') : '';
  if (!(phase.phase in PHASES)) return bannerState(t('Measuring'), 'busy', 'reading', t('The stage turns from angle to angle') + asked);
  const [word, icon, sentence] = PHASES[phase.phase], limit = limitWords(phase);
  const todo = {held: t('Continue or stop when you are ready.'), 'waiting for a port to come back': t('Plug it in again; the run goes on by itself.')}[phase.phase] ?? '';
  return bannerState(word, KINDS[phase.phase] ?? 'busy', icon, sentence + asked,
    {todo, limit: limit && t`Limit: ${limit}.`, fault: phase.phase === 'waiting for a port to come back' ? phase.words ?? '' : ''});
}
