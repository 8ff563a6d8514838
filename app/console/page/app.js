import {byId, element} from '/text.js';
import {know, said, translated} from '/said.js';
import {BenchView} from '/bench.js';
import {offerBenches, showBenches} from '/benches.js';
import {offerComparisons, showComparisons} from '/comparisons.js';
import {withoutMissing} from '/items.js';
import {JogForm} from '/jog.js';
import {LiveView} from '/live.js';
import {endMaking} from '/making.js';
import {Notifier} from '/notify.js';
import {Outcome} from '/outcome.js';
import {Palette} from '/palette.js';
import {QueueView} from '/queue.js';
import {Readiness} from '/readiness.js';
import {StartForm} from '/start.js';
import {stateOf} from '/state.js';
import {ask as send, attach, axes, connected, contact, showBanner, UNCONFIRMED_AFTER_MS} from '/stop.js';
import {offerTimes, timeElement} from '/time.js';
import {offerLanguage, t, translate} from '/language.js';
import {keepFocus} from '/focus.js';
import {readyForPaper} from '/print.js';
import {showChart, showCompare, showMeasurement, showRun, showRuns, statesMayHaveChanged} from '/runs.js';

translate();
const live = new LiveView();
const notifier = new Notifier();
let me = null, maySteer = true, steering = {page: null}, bench = {state: 'on'};
let hadControl = false, answered = false, outdated = null;  // answered: the text in #reply says that all is well, and expires.
const ANSWER_SHOWN_MS = 10_000;
const USE_THE_SWITCH = t('use the switch on the stage');

let dayViews = [];  // The views of a day's work, each with receive(message) and offer(may, idle).

// Types of messages that arrive many times a second: the banner changes once for all messages of 50 ms.
const OFTEN = new Set(['dwell_done', 'log', 'phase', 'stage', 'strip']);
let showing = null;
function showSoon() {
  showing ??= setTimeout(() => { showing = null; show(); }, 50);
}

function receive(message) {
  know(message);
  if (message.type === 'you') {
    me = message.number;
    maySteer = message.may_steer;
    byId('person').hidden = !message.person;
    byId('person-name').textContent = message.person;
    byId('lost-control').replaceChildren();
    // An acceptance from before the connection was lost is outdated; a missing confirmation stays until the next request.
    clearReply();
    if (hadControl) lostControl(t('this page lost its connection'));
  }
  if (message.type === 'control') {
    if (hadControl && message.page !== me) lostControl(message.page === null ? t('nobody has it now') : t`${message.who} has taken it`);
    hadControl = message.page === me;
    if (hadControl) byId('lost-control').replaceChildren();
    steering = message;
  }
  if (message.type === 'snapshot') {
    byId('link').title = message.about.program;
    bench = message.bench ?? {state: 'on'};
  }
  if (message.type === 'bench') bench = message;
  if (endsRequest(message)) clearReply();
  const before = live.activity?.activity;
  live.receive(message);
  notifier.receive(message);
  if (before !== undefined && (message.type === 'snapshot' || live.activity.activity !== before)) statesMayHaveChanged(resume);
  for (const view of dayViews) view.receive(message);
  if (OFTEN.has(message.type)) showSoon(); else show();
}

// Whether a request that was accepted before is over now.
const endsRequest = ({type, activity, stop_asked: stopAsked}) => ['fault', 'finished', 'halt'].includes(type) || (type === 'activity' && (activity === 'idle' || stopAsked));

function clearReply() {
  clearTimeout(outdated);
  if (answered) byId('reply').textContent = '';
}

function contactMayHaveChanged() {
  if (!connected()) { me = null; steering = {page: null}; }
  show();
}

function lostControl(why) {
  hadControl = false;
  byId('lost-control').replaceChildren(t('This page no longer has control: '), why, ' (', timeElement(new Date(), 'clock'), ').');
}

// Values that are not known now are shown differently from those that are.
function show() {
  const there = contact(), known = live.activity !== undefined;
  document.body.classList.toggle('no-contact', !there);
  document.body.classList.toggle('has-run', Boolean(live.run));
  document.body.classList.toggle('running', live.activity?.activity === 'running');
  if (known) document.body.classList.remove('unknown');
  live.setContact(there);
  byId('link').textContent = there ? t('Connected') : t('No contact');
  const state = stateOf({known, activity: live.activity, phase: live.phase, ended: live.ended, fault: live.fault, bench, axes: axes()});
  const {measured, total} = live.progress ?? {};
  showBanner(state, {situation: known, count: total && live.activity?.activity === 'running' ? t`, ${measured} of ${total}` : ''});
  offer(there);
}

// Offers the requests that are possible now. Buttons of another activity are hidden; others that cannot be used show the reason. One
// button is the next step, and looks so.
function offer(there) {
  const steer = there && me !== null && steering.page === me;
  const activity = live.activity ?? {activity: 'idle', hold_asked: false, stop_asked: false}, what = activity.activity;
  const other = steering.page !== null && steering.page !== me, idle = what === 'idle', running = what === 'running';
  const held = running && activity.hold_asked;
  byId('try-demo').disabled = !there || me === null || !maySteer || other || !idle;
  byId('take-control').textContent = steer ? t('Release control') : other ? t('Take control from the other page') : t('Take control');
  const offered = {
    'take-control': [there && me !== null && maySteer, true],
    'do-check': [steer && idle, !running], 'do-start': [steer && idle, !running], 'do-jog': [steer && idle, true],
    'do-hold': [steer && running && !activity.hold_asked && !activity.stop_asked, running && !held],
    'do-continue': [steer && held && !activity.stop_asked, held],
  };
  const next = byId(nextStep(there, steer, idle, held));
  for (const [id, [possible, shown]] of Object.entries(offered)) {
    byId(id).hidden = !shown;
    byId(id).disabled = !possible;
  }
  for (const button of document.querySelectorAll('.next-step')) if (button !== next) button.classList.remove('next-step');
  next?.classList.add('next-step');
  offerHandOver(there);
  const steers = other ? (steering.silent ? t`${steering.who} steers, and does not answer.` : t`${steering.who} steers.`) : '';
  const why = !there ? t('The buttons need contact with the console.')
    : !maySteer ? [steers, t('You may watch and stop; steering needs the right to measure.')].filter(Boolean).join(' ')
      : steers || (!steer ? t('The other buttons need control.')
        : activity.stop_asked ? t('The other buttons wait until the stage is halted.')
          : !idle && !running ? t('The other buttons wait until this is done.') : '');
  if (byId('who-steers').textContent !== why) byId('who-steers').textContent = why;
  const mayResume = steer && idle, {ended} = live;
  outcome.show(ended?.complete && ended.words ? live.run.file.split('/').at(-1) : '', {seen: !running, may: steer && idle});
  for (const view of dayViews) view.offer(steer, idle);
  document.body.classList.toggle('may-resume', mayResume);
  byId('acknowledge').disabled = !mayResume;
  for (const button of document.querySelectorAll('button.resume')) button.disabled = !mayResume;
  for (const control of byId('note-form').elements) control.disabled = !(steer && running);
}

// Who watches, and who asks for control.
function offerHandOver(there) {
  const {page, asks = null, watch = []} = steering, others = watch.filter((one) => one.page !== me);
  const isMine = there && page !== null && page === me && asks !== null;
  byId('asks-control').hidden = !isMine;
  const words = isMine ? t`${asks.who} asks for control.` : '';
  if (byId('asks-words').textContent !== words) byId('asks-words').textContent = words;
  byId('ask-control').hidden = !there || !maySteer || page === null || page === me;
  byId('ask-control').disabled = asks !== null;
  byId('ask-control').textContent = asks?.page === me ? t('Asked for control') : t('Ask for control');
  const names = others.map(({who}) => who).join('; '), watching = there && names ? t`Also on this bench: ${names}.` : '';
  if (byId('who-watches').textContent !== watching) byId('who-watches').textContent = watching;
}

// The button of the next step; empty if there is none, or if another page takes it.
function nextStep(there, steer, idle, held) {
  if (!there || me === null || !maySteer) return '';
  if (idle && readiness.offersDemo && (steer || steering.page === null)) return 'try-demo';
  if (!steer) return steering.page === null ? 'take-control' : '';
  if (idle) return live.interrupted ? 'resume-interrupted' : readiness.needsCheck ? 'do-check' : 'do-start';
  return held ? 'do-continue' : '';
}

// Sends a request, and shows its state: sent, done, refused, or not confirmed. A request that takes time is accepted when it has
// begun; the banner shows its progress.
const DONE_WHEN_ANSWERED = new Set(['control', 'continue', 'acknowledge', 'queue_add', 'queue_move', 'queue_remove', 'queue_repeat', 'queue_pause']);
async function ask(name, request, {moves = true} = {}) {
  const say = (words) => { clearTimeout(outdated); byId('reply').textContent = `${name}: ${words}`; answered = false; };
  const advice = moves ? `: ${USE_THE_SWITCH}` : '';
  say(t('sent'));
  const late = setTimeout(() => say(t`not confirmed after ${UNCONFIRMED_AFTER_MS / 1000} s` + advice), UNCONFIRMED_AFTER_MS);
  const reply = await send(request);
  know(reply);
  clearTimeout(late);
  if (reply.ok) say(DONE_WHEN_ANSWERED.has(request.do) ? t('done') : t('accepted'));
  else if (reply.unsent) say(t`not sent, ${reply.why}` + advice);
  else if (reply.lost) say(t`not confirmed, ${reply.why}` + advice);
  else say(t`refused: ${translated(reply.why) ?? reply.why}`);
  answered = reply.ok;
  if (answered) outdated = setTimeout(clearReply, ANSWER_SHOWN_MS);
  return reply.ok;
}

byId('log-out').addEventListener('click', async () => {
  await fetch('/logout', {method: 'POST'}).catch(() => {});  // The next page shows whether there is contact.
  location.replace('/');
});

// A person's yes, by a dialog that begins at "Cancel".
// more: a form inside it (open(holder, yes)).
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
const readiness = new Readiness(async () => {
  if (steering.page !== me && !(await ask(t('Control'), {do: 'control'}, {moves: false}))) return;
  // The bench reports who steers.
  for (let i = 0; i < 40 && byId('do-start').disabled; ++i) await new Promise((done) => setTimeout(done, 50));
  byId('do-start').click();
}, {loaded: (words) => live.setLoaded(words)});
const outcome = new Outcome(() => byId('do-start').click());
new Palette();
dayViews = [new QueueView(page), new BenchView(page), new JogForm(page), readiness];
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
const answerControl = (key) => () => ask(t('Control'), {do: 'control', [key]: steering.asks?.page ?? 0}, {moves: false});
byId('hand-over').addEventListener('click', answerControl('hand_over_to'));
byId('not-now').addEventListener('click', answerControl('not_to'));
byId('ask-control').addEventListener('click', () => ask(t('Control'), {do: 'control', ask: true}, {moves: false}));
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

byId('acknowledge').addEventListener('click', () => ask(t('Acknowledge'), {do: 'acknowledge', run: live.interrupted.file}, {moves: false}));

// The decoded parts of the address after "#"; none if it cannot be decoded, e.g. "#runs/%E0%A4%A".
function partsOfAddress() {
  try {
    return location.hash.slice(1).split('/').map((part) => decodeURIComponent(part));
  } catch {
    return [];
  }
}

const VIEWS = ['live', 'queue', 'bench', 'runs', 'benches', 'compare', 'comparisons', 'chart', 'life', 'measurements'];
const SHOWN_BY = {life: 'runs', measurements: 'runs'};  // Views that are drawn in the section of another.
function route() {
  endMaking();
  const [view, ...rest] = partsOfAddress();
  const kiosk = view === 'kiosk', known = kiosk || view === '' || (VIEWS.includes(view) && (view !== 'life' || ['item', 'bench'].includes(rest[0])));
  const name = known && view && !kiosk ? view : 'live';
  document.body.classList.remove('loading');
  document.body.classList.toggle('kiosk', kiosk);
  byId('unknown-address').textContent = known ? '' : t`This page has no view with the address ${location.hash}. It shows the view Live.`;
  for (const view of document.querySelectorAll('main > section')) view.hidden = view.id !== `view-${SHOWN_BY[name] ?? name}`;
  for (const a of document.querySelectorAll('nav a')) {
    if (a.hash === `#${name}` && !kiosk) a.setAttribute('aria-current', 'page'); else a.removeAttribute('aria-current');
  }
  if (name === 'runs') rest.length ? showRun(rest[0], rest[1], rest[2]) : showRuns(resume);
  if (name === 'measurements') rest.length ? showMeasurement(rest[0], rest[1]) : showRuns(resume);
  if (name === 'compare') showCompare(rest[0], rest[1]);
  if (name === 'benches') showBenches();
  if (name === 'comparisons') showComparisons();
  if (name === 'life') showRuns(resume, {[rest[0]]: rest[1] ?? ''});
  if (name === 'chart') showChart(rest[0], rest[1]);
}
addEventListener('hashchange', () => { route(); byId('main').focus(); });
// The link to the content stays on the view that is shown: #main is not the address of a view.
document.querySelector('.skip').addEventListener('click', (event) => { event.preventDefault(); byId('main').focus(); });
offerLanguage(byId('language'), () => { byId('reply').textContent = t('Language: not changed, there is no connection to the console'); answered = true; });
offerTimes(byId('times'), () => { live.dirty.add('strip'); if (location.hash.startsWith('#chart')) route(); });
keepFocus(byId('top'));
readyForPaper();
show();
attach({receive, contact: contactMayHaveChanged});
offerBenches();
offerComparisons();
route();
