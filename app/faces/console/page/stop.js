// The parts that work whatever else of the page fails: the connection to the console, the banner, and Stop. They need no other module; all
// others use this connection, this banner and this Stop. In the page it is the first script, and waits neither for style sheets nor
// for other scripts.
export const SILENT_AFTER_MS = 3000;
export const UNCONFIRMED_AFTER_MS = 2000;
const LOADED_WITHIN_MS = 5000;  // The other modules; after that the banner says that they are missing.
const MOST_EARLY = 2000;  // Messages that wait for the other modules.

const byId = (id) => document.getElementById(id);

// Words in the language of the page, and times as the page has them, come from other modules. Without these: English and UTC.
const words = {
  t: (text, ...values) => (typeof text === 'string' ? text : String.raw({raw: text}, ...values)),
  said: (english) => english,
  translated: () => null,
  clock: (moment) => `${new Date(moment).toISOString().slice(11, 19)} UTC`,
};
const t = (...text) => words.t(...text);

// Why part of the page does not work: the first reason, since others follow from it. Empty: all is well.
let failure = '', began = false;
function fail(why) {
  failure ||= why;
  if (began) show();
}
addEventListener('error', ({target, error}) => {
  if (target !== window) {
    if (target.matches('script, link[rel=stylesheet]')) fail((target.src || target.href).replace(`${location.origin}/`, ''));
  } else if (error) {  // Without an error nothing was thrown: a notice of the browser.
    fail(String(error));
  }
}, {capture: true});
addEventListener('unhandledrejection', ({reason}) => fail(String(reason)));

// Another module's mistake is reported, and keeps nothing here from going on.
function safely(act) {
  try {
    act();
  } catch (error) {
    reportError(error);
  }
}

// The rest of the page: receive(message), and contact(), which is called each second and whenever contact begins or ends. Messages
// that came before it are passed on; if they were too many, the connection is made again and begins with the whole state.
let rest = null, early = [], tooMany = false;
export function attach(listener) {
  rest = listener;
  if (tooMany) socket.close();
  for (const message of early.splice(0)) pass(message);
  show();
}

function pass(message) {
  if (rest) return safely(() => rest.receive(message));
  if (message.type === 'snapshot') early = early.filter(({type}) => type === 'you');  // It says what all before it have said.
  if (early.length < MOST_EARLY) early.push(message);
  else tooMany = true;
}

// ---- The connection, a WebSocket: messages in, requests out; connects again by itself. Knows when the bench was last heard: each
// second the bench sends a beat, which is answered.

let socket, wait = 500, lastId = 0;
let heard = null;     // performance.now() of the last beat
let heardUtc = null;  // The same moment by this computer's clock.
const waiting = new Map();

export const connected = () => socket.readyState === WebSocket.OPEN;
export const contact = () => connected() && heard !== null && performance.now() - heard < SILENT_AFTER_MS;

function contactMayHaveChanged() {
  if (rest) safely(() => rest.contact());
  show();
}

function open() {
  const scheme = location.protocol === 'https:' ? 'wss:' : 'ws:';
  socket = new WebSocket(`${scheme}//${location.host}/live`);
  socket.onopen = () => { wait = 500; };
  socket.onmessage = ({data}) => safely(() => receive(JSON.parse(data)));
  socket.onclose = () => {
    for (const resolve of waiting.values()) resolve({ok: false, lost: true, why: t('the connection was lost before the answer')});
    waiting.clear();
    early = [];
    tooMany = false;
    contactMayHaveChanged();
    askWho();
    setTimeout(open, wait);
    wait = Math.min(2 * wait, 8000);
  };
}

// Whether this page may still be here: a WebSocket that is declined does not say why.
async function askWho() {
  try {
    if ((await fetch('/who')).status === 401) location.reload();
  } catch { /* No contact; the page says so. */ }
}

function receive(message) {
  message.type ??= message.event;  // Events of a run have the names that they have in the program.
  if (message.type === 'reply') {
    const resolve = waiting.get(message.id);
    waiting.delete(message.id);
    if (resolve) resolve(message);
    return;
  }
  // A beat, or the whole state to begin with; anything else may have been on its way for long.
  if (message.type === 'beat' || message.type === 'snapshot') {
    const before = contact();
    heard = performance.now();
    heardUtc = new Date();
    if (message.type === 'beat') socket.send('{"do":"beat"}');
    if (!before) contactMayHaveChanged();
  }
  note(message);
  pass(message);
}

// The answer: {ok, why}; `lost`: none came, and nobody knows whether the request was carried out.
export function ask(request) {
  if (!connected()) return Promise.resolve({ok: false, unsent: true, why: t('there is no connection to the console')});
  const id = ++lastId;
  return new Promise((resolve) => {
    waiting.set(id, resolve);
    socket.send(JSON.stringify({...request, id}));
  });
}

// ---- What is known of the bench: as much as Stop and a plain banner need.

let activity = null, bench = {state: 'on'}, fault = null;
// State of the axes by the guard of the stage, which answers also while the process that holds the bench does not.
let guarded = {x: {state: 'not moved'}, z: {state: 'not moved'}};
export const axes = () => guarded;
const RESTLESS = ['may be moving', 'unreachable'];
export const areAtRest = ({x, z}) => !RESTLESS.includes(x.state) && !RESTLESS.includes(z.state);

function note(message) {
  const before = activity?.activity;
  if (message.type === 'snapshot') {
    ({activity, fault} = message);
    byId('bench-name').textContent = message.about.bench_file;
    bench = message.bench ?? {state: 'on'};
    // Where axes have halted is not so any more if somebody has moved them while this page was away.
    if (message.halt) showHalt(message.halt);
    else if (activity.activity === 'idle' || haltKnown) clearHalt();
  } else if (message.type === 'activity') {
    activity = message;
    if (activity.activity !== 'idle') {
      fault = null;
      if (before === 'idle') clearHalt();
    }
  } else if (message.type === 'bench') {
    bench = message;
  } else if (message.type === 'fault') {
    fault = message;
  } else if (message.type === 'halt') {
    showHalt(message);
  } else if (message.type === 'guard') {
    guarded = message.axes;
  } else {
    return;
  }
  show();
}

// ---- The banner

// The activity of the bench in one word, and what a person should know with it. kind: colour and icon of the tab (favicon-KIND.svg).
// english: what the program says further, in English alone.
export const bannerState = (word, kind, icon, sentence, more = {}) => ({word, kind, icon, sentence, fault: '', todo: '', limit: null, known: true, english: '', ...more});

// The axes in words, where one of them is not confirmed at rest; empty otherwise.
function axesInWords({x, z}) {
  if (areAtRest({x, z})) return '';
  const one = (name, {state, since}) => {
    const at = since ? `${since.slice(11, 19)} UTC` : '';
    if (state === 'unreachable') return t`Axis ${name} is unreachable since ${at} and may be moving.`;
    if (state === 'may be moving') return t`Axis ${name} may be moving.`;
    return at ? t`Axis ${name} is at rest, confirmed at ${at}.` : t`Axis ${name} was not moved.`;
  };
  return `${one('X', x)} ${one('Z', z)}`;
}

// As far as it follows from the activity of the bench and from its guard.
export function plainState(view) {
  if (!view.known) return bannerState(t('No contact'), 'lost', 'lost', t('Nothing is known of the bench yet'), {todo: t('Use the switch on the stage if it must stop now.'), known: false});
  const moving = axesInWords(view.axes);
  if (view.bench.state !== 'on') return bannerState(t('Not known'), 'fault', 'lost', [t(view.bench.words), moving].filter(Boolean).join(' '), {todo: t('Look at the stage before anything else; use its own switch if it moves.')});
  const what = view.activity.activity;
  if (what !== 'idle' && view.activity.stop_asked) return bannerState(t('Stopping'), 'fault', 'stop', t('Stopping: the stage is being halted'), {todo: t('Use the switch on the stage if it still moves.')});
  if (what === 'checking') return bannerState(t('Checking'), 'busy', 'reading', t('Checking the bench'));
  if (what === 'jogging') return bannerState(t('Moving'), 'busy', 'moving', t('The stage is jogged'));
  if (what === 'analysing') return bannerState(t('Analysing'), 'busy', 'reading', t('All angles are measured; the run is being analysed'));
  if (what !== 'idle') return bannerState(t('Running'), 'busy', 'moving', t('A run is in progress; the stage may move'));
  if (moving) return bannerState(t('Not at rest'), 'fault', 'moving', moving, {todo: t('The guard halts it until that is confirmed. Use the switch on the stage if it still moves.')});
  if (view.fault) return bannerState(t('Faulted'), 'fault', 'fault', '', {english: view.fault.words, fault: view.fault.instrument});
  return bannerState(t('Idle'), 'idle', 'idle', t('No run is in progress.'));
}

// The one who writes the banner is the rest of the page, as long as nothing of it has failed: else it might stand still.
export function showBanner(seen, more) {
  if (!failure) write(seen, more);
}

let written = '';
// limit, count: words on the time limit that runs, and on the progress for the title.
function write(seen, {limit = '', count = ''} = {}) {
  const there = contact();
  const word = there ? seen.word : t('No contact');
  const sentence = there || !seen.known ? seen.sentence : t`Last known: ${seen.word}. ${seen.sentence}`;
  const [kind, icon] = there ? [seen.kind, seen.icon] : ['lost', 'lost'];
  const more = [seen.fault && t`At fault: ${seen.fault}.`, there && limit, seen.todo].filter(Boolean).join(' ');
  const title = `${word}${there ? count : ''} – ${byId('bench-name').textContent || 'abcal'}`;
  if (document.title !== title) document.title = title;
  const now = JSON.stringify([word, sentence, seen.english, more, kind, icon]);
  if (now === written) return;
  written = now;
  byId('banner').dataset.kind = kind;
  byId('banner-icon').firstElementChild.setAttribute('href', `#icon-${icon}`);
  byId('banner-word').textContent = word;
  if (byId('state').textContent !== sentence + seen.english) byId('state').replaceChildren(sentence, words.said(seen.english));
  byId('banner-more').textContent = more;
  byId('favicon').href = `/favicon-${kind}.svg`;
}

const USE_THE_SWITCH = () => t('use the switch on the stage');

function silence() {
  if (contact()) return [];
  if (heardUtc === null) return performance.now() > SILENT_AFTER_MS ? [t('No contact with the console yet.')] : [];
  return [t`No contact for ${Math.round((performance.now() - heard) / 1000)} s, last known at `, words.clock(heardUtc), t`. The stage may be moving: ${USE_THE_SWITCH()} to stop it.`];
}

function missing() {
  if (failure) return t`Part of this page has failed (${failure}). Reload the page. The banner and Stop work; what else is shown may be wrong or missing.`;
  if (!rest && performance.now() > LOADED_WITHIN_MS) return t('Part of this page has not loaded. Reload the page. The banner and Stop work.');
  return '';
}

// Shows what is known, and since when; outdated data are marked as such.
function show() {
  const silent = silence(), lost = byId('contact'), failed = byId('failed'), problem = missing();
  if (silent.length || lost.childNodes.length) lost.replaceChildren(...silent);
  if (failed.textContent !== problem) failed.textContent = problem;
  if (!rest || failure) write(plainState({known: activity !== null, activity, bench, fault, axes: guarded}));
  // Everybody may stop, with control or without, as long as anything can move or nobody knows whether it does.
  const mayMove = (activity && !['idle', 'analysing'].includes(activity.activity)) || (!contact() && heardUtc !== null) || bench.state !== 'on' || !areAtRest(guarded);
  for (const id of ['do-stop', 'dialog-stop']) byId(id).disabled = !mayMove;
}

// ---- Stop is sent at once and by anybody; it is done when each axis has said that it stands still.

let stopping = null;  // While the axes have not answered.
let haltKnown = false;  // The text of the halt is the answer of the axes.
let haltWords = () => [];
function sayOfHalt(said) {
  haltWords = said;
  byId('halt').replaceChildren(...haltWords());
}

function clearHalt() {
  haltKnown = false;
  sayOfHalt(() => []);
}

async function stop() {
  clearTimeout(stopping);
  haltKnown = false;
  sayOfHalt(() => [t('Stop: sent')]);
  stopping = setTimeout(() => sayOfHalt(() => [t`Stop: not confirmed after ${UNCONFIRMED_AFTER_MS / 1000} s: ${USE_THE_SWITCH()}`]), UNCONFIRMED_AFTER_MS);
  const reply = await ask({do: 'stop'});
  if (reply.ok) return;
  clearTimeout(stopping);
  sayOfHalt(() => [reply.unsent ? t`Stop: not sent, ${reply.why}: ${USE_THE_SWITCH()}` : reply.lost ? t`Stop: not confirmed, ${reply.why}: ${USE_THE_SWITCH()}` : t`Stop: refused: ${words.translated(reply.why) ?? reply.why}`]);
}

function showHalt({axes, took_s: took, since}) {
  clearTimeout(stopping);
  haltKnown = true;
  const all = axes.x === 'halted' && axes.z === 'halted';
  const became = (axis) => (axis === 'halted' ? t('has halted') : t('is unreachable and may be moving'));
  sayOfHalt(() => [t`Axis X ${became(axes.x)}. Axis Z ${became(axes.z)}. (${took.toFixed(2)} s, `, words.clock(since), ')', all ? '' : t(' Use the switch on the stage.')]);
}

// ---- It begins when the whole of index.html is there, whatever that loads.

if (document.readyState === 'loading') await new Promise((done) => document.addEventListener('readystatechange', done, {once: true}));
began = true;
for (const id of ['do-stop', 'dialog-stop']) byId(id).addEventListener('click', stop);
let escaped = -Infinity;
addEventListener('keydown', (event) => {
  if (event.key !== 'Escape' || event.repeat) return;
  // When it was pressed: a busy page hears of it late.
  if (event.timeStamp - escaped < 1000) {
    escaped = -Infinity;
    if (!byId('do-stop').disabled) stop();
  } else {
    escaped = event.timeStamp;
  }
}, {capture: true});
open();
show();
setInterval(contactMayHaveChanged, 1000);
// A browser shows nothing while a style sheet is on its way. One that is late is asked for again, in a way that nothing waits for.
setTimeout(() => {
  for (const sheet of document.querySelectorAll('link[rel=stylesheet]:not([media])')) if (!sheet.sheet) sheet.replaceWith(sheet.cloneNode());
}, LOADED_WITHIN_MS);

function speak(better) {
  Object.assign(words, better);
  written = '';
  sayOfHalt(haltWords);
  contactMayHaveChanged();
}
const without = () => {};  // Whoever needs the module reports that it is missing.
import('/language.js').then(({t: inLanguage, translate}) => { translate(byId('top')); speak({t: inLanguage}); }, without);
import('/said.js').then(({said, translated}) => speak({said, translated}), without);
import('/time.js').then(({timeElement}) => speak({clock: (moment) => timeElement(moment, 'clock')}), without);
