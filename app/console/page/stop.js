// The connection to the console, the banner, and Stop: they work even if every other part of the page is missing, fails or never
// ends loading. This module imports nothing that it needs; all other modules use its connection, its banner and its Stop. It is the
// first script of the page and waits neither for style sheets nor for other scripts (async).
export const SILENT_AFTER_MS = 3000;
export const UNCONFIRMED_AFTER_MS = 2000;
const LOADED_WITHIN_MS = 5000;  // After this time the banner reports that other modules are missing.
const MOST_EARLY = 2000;  // The most messages that may wait for the other modules.

const byId = (id) => document.getElementById(id);

// Other modules provide the language of the page and its times. Without them texts are English and times are UTC.
const words = {
  t: (text, ...values) => (typeof text === 'string' ? text : String.raw({raw: text}, ...values)),
  said: (english) => english,
  translated: () => null,
  know: () => {},
  clock: (moment) => `${new Date(moment).toISOString().slice(11, 19)} UTC`,
};
const t = (...text) => words.t(...text);

// The reason why part of the page does not work: the first one, since others follow from it. Empty if nothing has failed.
let failure = '', began = false;
function fail(why) {
  failure ||= why;
  if (began) show();
}
const nameOf = (address) => address.replace(`${location.origin}/`, '');
addEventListener('error', ({target, error}) => {
  if (target !== window) {
    if (target.matches('script, link[rel=stylesheet]')) fail(nameOf(target.src || target.href));
  } else if (error) {  // Notices of the browser have no error: nothing was thrown.
    fail(String(error));
  }
}, {capture: true});
addEventListener('unhandledrejection', ({reason}) => fail(String(reason)));
// The browser keeps a record of files that were refused before this module began to listen.
new PerformanceObserver((list) => {
  for (const {name, responseStatus} of list.getEntries()) if (responseStatus >= 400 && /\/[^/]+\.(js|css)$/.test(name)) fail(nameOf(name));
}).observe({type: 'resource', buffered: true});

// Reports an exception of another module; the code that follows the call is still executed.
function safely(act) {
  try {
    act();
  } catch (error) {
    reportError(error);
  }
}

// The rest of the page has two functions: receive(message), and contact(), which is called each second and whenever contact begins
// or ends. It receives messages that arrived before it was attached. If there were too many, the connection is opened again and begins
// with the whole state.
let rest = null, early = [], tooMany = false;
export function attach(listener) {
  rest = listener;
  if (tooMany) socket.close();
  for (const message of early.splice(0)) pass(message);
  show();
}

function pass(message) {
  if (rest) return safely(() => rest.receive(message));
  if (message.type === 'snapshot') early = early.filter(({type}) => type === 'you');  // A snapshot replaces all messages before it.
  if (early.length < MOST_EARLY) early.push(message);
  else tooMany = true;
}

// ---- The connection is a WebSocket, which is opened again whenever it is closed. The bench sends a beat each second; the page
// answers it and keeps the time of the last one.

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

// Loads the page again if its login has ended: a WebSocket that is refused does not report the reason.
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
  // Only a beat and the whole state show that the bench is there now; other messages may have been queued for long.
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

// Sends a request. The answer is {ok, why}. With `unsent` the request was not sent; with `lost` no answer arrived, and it is unknown
// whether the request was carried out.
export function ask(request) {
  if (!connected()) return Promise.resolve({ok: false, unsent: true, why: t('there is no connection to the console')});
  const id = ++lastId;
  return new Promise((resolve) => {
    waiting.set(id, resolve);
    socket.send(JSON.stringify({...request, id}));
  });
}

// Sends a request that is not answered.
export function tell(request) {
  if (connected()) socket.send(JSON.stringify(request));
}

// ---- The state of the bench, as far as Stop and a plain banner need it.

let activity = null, bench = {state: 'on'}, fault = null;
// State of the axes by the guard of the stage, which answers also while the process that holds the bench does not, or by its log
// where no guard answers. Nobody has said anything yet: nothing is known.
let guarded = {x: {state: 'unknown'}, z: {state: 'unknown'}};
export const axes = () => guarded;
const AT_REST = ['at rest', 'not moved'];
export const areAtRest = ({x, z}) => AT_REST.includes(x.state) && AT_REST.includes(z.state);

function note(message) {
  const before = activity?.activity;
  if (message.type === 'snapshot') {
    ({activity, fault} = message);
    byId('bench-name').textContent = message.about.bench_file;
    bench = message.bench ?? {state: 'on'};
    // The axes may have been moved again while this page had no connection.
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

// A state of the banner. word: the activity in one word; kind: colour of the banner and icon of the tab (favicon-KIND.svg); icon:
// symbol of index.html; sentence: the activity in a sentence; english: a text of the program, which is appended to the sentence and
// is translated if there are words for it; fault: the instrument at fault; todo: advice; limit: the time limit that runs, in words;
// known: false if no state has been received yet.
export const bannerState = (word, kind, icon, sentence, more = {}) => ({word, kind, icon, sentence, fault: '', todo: '', limit: '', known: true, english: '', ...more});

// The axes in words, where one of them is not confirmed at rest; empty otherwise.
function axesInWords({x, z}) {
  if (areAtRest({x, z})) return '';
  const one = (name, {state, since}) => {
    const at = since ? `${since.slice(11, 19)} UTC` : '';
    if (state === 'unreachable') return t`Axis ${name} is unreachable since ${at} and may be moving.`;
    if (state === 'may be moving') return t`Axis ${name} may be moving.`;
    if (state === 'unknown') return at ? t`Axis ${name} may be moving: it was commanded to at ${at}, and nobody is left who would see it come to rest.` : t`Nothing is known of axis ${name} yet.`;
    return at ? t`Axis ${name} is at rest, confirmed at ${at}.` : t`Axis ${name} was not moved.`;
  };
  return `${one('X', x)} ${one('Z', z)}`;
}

// Empty where nothing was moved, so that there is no guard to confirm it.
const confirmedAtRest = ({x, z}) => (x.state === 'at rest' || z.state === 'at rest' ? t('Its guard has confirmed that the axes are at rest.') : '');

// The state of the banner as far as the activity of the bench determines it. view: as stateOf() in state.js.
export function plainState(view) {
  if (!view.known) return bannerState(t('No contact'), 'lost', 'lost', t('Nothing is known of the bench yet'), {todo: t('Use the switch on the stage if it must stop now.'), known: false});
  const moving = axesInWords(view.axes);
  if (view.bench.state !== 'on') return bannerState(t('Not known'), 'fault', 'lost', [t(view.bench.words), moving || confirmedAtRest(view.axes)].filter(Boolean).join(' '), {todo: t('Look at the stage before anything else; use its own switch if it moves.')});
  const what = view.activity.activity;
  if (what !== 'idle' && view.activity.stop_asked) return bannerState(t('Stopping'), 'fault', 'stop', t('Stopping: the stage is being halted'), {todo: t('Use the switch on the stage if it still moves.')});
  if (what === 'checking') return bannerState(t('Checking'), 'busy', 'reading', t('Checking the bench'));
  if (what === 'jogging') return bannerState(t('Moving'), 'busy', 'moving', t('The stage is jogged'));
  if (what === 'analysing') return bannerState(t('Analysing'), 'busy', 'reading', t('All angles are measured; the run is being analysed'));
  if (what !== 'idle') return bannerState(t('Running'), 'busy', 'moving', t('A run is in progress; the stage may move'));
  if ([view.axes.x, view.axes.z].some(({state}) => state === 'unknown')) return bannerState(t('Not known'), 'fault', 'lost', moving, {todo: t('Look at the stage before anything else; use its own switch if it moves.')});
  if (moving) return bannerState(t('Not at rest'), 'fault', 'moving', moving, {todo: t('The guard halts it until that is confirmed. Use the switch on the stage if it still moves.')});
  if (view.fault) return bannerState(t('Faulted'), 'fault', 'fault', '', {english: view.fault.words, fault: view.fault.instrument});
  return bannerState(t('Idle'), 'idle', 'idle', t('No run is in progress.'));
}

// Shows a state that another module has determined. Once part of the page has failed this has no effect, since that module may no
// longer follow the bench; from then on the banner shows plainState().
// count: the progress for the title of the page; situation: whether the data of #situation are those of a run.
export function showBanner(seen, {count, situation}) {
  if (failure) return;
  byId('situation').hidden = !situation;
  write(seen, count);
}

let written = '';
function write(seen, count = '') {
  const there = contact();
  const word = there ? seen.word : t('No contact');
  // While the process that holds the bench is silent or gone, the console still reports this, and the state of the axes from their
  // guard.
  const isPresent = there || !seen.known || (connected() && bench.state !== 'on');
  const sentence = isPresent ? seen.sentence : t`Last known: ${seen.word}. ${seen.sentence}`;
  const [kind, icon] = there ? [seen.kind, seen.icon] : ['lost', 'lost'];
  const more = [seen.fault && t`At fault: ${seen.fault}.`, there && seen.limit, seen.todo].filter(Boolean).join(' ');
  const title = `${word}${there ? count : ''} – ${byId('bench-name').textContent || 'abcal'}`;
  if (document.title !== title) document.title = title;
  const now = JSON.stringify([word, sentence, seen.english, more, kind, icon]);
  if (now === written) return;
  written = now;
  byId('banner').dataset.kind = kind;
  byId('banner-icon').firstElementChild.setAttribute('href', `#icon-${icon}`);
  byId('banner-word').textContent = word;
  if (byId('state').textContent !== sentence + seen.english) byId('state').replaceChildren(sentence, words.said(seen.english));
  byId('state').title = byId('state').textContent;  // A long one is shown in part.
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

// Writes the warnings, the plain banner if no other module writes it, and whether Stop can be pressed.
function show() {
  const silent = silence(), lost = byId('contact'), failed = byId('failed'), problem = missing();
  if (silent.length || lost.childNodes.length) lost.replaceChildren(...silent);
  if (failed.textContent !== problem) failed.textContent = problem;
  if (!rest || failure) byId('situation').hidden = true;  // Nobody keeps it up to date.
  if (!rest || failure) write(plainState({known: activity !== null, activity, bench, fault, axes: guarded}));
  // Everybody may stop, with control or without, while anything can move and while it is not known whether it does.
  const mayMove = (activity && !['idle', 'analysing'].includes(activity.activity)) || (!contact() && heardUtc !== null) || bench.state !== 'on' || !areAtRest(guarded);
  for (const id of ['do-stop', 'dialog-stop']) byId(id).disabled = !mayMove;
}

// ---- Stop is sent at once. It is complete when each axis has confirmed standstill.

let stopping = null;  // The timer that runs until the axes have answered.
let haltKnown = false;  // True if #halt shows the answer of the axes.
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
  words.know(reply);
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

// ---- The page begins here, when index.html has been read; files that it names may still be loading.

if (document.readyState === 'loading') await new Promise((done) => document.addEventListener('readystatechange', done, {once: true}));
began = true;
for (const id of ['do-stop', 'dialog-stop']) byId(id).addEventListener('click', stop);
let escaped = -Infinity;
addEventListener('keydown', (event) => {
  if (event.key !== 'Escape' || event.repeat) return;
  // By the time at which the key was pressed: a busy page receives the event late.
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
// A browser draws nothing while it waits for a style sheet of index.html. A late one is replaced by a copy, for which no browser but
// Firefox waits; there all loading is ended.
setTimeout(() => {
  for (const sheet of document.querySelectorAll('link[rel=stylesheet]:not([media])')) if (!sheet.sheet) sheet.replaceWith(sheet.cloneNode());
  if (!rest && !byId('do-stop').checkVisibility()) window.stop();
}, LOADED_WITHIN_MS);

function speak(better) {
  Object.assign(words, better);
  written = '';
  byId('state').replaceChildren();  // The words there now may be those of before, in English and not marked so.
  sayOfHalt(haltWords);
  contactMayHaveChanged();
}
const without = () => {};  // Such a failure is reported by the modules that need the file.
import('/language.js').then(({t: inLanguage, translate}) => { translate(byId('top')); speak({t: inLanguage}); }, without);
import('/said.js').then(({know, said, translated}) => speak({know, said, translated}), without);
import('/time.js').then(({timeElement}) => speak({clock: (moment) => timeElement(moment, 'clock')}), without);
