// What the bench is doing, in one word, and what a person should know with it: a pure function of what the server has said.
// kind: colour and icon of the tab (favicon-KIND.svg).
const PHASES = {
  homing: ['Homing', 'busy', 'homing', 'The axes are homed'],
  'warming up': ['Warming up', 'busy', 'settling', 'Warming up'],
  held: ['Held', 'held', 'held', 'Held; the stage stands still'],
  'waiting for a port to come back': ['Waiting for a port', 'fault', 'port', 'A port has vanished; waiting for it to come back'],
  moving: ['Moving', 'busy', 'moving', 'The stage moves'],
  settling: ['Settling', 'busy', 'settling', 'Waiting until the outputs are quiet'],
  reading: ['Reading', 'busy', 'reading', 'Reading the accelerometer'],
  'waiting for the temperature': ['Waiting', 'busy', 'settling', 'Waiting for the temperature to be stable'],
  parking: ['Parking', 'busy', 'moving', 'The stage goes to zero'],
};

// What to do first when an instrument fails, by the fault that its driver reports.
const ADVICE = {
  refused: 'Read what the instrument answered, and correct it there or in the bench file.',
  'no reply': 'Check power and cable of the instrument; then check the bench.',
  'bad frame': 'Check the cable and the speed of the line; then check the bench.',
  'link lost': 'Plug the instrument in again; then resume the run.',
  'cannot open': 'Plug the instrument in, or end the program that holds its port.',
  'wrong instrument': 'Connect the instrument that the bench file names.',
  'not ready': 'Switch the instrument on and check the bench.',
  'out of travel': 'Correct the plan or the travel in the bench file.',
  stalled: 'Look whether the stage is free to turn; then check the bench.',
  'implausible readings': 'Look at the accelerometer and its cable; then check the bench.',
};

const made = (word, kind, icon, sentence, more = {}) => ({word, kind, icon, sentence, fault: '', todo: '', limit: null, ...more});

export const canMove = (activity) => ['running', 'checking', 'jogging'].includes(activity.activity);

// view: {known, activity, phase, run, ended, fault, bench}, each as the messages have them; known: something was said at all.
export function stateOf({known, activity, phase, ended, fault, bench}) {
  if (!known) return made('No contact', 'lost', 'lost', 'Nothing is known of the bench yet', {todo: 'Use the switch on the stage if it must stop now.'});
  if (bench && bench.state !== 'on') {
    return made('Not known', 'fault', 'lost', bench.words, {todo: 'Look at the stage before anything else; use its own switch if it moves.'});
  }
  const what = activity.activity;
  if (what !== 'idle' && activity.stop_asked) return made('Stopping', 'fault', 'stop', 'Stopping: the stage is halted', {todo: 'Use the switch on the stage if it still moves.'});
  if (what === 'checking') return made('Checking', 'busy', 'reading', 'Checking the bench');
  if (what === 'jogging') return made('Moving', 'busy', 'moving', 'The stage is jogged');
  if (what === 'analysing') return made('Analysing', 'busy', 'reading', 'All angles are measured; the run is being analysed');
  if (what === 'running') {
    if (!phase) return made('Starting', 'busy', 'homing', 'The run begins');
    const [word, kind, icon, sentence] = PHASES[phase.phase] ?? [phase.phase, 'busy', 'moving', phase.phase];
    const limit = phase.limit_s === null || phase.limit_s === undefined ? null : {seconds: phase.limit_s, words: phase.limit_words};
    const asked = activity.hold_asked && phase.phase !== 'held' ? '; it holds after this angle' : '';
    const todo = {held: 'Continue or stop when you are ready.', 'waiting for a port to come back': 'Plug it in again; the run goes on by itself.'}[phase.phase] ?? '';
    return made(word, kind, icon, sentence + asked, {limit, todo, fault: phase.phase.startsWith('waiting for a port') ? phase.words ?? '' : ''});
  }
  if (fault) {
    const interrupted = ended && !ended.complete ? 'The run is interrupted and can be resumed: ' : '';
    return made('Faulted', 'fault', 'fault', interrupted + fault.words, {fault: fault.instrument, todo: ADVICE[fault.fault] ?? 'Look at the log; then check the bench.'});
  }
  if (ended && ended.complete) return made('Finished', 'done', 'done', `The run is complete. Result: ${ended.words}`);
  if (ended) return made('Interrupted', 'held', 'stop', `The run is interrupted and can be resumed: ${ended.words}`, {todo: 'Resume it when the stage is clear.'});
  return made('Idle', 'idle', 'idle', 'No run is in progress.');
}
