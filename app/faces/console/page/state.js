import {t} from '/language.js';

// The activity of the bench in one word, with a sentence and advice for people: a pure function of the server's messages.
// kind: colour and icon of the tab (favicon-KIND.svg). english: a further text of the program, in English only.
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

const made = (word, kind, icon, sentence, more = {}) => ({word, kind, icon, sentence, fault: '', todo: '', limit: null, known: true, english: '', ...more});

export const canMove = (activity) => ['running', 'checking', 'jogging'].includes(activity.activity);

// Arguments are as in the messages. known: a message has arrived.
export function stateOf({known, activity, phase, ended, fault, bench}) {
  if (!known) return made(t('No contact'), 'lost', 'lost', t('Nothing is known of the bench yet'), {todo: t('Use the switch on the stage if it must stop now.'), known: false});
  if (bench && bench.state !== 'on') {
    return made(t('Not known'), 'fault', 'lost', t(bench.words), {todo: t('Look at the stage before anything else; use its own switch if it moves.')});
  }
  const what = activity.activity;
  if (what !== 'idle' && activity.stop_asked) return made(t('Stopping'), 'fault', 'stop', t('Stopping: the stage is being halted'), {todo: t('Use the switch on the stage if it still moves.')});
  if (what === 'checking') return made(t('Checking'), 'busy', 'reading', t('Checking the bench'));
  if (what === 'jogging') return made(t('Moving'), 'busy', 'moving', t('The stage is jogged'));
  if (what === 'analysing') return made(t('Analysing'), 'busy', 'reading', t('All angles are measured; the run is being analysed'));
  if (what === 'running') {
    if (!phase) return made(t('Starting'), 'busy', 'homing', t('The run begins'));
    const [word, kind, icon, sentence] = PHASES[phase.phase] ?? [phase.phase, 'busy', 'moving', phase.phase];
    const limit = phase.limit_s === null || phase.limit_s === undefined ? null : {seconds: phase.limit_s, words: phase.limit_words, simulated: phase.limit_simulated};
    const asked = activity.hold_asked && phase.phase !== 'held' ? t('; it holds after this angle') : '';
    const todo = {held: t('Continue or stop when you are ready.'), 'waiting for a port to come back': t('Plug it in again; the run goes on by itself.')}[phase.phase] ?? '';
    return made(word, kind, icon, sentence + asked, {limit, todo, fault: phase.phase.startsWith('waiting for a port') ? phase.words ?? '' : ''});
  }
  if (fault) {
    const interrupted = ended && !ended.complete ? t('The run is interrupted and can be resumed: ') : '';
    return made(t('Faulted'), 'fault', 'fault', interrupted, {english: fault.words, fault: fault.instrument, todo: ADVICE[fault.fault] ?? t('Look at the log; then check the bench.')});
  }
  if (ended && ended.complete && !ended.words) return made(t('Finished'), 'done', 'done', t('The levelling is complete. Its result is on the view Bench.'));
  if (ended && ended.complete) return made(t('Finished'), 'done', 'done', t('The run is complete. Result: '), {english: ended.words});
  if (ended) return made(t('Interrupted'), 'held', 'stop', t('The run is interrupted and can be resumed: '), {english: ended.words, todo: t('Resume it when the stage is clear.')});
  return made(t('Idle'), 'idle', 'idle', t('No run is in progress.'));
}
