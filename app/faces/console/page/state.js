import {t} from '/language.js';
import {areAtRest, bannerState, plainState} from '/stop.js';

// The state of the banner with all its details (plainState() in stop.js has none): a pure function of the messages of the server.
const PHASES = {
  homing: [t('Homing'), 'busy', 'homing', t('The axes are homed')],
  'warming up': [t('Warming up'), 'busy', 'settling', t('Warming up')],
  held: [t('Held'), 'held', 'held', t('Held; the stage stands still')],
  'waiting for a port to come back': [t('Waiting for a port'), 'fault', 'port', t('A port has vanished; waiting for it to come back')],
  moving: [t('Moving'), 'busy', 'moving', t('The stage moves')],
  settling: [t('Settling'), 'busy', 'settling', t('Waiting until the outputs are quiet')],
  reading: [t('Reading'), 'busy', 'reading', t('Reading the accelerometer')],
  'waiting for the temperature': [t('Waiting'), 'busy', 'settling', t('Waiting for the temperature to be stable')],
  parking: [t('Parking'), 'busy', 'moving', t('The stage goes to zero')],
};

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

// view: {known, activity, phase, run, ended, fault, bench, axes}, each as the messages have them; known: something was said at all.
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
  if (ended && ended.complete) return bannerState(t('Finished'), 'done', 'done', t('The run is complete. Result: '), {english: ended.words});
  if (ended) return bannerState(t('Interrupted'), 'held', 'stop', t('The run is interrupted and can be resumed: '), {english: ended.words, todo: t('Resume it when the stage is clear.')});
  return plain;
}

function runningState(activity, phase) {
  if (!phase) return bannerState(t('Starting'), 'busy', 'homing', t('The run begins'));
  const [word, kind, icon, sentence] = PHASES[phase.phase] ?? [phase.phase, 'busy', 'moving', phase.phase];
  const limit = phase.limit_s === null || phase.limit_s === undefined ? null : {seconds: phase.limit_s, words: phase.limit_words, simulated: phase.limit_simulated};
  const asked = activity.hold_asked && phase.phase !== 'held' ? t('; it holds after this angle') : '';
  const todo = {held: t('Continue or stop when you are ready.'), 'waiting for a port to come back': t('Plug it in again; the run goes on by itself.')}[phase.phase] ?? '';
  return bannerState(word, kind, icon, sentence + asked, {limit, todo, fault: phase.phase.startsWith('waiting for a port') ? phase.words ?? '' : ''});
}
