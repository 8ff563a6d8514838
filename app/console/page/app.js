import {byId} from '/text.js';
import {Link} from '/link.js';
import {LiveView} from '/live.js';
import {showChart, showCompare, showRun, showRuns} from '/runs.js';

const live = new LiveView();
let me = null, controller = null, activity = {activity: 'idle', hold_asked: false, stop_asked: false};

const link = new Link((message) => {
  if (message.type === 'you') me = message.number;
  if (message.type === 'control') controller = message.page;
  if (message.type === 'snapshot') {
    activity = message.activity;
    const {program, bench_file: bench} = message.about;
    byId('bench-name').textContent = bench;
    document.title = `${bench} – abcal console`;
    byId('link').title = program;
  }
  if (message.type === 'activity') activity = message;
  live.receive(message);
  offer();
}, (connected) => {
  byId('link').textContent = connected ? 'Connected' : 'No connection; trying again. The run does not depend on it.';
  if (!connected) { me = null; controller = null; }
  offer();
});

// What can be asked for now.
function offer() {
  const steer = me !== null && controller === me;
  const what = activity.activity;
  const set = (id, possible) => { byId(id).disabled = !possible; };
  byId('take-control').textContent = steer ? 'Release control' : controller === null ? 'Take control' : 'Take control from the other page';
  set('take-control', me !== null);
  for (const id of ['do-check', 'do-start', 'do-jog']) set(id, steer && what === 'idle');
  set('do-hold', steer && what === 'running' && !activity.hold_asked && !activity.stop_asked);
  set('do-continue', steer && what === 'running' && activity.hold_asked && !activity.stop_asked);
  set('do-stop', steer && what !== 'idle' && what !== 'analysing' && !activity.stop_asked);
  const mayResume = steer && what === 'idle';
  document.body.classList.toggle('may-resume', mayResume);
  for (const button of document.querySelectorAll('button.resume')) button.disabled = !mayResume;
  for (const control of byId('note-form').elements) control.disabled = !(steer && what === 'running');
}

export async function ask(request) {
  const reply = await link.ask(request);
  byId('reply').textContent = reply.ok ? '' : `Refused: ${reply.why}`;
  return reply.ok;
}

// A person's yes, by a dialog that begins at "Cancel".
export function confirmed(title, text, yes) {
  const dialog = byId('confirm');
  byId('confirm-title').textContent = title;
  byId('confirm-text').textContent = text;
  byId('confirm-yes').textContent = yes;
  dialog.returnValue = 'no';
  dialog.showModal();
  byId('confirm-no').focus();
  return new Promise((resolve) => dialog.addEventListener('close', () => resolve(dialog.returnValue === 'yes'), {once: true}));
}

const CLEAR = 'Is the stage free to turn, and is everybody clear of it?';
byId('take-control').addEventListener('click', async () => {
  if (controller === me) return ask({do: 'control', release: true});
  if (controller === null) return ask({do: 'control'});
  if (await confirmed('Take control from the other page?', 'Another page steers this bench. It will then only watch.', 'Take control'))
    await ask({do: 'control', from_another: true});
});
byId('do-check').addEventListener('click', async () => {
  if (await confirmed('Check the bench?', `Both instruments are identified, the accelerometer is read at rest, and both axes are turned by 30 degrees. ${CLEAR}`, 'Check, and turn the stage'))
    await ask({do: 'check', with_motion: true, confirmed: true});
});
byId('do-start').addEventListener('click', async () => {
  if (await confirmed('Start a run?', `The stage moves through all three experiments. ${CLEAR}`, 'Start, and turn the stage'))
    await ask({do: 'start', confirmed: true});
});
byId('do-hold').addEventListener('click', () => ask({do: 'hold'}));
byId('do-continue').addEventListener('click', async () => {
  if (await confirmed('Continue the run?', `The stage moves on. ${CLEAR}`, 'Continue, and turn the stage'))
    await ask({do: 'continue', confirmed: true});
});
// At once: to stop needs no confirmation.
byId('do-stop').addEventListener('click', () => ask({do: 'stop'}));
byId('note-form').addEventListener('submit', async (event) => {
  event.preventDefault();
  if (await ask({do: 'note', text: byId('note').value})) byId('note').value = '';
});
byId('jog-form').addEventListener('submit', async (event) => {
  event.preventDefault();
  const axis = byId('jog-axis').value, by = Number(byId('jog-by').value);
  if (await confirmed(`Turn axis ${axis.toUpperCase()} by ${by} degrees?`, `It is homed first if it is not homed. ${CLEAR}`, 'Turn the stage'))
    await ask({do: 'jog', axis, by_deg: by, confirmed: true});
});

// Of a run whose angles are all measured only the analysis is missing: nothing moves.
async function resume(run, measured) {
  if (!measured && !(await confirmed(`Resume ${run}?`, `Both axes are homed, the last angle is measured again, and the run continues. ${CLEAR}`, 'Resume, and turn the stage'))) return;
  if (await ask({do: 'resume', run, confirmed: true})) location.hash = '#live';
}

function route() {
  const [view, ...rest] = location.hash.slice(1).split('/');
  const name = ['live', 'runs', 'compare', 'chart'].includes(view) ? view : 'live';
  if (name === 'runs') rest.length ? showRun(decodeURIComponent(rest[0])) : showRuns(resume);
  if (name === 'compare') showCompare();
  if (name === 'chart') showChart();
  for (const view of document.querySelectorAll('main > section')) view.hidden = view.id !== `view-${name}`;
  for (const a of document.querySelectorAll('nav a')) {
    if (a.hash === `#${name}`) a.setAttribute('aria-current', 'page'); else a.removeAttribute('aria-current');
  }
}
addEventListener('hashchange', () => { route(); byId('main').focus(); });
route();
offer();
