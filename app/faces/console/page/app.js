import {byId, duration, element, small} from '/text.js';
import {said, translated} from '/said.js';
import {BenchView} from '/bench.js';
import {Link, SILENT_AFTER_MS, UNCONFIRMED_AFTER_MS} from '/link.js';
import {withoutMissing} from '/items.js';
import {LiveView} from '/live.js';
import {endMaking} from '/making.js';
import {QueueView} from '/queue.js';
import {StartForm} from '/start.js';
import {canMove, stateOf} from '/state.js';
import {offerTimes, timeElement} from '/time.js';
import {offerLanguage, t, translate} from '/language.js';
import {keepFocus} from '/focus.js';
import {readyForPaper} from '/print.js';
import {showChart, showCompare, showRun, showRuns, statesMayHaveChanged} from '/runs.js';

translate();
const live = new LiveView();
let me = null, maySteer = true, steering = {page: null}, bench = {state: 'on'};
let hadControl = false, answered = false;  // answered: the text in #reply expires with the connection.
const USE_THE_SWITCH = t('use the switch on the stage');

let dayViews = [];  // The views of a day's work, each with receive(message) and offer(may, idle).

// Types of messages that arrive many times a second: the banner changes once for all messages of 50 ms.
const OFTEN = new Set(['dwell_done', 'log', 'phase', 'stage', 'strip']);
let showing = null;
function showSoon() {
  showing ??= setTimeout(() => { showing = null; show(); }, 50);
}

const link = new Link((message) => {
  if (message.type === 'you') {
    me = message.number;
    maySteer = message.may_steer;
    byId('person').hidden = !message.person;
    byId('person-name').textContent = message.person;
    byId('lost-control').replaceChildren();
    // An acceptance from before the connection was lost is outdated; a missing confirmation stays until the next request.
    if (answered) byId('reply').textContent = '';
    if (hadControl) lostControl(t('this page lost its connection'));
  }
  if (message.type === 'control') {
    if (hadControl && message.page !== me) lostControl(message.page === null ? t('nobody has it now') : t`${message.who} has taken it`);
    hadControl = message.page === me;
    if (hadControl) byId('lost-control').replaceChildren();
    steering = message;
  }
  if (message.type === 'snapshot') {
    byId('bench-name').textContent = message.about.bench_file;
    byId('link').title = message.about.program;
    bench = message.bench ?? {state: 'on'};
    // A halt that is shown is outdated if somebody has moved the axes while this page was not connected.
    if (message.halt) showHalt(message.halt);
    else if (message.activity.activity === 'idle' || haltKnown) clearHalt();
  }
  if (message.type === 'bench') bench = message;
  if (message.type === 'activity' && message.activity !== 'idle' && live.activity?.activity === 'idle') clearHalt();
  if (message.type === 'halt') showHalt(message);
  const before = live.activity?.activity;
  live.receive(message);
  if (before !== undefined && (message.type === 'snapshot' || live.activity.activity !== before)) statesMayHaveChanged(resume);
  for (const view of dayViews) view.receive(message);
  if (OFTEN.has(message.type)) showSoon(); else show();
}, () => {
  if (!link.connected) { me = null; steering = {page: null}; }
  show();
});

function lostControl(why) {
  hadControl = false;
  byId('lost-control').replaceChildren(t('This page no longer has control: '), why, ' (', timeElement(new Date(), 'clock'), ').');
}

// Shows what is known, and since when; outdated data are marked as such.
function show() {
  const contact = link.contact, known = live.activity !== undefined;
  document.body.classList.toggle('no-contact', !contact);
  live.setContact(contact);
  byId('link').textContent = contact ? t('Connected') : t('No contact');
  const silent = byId('contact');
  if (contact) {
    if (silent.childNodes.length) silent.replaceChildren();
  } else if (link.heardUtc === null) {
    if (performance.now() > SILENT_AFTER_MS) silent.replaceChildren(t('No contact with the console yet.'));
  } else {
    const words = [t`No contact for ${Math.round(link.silentMs / 1000)} s, last known at `, timeElement(link.heardUtc, 'clock'), t`. The stage may be moving: ${USE_THE_SWITCH} to stop it.`];
    silent.replaceChildren(...words);
  }
  const state = stateOf({known, activity: live.activity, phase: live.phase, ended: live.ended, fault: live.fault, bench});
  showState(contact ? state : {...state, kind: 'lost', icon: 'lost'}, contact);
  offer(contact);
}

// How long a phase may last. In simulated time that differs from the real time that a person sees pass.
function limitIn({seconds, simulated, words}) {
  const time = seconds < 1 ? small(seconds, 's') : duration(seconds);
  return simulated ? t`Limit: ${time} of simulated time ${t(words)}.` : t`Limit: ${time} ${t(words)}.`;
}

let shown = '';
function showState(state, contact) {
  const word = contact ? state.word : t('No contact');
  const sentence = contact || !state.known ? state.sentence : t`Last known: ${state.word}. ${state.sentence}`;
  const limit = contact && state.limit ? limitIn(state.limit) : '';
  const more = [state.fault && t`At fault: ${state.fault}.`, limit, state.todo].filter(Boolean).join(' ');
  const now = JSON.stringify([word, sentence, state.english, more, state.kind, state.icon]);
  const {measured, total} = live.progress ?? {};
  const count = total && live.activity?.activity === 'running' ? t`, ${measured} of ${total}` : '';
  const title = `${word}${contact ? count : ''} – ${byId('bench-name').textContent || 'abcal'}`;
  if (document.title !== title) document.title = title;
  if (now === shown) return;
  shown = now;
  byId('banner').dataset.kind = state.kind;
  byId('banner-icon').firstElementChild.setAttribute('href', `#icon-${state.icon}`);
  byId('banner-word').textContent = word;
  if (byId('state').textContent !== sentence + state.english) byId('state').replaceChildren(sentence, said(state.english));
  byId('banner-more').textContent = more;
  byId('favicon').href = `/favicon-${state.kind}.svg`;
}

// Enables the controls that can be used now.
function offer(contact) {
  const steer = contact && me !== null && steering.page === me;
  const activity = live.activity ?? {activity: 'idle', hold_asked: false, stop_asked: false}, what = activity.activity;
  const set = (id, possible) => { byId(id).disabled = !possible; };
  const other = steering.page !== null && steering.page !== me;
  byId('take-control').textContent = steer ? t('Release control') : other ? t('Take control from the other page') : t('Take control');
  byId('who-steers').textContent = (other ? (steering.silent ? t`${steering.who} steers, and does not answer.` : t`${steering.who} steers.`) : '')
    + (maySteer ? '' : t(' You may watch and stop; steering needs the right to measure.'));
  set('take-control', contact && me !== null && maySteer);
  for (const id of ['do-check', 'do-start', 'do-jog']) set(id, steer && what === 'idle');
  set('do-hold', steer && what === 'running' && !activity.hold_asked && !activity.stop_asked);
  set('do-continue', steer && what === 'running' && activity.hold_asked && !activity.stop_asked);
  // Everybody may stop, with control or without, while anything moves or its motion is unknown.
  const mayMove = canMove(activity) || (!contact && link.heardUtc !== null) || bench.state !== 'on';
  for (const id of ['do-stop', 'dialog-stop']) set(id, mayMove);
  const mayResume = steer && what === 'idle';
  for (const view of dayViews) view.offer(steer, what === 'idle');
  document.body.classList.toggle('may-resume', mayResume);
  for (const button of document.querySelectorAll('button.resume')) button.disabled = !mayResume;
  for (const control of byId('note-form').elements) control.disabled = !(steer && what === 'running');
}

// Sends a request, and shows its state: sent, done, refused, or not confirmed. A request that takes time is accepted when it has
// begun; the banner shows its progress.
const DONE_WHEN_ANSWERED = new Set(['control', 'continue', 'queue_add', 'queue_move', 'queue_remove', 'queue_repeat', 'queue_pause']);
async function ask(name, request, {moves = true} = {}) {
  const say = (words) => { byId('reply').textContent = `${name}: ${words}`; answered = false; };
  const advice = moves ? `: ${USE_THE_SWITCH}` : '';
  say(t('sent'));
  const late = setTimeout(() => say(t`not confirmed after ${UNCONFIRMED_AFTER_MS / 1000} s` + advice), UNCONFIRMED_AFTER_MS);
  const reply = await link.ask(request);
  clearTimeout(late);
  if (reply.ok) say(DONE_WHEN_ANSWERED.has(request.do) ? t('done') : t('accepted'));
  else if (reply.unsent) say(t`not sent, ${reply.why}` + advice);
  else if (reply.lost) say(t`not confirmed, ${reply.why}` + advice);
  else say(t`refused: ${translated(reply.why) ?? reply.why}`);
  answered = reply.ok;
  return reply.ok;
}

// Stop is sent at once, by anybody; it is done when each axis has confirmed that it is at rest.
let stopping = null;  // Timer, while the axes have not answered.
let haltKnown = false;  // #halt shows the answer of the axes.
function clearHalt() {
  haltKnown = false;
  byId('halt').textContent = '';
}

async function stop() {
  clearTimeout(stopping);
  haltKnown = false;
  const say = (words) => { byId('halt').textContent = words; };
  say(t('Stop: sent'));
  const unconfirmed = () => say(t`Stop: not confirmed after ${UNCONFIRMED_AFTER_MS / 1000} s: ${USE_THE_SWITCH}`);
  stopping = setTimeout(unconfirmed, UNCONFIRMED_AFTER_MS);
  const reply = await link.ask({do: 'stop'});
  if (reply.ok) return;
  clearTimeout(stopping);
  say(reply.unsent ? t`Stop: not sent, ${reply.why}: ${USE_THE_SWITCH}` : reply.lost ? t`Stop: not confirmed, ${reply.why}: ${USE_THE_SWITCH}` : t`Stop: refused: ${translated(reply.why) ?? reply.why}`);
}

function showHalt({axes, took_s: took, since}) {
  clearTimeout(stopping);
  haltKnown = true;
  const all = axes.x === 'halted' && axes.z === 'halted';
  const words = {halted: t('has halted'), unreachable: t('is unreachable and may be moving')};
  byId('halt').replaceChildren(t`Axis X ${words[axes.x]}. Axis Z ${words[axes.z]}. (${took.toFixed(2)} s, `, timeElement(since, 'clock'), ')', all ? '' : t(' Use the switch on the stage.'));
}

byId('log-out').addEventListener('click', async () => {
  try {
    await fetch('/logout', {method: 'POST'});
  } finally {
    location.replace('/');
  }
});

byId('do-stop').addEventListener('click', stop);
byId('dialog-stop').addEventListener('click', stop);
let escaped = -Infinity;
addEventListener('keydown', (event) => {
  if (event.key !== 'Escape' || event.repeat) return;
  // The time of the key press, as a busy page receives the event late.
  if (event.timeStamp - escaped < 1000) {
    escaped = -Infinity;
    if (!byId('do-stop').disabled) stop();
  } else {
    escaped = event.timeStamp;
  }
}, {capture: true});

// Asks a person for a confirmation, by a dialog with the focus on "Cancel".
// more: a form in the dialog (open(holder, yes)).
function confirmed(title, text, yes, more = null) {
  const dialog = byId('confirm');
  byId('confirm-title').textContent = title;
  byId('confirm-text').textContent = text;
  byId('confirm-yes').textContent = yes;
  byId('confirm-yes').disabled = false;
  byId('confirm-more').replaceChildren();
  more?.open(byId('confirm-more'), byId('confirm-yes'));
  dialog.returnValue = 'no';
  dialog.showModal();
  byId('confirm-no').focus();
  return new Promise((resolve) => dialog.addEventListener('close', () => resolve(dialog.returnValue === 'yes'), {once: true}));
}

const CLEAR = t('Is the stage free to turn, and is everybody clear of it?');
const page = {ask, confirmed, clear: CLEAR, pace: () => live.about?.pace ?? 1};
dayViews = [new QueueView(page), new BenchView(page)];
byId('take-control').addEventListener('click', async () => {
  const control = (more) => ask(t('Control'), {do: 'control', ...more}, {moves: false});
  if (steering.page !== null && steering.page === me) {
    hadControl = false;
    return control({release: true});
  }
  if (steering.page === null) return control({});
  if (await confirmed(t('Take control from the other page?'), t`${steering.who} steers this bench. That page will then only watch, and is told who took over.`, t('Take control')))
    await control({from_another: true});
});
byId('do-check').addEventListener('click', async () => {
  if (await confirmed(t('Check the bench?'), t`Both instruments are identified, the accelerometer is read at rest, and both axes are turned by 30 degrees. ${CLEAR}`, t('Check, and turn the stage')))
    await ask(t('Check'), {do: 'check', with_motion: true, confirmed: true});
});
byId('do-start').addEventListener('click', async () => {
  const form = new StartForm(live.about?.pace ?? 1);
  if (await confirmed(t('Start a run?'), t`The stage moves through all three experiments. ${CLEAR}`, t('Start, and turn the stage'), form))
    await ask(t('Start'), {do: 'start', confirmed: true, ...form.choice()});
});
byId('do-hold').addEventListener('click', () => ask(t('Hold'), {do: 'hold'}));
byId('do-continue').addEventListener('click', async () => {
  if (await confirmed(t('Continue the run?'), t`The stage moves on. ${CLEAR}`, t('Continue, and turn the stage')))
    await ask(t('Continue'), {do: 'continue', confirmed: true});
});
byId('note-form').addEventListener('submit', async (event) => {
  event.preventDefault();
  if (await ask(t('Note'), {do: 'note', text: byId('note').value}, {moves: false})) byId('note').value = '';
});
byId('jog-form').addEventListener('submit', async (event) => {
  event.preventDefault();
  const axis = byId('jog-axis').value, by = Number(byId('jog-by').value);
  if (await confirmed(t`Turn axis ${axis.toUpperCase()} by ${by} degrees?`, t`It is homed first if it is not homed. ${CLEAR}`, t('Turn the stage')))
    await ask(t('Jog'), {do: 'jog', axis, by_deg: by, confirmed: true});
});

// Resumes a run. If all its angles are measured, it is only analysed and nothing moves. items: number that still takes part.
async function resume(run, measured, items) {
  const missing = withoutMissing('resume-without-missing');
  const form = items > 1 ? {open: (holder) => holder.append(element('p', {}, t`${items} items take part. One that is left out stays left out.`), missing.label)} : null;
  if (!measured && !(await confirmed(t`Resume ${run}?`, t`Both axes are homed, the last angle is measured again, and the run continues. ${CLEAR}`, t('Resume, and turn the stage'), form))) return;
  if (await ask(measured ? t('Analyse') : t('Resume'), {do: 'resume', run, confirmed: true, ...missing.choice()}, {moves: !measured})) location.hash = '#live';
}
byId('resume-interrupted').addEventListener('click', () => {
  const {file, measured, planned, items} = live.interrupted;
  resume(file, measured === planned, items);
});

function route() {
  endMaking();
  const [view, ...rest] = location.hash.slice(1).split('/');
  const kiosk = view === 'kiosk';
  const name = ['live', 'queue', 'bench', 'runs', 'compare', 'chart'].includes(view) ? view : 'live';
  document.body.classList.remove('loading');
  document.body.classList.toggle('kiosk', kiosk);
  if (name === 'runs') rest.length ? showRun(decodeURIComponent(rest[0]), rest[1]) : showRuns(resume);
  if (name === 'compare') showCompare();
  if (name === 'chart') showChart();
  for (const view of document.querySelectorAll('main > section')) view.hidden = view.id !== `view-${name}`;
  for (const a of document.querySelectorAll('nav a')) {
    if (a.hash === `#${name}` && !kiosk) a.setAttribute('aria-current', 'page'); else a.removeAttribute('aria-current');
  }
}
addEventListener('hashchange', () => { route(); byId('main').focus(); });
offerLanguage(byId('language'), () => { byId('reply').textContent = t('Language: not changed, there is no connection to the console'); answered = true; });
offerTimes(byId('times'), () => { live.dirty.add('strip'); if (location.hash.startsWith('#chart')) route(); });
keepFocus(byId('top'));
readyForPaper();
route();
show();
